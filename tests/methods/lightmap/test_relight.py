"""Relighting: the first bounce in the same frame, known light, the sky, and what lights moving things."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.kernels.surface import surface_at
from luxel.methods import inspector_of
from luxel.methods.lightmap.run.state import bake_of
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.library.shapes import box, quad, sphere, translation
from luxel.scene.model import Camera, Light, Material, Object, SceneData, Sky

SMALL = {"texel_target": 2048, "surfel_target": 512, "rays_per_texel": 128, "probe_target": 64}


def open_field(radius: float = 0.3, **options: object) -> SceneData:
    """Return a plain under the sky, with a ball that hovers over it and moves on."""
    plain = quad((-5, 0, 5), (5, 0, 5), (5, 0, -5), (-5, 0, -5), 0)
    ball = sphere((0, 0, 0), radius, 1, rings=12, sectors=24)

    def motion(time: float) -> np.ndarray:
        return translation(time, 1.0, 0.0)

    objects = [Object("plain", [plain]), Object("ball", [ball], motion(0.0), motion)]
    materials = [Material("plain", (0.5, 0.5, 0.5)), Material("ball", (0.5, 0.5, 0.5))]
    camera = Camera((0.0, 3.0, 6.0), (0.0, 0.0, 0.0), fov=60.0)
    settings: dict = {"cameras": [camera], "duration": 4.0, **options}
    return SceneData("field", objects, materials, **settings)


def test_a_changed_light_shows_its_first_bounce_in_the_same_frame() -> None:
    renderer = Renderer(load("opening"), "lightmap", dict(SMALL), size=(48, 48))
    renderer.set_light_scale(0.0)
    renderer.run(3)
    assert not renderer.layers().indirect.any()
    renderer.set_light_scale(1.0)
    renderer.step()
    first = float(renderer.layers().indirect.mean())
    renderer.run(60)
    settled = float(renderer.layers().indirect.mean())
    assert 0.2 * settled < first < 0.9 * settled
    renderer.set_light_scale(2.0)
    renderer.step()
    # The new frame lights one set of sample points, the settled light is the mean of all of them.
    assert float(renderer.layers().indirect.mean()) == pytest.approx(settled + first, rel=0.04)


@pytest.mark.parametrize("name", ["furnace", "sphere"])
@pytest.mark.parametrize("preset", [None, "source"])
def test_light_that_is_known(name: str, preset: str | None) -> None:
    data = load(name)
    settings = {**SMALL, "surfel_target": 512} if preset is None else {"texel_target": 2048, "probe_target": 64}
    renderer = Renderer(data, "lightmap", settings, preset=preset, size=(64, 64))
    renderer.run(128)
    layers = renderer.layers()
    assert float(layers.indirect[layers.hit].mean()) == pytest.approx(data.facts["indirect_irradiance"], rel=0.01)


def test_a_plain_under_an_even_sky() -> None:
    renderer = Renderer(open_field(sky=Sky((1.0, 2.0, 3.0))), "lightmap", dict(SMALL), size=(64, 64))
    renderer.run(4)
    layers = renderer.layers()
    plain = layers.hit & (layers.indirect[..., 1] > 0.0)
    # The ball is no part of the bake: nothing hides the sky.
    np.testing.assert_allclose(np.median(layers.indirect[plain], axis=0), np.pi * np.array([1.0, 2.0, 3.0]), rtol=1e-3)


def test_the_skys_image_keeps_its_sides() -> None:
    image = np.zeros((16, 32, 3), np.float32)
    image[:8, 16:24] = 1.0  # from the image's middle, -Z, a quarter turn towards +X
    renderer = Renderer(open_field(sky=Sky((1.0, 1.0, 1.0), image)), "lightmap", dict(SMALL), size=(16, 16))
    renderer.run(2)
    p = np.array([[3.0, 1.0, 0.0]] * 4, np.float32)
    n = np.array([[1, 0, 0], [-1, 0, 0], [0, 0, -1], [0, 0, 1]], np.float32)
    east, west, north, south = renderer.irradiance_at(p, n)[:, 0]
    assert east == pytest.approx(north, rel=0.2)
    assert east > 3.0 * west and north > 3.0 * south


def test_a_moving_ball_is_lit_by_the_probes() -> None:
    sun = Light("directional", (10.0, 10.0, 10.0), direction=(0.0, -1.0, 0.0))
    renderer = Renderer(open_field(lights=[sun]), "lightmap", dict(SMALL), size=(64, 64))
    renderer.step(time=0.0)
    renderer.step(time=1.0)
    # The plain sends 5 W/m^2 of radiosity up; seen from a metre above, it fills most of the lower half.
    below = renderer.irradiance_at(np.array([[1.0, 0.7, 0.0]]), np.array([[0.0, -1.0, 0.0]]))[0]
    above = renderer.irradiance_at(np.array([[1.0, 1.3, 0.0]]), np.array([[0.0, 1.0, 0.0]]))[0]
    assert 4.0 < below[0] < 5.2 and above[0] < 0.3
    layers = renderer.layers()
    assert (layers.weight[layers.hit] > 0.0).mean() > 0.99


def test_shadows_of_moving_things_darken_the_bounce() -> None:
    """A moving thing is no part of the transport, but the surfels' shadow rays meet it where it is now."""
    sun = Light("directional", (10.0, 10.0, 10.0), direction=(0.0, -1.0, 0.0))
    renderer = Renderer(open_field(0.9, lights=[sun]), "lightmap", dict(SMALL), size=(16, 16))
    renderer.step(time=0.0)
    bake = bake_of(renderer.state)
    shaded = np.hypot(bake.surfel_p[:, 0], bake.surfel_p[:, 2]) < 0.5
    assert shaded.sum() >= 3
    above, down = np.array([[0.0, 1.5, 0.0]]), np.array([[0.0, -1.0, 0.0]])
    first, first_bounce = np.array(renderer.state.direct)[0], renderer.irradiance_at(above, down)[0, 0]
    renderer.step(time=2.0)
    then, then_bounce = np.array(renderer.state.direct)[0], renderer.irradiance_at(above, down)[0, 0]
    assert first[shaded].max() == 0.0
    np.testing.assert_allclose(then[shaded], 10.0, rtol=1e-4)
    assert first_bounce < 0.9 * then_bounce


