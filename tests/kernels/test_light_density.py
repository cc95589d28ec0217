"""How likely the light sampler was to take a place that another sampler met: densities, against sums and counts.

Points of triangles, angles and integrals are made in NumPy, in float64; the sky's own table has `test_sky_sampling.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scipy.stats

from luxel.kernels.direct import choose_light, draw_light, emitter_density, sample_each, shadow_light, sun_light
from luxel.kernels.light_sample import LightSample, balance
from luxel.kernels.light_tree import source_probability
from luxel.kernels.records import Surface
from luxel.kernels.sampling import cosine_hemisphere, random_2d, to_world
from luxel.kernels.surface import surface_at_hit
from luxel.kernels.trace import offset_origin, trace_closest
from luxel.scene import live
from luxel.scene.device import Scene, set_time, upload
from luxel.scene.library.shapes import box, quad, rotation, translation
from luxel.scene.lights import DELTA_EACH_LIMIT, ENTRY_IS_DELTA, NO_ENTRY
from luxel.scene.model import Light, Material, Mesh, Object, SceneData

SAMPLES = 1 << 16
CELLS = 8
"""A triangle is looked at in so many cells squared."""
FLOOR = quad((-4, 0, 4), (4, 0, 4), (4, 0, -4), (-4, 0, -4), 0)
LAMP, DIM = Material(emission=(3.0, 3.0, 3.0)), Material(emission=(0.4, 0.2, 0.1), emit_back=True)
TURNED = translation(0.3, 0.2, -0.4) @ rotation("z", 25.0) @ np.diag([-1.4, 0.8, 1.1, 1.0])
"""Turned, stretched and mirrored."""


def panel(height: float, x: float, size: float, material: int) -> Mesh:
    """Return a square that faces down."""
    low, high = x - size, x + size
    return quad((low, height, -size), (high, height, -size), (high, height, size), (low, height, size), material)


def lamps(*lights: Light, moving: bool = False) -> Scene:
    """Return a floor under a near, a far and a dim panel, and a wall that glows on both sides."""
    near, far, dim = panel(1.0, 0.0, 0.8, 1), panel(3.0, 2.0, 0.1, 1), panel(2.0, -2.0, 0.3, 2)
    wall = quad((-3, 0, -1), (-3, 2, -1), (-3, 2, 1), (-3, 0, 1), 2)
    objects = [Object("floor", [FLOOR]), Object("panels", [near, far, dim, wall])]
    if moving:
        objects[1] = Object("panels", [near, far, dim, wall], motion=lambda _: TURNED)
    scene = upload(SceneData("lamps", objects, [Material(), LAMP, DIM], lights=list(lights)))
    if moving:
        set_time(scene, 1.0)
    return scene


def lamp_posts() -> list[Light]:
    rng = np.random.default_rng(4)
    posts = [Light("point", (0.5, 0.5, 0.5), tuple(rng.uniform((-3, 1, -3), (3, 3, 3)))) for _ in range(11)]
    return [*posts, Light("spot", (9.0, 9.0, 9.0), (1.0, 3.0, 0.0), (0.0, -1.0, 0.0), 0.9, 0.7)]


def suns(count: int, in_sky: bool = True, diameter: float = 20.0) -> list[Light]:
    return [
        Light("directional", (1.0, 2.0, 3.0), direction=(0.2 * index, -1.0, 0.1), angular_diameter=diameter,
              in_sky=in_sky)
        for index in range(count)
    ]  # fmt: skip


SCENES: dict[str, Callable[[], Scene]] = {
    "panels": lamps,
    "panels that move": lambda: lamps(moving=True),
    "panels and lamps": lambda: lamps(*lamp_posts()),
    "suns, panels and lamps": lambda: lamps(*suns(DELTA_EACH_LIMIT + 2), *lamp_posts()),
    "suns alone": lambda: lamps_only(*suns(DELTA_EACH_LIMIT + 2)),
}
EACH = pytest.mark.parametrize("name", SCENES)
PLACES = [((0.2, 0.0, 0.1), (0.0, 1.0, 0.0)), ((-1.5, 0.4, 0.6), (0.6, 0.8, 0.0)), ((0.1, 0.93, 0.0), (0.0, 1.0, 0.0))]
"""The last one is so near to a panel that its triangles fill most of the view."""


def lamps_only(*lights: Light) -> Scene:
    return upload(SceneData("lit", [Object("floor", [FLOOR])], [Material()], lights=list(lights)))


def free(place: tuple, width: int) -> Surface:
    p, n = (mi.Point3f(*place[0]), mi.Normal3f(*place[1]))
    return Surface.at(p, n, active=dr.full(mi.Bool, True, width))


def draw(scene: Scene, surface: Surface, seed: int = 1) -> LightSample:
    lane = dr.arange(mi.UInt32, SAMPLES)
    active = dr.full(mi.Bool, True, SAMPLES)
    pick = random_2d(mi.UInt32(seed), lane).x
    return draw_light(scene, surface, pick, random_2d(mi.UInt32(seed + 1), lane), active)


def entries_of(scene: Scene) -> np.ndarray:
    entries = np.array(scene.lights.entries)
    return entries[entries != NO_ENTRY]


def corners_of(scene: Scene, prim: int) -> np.ndarray:
    """Return a triangle's corners (3, 3) in the world, float64."""
    rows = np.array(scene.geometry.triangles).reshape(-1, 4)[prim].astype(int)
    corners = np.array(scene.geometry.vertices).reshape(-1, 4)[rows[:3], :3].astype(float)
    if not scene.features.moving:
        return corners
    return corners @ TURNED[:3, :3].T + TURNED[:3, 3] if rows[3] >> 16 == 2 else corners


