"""Rays that leave surfaces, judged by arithmetic: a closed box lets none out, wherever and however large it is."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.direct import direct_irradiance
from luxel.kernels.sampling import cosine_hemisphere, to_world
from luxel.kernels.surface import surface_at, surface_at_hit
from luxel.kernels.trace import offset_origin, trace_closest, trace_occluded
from luxel.kernels.triangle import triangle_count
from luxel.scene.device import Scene, set_time, upload
from luxel.scene.library.shapes import quad, translation
from luxel.scene.model import Light, Material, Mesh, Object, SceneData, Texture

RAYS = 100_000
SIZES = (1e-5, 1e-3, 1.0, 1e2, 1e4)
ESCAPES = 3
"""Rays in `RAYS` that Embree may let out between two triangles, far from corners: it tests each by itself."""


def closed_box(parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Return corners (V, 3) and faces of a closed box of side 1 about the origin that faces inwards."""
    corners, faces, start = [], [], 0
    line = np.linspace(-0.5, 0.5, parts + 1)
    number = np.arange((parts + 1) ** 2).reshape(parts + 1, parts + 1)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    pairs = np.concatenate([np.stack(three, -1).reshape(-1, 3) for three in ((a, b, c), (a, c, d))])
    for axis in range(3):
        for end in (-0.5, 0.5):
            side = np.full((parts + 1, parts + 1, 3), end)
            side[..., (axis + 1) % 3], side[..., (axis + 2) % 3] = np.meshgrid(line, line, indexing="ij")
            corners.append(side.reshape(-1, 3))
            faces.append((pairs if end < 0.0 else pairs[:, ::-1]) + start)
            start += len(corners[-1])
    return np.concatenate(corners), np.concatenate(faces).astype(np.uint32)


def turn(seed: int = 3) -> np.ndarray:
    matrix, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return matrix * np.sign(np.linalg.det(matrix))


def boxed(points: np.ndarray, faces: np.ndarray, **settings: object) -> Scene:
    return upload(SceneData("box", [Object("box", [Mesh(points.astype(np.float32), faces)], **settings)], [Material()]))  # type: ignore[arg-type]


def weights(kind: str, rng: np.random.Generator) -> np.ndarray:
    """Return weights (RAYS, 2) of points anywhere on a triangle, or on and very near its edges."""
    three = rng.dirichlet([1, 1, 1], RAYS)
    if kind == "edges":
        share = np.where(rng.random(RAYS) < 0.3, 0.0, 10.0 ** rng.uniform(-9, -2, RAYS))
        edge, row = rng.integers(0, 3, RAYS), np.arange(RAYS)
        three[row, edge] = 0.0
        three *= ((1.0 - share) / three.sum(axis=1))[:, None]
        three[row, edge] = share
    return three[:, 1:].T.astype(np.float32)


def leaving(scene: Scene, kind: str, seed: int = 1) -> tuple[int, int, int]:
    """Return how many of `RAYS` cosine rays meet their own triangle, miss all, or meet a back."""
    rng = np.random.default_rng(seed)
    count = triangle_count(scene)
    prim, every = mi.UInt32(rng.integers(0, count, RAYS).astype(np.uint32)), dr.full(mi.Bool, True, RAYS)
    sample = rng.random((2, RAYS))
    if kind == "grazing":
        sample[0] = 1.0 - 10.0 ** rng.uniform(-8, 0, RAYS)
    surface = surface_at(scene, prim, mi.Point2f(weights(kind, rng)), every)
    direction = to_world(surface.n_geometric, cosine_hemisphere(mi.Point2f(sample.astype(np.float32))))
    hit = trace_closest(scene, offset_origin(scene, surface.p, surface.n_geometric), direction, every)
    met = surface_at_hit(scene, hit, direction)
    own, out, back = hit.valid & (hit.prim_id == prim), ~hit.valid, hit.valid & ~met.front
    return tuple(int(np.array(which).sum()) for which in (own, out, back))  # type: ignore[return-value]


