"""Light for normals other than the surfels' own: the warp, the equation against quadrature, and pictures by Mitsuba."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy import stats

from luxel import runtime
from luxel.kernels.camera import camera_ray, make_pinhole
from luxel.kernels.film import Film
from luxel.kernels.records import Surface
from luxel.methods.gibs.directions import choose_direction
from luxel.methods.gibs.normal_light import (
    NormalLight,
    NormalLightSum,
    add_ray,
    along_axes,
    has_own_normals,
    light_for_normal,
    moments_of_ray,
    pack_normal_light,
    sample_of_no_ray,
    surfel_normal_kept,
    turn_normal_light,
    unpack_normal_light,
    widened_density,
    widened_hemisphere,
)
from luxel.metrics.error import ambient_irradiance, bias, regional
from luxel.render import oracle
from luxel.render.oracle_materials import describe_material
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.device import upload
from luxel.scene.library.shapes import quad
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData, Sky, Texture

MU, PHI = 256, 512
SIZE = 96


@pytest.fixture(autouse=True)
def _started() -> None:
    runtime.start("auto")


# --------------------------------------------------------------------------------------------- rays


@pytest.mark.parametrize("share", [0.0, 0.25, 0.9])
def test_directions_have_the_density_that_is_told(share: float) -> None:
    generator = np.random.default_rng(5)
    sample = mi.Point2f(*generator.random((2, 200_000)).astype(np.float32))
    local = widened_hemisphere(sample, mi.Float(share))
    x, y, z = np.array(local).astype(float)
    assert np.abs(x * x + y * y + z * z - 1.0).max() < 1e-5 and z.min() >= 0.0
    # The cosine's distribution by integrating the mixture, and every turn about the normal alike.
    assert stats.kstest(z, lambda t: (1.0 - share) * t * t + share * t).pvalue > 1e-3
    assert stats.kstest(np.arctan2(y, x) / (2.0 * np.pi) + 0.5, "uniform").pvalue > 1e-3
    told = np.array(widened_density(local.z, mi.Float(share))).astype(float)
    np.testing.assert_allclose(told, (1.0 - share) * z / np.pi + share / (2.0 * np.pi), rtol=1e-5)
    assert np.array(widened_density(mi.Float(-0.1), mi.Float(share)))[0] == 0.0


# --------------------------------------------------------------------------------------------- the equation


@cache
def hemisphere() -> tuple[np.ndarray, float]:
    """Return directions (N, 3) about +Z on a grid, and the solid angle of each."""
    mu, phi = np.meshgrid((np.arange(MU) + 0.5) / MU, (np.arange(PHI) + 0.5) / PHI * 2.0 * np.pi, indexing="ij")
    sine = np.sqrt(1.0 - mu * mu)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), mu], -1).reshape(-1, 3), 2.0 * np.pi / (MU * PHI)


def answer(radiance: np.ndarray, n: np.ndarray, n_geometric: np.ndarray | None = None) -> float:
    """Return the light under the normal `n` from what a surfel of normal +Z keeps of grey `radiance` (N,)."""
    w, solid = hemisphere()
    vector = (radiance[:, None] * w).sum(0) * solid
    near = 1.5 * (radiance * (1.0 - w[:, 2]) ** 2).sum() * solid
    e, tangential = vector[2], vector[:2] @ n[:2]
    found = NormalLightSum(mi.Color3f(float(tangential)), mi.Float(float(n[2])), mi.Float(float(near / e)))
    to_geometric = float(n[2] if n_geometric is None else n @ n_geometric)
    light = light_for_normal(mi.Color3f(float(e)), found, mi.Float(1.0), mi.Float(to_geometric))
    return float(np.array(light)[0, 0])


def wanted(radiance: np.ndarray, n: np.ndarray) -> float:
    """Return the integral over what lies above +Z and above `n`."""
    w, solid = hemisphere()
    return float((radiance * np.maximum(w @ n, 0.0)).sum() * solid)


def turned(degrees: float, phi: float = 0.0) -> np.ndarray:
    angle = np.radians(degrees)
    return np.array([np.sin(angle) * np.cos(phi), np.sin(angle) * np.sin(phi), np.cos(angle)])


@pytest.mark.parametrize("degrees", [0, 10, 30, 60, 85])
def test_one_radiance_everywhere_is_exact(degrees: float) -> None:
    """What the surface hides is missing: pi (1 + cos) / 2 of the radiance is left."""
    radiance = np.full(MU * PHI, 2.0)
    n = turned(degrees)
    assert answer(radiance, n) == pytest.approx(np.pi * (1.0 + n[2]), rel=2e-3)
    assert answer(radiance, n) == pytest.approx(wanted(radiance, n), rel=2e-3)


@pytest.mark.parametrize("degrees", [5, 20, 40])
def test_around_a_bend_nothing_is_missing(degrees: float) -> None:
    """A pixel of a bent surface, lit by its own normal, sees a whole hemisphere; the surfel's lies on another plane."""
    n = turned(degrees)
    assert answer(np.full(MU * PHI, 2.0), n, n) == pytest.approx(2.0 * np.pi, rel=2e-3)
    w, _ = hemisphere()
    # Linear in direction, over all of space: pi a + 2 pi / 3 b . n.
    for phi in (0.0, 1.0, np.pi):
        slope = np.array([np.cos(phi), np.sin(phi), 0.0])
        truth = np.pi + 2.0 * np.pi / 3.0 * 0.4 * (slope @ n)
        assert answer(1.0 + 0.4 * w @ slope, n, n) == pytest.approx(truth, rel=0.01)