def probabilities(scene: Scene, place: tuple) -> dict[int, float]:
    entries = entries_of(scene)
    surface = free(place, len(entries))
    chance = source_probability(scene, surface.p, surface.n_shading, mi.UInt32(entries), mi.Bool(True))
    return dict(zip(entries.tolist(), np.broadcast_to(np.array(chance, float), len(entries)).tolist(), strict=True))


def cells_of_triangle(scene: Scene, prim: int, place: tuple) -> np.ndarray:
    """Return the integral of the density over each cell's directions, (CELLS, CELLS): 12 x 12 points a cell.

    Cells are squares of (root of 1 - weight of the first corner, share along the opposite edge).
    """
    fine = 12 * CELLS
    root, share = (grid.ravel() for grid in np.meshgrid(*2 * [(np.arange(fine) + 0.5) / fine], indexing="ij"))
    a, b, c = corners_of(scene, prim)
    y = a + root[:, None] * ((b - a) * (1.0 - share)[:, None] + (c - a) * share[:, None])
    face = np.cross(b - a, c - a)
    offset = y - np.array(place[0])
    squared = (offset**2).sum(axis=1)
    area = root * np.linalg.norm(face) / fine**2
    angle = area * np.abs(offset @ face) / np.linalg.norm(face) / squared**1.5
    surface = free(place, len(y))
    density = emitter_density(scene, surface, mi.UInt32(prim), mi.Point3f(*y.T.astype(np.float32)), surface.active)
    return (np.array(density, float) * angle).reshape(CELLS, 12, CELLS, 12).sum(axis=(1, 3))


@EACH
@pytest.mark.parametrize("place", PLACES)
def test_all_that_is_drawn_adds_up_to_one(name: str, place: tuple) -> None:
    """Over the directions to triangles and the sky's discs, and over the lights without size."""
    scene = SCENES[name]()
    chances = probabilities(scene, place)
    total = 0.0
    for entry, chance in chances.items():
        if entry & ENTRY_IS_DELTA:
            total += chance
        else:
            cells = cells_of_triangle(scene, entry, place)
            assert cells.sum() == pytest.approx(chance, rel=0.01, abs=1e-5)
            total += cells.sum()
    assert total == pytest.approx(1.0, abs=0.005) and max(chances.values()) < 1.0