# ------------------------------------------------------------------------------------------------ leaving surfaces


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("size", SIZES)
def test_no_ray_leaves_a_closed_box(size: float, turned: bool) -> None:
    points, faces = closed_box(3)
    points = points @ turn().T if turned else points
    for kind in ("anywhere", "edges", "grazing"):
        own, out, back = leaving(boxed(size * points, faces), kind)
        assert own == 0 and back <= ESCAPES and out <= ESCAPES, (kind, own, out, back)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("away", [10.0, 1e3, 1e4])
def test_no_ray_leaves_a_box_far_from_the_origin(away: float, turned: bool) -> None:
    points, faces = closed_box(5)
    points = points @ turn().T if turned else points
    for step in ((1.0, 0.0, 0.0), (0.6, -1.0, 0.3)):
        for kind in ("anywhere", "edges", "grazing"):
            own, out, back = leaving(boxed(2.0 * points + away * np.array(step), faces), kind)
            # In one place of 10 km a step is a millimetre: corners of the box are not where they should be.
            assert own == 0 and out + back <= (ESCAPES if away < 1e4 else 20), (kind, own, out, back)


def test_a_point_near_the_origin_may_lie_on_a_large_triangle() -> None:
    corners = np.array([[-900.0, -350.0, 1000.0], [1100.0, 420.0, 900.0], [-100.0, -30.0, -1000.0]])
    scene = boxed(corners, np.array([[0, 1, 2]], np.uint32))
    inverse = np.linalg.inv(np.vstack([corners[:, ::2].T, np.ones(3)]))
    rng = np.random.default_rng(1)
    share = (inverse @ np.vstack([rng.uniform(-0.02, 0.02, (2, RAYS)), np.ones(RAYS)]))[1:].astype(np.float32)
    every = dr.full(mi.Bool, True, RAYS)
    for back in (False, True):
        surface = surface_at(scene, mi.UInt32(0), mi.Point2f(share), every, back=back)
        assert np.abs(np.array(surface.p)).max() < 3.0
        direction = to_world(
            surface.n_geometric, cosine_hemisphere(mi.Point2f(rng.random((2, RAYS)).astype(np.float32)))
        )
        origin = offset_origin(scene, surface.p, surface.n_geometric)
        assert not np.array(trace_occluded(scene, origin, direction, mi.Float(1e6), every)).any()


@pytest.mark.parametrize("one_accel", [False, True])
@pytest.mark.parametrize("carried", ["far by its matrix", "back by its matrix"])
def test_no_ray_leaves_a_box_that_moves(carried: str, one_accel: bool) -> None:
    """Its points are rounded in its own space and in the world, and by the way from one to the other."""
    points, faces = closed_box(2)
    matrix = translation(700.0, -300.0, 500.0)
    matrix[:3, :3] = turn(5) * 1.5
    if carried.startswith("back"):
        points = points + np.array([700.0, -300.0, 500.0])
        matrix[:3, 3] = -matrix[:3, :3] @ [700.0, -300.0, 500.0] + 0.3
    data = SceneData(
        "box", [Object("box", [Mesh(points.astype(np.float32), faces)], motion=lambda _: matrix)], [Material()]
    )
    scene = upload(data, one_accel=one_accel)
    set_time(scene, 0.5)
    for kind in ("anywhere", "edges", "grazing"):
        own, out, back = leaving(scene, kind)
        assert own == 0 and out + back <= 20, (kind, own, out, back)