@pytest.mark.parametrize("degrees", [5, 20, 40, 60])
@pytest.mark.parametrize("phi", [0.0, 2.0, np.pi])
def test_radiance_that_is_linear_in_direction_is_exact(degrees: float, phi: float) -> None:
    w, _ = hemisphere()
    radiance = 1.0 + 0.9 * w[:, 0]
    n = turned(degrees, phi)
    assert answer(radiance, n) == pytest.approx(wanted(radiance, n), rel=0.01)


def test_any_radiance_is_exact_for_the_surfels_own_normal() -> None:
    radiance = np.random.default_rng(3).random(MU * PHI) ** 8
    assert answer(radiance, turned(0.0)) == pytest.approx(wanted(radiance, turned(0.0)), rel=1e-5)


def test_random_skies_err_far_less_than_one_answer_for_all_normals() -> None:
    generator, (w, solid) = np.random.default_rng(11), hemisphere()
    errors = []
    for _ in range(40):
        lobes = generator.normal(size=(6, 3))
        lobes /= np.linalg.norm(lobes, axis=1)[:, None]
        sharp, bright = generator.uniform(0.5, 8.0, 6), generator.random(6)
        radiance = (bright * np.exp(sharp * (w @ lobes.T - 1.0))).sum(1)
        n = turned(30.0, generator.uniform(0.0, 2.0 * np.pi))
        truth, plain = wanted(radiance, n), float((radiance * w[:, 2]).sum() * solid)
        errors.append((answer(radiance, n) / truth - 1.0, plain / truth - 1.0))
    ours, plain = np.sqrt(np.mean(np.square(errors), axis=0))
    assert ours < 0.03 and plain > 6.0 * ours


def test_light_from_behind_the_normal_never_goes_below_zero() -> None:
    w, _ = hemisphere()
    radiance = np.where((w[:, 0] < -0.95) & (w[:, 2] > 0.05), 100.0, 0.0)
    for degrees in (10, 45, 80):
        assert answer(radiance, turned(degrees)) > 0.0
    # A normal map may lean a point's normal to more than a right angle from a surfel around a bend.
    overhead = np.where(w[:, 2] > 0.98, 100.0, 0.0)
    for degrees in (95, 120, 170):
        assert answer(overhead, turned(degrees)) == pytest.approx(0.0, abs=0.01)


# --------------------------------------------------------------------------------------------- what is kept