@EACH
@pytest.mark.parametrize("place", PLACES)
def test_samples_tell_the_density_that_their_place_has(name: str, place: tuple) -> None:
    scene = SCENES[name]()
    surface = free(place, SAMPLES)
    drawn = draw(scene, surface)
    source, told = np.array(drawn.source), np.array(drawn.density, float)
    weight = np.array(drawn.weight, float)
    on_triangle = (source & ENTRY_IS_DELTA == 0) & (weight > 0.0)
    met = np.array(emitter_density(scene, surface, drawn.source, drawn.point, mi.Bool(on_triangle)), float)
    if scene.lights.has_triangles:
        assert on_triangle.mean() > 0.1
        np.testing.assert_allclose(met[on_triangle], told[on_triangle], rtol=2e-3)
        np.testing.assert_allclose(weight[on_triangle] * told[on_triangle], 1.0, rtol=1e-4)
    # A lamp has no density, and a weight of one over its probability.
    rows, chances = source & (ENTRY_IS_DELTA - 1), probabilities(scene, place)
    kinds = np.array([light.kind for light in scene.host.data.lights] or ["none"])
    lamp = (source & ENTRY_IS_DELTA != 0) & (weight > 0.0)
    lamp[lamp] = kinds[rows[lamp]] != "directional"
    assert not told[lamp].any()
    right = [1.0 / chances[int(entry)] for entry in source[lamp]]
    np.testing.assert_allclose(weight[lamp], right, rtol=1e-4)


@EACH
def test_counts_follow_the_density(name: str) -> None:
    """Chi-square over cells of triangles and over the other lights."""
    place = PLACES[0]
    scene = SCENES[name]()
    drawn = draw(scene, free(place, SAMPLES))
    source, point = np.array(drawn.source), np.array(drawn.point, float).T
    expected, counted = [], []
    for entry, chance in probabilities(scene, place).items():
        own = source == entry
        if entry & ENTRY_IS_DELTA:
            expected.append(np.array([chance]))
            counted.append(np.array([own.sum()]))
            continue
        a, b, c = corners_of(scene, entry)
        weights = np.linalg.lstsq(np.stack([b - a, c - a], axis=1), (point[own] - a).T, rcond=None)[0]
        root = weights.sum(axis=0)
        place_of = np.stack([root, weights[1] / np.maximum(root, 1e-9)]).clip(0.0, 1.0 - 1e-9)
        cell = (place_of * CELLS).astype(int)
        expected.append(cells_of_triangle(scene, entry, place).ravel())
        counted.append(np.bincount(cell[0] * CELLS + cell[1], minlength=CELLS**2))
    right, found = SAMPLES * np.concatenate(expected), np.concatenate(counted)
    few = right < 10.0
    right, found = np.append(right[~few], right[few].sum()), np.append(found[~few], found[few].sum())
    right, found = right[right > 1.0], found[right > 1.0]
    # Cells are integrated to a percent, which counts as much as chance where most samples fall.
    chi_square = ((found - right) ** 2 / np.maximum(right, (0.01 * right) ** 2)).sum()
    assert len(right) > 1 and scipy.stats.chi2.sf(chi_square, len(right) - 1) > 1e-4


