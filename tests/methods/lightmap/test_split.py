"""Triangles that reach from the scene to the horizon: cut by octaves in the atlas, whole for rays."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scipy

from luxel.kernels.triangle import triangle_count
from luxel.methods.lightmap.flatten.cuts import cut_triangle
from luxel.methods.lightmap.flatten.flat_scene import FlatScene, lay_out
from luxel.methods.lightmap.flatten.octaves import octave_boxes
from luxel.methods.lightmap.flatten.tables import locate
from luxel.methods.lightmap.params import LightmapParams
from luxel.render.renderer import Renderer
from luxel.scene.device import upload
from luxel.scene.library.shapes import box, quad
from luxel.scene.model import Camera, Material, Mesh, Object, SceneData, Sky
from luxel.scene.triangles import Box

CAMERA = Camera((3.0, 2.0, 9.0), (0.0, 1.0, 0.0), fov=60.0)
UNIT = Box(np.zeros(3), np.ones(3))


def plain(half: float, height: float = 0.0) -> Mesh:
    return quad((-half, height, -half), (-half, height, half), (half, height, half), (half, height, -half), 0)


def house_on_plain(half: float = 1000.0) -> SceneData:
    """Return a black house, sunk a little into a black ground of twice `half`, under a sky of radiance 1."""
    objects = [Object("house", [box((-2.0, -0.5, -2.0), (2.0, 3.0, 2.0), 0)]), Object("ground", [plain(half)])]
    black, sky = Material(base_color=(0.0, 0.0, 0.0)), Sky((1.0, 1.0, 1.0))
    return SceneData("plain", objects, [black], cameras=[CAMERA], sky=sky)


def seen_of_wall(p: np.ndarray, wall: np.ndarray) -> np.ndarray:
    """Return the form factor of a polygon (n, 3) from points (N, 3) that face up: Lambert's formula; 0 from behind."""
    total = np.zeros(len(p))
    for start, end in zip(wall, np.roll(wall, -1, axis=0), strict=True):
        a, b = start - p, end - p
        a, b = a / np.linalg.norm(a, axis=1, keepdims=True), b / np.linalg.norm(b, axis=1, keepdims=True)
        across = np.cross(a, b)
        length = np.maximum(np.linalg.norm(across, axis=1), 1e-12)
        total += np.arccos(np.clip((a * b).sum(axis=1), -1.0, 1.0)) * across[:, 1] / length
    return np.maximum(-total / (2.0 * np.pi), 0.0)


def seen_of_house(p: np.ndarray) -> np.ndarray:
    """Return the form factor (N,) of the house's walls from points (N, 3) of the ground."""
    ring = np.array([(2.0, 2.0), (2.0, -2.0), (-2.0, -2.0), (-2.0, 2.0)])
    walls = []
    for (x, z), (u, w) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        walls.append(np.array([(x, 0.0, z), (u, 0.0, w), (u, 3.0, w), (x, 3.0, z)]))
    return sum((seen_of_wall(p, wall) for wall in walls), np.zeros(len(p)))


def places_around(distance: float, count: int = 256) -> np.ndarray:
    """Return points (N, 3) of the ground about `distance` metres before the house's walls."""
    random = np.random.default_rng(3)
    along, side = random.uniform(-2.0, 2.0, count), random.integers(0, 4, count)
    out = 2.0 + distance * random.uniform(0.8, 1.2, count)
    x = np.choose(side, [out, -out, along, along])
    z = np.choose(side, [along, along, out, -out])
    return np.stack([x, np.zeros(count), z], axis=1)


@pytest.fixture(scope="module")
def house() -> Renderer:
    settings = {"texel_target": 8000, "surfel_target": 1024, "rays_per_texel": 256, "probe_target": 64}
    renderer = Renderer(house_on_plain(), "lightmap", settings, size=(32, 24))
    renderer.run(2)
    return renderer


@pytest.mark.parametrize("distance", [0.4, 1.0, 3.0, 10.0, 40.0, 200.0])
def test_ground_beside_a_house_has_the_light_of_the_closed_form(house: Renderer, distance: float) -> None:
    """At one density for all of the ground, texels are metres wide: 0.4 m from the wall light was 1.58 times this."""
    p = places_around(distance)
    wanted = np.pi * (1.0 - seen_of_house(p))
    found = house.irradiance_at(p, np.broadcast_to((0.0, 1.0, 0.0), p.shape))[:, 1]
    assert found.mean() == pytest.approx(wanted.mean(), rel=0.02)
    assert np.sqrt(np.mean((found / wanted - 1.0) ** 2)) < 0.08


def test_rays_meet_the_triangles_that_the_file_has(house: Renderer) -> None:
    data = house_on_plain()
    assert triangle_count(house.scene) == sum(len(mesh.faces) for item in data.objects for mesh in item.meshes)


@pytest.fixture(scope="module")
def flat() -> FlatScene:
    return lay_small(1000.0)


def lay_small(half: float) -> FlatScene:
    return lay_out(upload(house_on_plain(half)), LightmapParams(texel_target=8000), 0)