def axes_of(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the axes of a surfel's tangential light as vectors (3,)."""
    kept = surfel_normal_kept(mi.Normal3f(*(mi.Float(float(c)) for c in n)))
    s, t = along_axes(kept, mi.Vector3f(*(mi.Float(row) for row in np.eye(3).tolist())))
    return np.array(s).astype(float), np.array(t).astype(float)


def random_light(width: int, seed: int = 1) -> NormalLight:
    generator = np.random.default_rng(seed)
    scale = 10.0 ** generator.uniform(-6, 6, width)
    numbers = generator.normal(size=(6, width)) * scale
    rows = [mi.Float(row.astype(np.float32)) for row in numbers]
    horizon = mi.Float((generator.uniform(0, 3, width) * scale).astype(np.float32))
    return NormalLight(mi.Color3f(*rows[:3]), mi.Color3f(*rows[3:]), horizon)


def test_packed_light_comes_back() -> None:
    width = 500
    light = random_light(width)
    irradiance = mi.Color3f(dr.fmax(light.horizon, 1e-12))
    rows = pack_normal_light(light, irradiance, width)
    found, scale = unpack_normal_light(dr.gather(mi.Vector4u, rows, dr.arange(mi.UInt32, width)))
    kept, given = (np.vstack([np.array(x.along_s), np.array(x.along_t)]).astype(float) for x in (found, light))
    kept *= np.array(scale).astype(float)
    assert (np.abs(kept - given) <= 3.2e-5 * np.abs(given).max(axis=0)).all()
    np.testing.assert_allclose(np.array(found.horizon), 1.0, atol=1e-4)
    dark = pack_normal_light(NormalLight(mi.Color3f(0.0), mi.Color3f(0.0), mi.Float(0.0)), mi.Color3f(0.0), 1)
    nothing, _ = unpack_normal_light(dr.gather(mi.Vector4u, dark, mi.UInt32(0)))
    assert not np.array(nothing.along_s).any() and np.isfinite(np.array(nothing.horizon)).all()


def test_rays_bring_the_integrals_without_bias() -> None:
    """Evenly spread and cosine rays together, by the mixture's density: the mean is the quadrature."""
    share, count = 0.25, 400_000
    generator = np.random.default_rng(9)
    n = np.array([0.48, -0.6, 0.64])
    normal = mi.Normal3f(*(mi.Float(float(c)) for c in n))
    local = widened_hemisphere(mi.Point2f(*generator.random((2, count)).astype(np.float32)), mi.Float(share))
    direction = mi.Frame3f(mi.Vector3f(normal)).to_world(local)
    radiance = dr.exp(3.0 * dr.dot(direction, mi.Vector3f(0.8, 0.6, 0.0)))
    weight = local.z * dr.inv_pi / widened_density(local.z, mi.Float(share))
    moments = moments_of_ray(normal, direction, mi.Bool(True))
    mean = mi.Color3f(2.0)
    light = mi.Color3f(dr.pi * radiance * weight)
    sample = add_ray(sample_of_no_ray(mean), mean, light, weight, moments, mi.Float(1.0))
    w, solid = hemisphere()
    s, t = axes_of(n)
    world = w[:, :1] * s + w[:, 1:2] * t + w[:, 2:] * n
    light = np.exp(3.0 * world @ np.array([0.8, 0.6, 0.0]))
    vector = (light[:, None] * world).sum(0) * solid
    near = 1.5 * (light * (1.0 - w[:, 2]) ** 2).sum() * solid
    scale = float((light * w[:, 2]).sum() * solid)
    for found, right in ((sample.along_s.x, vector @ s), (sample.along_t.x, vector @ t), (sample.horizon, near)):
        assert float(np.array(found).astype(float).mean()) == pytest.approx(right, abs=0.01 * scale)


def test_no_ray_next_to_the_horizon_counts_for_more_than_its_density_says() -> None:
    """Rays at the disc's rim, where the cosine of the direction is rounding: one over the density is at most 2 pi / s.

    A ray's share of T is its radiance times pi over that, so 2 / s by the sines.
    """
    generator, count, share = np.random.default_rng(4), 400_000, 0.9
    rim, along = generator.integers(0, 40 * 2**8, count), generator.integers(0, 2**32, count)
    rim = np.where(generator.random(count) < 0.5, rim, 2**32 - 1 - rim)
    rim_word, along_word = (mi.UInt32(word.astype(np.uint32)) for word in (rim, along))
    normals = generator.normal(size=(3, count))
    n = dr.normalize(mi.Normal3f(*(mi.Float(row.astype(np.float32)) for row in normals)))
    renderer = Renderer(smooth_ball(), "gibs", {"surfel_target": 100, "even_share": share}, size=(16, 16))
    active = dr.full(mi.Bool, True, count)
    chosen = choose_direction(renderer.scene, renderer.state, n, rim_word, along_word, active)
    moments = moments_of_ray(n, chosen.direction, active)
    held = np.abs(np.array(chosen.weight * moments))
    assert held[:2].max() <= 2.0 / share * 1.001 and held[2].max() <= 3.0 / share * 1.001


def test_one_radiance_everywhere_brings_no_noise() -> None:
    """Four rays of a surfel whose irradiance is known: all samples are exact."""
    generator = np.random.default_rng(2)
    n = mi.Normal3f(0.0, 1.0, 0.0)
    mean = mi.Color3f(np.pi)
    found = sample_of_no_ray(mean)
    for _ in range(4):
        local = widened_hemisphere(mi.Point2f(*generator.random((2, 64)).astype(np.float32)), mi.Float(0.25))
        weight = local.z * dr.inv_pi / widened_density(local.z, mi.Float(0.25))
        moment = moments_of_ray(n, mi.Frame3f(n).to_world(local), True)
        found = add_ray(found, mean, mi.Color3f(dr.pi * weight), weight, moment, mi.Float(0.25))
    assert np.abs(np.array(found.along_s)).max() < 1e-3 and np.abs(np.array(found.along_t)).max() < 1e-3
    np.testing.assert_allclose(np.array(found.horizon), np.pi, rtol=1e-4)


def test_light_does_not_turn_with_an_object() -> None:
    """The part of V along any direction at right angles to both normals stays; a turn about the normal changes none."""
    light = random_light(1, seed=4)
    around = turn_normal_light(light, mi.Normal3f(0, 0, 1), mi.Normal3f(0, 0, 1))
    np.testing.assert_allclose(np.array(around.along_s), np.array(light.along_s), rtol=1e-5)
    before, now = mi.Normal3f(0.0, 0.0, 1.0), mi.Normal3f(0.0, 0.6, 0.8)
    after = turn_normal_light(light, before, now)

    def along_x(held: NormalLight, n: mi.Normal3f) -> np.ndarray:
        s, t = axes_of(np.array(n).reshape(3))
        return np.array(held.along_s) * s[0] + np.array(held.along_t) * t[0]

    np.testing.assert_allclose(along_x(after, now), along_x(light, before), rtol=5e-3)


@pytest.mark.parametrize("n", [(0.48, -0.6, 0.64), (0.6, 0.0, -0.8), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)])
def test_axes_are_a_frame(n: tuple[float, float, float]) -> None:
    axes = np.stack([*axes_of(np.array(n)), n])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=4e-3)