@pytest.mark.parametrize("count", [1, DELTA_EACH_LIMIT + 2])
def test_rays_into_a_disc_know_how_likely_a_sample_was(count: int) -> None:
    """A cap has 2 pi (1 - cos r) steradians; a sun has a ray of its own or shares one by the tree."""
    scene = lamps_only(*suns(count))
    place = PLACES[0]
    surface = free(place, SAMPLES)
    angle = 2.0 * math.pi * (1.0 - math.cos(math.radians(10.0)))
    chances = probabilities(scene, place)
    for index in range(count):
        middle = -np.array(scene.host.data.lights[index].direction)
        middle /= np.linalg.norm(middle)
        radiance, density = sun_light(scene, surface, index, mi.Vector3f(*middle.tolist()), mi.Bool(True))
        chance = 1.0 if index < DELTA_EACH_LIMIT else chances[index | ENTRY_IS_DELTA]
        assert np.array(density, float).max() == pytest.approx(chance / angle, rel=1e-4)
        right = np.array([1.0, 2.0, 3.0]) / (math.pi * math.sin(math.radians(10.0)) ** 2)
        np.testing.assert_allclose(np.array(radiance)[:, 0], right, rtol=1e-4)
        beside = np.cross(middle, (1.0, 0.0, 0.0)) + 2.0 * middle
        beside /= np.linalg.norm(beside)
        radiance, density = sun_light(scene, surface, index, mi.Vector3f(*beside.tolist()), mi.Bool(True))
        assert not np.array(radiance).any() and not np.array(density).any()
    lane = dr.arange(mi.UInt32, SAMPLES)
    own = sample_each(scene, surface, 0, mi.UInt32(3), lane, mi.Bool(True))
    np.testing.assert_allclose(np.array(own.density), 1.0 / angle, rtol=1e-4)
    np.testing.assert_allclose(np.array(own.density) * np.array(own.weight), 1.0, rtol=1e-4)
    _, met = sun_light(scene, surface, 0, own.direction, mi.Bool(True))
    # A sample on the rim may be rounded out of the disc.
    assert (np.abs(np.array(met) * angle - 1.0) < 1e-4).mean() > 0.999


def test_suns_that_no_ray_meets_have_no_density() -> None:
    for hidden in (suns(1, in_sky=False), suns(1, diameter=0.0)):
        scene = lamps_only(*hidden)
        sample = sample_each(scene, free(PLACES[0], 1), 0, mi.UInt32(3), mi.UInt32(0), mi.Bool(True))
        assert not np.array(sample.density).any() and np.array(sample.weight).all()
        assert float(np.array(balance(sample.density, mi.Float(7.0))).max()) == 1.0


def test_what_is_not_sampled_has_no_density() -> None:
    scene = lamps(*lamp_posts())
    surface = free(PLACES[0], 1)
    for prim in (0, 1, NO_ENTRY):
        density = emitter_density(scene, surface, mi.UInt32(prim), mi.Point3f(1.0, 0.0, 0.0), mi.Bool(prim < 2))
        assert not np.array(density).any()
    chance = source_probability(scene, surface.p, surface.n_shading, mi.UInt32(NO_ENTRY), mi.Bool(True))
    assert not np.array(chance).any()
    dark = upload(SceneData("dark", [Object("floor", [FLOOR])], [Material()]))
    assert not np.array(emitter_density(dark, surface, mi.UInt32(0), mi.Point3f(1.0, 0.0, 0.0), mi.Bool(True))).any()


def test_densities_follow_an_edit_of_the_lights() -> None:
    scene = lamps(*lamp_posts())
    before = probabilities(scene, PLACES[0])
    live.set_lights(scene, [*suns(DELTA_EACH_LIMIT + 1), *lamp_posts()[:5]])
    after = probabilities(scene, PLACES[0])
    assert sum(before.values()) == pytest.approx(1.0, abs=1e-5) == pytest.approx(sum(after.values()), abs=1e-5)
    assert before.keys() != after.keys()


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("place", PLACES)
def test_two_samplers_share_a_light_by_the_balance_heuristic(place: tuple, moving: bool) -> None:
    """Rays by the cosine find the panels too: both together bring what a sum over the panels' points does."""
    scene = lamps(moving=moving)
    surface, lane = free(place, SAMPLES), dr.arange(mi.UInt32, SAMPLES)

    def cosine(direction: mi.Vector3f) -> mi.Float:
        return dr.fmax(dr.dot(surface.n_geometric, direction), 0.0)

    def shared(direction: mi.Vector3f, density: mi.Float) -> mi.Float:
        return cosine(direction) * balance(density, cosine(direction) * dr.inv_pi)

    origin = offset_origin(scene, surface.p, surface.n_geometric)
    sample = choose_light(scene, surface, mi.UInt32(5), lane, surface.active, cosine)
    by_light = shadow_light(scene, origin, sample, shared(sample.direction, sample.density), surface.active)
    direction = to_world(surface.n_geometric, cosine_hemisphere(random_2d(mi.UInt32(77), lane)))
    hit = trace_closest(scene, origin, direction, surface.active)
    vertex = surface_at_hit(scene, hit, direction)
    density = emitter_density(scene, surface, hit.prim_id, vertex.p, hit.valid)
    own = cosine(direction) * dr.inv_pi
    by_ray = dr.select(hit.valid, vertex.emission * (dr.pi * balance(own, density)), mi.Color3f(0.0))
    found = np.array(by_light, float)[0] + np.array(by_ray, float)[0]
    shares = [np.array(part, float)[0].mean() for part in (by_light, by_ray)]
    assert min(shares) > 0.02 * sum(shares), "each of them has something to find"
    error = found.std() / math.sqrt(SAMPLES)
    assert found.mean() == pytest.approx(irradiance(scene, place), abs=4.0 * error + 2e-3 * found.mean())


