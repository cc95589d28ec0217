"""`path:reproject`: a moving view's mean of many frames, judged by Mitsuba's own path tracer and by arithmetic."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.image.layers import Layers
from luxel.methods import METHODS, make_params
from luxel.metrics.error import bias, regional
from luxel.render.renderer import Renderer
from luxel.render.truth import render_truth
from luxel.scene import load
from luxel.scene.library.shapes import quad
from luxel.scene.model import Camera, Material, Object, SceneData, Sky

SIZE = 64


def start(scene: str | SceneData, history: int = 32, **options: object) -> Renderer:
    settings: dict = {"size": (SIZE, SIZE), "seed": 1, **options}
    return Renderer(load(scene) if isinstance(scene, str) else scene, "path", {"history": history}, **settings)


def counts(renderer: Renderer) -> np.ndarray:
    """Return (H, W): how many frames each pixel's mean counts as."""
    return renderer.film.to_image(renderer.screen.kept.count)


# ------------------------------------------------------------------------------------------------ error in motion


def fly(step: float) -> Camera:
    """Return the camera of a straight flight into the Cornell box, 0..1."""
    return Camera((-0.3 + 0.6 * step, 0.1, 3.7 - 0.5 * step), (0.1 * step, 0.0, 0.0), fov=42.0)