def test_axes_do_not_depend_on_the_sign_of_nothing() -> None:
    """Walls whose normal has -0 and +0 along z have the axes of the packed normal, which a look-up has."""
    normals = mi.Normal3f(mi.Float([1, 1, 1]), mi.Float([0, 0, 0]), mi.Float([0.0, -0.0, -1e-9]))
    s, t = (np.array(part) for part in along_axes(surfel_normal_kept(normals), mi.Vector3f(0.1, 0.7, 0.6)))
    assert (s == s[0]).all() and (t == t[0]).all()


# --------------------------------------------------------------------------------------------- scenes


def room(back: Mesh, materials: list[Material], *more: Mesh) -> SceneData:
    """A closed room of 4 x 3 x 4 m with a red and a green wall and two spots, which light those alone."""
    grey, red, green = ((0.75, 0.75, 0.75), (0.75, 0.1, 0.08), (0.1, 0.6, 0.15))
    walls = [
        quad((-2, 0, 2), (2, 0, 2), (2, 0, -2), (-2, 0, -2), 0),
        quad((-2, 3, -2), (2, 3, -2), (2, 3, 2), (-2, 3, 2), 0),
        quad((2, 0, 2), (-2, 0, 2), (-2, 3, 2), (2, 3, 2), 0),
        quad((-2, 0, 2), (-2, 0, -2), (-2, 3, -2), (-2, 3, 2), 1),
        quad((2, 0, -2), (2, 0, 2), (2, 3, 2), (2, 3, -2), 2),
    ]
    cone: dict[str, Any] = {"cos_inner": 0.9, "cos_outer": 0.8, "spot_falloff": "linear-angle"}
    lights = [
        Light("spot", (40, 40, 40), (-0.2, 2.6, 1.4), (-1.0, -0.5, 0.0), **cone),
        Light("spot", (20, 20, 20), (0.2, 0.4, 1.4), (1.0, 0.6, -0.2), **cone),
    ]
    painted = [Material(base_color=color) for color in (grey, red, green)] + materials
    return SceneData("room", [Object("room", [*walls, back, *more])], painted, lights=lights)