@pytest.mark.parametrize("half", [1e3, 1e5, 3e7])
def test_places_in_the_atlas_are_those_of_the_points_that_texels_average(half: float) -> None:
    """What is looked up at a point of a whole triangle must lie beside the dense points that are near it in space.

    On a ground as wide as the earth single precision knows points to a metre or two, so texels may be no finer.
    """
    flat = lay_small(half)
    random = np.random.default_rng(1)
    p = np.zeros((4000, 3))
    # As many in each octave of distance.
    radius, angle = 3.0 * 2.0 ** random.uniform(0.0, 8.0, len(p)), random.uniform(0.0, 2.0 * np.pi, len(p))
    p[:, 0], p[:, 2] = radius * np.cos(angle), radius * np.sin(angle)
    prims = np.flatnonzero(np.bincount(flat.faces.prim[flat.faces.octave >= 0]))
    corners = {prim: flat.faces.whole[flat.faces.prim == prim][0] for prim in prims}
    for prim, (a, b, c) in corners.items():
        weights = np.linalg.solve(np.stack([b - a, c - a], axis=1)[[0, 2]], (p - a)[:, [0, 2]].T).T
        held = (weights.min(axis=1) > 0.0) & (weights.sum(axis=1) < 1.0)
        place = mi.Point2f(np.ascontiguousarray(weights[held].T, np.float32))
        count = int(held.sum())
        back = dr.full(mi.Bool, False, count)
        uv, found = locate(flat.tables, dr.full(mi.UInt32, int(prim), count), back, place, ~back)
        assert np.array(found).all() and count > 100
        gap, nearest = scipy.spatial.KDTree(flat.points.xy).query(np.array(uv).T)
        assert gap.max() < 1.0
        density = np.sqrt(flat.weight / flat.points.area)[nearest]
        apart = np.linalg.norm(flat.points.p[nearest] - p[held], axis=1)
        rounding = 4.0 * half * 2.0**-24  # of barycentric weights in single precision, however a device adds them up
        assert ((apart - rounding) * density / flat.atlas.texel_size).max() < 1.5


def test_ground_beside_the_house_is_as_fine_as_the_house(flat: FlatScene) -> None:
    near = (np.abs(flat.points.p[:, [0, 2]]) < 2.5).all(axis=1) & (np.abs(flat.points.p[:, 1]) < 0.01)
    assert flat.points.area[near].mean() == pytest.approx((flat.atlas.texel_size / 4.0) ** 2, rel=0.2)


def test_ground_of_many_triangles_is_fine_beside_the_house_too() -> None:
    """Small triangles are not cut, but go to charts by where they begin: some reach out of the first octave."""
    steps = 3.0 * np.sign(np.arange(-14, 15)) * (2.0 ** (np.abs(np.arange(-14, 15)) * 0.6) - 1.0)
    x, z = np.meshgrid(steps, steps, indexing="ij")
    positions = np.stack([x, 0.0 * x, z], axis=2).reshape(-1, 3).astype(np.float32)
    i, j = (index.ravel() for index in np.meshgrid(np.arange(28), np.arange(28), indexing="ij"))
    corner = i * 29 + j
    rows = np.concatenate([[corner, corner + 1, corner + 30], [corner, corner + 30, corner + 29]], axis=1).T
    data = house_on_plain()
    data.objects[1] = Object("ground", [Mesh(positions, rows.astype(np.uint32), 0)])
    flat = lay_out(upload(data), LightmapParams(texel_target=8000), 0)
    near = (np.abs(flat.points.p[:, [0, 2]]) < 2.5).all(axis=1) & (np.abs(flat.points.p[:, 1]) < 0.01)
    assert (flat.faces.octave < 0).all()
    assert flat.points.area[near].mean() < 2.0 * (flat.atlas.texel_size / 4.0) ** 2


@pytest.mark.parametrize(
    "corners",
    [
        [(-40.0, 0.5, -30.0), (50.0, 0.5, -20.0), (0.0, 0.5, 60.0)],
        [(-40.0, -9.0, 3.0), (50.0, 20.0, -20.0), (0.0, 0.5, 60.0)],
        [(0.5, 0.5, 0.5), (200.0, 0.5, 0.5), (200.0, 0.5, 1.0)],
        [(100.0, 0.0, 0.0), (101.0, 300.0, 0.0), (100.0, 0.0, 300.0)],
    ],
    ids=["flat", "steep", "needle", "away"],
)
def test_parts_are_the_whole_without_gaps(corners: list[tuple[float, float, float]]) -> None:
    triangle, boxes = np.array(corners), octave_boxes(UNIT, 9)
    parts, octave = cut_triangle(triangle, boxes, 0)
    placed = parts @ triangle
    flat = np.cross(placed[:, 1] - placed[:, 0], placed[:, 2] - placed[:, 0])
    whole = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
    # All the same way round, and no more or less than the triangle.
    assert (flat @ whole > 0.0).all()
    assert flat.sum(axis=0) == pytest.approx(whole, rel=1e-9, abs=1e-6)
    for number in range(int(octave.max()) + 1):
        held = placed[octave == number].reshape(-1, 3)
        away = np.maximum(-held, held - 1.0).max(axis=1)
        ends = [3.0**0.5 * (2.0**step - 0.9) for step in (number - 1, number)]
        assert (away <= ends[1] + 1e-5).all()
        # A part may begin within the last box where only its hull does, so its middle tells.
        middle = placed[octave == number].mean(axis=1)
        assert number == 0 or (np.maximum(-middle, middle - 1.0).max(axis=1) > ends[0] - 1e-5).all()
    # Corner to corner: each edge belongs to two parts, or lies on the triangle's own border.
    _, vertex = np.unique(np.round(parts.reshape(-1, 3), 9), axis=0, return_inverse=True)
    vertex = vertex.reshape(-1, 3)
    edges = np.sort(np.stack([vertex, np.roll(vertex, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    used, first, times = np.unique(edges, axis=0, return_index=True, return_counts=True)
    assert times.max() <= 2
    ends_of = np.stack([parts, np.roll(parts, -1, axis=1)], axis=2).reshape(-1, 2, 3)[first[times == 1]]
    assert (ends_of.max(axis=1).min(axis=1) < 1e-9).all() or (np.abs(ends_of).max(axis=1).min(axis=1) < 1e-7).all()