def irradiance(scene: Scene, place: tuple) -> float:
    """Return red irradiance: a sum over 300 x 300 points a triangle; what is nearer hides what is behind it."""
    p, n = (np.array(part, float) for part in place)
    emitters = [(int(prim), corners_of(scene, int(prim))) for prim in entries_of(scene)]
    tags = np.array(scene.geometry.triangles).reshape(-1, 4)[:, 3] & 0xFFFF
    total, fine = 0.0, 300
    root, share = (grid.ravel()[:, None] for grid in np.meshgrid(*2 * [(np.arange(fine) + 0.5) / fine]))
    for prim, (a, b, c) in emitters:
        y = a + root * ((b - a) * (1.0 - share) + (c - a) * share)
        face = np.cross(b - a, c - a) * (np.sign(np.linalg.det(TURNED[:3, :3])) if scene.features.moving else 1.0)
        material = scene.host.data.materials[tags[prim]]
        offset = y - p
        distance = np.linalg.norm(offset, axis=1)
        cos_light = -(offset @ face) / np.linalg.norm(face) / distance
        cos_light = np.abs(cos_light) if material.emit_back else np.maximum(cos_light, 0.0)
        cosine = np.maximum(offset @ n, 0.0) / distance
        seen = np.ones(len(y), bool)
        for other, corners in emitters:
            if other != prim:
                seen &= ~_between(p, offset, corners)
        area = root[:, 0] * np.linalg.norm(face) / fine**2
        total += float((material.emission[0] * cosine * cos_light / distance**2 * area * seen).sum())
    return total


def _between(p: np.ndarray, offset: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return whether the triangle crosses the ways from p by `offset` (N, 3)."""
    a, edge_1, edge_2 = corners[0], corners[1] - corners[0], corners[2] - corners[0]
    cross = np.cross(offset, edge_2)
    volume = cross @ edge_1
    volume = np.where(np.abs(volume) > 1e-12, volume, 1e-12)
    u = cross @ (p - a) / volume
    other = np.cross(p - a, edge_1)
    v, t = offset @ other / volume, edge_2 @ other / volume
    return (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 1e-6) & (t < 1.0 - 1e-4)


def test_a_closed_lamp_fills_the_sphere() -> None:
    """Inside a box that glows, every direction has a density, and the lights' half of the sphere holds all of it."""
    glow = Material(emission=(1.0, 1.0, 1.0), emit_back=True)
    scene = upload(SceneData("oven", [Object("oven", [box((-1, -1, -1), (1, 1, 1), 0)])], [glow]))
    surface = free(((0.1, 0.2, -0.3), (0.0, 0.0, 1.0)), SAMPLES)
    uniform = random_2d(mi.UInt32(9), dr.arange(mi.UInt32, SAMPLES))
    direction = mi.warp.square_to_uniform_sphere(uniform)
    hit = trace_closest(scene, surface.p, direction, surface.active)
    there = surface_at_hit(scene, hit, direction)
    density = np.array(emitter_density(scene, surface, hit.prim_id, there.p, hit.valid), float)
    assert np.array(hit.valid).all()
    assert density.mean() * 4.0 * math.pi == pytest.approx(1.0, abs=4.0 * density.std() * 4 * math.pi / 256)