def bumpy_wall() -> SceneData:
    """The back wall's normal map leans up to 31 degrees along each axis, in waves of 2 m."""
    v, u = np.meshgrid(*[(np.arange(64) + 0.5) / 64 * 2.0 * np.pi] * 2, indexing="ij")
    n = np.stack([0.6 * np.sin(u), 0.6 * np.sin(v), np.ones_like(u)], axis=-1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    image = np.round((0.5 * n + 0.5) * 255.0).astype(np.uint8)
    back = quad((-2, 0, -2), (2, 0, -2), (2, 3, -2), (-2, 3, -2), 3, uv_scale=(2.0, 1.5))
    data = room(back, [Material(base_color=(0.7, 0.7, 0.7), normal_texture=Texture(image, srgb=False))])
    data.cameras = [Camera((0.0, 1.5, 0.2), (0.0, 1.5, -2.0), fov=68.0)]
    return data


def smooth_ball() -> SceneData:
    """A ball of 80 triangles with vertex normals, which fills the view."""
    golden = (1.0 + 5.0**0.5) / 2.0
    corners = np.array([(s, t * golden, 0.0) for s in (-1, 1) for t in (-1, 1)])
    corners = np.concatenate([np.roll(corners, shift, axis=1) for shift in range(3)])
    corners /= np.linalg.norm(corners, axis=1)[:, None]
    near = np.linalg.norm(corners[:, None] - corners[None], axis=2) < 1.2
    faces = [
        (i, j, k) for i in range(12) for j in range(i + 1, 12) for k in range(j + 1, 12)
        if near[i, j] and near[j, k] and near[i, k]
    ]  # fmt: skip
    triangles = corners[np.array(faces)]
    triangles[np.linalg.det(triangles) < 0.0] = triangles[np.linalg.det(triangles) < 0.0][:, ::-1]
    middle = triangles + np.roll(triangles, -1, axis=1)
    middle /= np.linalg.norm(middle, axis=2, keepdims=True)
    a, b, c = (triangles[:, i] for i in range(3))
    ab, bc, ca = (middle[:, i] for i in range(3))
    points = np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    normals = points.reshape(-1, 3).astype(np.float32)
    assert len(points) == 80
    faces_of = np.arange(len(normals), dtype=np.uint32).reshape(-1, 3)
    ball = Mesh((0.7 * normals + (0.0, 1.5, -0.3)).astype(np.float32), faces_of, 0, normals=normals)
    data = room(quad((-2, 0, -2), (2, 0, -2), (2, 3, -2), (-2, 3, -2), 0), [], ball)
    data.cameras = [Camera((0.3, 1.7, 1.9), (0.0, 1.5, -0.3), fov=28.0)]
    return data


def without_shadowing(material: Material) -> dict[str, Any]:
    """Return Mitsuba's description of a material; by default it darkens mapped normals beyond what they are."""
    found = describe_material(material)
    parts = [found]
    while parts:
        part = parts.pop()
        if part.get("type") == "normalmap":
            part["use_shadowing_function"] = False
        parts += [value for value in part.values() if isinstance(value, dict)]
    return found


def trace_by_mitsuba(data: SceneData, spp: int, monkeypatch: pytest.MonkeyPatch, max_depth: int = -1) -> np.ndarray:
    """Return Mitsuba's own path-traced radiance (SIZE, SIZE, 3), rays at pixel centres; -1: all bounces."""
    monkeypatch.setattr(oracle, "describe_material", without_shadowing)
    scene = oracle.make_full_scene(data)
    integrator = mi.load_dict({"type": "path", "max_depth": max_depth, "rr_depth": 4})
    sampler = mi.load_dict({"type": "independent"})
    film, pinhole = Film(SIZE, SIZE), make_pinhole(data.cameras[0], SIZE, SIZE)
    column, row, inside = film.pixel_of_lane(dr.arange(mi.UInt32, film.lane_count))
    x, y = (mi.Float(column) + 0.5) * (2.0 / SIZE) - 1.0, 1.0 - (mi.Float(row) + 0.5) * (2.0 / SIZE)
    origin, direction = camera_ray(pinhole, x, y)
    total = dr.zeros(mi.Color3f, film.lane_count)
    for sample in range(spp):
        sampler.seed(sample + 1, film.lane_count)
        ray = mi.RayDifferential3f(mi.Ray3f(origin, direction))
        total += mi.Color3f(integrator.sample(scene, sampler, ray, None, inside)[0])
        dr.eval(total)
    return (np.array(total).T / spp)[film.lanes_of_image()].astype(np.float64)


@pytest.mark.parametrize("make", [bumpy_wall, smooth_ball])
def test_maps_and_smooth_normals_are_lit_as_mitsuba_has_them(make, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: ANN001
    # The spots do not shine on what is seen, so all of the light there is indirect.
    indirect = trace_by_mitsuba(make(), 320, monkeypatch)
    figures = {}
    for on in (True, False):
        renderer = Renderer(make(), "gibs", {"surfel_target": 4000, "normal_light": on}, size=(SIZE, SIZE), seed=1)
        renderer.run(160 if on else 48)
        layers = renderer.layers()
        assert not layers.direct.any()
        truth = replace(layers, indirect=(np.pi * indirect / layers.albedo).astype(np.float32))
        figures[on] = regional(layers, truth)
        ambient = np.broadcast_to(np.asarray(ambient_irradiance(truth), np.float32), truth.indirect.shape)
        assert regional(replace(truth, indirect=ambient), truth) > 0.04
    assert figures[True] <= 0.02 and figures[False] > 0.04, figures


def test_pixels_without_surfels_are_lit_by_their_own_normals(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where none is ever placed, rays of the pixels bring one bounce of light: what Mitsuba has of that length."""
    indirect = trace_by_mitsuba(bumpy_wall(), 128, monkeypatch, max_depth=3)
    figures = {}
    for on in (True, False):
        params = {"surfel_target": 64, "spawn_threshold": 0.0, "hit_spawn_threshold": 0.0, "normal_light": on}
        renderer = Renderer(bumpy_wall(), "gibs", params, size=(SIZE, SIZE), seed=1)
        shown = []
        for _ in range(16):
            renderer.step()
            shown.append(renderer.layers().indirect)
        assert renderer.cache()["surfel_count"] == 0
        layers = replace(renderer.layers(), indirect=np.mean(shown, axis=0, dtype=np.float32))
        truth = replace(layers, indirect=(np.pi * indirect / layers.albedo).astype(np.float32))
        figures[on] = regional(layers, truth), bias(layers, truth)
    assert figures[True][0] < 0.09 and abs(figures[True][1]) < 0.02, figures
    assert figures[False][0] > 0.18 and figures[False][1] > 0.1, figures


def one_normal(degrees: float) -> Texture:
    """Return a normal map that leans so far towards +X of the texture everywhere."""
    return Texture(np.full((2, 2, 3), np.round((0.5 * turned(degrees) + 0.5) * 255.0), np.uint8), srgb=False)


def floor_under_a_slope(material: Material) -> SceneData:
    """A floor, seen from above, under a sky whose radiance is 1 + 0.8 x in direction (x, y, z)."""
    rows = 64
    theta, phi = np.meshgrid((np.arange(rows) + 0.5) / rows, (np.arange(2 * rows) + 0.5) / rows - 1.0, indexing="ij")
    x = np.sin(np.pi * theta) * np.sin(np.pi * phi)
    image = np.repeat((1.0 + 0.8 * x)[..., None], 3, axis=2).astype(np.float32)
    floor = Object("floor", [quad((-2, 0, 2), (2, 0, 2), (2, 0, -2), (-2, 0, -2), 0)])
    data = SceneData("floor", [floor], [material])
    data.sky = Sky((1.0, 1.0, 1.0), image)
    data.cameras = [Camera((0.0, 2.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), fov=60.0)]
    return data


def light_of_the_slope(n: np.ndarray) -> float:
    """Return the irradiance of that sky under a normal whose third part is up."""
    w, _ = hemisphere()
    return wanted(1.0 + 0.8 * w[:, 0], n)


def test_a_normal_map_that_comes_by_a_live_edit_is_lit_by_its_normals() -> None:
    """A flat scene's surfels keep no light for other normals: with the first map they must; they start anew once."""
    renderer = Renderer(floor_under_a_slope(Material("floor")), "gibs", {"surfel_target": 300}, size=(32, 32), seed=2)
    renderer.run(64)
    assert renderer.state.normal_light is None
    assert renderer.layers().indirect.mean() == pytest.approx(light_of_the_slope(turned(0.0)), rel=0.03)
    for degrees in (30.0, -20.0):
        texture = one_normal(degrees)
        n = texture.image[0, 0] / 127.5 - 1.0
        renderer.set_material("floor", normal_texture=texture)
        renderer.run(64)
        assert renderer.layers().indirect.mean() == pytest.approx(light_of_the_slope(n / np.linalg.norm(n)), rel=0.03)
        assert renderer.frame_index == (64 if degrees > 0.0 else 128), "the second map starts nothing anew"
    renderer.set_material("floor", normal_texture=None)
    renderer.run(2)
    assert renderer.frame_index == 130
    assert renderer.layers().indirect.mean() == pytest.approx(light_of_the_slope(turned(0.0)), rel=0.03)


def test_free_points_and_bakes_have_light_for_their_normals() -> None:
    """A floor under a sky whose radiance is linear in direction: query with other normals, against the integral."""
    data = floor_under_a_slope(Material(normal_texture=one_normal(0.0)))
    renderer = Renderer(data, "gibs", {"surfel_target": 300}, size=(32, 32), seed=2)
    renderer.run(128)
    for degrees in (-40.0, 0.0, 25.0):
        n = turned(degrees)
        right = light_of_the_slope(n)
        lean = mi.Normal3f(float(n[0]), float(n[2]), float(-n[1]))
        points = mi.Point3f(mi.Float(np.linspace(-0.8, 0.8, 64, dtype=np.float32)), 1e-4, 0.1)
        active = dr.full(mi.Bool, True, 64)
        surface = Surface.at(points, mi.Normal3f(0.0, 1.0, 0.0), n_shading=lean, active=active)
        light = renderer.method.query(renderer.scene, renderer.state, surface)
        assert float(np.array(light.irradiance).mean()) == pytest.approx(right, rel=0.02)


def test_light_for_normals_is_kept_where_there_are_any() -> None:
    assert has_own_normals(upload(bumpy_wall())) and has_own_normals(upload(smooth_ball()))
    assert has_own_normals(upload(load("atrium"))), "its columns are round"
    flat = bumpy_wall()
    flat.materials[3] = Material()
    assert not has_own_normals(upload(flat)) and not has_own_normals(upload(load("cornell-box")))
    for data, kept in ((flat, False), (smooth_ball(), True)):
        state = Renderer(data, "gibs", {"surfel_target": 100}, size=(16, 16)).state
        assert (state.normal_light is not None) is kept