def mitsuba_cornell(camera: Camera, max_depth: int) -> np.ndarray:
    """Return Mitsuba's own Cornell box by Mitsuba's own path tracer, (SIZE, SIZE, 3)."""
    description = mi.cornell_box()
    description["sensor"]["film"] |= {"width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}
    description["sensor"]["to_world"] = mi.ScalarTransform4f().look_at(camera.eye, camera.target, (0, 1, 0))
    description["sensor"]["fov"] = camera.fov
    description["integrator"] = {"type": "path", "max_depth": max_depth, "rr_depth": 5}
    return np.array(mi.render(mi.load_dict(description), spp=512, seed=7))


def in_blocks(image: np.ndarray) -> np.ndarray:
    return image.reshape(SIZE // 8, 8, SIZE // 8, 8, 3).mean(axis=(1, 3))


def test_a_flight_is_nearer_to_mitsubas_picture_than_one_path_a_pixel() -> None:
    frames = 32
    total, direct = (mitsuba_cornell(fly(1.0), depth) for depth in (-1, 2))
    truth = in_blocks(total - direct)
    errors, means = {}, {}
    for history in (0, 32):
        renderer = start("cornell-box", history, camera=fly(0.0))
        renderer.run(8)
        for frame in range(frames):
            renderer.step(camera=fly((frame + 1) / frames))
        layers = renderer.layers()
        # Blocks of one colour: our rays go through centres, Mitsuba's through all of a pixel.
        albedo = layers.albedo.reshape(SIZE // 8, 8, SIZE // 8, 8, 3)
        even = (albedo.max(axis=(1, 3)) - albedo.min(axis=(1, 3))).max(axis=-1) < 1e-6
        even &= ~in_blocks(layers.emission).any(axis=-1) & layers.hit.reshape(SIZE // 8, 8, SIZE // 8, 8).all(
            axis=(1, 3)
        )
        assert even.sum() > 15
        found = in_blocks(layers.indirect * layers.albedo / np.pi)
        errors[history] = np.sqrt(np.mean((found - truth)[even] ** 2)) / truth[even].mean()
        means[history] = found[even].mean() / truth[even].mean()
    assert errors[32] < 0.4 * errors[0] and errors[0] > 0.05, errors
    assert means[32] == pytest.approx(1.0, abs=0.01), means


def test_a_moving_scene_is_nearer_to_its_truth() -> None:
    """Lamp and things move slowly: a history shows the light of as many frames ago."""
    data = load("moving")
    truth = render_truth(data, size=(SIZE, SIZE), spp=256, time=1.0, cache=False).layers
    found: dict[int, Layers] = {}
    for history in (0, 16):
        renderer = start("moving", history)
        renderer.run(4)
        for frame in range(24):
            renderer.step(time=0.88 + 0.005 * (frame + 1))
        found[history] = renderer.layers()
        if history:
            seen = counts(renderer)
            ids = renderer.film.to_image(renderer._view.view.last.object_id)  # type: ignore[union-attr]
            for item in np.unique(ids[truth.hit]):
                assert np.median(seen[ids == item]) > 8.0, item  # what moves has a history, too
            assert seen.max() <= 16.0
    assert regional(found[16], truth) < 0.6 * regional(found[0], truth)
    assert abs(bias(found[16], truth)) < 0.03


# ------------------------------------------------------------------------------------------------ rest


def test_at_rest_it_is_plain_averaging() -> None:
    one, many = start("cornell-box", 0), start("cornell-box", 8)
    for renderer in (one, many):
        renderer.run(24)
    np.testing.assert_array_equal(many.image(), one.image())


def test_after_a_flight_rest_alone_counts() -> None:
    """Two histories after it has come to rest, nothing of the flight is left; until then it helps."""
    one, many = start("cornell-box", 0), start("cornell-box", 8)
    for renderer in (one, many):
        for frame in range(12):
            renderer.step(camera=fly(frame / 12))
    assert np.median(counts(many)) == pytest.approx(8.0)
    for rest in (1, 6, 20):
        for renderer in (one, many):
            renderer.run(rest)
        same = np.allclose(many.layers().indirect, one.layers().indirect, rtol=1e-5, atol=1e-6)
        assert same == (rest == 20)


def test_light_that_goes_out_is_forgotten() -> None:
    renderer = start("cornell-box", 8)
    for frame in range(12):
        renderer.step(camera=fly(frame / 12))
    renderer.run(3)
    renderer.set_light_scale(0.0)
    before, left = float(renderer.layers().indirect.mean()), []
    for _ in range(18):
        renderer.step()
        left.append(float(renderer.layers().indirect.mean()))
    # Seven frames of the past count beside the dark one, and fade out within two histories.
    frame = np.arange(1, 19)
    past = 7.0 * np.maximum(1.0 - (frame - 1) / 16.0, 0.0)
    np.testing.assert_allclose(left, before * past / (past + frame), rtol=2e-3)
    assert left[15] > 0.0 and left[16] == left[17] == 0.0


# ------------------------------------------------------------------------------------------------ rejection


def test_a_disoccluded_strip_begins_anew() -> None:
    """A board before a wall, one object: where the old eye saw the board, the wall has one frame."""
    board = quad((-0.8, 0, 2.0), (0.8, 0, 2.0), (0.8, 2, 2.0), (-0.8, 2, 2.0), 0)
    wall = quad((-30, -30, 0), (30, -30, 0), (30, 30, 0), (-30, 30, 0), 0)
    data = SceneData("board", [Object("all", [wall, board])], [Material()], sky=Sky((1.0, 1.0, 1.0)))
    before, now = (Camera((x, 1.0, 6.0), (x, 1.0, 0.0), fov=60.0) for x in (0.0, 1.6))
    renderer = start(data, 32, camera=before)
    renderer.run(10)
    renderer.step(camera=now)
    seen = counts(renderer)
    half, rows, columns = np.tan(np.radians(30.0)), *np.mgrid[:SIZE, :SIZE]
    x = 1.6 + ((columns + 0.5) / SIZE * 2 - 1) * half * 6.0
    y = 1.0 + (1 - (rows + 0.5) / SIZE * 2) * half * 6.0
    pixel = 2 * half * 6.0 / SIZE

    def shadow(eye: float, margin: float) -> np.ndarray:
        """Return which points of the wall (its plane) the board hides from an eye there, grown by a margin."""
        return (np.abs(eye + (x - eye) * 4 / 6) < 0.8 + margin) & (np.abs(1 + (y - 1) * 4 / 6 - 1) < 1 + margin)

    strip = shadow(0.0, -pixel) & ~shadow(1.6, pixel)
    assert strip.sum() > 60
    np.testing.assert_array_equal(seen[strip], 1.0)
    was = (x / (half * 6.0) + 1) * SIZE / 2
    old = ~shadow(0.0, pixel) & ~shadow(1.6, pixel) & (was > 1) & (was < SIZE - 1)
    assert old.sum() > 1000
    np.testing.assert_allclose(seen[old], 11.0, rtol=1e-5)
    assert (seen[(was < -1) | (was > SIZE + 1)] == 1.0).all()


# ------------------------------------------------------------------------------------------------ full materials


def test_full_materials_keep_the_light_of_what_is_rough() -> None:
    data = load("glossy")
    camera = data.flight[0] if data.flight else data.cameras[0]
    eye = np.array(camera.eye)

    def at(step: float) -> Camera:
        return Camera(tuple(eye + step * np.array([0.3, 0.05, 0.0])), camera.target, fov=camera.fov)

    truth = render_truth(data, camera=at(1.0), size=(SIZE, SIZE), spp=64, materials="full", cache=False).layers
    found = {}
    for history in (0, 16):
        renderer = start("glossy", history, camera=at(0.0), materials="full")
        renderer.run(4)
        for frame in range(24):
            renderer.step(camera=at((frame + 1) / 24))
        found[history] = renderer.layers()
        if history:
            seen = counts(renderer)
            assert (seen == 0.0).sum() > 50 and (seen > 8.0).sum() > 1000  # mirrors and glass have none
            np.testing.assert_array_equal(found[16].indirect[seen == 0.0], found[0].indirect[seen == 0.0])
    assert regional(found[16], truth) < 0.6 * regional(found[0], truth)
    assert abs(bias(found[16], truth)) < 0.05


def test_full_materials_at_rest_are_plainly_averaged() -> None:
    data = load("cornell-box")
    data.materials[0] = replace(data.materials[0], metallic=0.5, roughness=0.4)
    one, many = (start(data, history, materials="full") for history in (0, 8))
    assert one.scene.features.gloss
    for renderer in (one, many):
        renderer.run(12)
    assert (counts(many)[one.layers().hit] > 11.5).mean() > 0.9
    np.testing.assert_allclose(many.image(), one.image(), rtol=1e-4, atol=1e-5)


# ------------------------------------------------------------------------------------------------ the frame


def test_only_those_that_reproject_keep_the_last_frame() -> None:
    for name, settings in (("none", {}), ("path", {}), ("path", {"history": 4})):
        renderer = Renderer(load("cornell-box"), name, settings, size=(16, 16))
        renderer.run(3)
        view = renderer._view.view
        assert view is not None and (view.last is not None) == bool(settings)
    assert renderer.method.reprojects(renderer.state)
    assert not any(method.reprojects(None) for name, method in METHODS.items() if name != "path")


def test_nothing_is_recorded_after_the_warm_up() -> None:
    renderer = start("moving", 16)
    renderer.run(8)
    # A scene that moves for the first time may be recorded once more, as OptiX's handles are new then.
    for time in (0.05, 0.1):
        renderer.step(time=time)
    recordings = renderer.compilations
    for frame in range(6):
        renderer.step(time=0.2 + 0.1 * frame, camera=Camera((0.1 * frame, 1.5, 2.2), (0.0, 1.0, 0.0)))
        assert renderer.set_params(history=20 + frame)
    renderer.run(2)
    assert renderer.compilations == recordings


def test_a_history_comes_and_goes() -> None:
    renderer = start("cornell-box", 0)
    renderer.run(3)
    assert not renderer.set_params(preset="reproject")
    for step in (0.2, 0.4, 0.6):
        renderer.step(camera=fly(step))
    assert np.median(counts(renderer)) == pytest.approx(3.0)
    assert not renderer.set_params(history=0)
    renderer.run(2)
    assert renderer.screen.kept is None and np.isfinite(renderer.image()).all()
    for history in (-1, 5000):
        with pytest.raises(LuxelError, match="'history' is"):
            renderer.set_params(history=history)


def test_a_saved_state_takes_the_history_asked_for(tmp_path: Path) -> None:
    renderer = start("cornell-box", 0)
    renderer.method.save(renderer.state, tmp_path / "state.npz")
    params = make_params("path", "reproject")
    state = renderer.method.load(renderer.scene, params, tmp_path / "state.npz")
    assert int(np.array(state.history)[0]) == params.history > 0
    np.testing.assert_array_equal(np.array(state.seed), np.array(renderer.state.seed))


@pytest.mark.parametrize("pixel_filter", ["box", "gaussian"])
def test_a_pixel_filter_and_a_history_go_together(pixel_filter: str) -> None:
    images = []
    for history in (0, 8):
        renderer = start("cornell-box", history, filter=pixel_filter, camera=fly(0.0))
        for frame in range(6):
            renderer.step(camera=fly(frame / 6))
        renderer.run(64)
        images.append(renderer.layers())
    dr.sync_thread()
    assert bias(images[1], images[0]) == pytest.approx(0.0, abs=0.01)
    assert regional(images[1], images[0]) < 0.03