def points_of_moving_box(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points on edges and faces of a unit box placed by `matrix`: exact, (N, 3), and as surfaces have them."""
    points, faces = closed_box(1)
    box = Object("box", [Mesh(points.astype(np.float32), faces)], motion=lambda _: matrix)
    scene = upload(SceneData("panel", [box], [Material()]))
    prim = np.repeat(np.arange(len(faces)), 3)
    share = np.tile([[0.33, 1e-6], [0.33, 0.5], [0.0, 0.4]], (len(faces), 1)).astype(np.float32)
    every = dr.full(mi.Bool, True, len(prim))
    surface = surface_at(scene, mi.UInt32(prim.astype(np.uint32)), mi.Point2f(share.T), every)
    three = np.column_stack([1.0 - share.sum(axis=1, dtype=float), share])
    exact = np.einsum("nk,nkj->nj", three, points[faces[prim]]) @ matrix[:3, :3].T + matrix[:3, 3]
    return exact, np.array(surface.p).T


@pytest.mark.parametrize("away", [0.0, 100.0])
@pytest.mark.parametrize("sides", [(10.0, 1e-3, 10.0), (1.0, 1000.0, 1.0), (1e-3, 1.0, 5.0)])
def test_points_stay_on_what_is_stretched_as_it_moves(sides: tuple[float, float, float], away: float) -> None:
    """A panel of 10 m and 1 mm, say: no side of it is rounded more coarsely than the world is there."""
    matrix = translation(away, 0.0, 0.0)
    matrix[:3, :3] = turn(5) @ np.diag(sides)
    exact, found = points_of_moving_box(matrix)
    # Sideways from two edges and off the plane, at 8 roundings each.
    farthest = away + np.linalg.norm(sides)
    assert np.linalg.norm(found - exact, axis=1).max() < 40.0 * 2.0**-24 * farthest


@pytest.mark.parametrize("sides", [(10.0, 1e-2, 10.0), (1.0, 300.0, 1.0)])
def test_no_ray_leaves_a_box_that_is_stretched_as_it_moves(sides: tuple[float, float, float]) -> None:
    points, faces = closed_box(2)
    matrix = translation(70.0, -30.0, 50.0)
    matrix[:3, :3] = turn(5) @ np.diag(sides)
    box = Object("box", [Mesh(points.astype(np.float32), faces)], motion=lambda _: matrix)
    scene = upload(SceneData("box", [box], [Material()]))
    for kind in ("anywhere", "edges", "grazing"):
        own, out, back = leaving(scene, kind)
        # Rays are tested in the object's own space, where the box is a cube and rays lie nearly along a plane.
        assert own == 0 and out + back <= (40 if kind == "edges" else 5), (kind, own, out, back)


@pytest.mark.parametrize("far", [0.0, 1e3, 3e4])
def test_a_lamp_stored_far_off_and_brought_back_is_not_in_its_own_way(far: float) -> None:
    """A turned square of radiance 1 whose vertices lie far away in their own space: it is rounded there."""
    half, height = 0.5, 2.0
    h = half
    lamp = quad((-h, height, -h), (h, height, -h), (h, height, h), (-h, height, h), 1)
    matrix = np.eye(4)
    matrix[:3, :3] = turn(4)
    matrix[:3, 3] = matrix[:3, :3] @ np.array([-far, 0.7 * far, far])
    lamp.positions = (lamp.positions.astype(np.float64) @ matrix[:3, :3] + [far, -0.7 * far, -far]).astype(np.float32)
    moving = Object("lamp", [lamp], motion=lambda _: matrix)
    data = SceneData(
        "lamp", [Object("floor", sheets(4.0, [0.0])), moving], [Material(), Material(emission=(1.0, 1.0, 1.0))]
    )
    scene = upload(data)
    every = dr.full(mi.Bool, True, RAYS)
    surface = surface_at(scene, mi.UInt32(0), mi.Point2f(0.0, 0.5), every)
    found = np.array(direct_irradiance(scene, surface, mi.UInt32(7), dr.arange(mi.UInt32, RAYS), every))[0].mean()
    x = half / height
    exact = 4.0 * x / np.sqrt(1.0 + x * x) * np.arctan(x / np.sqrt(1.0 + x * x))
    # At 30 km its vertices are millimetres off.
    assert found == pytest.approx(exact, rel=0.02)


# --------------------------------------------------------------------------------------- what lies close to something


def sheets(size: float, heights: list[float], material: int = 0) -> list[Mesh]:
    s = 0.5 * size
    return [quad((-s, y, s), (s, y, s), (s, y, -s), (-s, y, -s), material) for y in heights]


@pytest.mark.parametrize("size", [2.0, 1e4])
def test_a_sheet_a_centimetre_above_another_keeps_it_dark(size: float) -> None:
    lamp = Light("directional", (1.0, 1.0, 1.0), direction=(0.2, -1.0, 0.1))
    scene = upload(SceneData("two", [Object("two", sheets(size, [0.0, 0.01]))], [Material()], lights=[lamp]))
    rng, every = np.random.default_rng(1), dr.full(mi.Bool, True, RAYS)
    places = mi.Point2f(0.9 * weights("anywhere", rng))
    for prim, lit in ((0, False), (2, True)):
        surface = surface_at(scene, mi.UInt32(prim), places, every)
        found = np.array(direct_irradiance(scene, surface, mi.UInt32(1), dr.arange(mi.UInt32, RAYS), every))
        assert (found > 0.0).all() if lit else not found.any()


@pytest.mark.parametrize("away", [0.0, 100.0, 1000.0])
def test_a_lamp_a_centimetre_below_the_ceiling_is_not_in_its_own_way(away: float) -> None:
    """A square of radiance 1 straight above, against the closed form; the ceiling beside it gets next to nothing."""
    half, height = 0.5, 2.0
    h = half
    lamp = quad((-h, height, -h), (h, height, -h), (h, height, h), (-h, height, h), 1)
    meshes = [*sheets(4.0, [0.0]), lamp, *sheets(4.0, [height + 0.01])]
    for mesh in meshes:
        mesh.positions = (mesh.positions + np.array([away, -away, 0.5 * away])).astype(np.float32)
    scene = upload(SceneData("lamp", [Object("all", meshes)], [Material(), Material(emission=(1.0, 1.0, 1.0))]))
    every = dr.full(mi.Bool, True, RAYS)
    surface = surface_at(scene, mi.UInt32(0), mi.Point2f(0.0, 0.5), every)
    found = np.array(direct_irradiance(scene, surface, mi.UInt32(7), dr.arange(mi.UInt32, RAYS), every))[0].mean()
    # Four rectangles that meet above the point, each a corner's form factor (Howell, C-11).
    x = half / height
    exact = 4.0 * x / np.sqrt(1.0 + x * x) * np.arctan(x / np.sqrt(1.0 + x * x))
    assert found == pytest.approx(exact, rel=0.01)


def masked(alpha: np.ndarray) -> Material:
    image = np.ones((*alpha.shape, 4), np.float32)
    image[..., 3] = alpha
    return Material(base_color_texture=Texture(image, srgb=False), alpha_mode="mask")


@pytest.mark.parametrize("away", [0.0, 100.0, 1e4])
@pytest.mark.parametrize("one_accel", [False, True])
def test_a_ray_goes_on_behind_holes_to_the_next_sheet(away: float, one_accel: bool) -> None:
    """Forty sheets of holes, a little apart, before one that is solid: it is met, and at its distance."""
    apart = max(1e-5, 64.0 * float(np.spacing(np.float32(away))))
    holes = sheets(20.0, [1.0 - apart * number for number in range(40)], 1)
    solid = sheets(20.0, [1.0 - apart * 40], 0)
    for mesh in [*holes, *solid]:
        mesh.positions = (mesh.positions + np.array([away, away, 0.0])).astype(np.float32)
    data = SceneData("holes", [Object("all", [*holes, *solid])], [Material(), masked(np.zeros((2, 2)))])
    scene = upload(data, one_accel=one_accel)
    rng = np.random.default_rng(2)
    origin = rng.uniform(-0.4, 0.4, (RAYS // 10, 3)) + [away, away + 2.0, 0.0]
    target = rng.uniform(-0.4, 0.4, (RAYS // 10, 3)) * [1, 0, 1] + [away, away + 1.0, 0.0]
    way = target - origin
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    o, d = mi.Point3f(origin.T.astype(np.float32)), mi.Vector3f(way.T.astype(np.float32))
    hit = trace_closest(scene, o, d, dr.full(mi.Bool, True, len(origin)))
    first = 0 if scene.groups[0].prim_count == 2 and not scene.groups[0].cutout else None
    assert first == 0 and (np.array(hit.prim_id) < 2).all() and np.array(hit.valid).all()
    y = float(solid[0].positions[0, 1])
    exact = (y - np.array(o.y, float)) / np.array(d.y, float)
    np.testing.assert_allclose(np.array(hit.t), exact, rtol=1e-5, atol=32.0 * float(np.spacing(np.float32(away))))