def test_free_points_on_a_wall_take_its_texels(cornell: Renderer) -> None:
    scene = cornell.scene
    import drjit as dr
    import mitsuba as mi

    prim = dr.arange(mi.UInt32, 10)
    # Near the corners: the boxes stand on the floor, and where two surfaces are one plane either may answer.
    where = surface_at(scene, prim, mi.Point2f(0.1, 0.1), dr.full(mi.Bool, True, 10))
    on_surface = np.array(cornell.method.query(scene, cornell.state, where).irradiance).T
    free = cornell.irradiance_at(np.array(where.p).T, np.array(where.n_geometric).T)
    np.testing.assert_allclose(free, on_surface, rtol=1e-3)
    assert (on_surface > 0.0).all()


def test_the_rim_of_a_plate_on_a_column_is_lit() -> None:
    """The column hides the plate's underside but for 2 cm: all points of its texels fall inside the column."""
    column = box((-0.5, 0.0, -0.5), (0.5, 2.0, 0.5), 0)
    plate = box((-0.52, 2.0, -0.52), (0.52, 2.2, 0.52), 0)
    floor = quad((-5, 0, 5), (5, 0, 5), (5, 0, -5), (-5, 0, -5), 0)
    objects = [Object("column", [column]), Object("plate", [plate]), Object("floor", [floor])]
    camera = Camera((0.0, 1.7, 0.9), (0.0, 2.0, 0.5), fov=30.0)
    data = SceneData("rim", objects, [Material("white", (0.5, 0.5, 0.5))], cameras=[camera], sky=Sky((1.0, 1.0, 1.0)))
    renderer = Renderer(data, "lightmap", dict(SMALL), size=(64, 64))
    renderer.run(4)
    layers = renderer.layers()
    assert (layers.indirect[layers.hit].min(axis=1) > 0.1).all()


def test_what_explains_a_point_adds_up_to_its_light(cornell: Renderer) -> None:
    import mitsuba as mi

    where = surface_at(cornell.scene, mi.UInt32([0]), mi.Point2f(0.4, 0.2), mi.Bool([True]))
    found = inspector_of(cornell.method).explain(cornell.scene, cornell.state, where)
    light = np.array(cornell.method.query(cornell.scene, cornell.state, where).irradiance).ravel()
    assert sum(item.weight for item in found) == pytest.approx(1.0, abs=1e-6)
    total = np.sum([np.multiply(item.weight, item.irradiance) for item in found], axis=0)
    np.testing.assert_allclose(total, light, rtol=1e-3)
    assert found[0].weight >= found[-1].weight and all(item.reason for item in found)


def test_every_look_has_something_to_tell(cornell: Renderer) -> None:
    import drjit as dr
    import mitsuba as mi

    where = surface_at(cornell.scene, dr.arange(mi.UInt32, 10), mi.Point2f(0.3), dr.full(mi.Bool, True, 10))
    for look in inspector_of(cornell.method).looks:
        if look.kind in ("sheet", "source"):
            continue
        reading = inspector_of(cornell.method).read(cornell.scene, cornell.state, where, look.name)
        assert np.array(reading.answered).all(), look.name
        assert np.isfinite(np.array(reading.value, dtype=np.float64)).all()
    views = inspector_of(cornell.method).views(cornell.scene, cornell.state)
    assert {view.kind for view in views.values()} == {"image", "points"}
