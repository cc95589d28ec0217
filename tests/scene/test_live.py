"""Changes to an uploaded scene: what a kernel sees afterwards is what a fresh upload of the edited scene gives."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest

import luxel
from luxel.errors import LuxelError
from luxel.render.renderer import Renderer
from luxel.scene import live
from luxel.scene.device import Scene, set_time, upload
from luxel.scene.library.shapes import translation
from luxel.scene.model import Light, SceneData
from luxel.scene.sun import sun_angles, sun_at_hour, with_sun

SIZE = (48, 48)
LAMP = Light("point", (3.0, 2.0, 1.0), position=(0.0, 0.0, 0.5), name="lamp")


def draw(scene, frames: int = 24) -> np.ndarray:  # noqa: ANN001
    """Return direct light, which needs no cache, averaged over some frames."""
    renderer = Renderer(scene, "none", size=SIZE)
    renderer.run(frames)
    return renderer.layers().direct


def edited(change) -> SceneData:  # noqa: ANN001
    data = live.copy_scene_data(luxel.load("cornell-box"))
    change(data)
    return data


def set_emission(scene: Scene, index: int, emission: tuple[float, float, float]) -> None:
    live.set_material(scene, index, replace(scene.host.data.materials[index], emission=emission))


def test_lamps_are_added_moved_and_removed() -> None:
    scene = upload(live.copy_scene_data(luxel.load("cornell-box")))
    plain = draw(scene)
    live.set_lights(scene, [LAMP])
    moved = replace(LAMP, position=(0.6, 0.6, 0.6))
    live.set_lights(scene, [moved])
    wanted = draw(upload(edited(lambda data: data.lights.append(moved))))
    np.testing.assert_allclose(draw(scene).mean(), wanted.mean(), rtol=0.02)
    assert draw(scene).mean() > 1.2 * plain.mean()
    live.set_lights(scene, [])
    np.testing.assert_allclose(draw(scene).mean(), plain.mean(), rtol=0.02)


def test_a_glow_changes_colour_and_strength() -> None:
    scene = upload(live.copy_scene_data(luxel.load("cornell-box")))
    plain = draw(scene)
    lamp = next(index for index, item in enumerate(scene.host.data.materials) if max(item.emission) > 0.0)
    before = scene.host.data.materials[lamp].emission
    set_emission(scene, lamp, (0.0, 2.0 * before[1], 0.0))
    after = draw(scene)
    assert after[..., 0].max() == after[..., 2].max() == 0.0
    np.testing.assert_allclose(after[..., 1].mean(), 2.0 * plain[..., 1].mean(), rtol=0.02)


def test_the_scale_of_all_light_stays_with_new_lights() -> None:
    scene = upload(live.copy_scene_data(luxel.load("cornell-box")))
    live.set_light_scale(scene, 0.5)
    live.set_lights(scene, [LAMP])
    live.set_lights(scene, [])
    plain = draw(upload(luxel.load("cornell-box")))
    np.testing.assert_allclose(draw(scene).mean(), 0.5 * plain.mean(), rtol=0.02)


def test_the_sun_is_turned_and_keeps_its_tint() -> None:
    red_sun = Light("directional", (4.0, 2.0, 1.0), direction=(0.0, -1.0, 0.0), name="sun")
    scene = upload(edited(lambda data: data.lights.append(red_sun)))
    live.set_lights(scene, with_sun(scene.host.data, 90.0, 30.0, 8.0))
    azimuth, elevation, strength, _ = sun_angles(scene.host.data) or (0.0, 0.0, 0.0, 0.0)
    assert (azimuth, elevation, strength) == pytest.approx((90.0, 30.0, 8.0))
    assert scene.host.data.lights[0].color == pytest.approx((8.0, 4.0, 2.0))
    assert sun_angles(luxel.load("cornell-box")) is None


@pytest.mark.parametrize(
    ("hour", "azimuth", "elevation"), [(6.0, 90.0, 0.0), (12.0, 0.0, 60.0), (18.0, 270.0, 0.0), (9.0, 45.0, 42.426)]
)
def test_the_hours_sun(hour: float, azimuth: float, elevation: float) -> None:
    found = sun_at_hour(hour)
    assert found[0] == pytest.approx(azimuth, abs=1e-6)
    assert found[1] == pytest.approx(elevation, abs=1e-3)
    assert sun_at_hour(12.0)[2] > sun_at_hour(8.0)[2] > sun_at_hour(5.0)[2] == 0.0


def test_an_object_is_held_and_placed_as_a_fresh_scene_would_have_it() -> None:
    data = luxel.load("cornell-box")
    scene = upload(live.with_held(data, 2, data.objects[2].to_world))
    before = draw(scene)
    np.testing.assert_allclose(before.mean(), draw(upload(luxel.load("cornell-box"))).mean(), rtol=0.02)
    moved = translation(0.1, 0.4, -0.1)

    def move(other: SceneData) -> None:
        other.objects[2].to_world = moved @ other.objects[2].to_world

    live.place_object(scene, 2, moved @ luxel.load("cornell-box").objects[2].to_world)
    wanted = draw(upload(edited(move)))
    assert np.abs(draw(scene) - wanted).mean() < 0.25 * np.abs(before - wanted).mean()


def test_moving_a_held_object_records_nothing() -> None:
    data = live.with_held(luxel.load("cornell-box"), 2, np.eye(4))
    renderer = Renderer(upload(data), "none", size=SIZE)
    for step in range(4):
        live.place_object(renderer.scene, 2, translation(0.0, 0.05 * step, 0.0))
        renderer.step()
    recordings = renderer.compilations
    for step in range(6):
        live.place_object(renderer.scene, 2, translation(0.05 * step, 0.0, 0.0))
        renderer.step()
    dr.sync_thread()
    assert renderer.compilations == recordings


def test_what_cannot_be_is_refused_and_changes_nothing() -> None:
    scene = upload(live.copy_scene_data(luxel.load("cornell-box")))
    for act, words in (
        (lambda: live.set_lights(scene, [replace(LAMP, color=(-1.0, 0.0, 0.0))]), "0 or more"),
        (lambda: live.set_lights(scene, [replace(LAMP, position=(float("nan"), 0.0, 0.0))]), "finite numbers"),
        (lambda: live.set_lights(scene, [Light("spot", (1.0, 1.0, 1.0), direction=(0.0, 0.0, 0.0))]), "direction"),
        (lambda: set_emission(scene, 3, (float("inf"), 0.0, 0.0)), "emission"),
        (lambda: live.set_light_scale(scene, -1.0), "scaled"),
        (lambda: live.place_object(scene, 2, np.eye(4)), "still scene"),
    ):
        with pytest.raises(LuxelError, match=words):
            act()
    assert scene.host.data.lights == []


def test_motion_vectors_span_a_move_by_hand() -> None:
    """The frame after a placement sees where the object was before; the one after that, that it rests."""
    scene = upload(live.with_held(luxel.load("cornell-box"), 2, np.eye(4)))

    def heights() -> tuple[float, float]:
        before, now = (np.array(rows).reshape(-1, 3, 4)[3, 1, 3] for rows in (
            scene.geometry.to_world_before, scene.geometry.to_world,
        ))  # fmt: skip
        return float(before), float(now)

    set_time(scene, 0.0)
    live.place_object(scene, 2, translation(0.0, 0.25, 0.0))
    live.place_object(scene, 2, translation(0.0, 0.5, 0.0))
    set_time(scene, 0.0)
    assert heights() == (0.0, 0.5)
    set_time(scene, 0.0)
    assert heights() == (0.5, 0.5)


def test_a_copy_leaves_the_original_alone() -> None:
    data = luxel.load("cornell-box")
    copy = live.copy_scene_data(data)
    copy.lights.append(LAMP)
    copy.materials[0].emission = (1.0, 1.0, 1.0)
    copy.objects[1].to_world = translation(1.0, 0.0, 0.0)
    assert not data.lights and max(data.materials[0].emission) == 0.0
    np.testing.assert_array_equal(data.objects[1].to_world, np.eye(4))


def test_the_tint_of_the_sun_outlives_the_night() -> None:
    data = luxel.load("atrium")
    for light in data.lights:
        if light.kind == "directional":
            light.color = (6.0, 3.0, 1.0)
    scene = upload(data)
    live.set_lights(scene, with_sun(scene.host.data, 90.0, -30.0, 0.0))
    live.set_lights(scene, with_sun(scene.host.data, 90.0, 30.0, 6.0))
    (sun,) = [light for light in scene.host.data.lights if light.kind == "directional"]
    assert sun.color == pytest.approx((6.0, 3.0, 1.0), rel=1e-4)
