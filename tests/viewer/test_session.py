"""The engine without a browser."""

from __future__ import annotations

import time as clock
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

import luxel
from luxel.errors import LuxelError
from luxel.render.exposure import KINDS, Meter
from luxel.render.shared import Cache, CameraView
from luxel.scene.model import Camera, Light
from luxel.viewer.interleaved import DisplaySettings, InterleavedView
from luxel.viewer.session import Session
from luxel.viewer.snapshot import Snapshot
from luxel.viewer.visitor import DisplayFrame, Mailbox, Visitor
from luxel.viewer.world import Choice

from .conftest import start_session, wait_for


def next_frame(visitor: Visitor) -> DisplayFrame:
    return wait_for(lambda: visitor.mailbox.take(0.2), what="a picture")


def rest(session: Session, visitor: Visitor) -> np.ndarray:
    """Return the sharp picture."""
    after = visitor.frame_count
    wait_for(
        lambda: visitor.frame_count > after + 2 and not visitor.is_moving and visitor.is_sharp, what="a sharp picture"
    )
    return next_frame(visitor).pixels


def test_a_visitor_gets_a_picture_that_sharpens(session: Session) -> None:
    visitor = session.join()
    assert next_frame(visitor).pixels.ndim == 3
    sharp = rest(session, visitor)
    assert sharp.shape == (visitor.size[1], visitor.size[0], 3)
    assert sharp.dtype == np.uint8
    assert sharp.mean() > 20.0 and sharp.std() > 10.0
    assert not session.faults


class Fading:
    """An encoder that shows every film alike, by the light of the moment."""

    light = 1.0

    def encode(self, film: Any, picture: Any, look: str, exposure: float) -> tuple[np.ndarray, Meter]:
        return np.full((film.height, film.width, 3), int(100 * self.light), np.uint8), self.meter()

    def meter(self) -> Meter:
        return Meter(np.full((KINDS, 1), self.light), np.ones((KINDS, 1)))


def test_a_picture_of_mixed_passes_is_not_called_sharp(monkeypatch: pytest.MonkeyPatch) -> None:
    """While the light changes from pass to pass, the pixels between one another show different light."""
    monkeypatch.setattr(CameraView, "look", lambda self, camera, shift=(0.0, 0.0), *, learn=True: None)
    renderer = luxel.Renderer("cornell-box", "none", size=(16, 16))
    cache = Cache(renderer.scene, "none", renderer.params)
    interleaved, encoder = InterleavedView(cache, (48, 24), 2.0, 3), Fading()
    visitor = Visitor(1, Camera(), (48, 24))
    visitor._interleaved = {"none": interleaved}

    def rest(passes: int, fade: float) -> None:
        for _ in range(passes):
            encoder.light *= fade
            interleaved.rest(Camera(), cast(Any, encoder), DisplaySettings(), learn=True)

    interleaved.turn(Camera(), cast(Any, encoder), DisplaySettings(), learn=True)
    for _ in range(3):
        rest(9, 0.97)
        assert interleaved.is_full and len(np.unique(interleaved.image())) > 1 and not visitor.is_sharp
    rest(9, 1.0)  # the last films of the change take the place of older ones
    rest(9, 1.0)
    assert len(np.unique(interleaved.image())) == 1 and visitor.is_sharp
    rest(9, 0.9995)
    assert visitor.is_sharp
    rest(1, 0.9)
    assert not visitor.is_sharp
    interleaved.turn(Camera(), cast(Any, encoder), DisplaySettings(), learn=True)
    assert not visitor.is_sharp


def test_visitors_have_cameras_of_their_own_and_share_the_cache(session: Session) -> None:
    one, two = session.join(), session.join()
    away = Camera((0.0, 0.0, 3.9), (10.0, 0.0, 3.9), fov=40.0)
    session.ask(two, lambda world, visitor: visitor.turn(away, clock.perf_counter()))
    assert rest(session, one).std() > 10.0
    assert rest(session, two).std() < 1.0  # it looks past the box
    session.post(two, lambda world, visitor: world.switch_method("none"))
    wait_for(lambda: session.facts.choice.method == "none")
    assert session.ask(one, lambda world, visitor: world.main) == "none"


def test_a_bad_value_is_refused_in_words_and_changes_nothing(session: Session) -> None:
    visitor = session.join()
    before = session.ask(visitor, lambda world, _: (world.caches[world.main].state, world.choices[world.main]))
    for key, value in (("rays_per_surfel", -1), ("tile_size", 5), ("surfel_target", 0), ("no_such", 1)):
        with pytest.raises(LuxelError, match=key):
            session.ask(visitor, lambda world, _, key=key, value=value: world.set_param(key, value))
    kind, sentence = visitor.notices[-1]
    assert kind == "error" and "no_such" in sentence
    after = session.ask(visitor, lambda world, _: world.choices[world.main])
    assert after == before[1]
    next_frame(visitor)
    assert session.running and not session.faults


def test_a_fault_in_a_request_leaves_the_session_alive(session: Session) -> None:
    visitor = session.join()

    def fail(world: object, _: Visitor) -> None:
        raise ZeroDivisionError("on purpose")

    with pytest.raises(LuxelError, match="on purpose"):
        session.ask(visitor, fail)
    assert "ZeroDivisionError" in session.faults[0]
    next_frame(visitor)


def test_dials_keep_the_cache_and_sizes_do_not(session: Session) -> None:
    visitor = session.join()
    rest(session, visitor)
    frames = session.ask(visitor, lambda world, _: world.caches["gibs"].frame_index)
    assert session.ask(visitor, lambda world, _: world.set_param("short_blend", 0.2))
    assert session.ask(visitor, lambda world, _: world.set_param("rays_per_surfel", 2))
    assert session.ask(visitor, lambda world, _: world.caches["gibs"].frame_index) >= frames
    assert not session.ask(visitor, lambda world, _: world.set_param("surfel_target", 2000))
    assert session.ask(visitor, lambda world, _: world.caches["gibs"].frame_index) < frames


def test_nothing_is_recorded_while_a_camera_turns(session: Session) -> None:
    visitor = session.join()
    rest(session, visitor)
    stride = visitor.stride_controller.stride
    recordings = session.stats.recordings
    for step in range(10):
        camera = Camera((0.05 * step, 0.0, 3.9), (0.0, 0.0, 0.0), fov=39.0)
        session.ask(visitor, lambda world, visitor, c=camera: visitor.turn(c, clock.perf_counter()))
        next_frame(visitor)
    if visitor.stride_controller.stride == stride:  # another stride is another size, and may be recorded
        assert session.stats.recordings == recordings


def test_only_the_last_of_requests_with_one_key_is_carried_out(session: Session) -> None:
    visitor, done = session.join(), []
    session.post(visitor, lambda world, _: clock.sleep(0.2))
    for number in range(20):
        session.post(visitor, lambda world, _, n=number: done.append(n), key="slider")
    session.ask(visitor, lambda world, _: None)
    assert done[-1] == 19 and len(done) <= 2


def test_who_leaves_is_forgotten_and_frames_stop(session: Session) -> None:
    visitor = session.join()
    next_frame(visitor)
    session.leave(visitor)
    clock.sleep(0.5)
    frame_count = visitor.frame_count
    clock.sleep(0.5)
    assert visitor.frame_count == frame_count and not session.visitors()


def test_light_can_be_scaled_added_moved_and_removed(session: Session) -> None:
    visitor = session.join()
    visitor.show(auto_exposure=False, exposure=0.5)
    before = rest(session, visitor).mean()
    session.ask(visitor, lambda world, _: world.set_light_scale(0.25))
    dark = rest(session, visitor).mean()
    assert dark < 0.8 * before
    session.ask(visitor, lambda world, _: world.set_light_scale(1.0))
    lamp = Light("point", (4.0, 4.0, 4.0), position=(0.0, 0.0, 0.8), name="lamp 1")
    session.ask(visitor, lambda world, _: world.add_light(lamp))
    assert rest(session, visitor).mean() > before
    session.ask(visitor, lambda world, _: world.set_light(0, position=(0.5, 0.5, 0.5)))
    with pytest.raises(LuxelError, match="0 or more"):
        session.ask(visitor, lambda world, _: world.set_light(0, color=(-1.0, 0.0, 0.0)))
    assert session.ask(visitor, lambda world, _: world.lights[0].position) == (0.5, 0.5, 0.5)
    session.ask(visitor, lambda world, _: world.remove_light(0))
    assert session.ask(visitor, lambda world, _: len(world.lights)) == 0
    assert not session.faults


def test_an_object_is_grabbed_moved_and_followed(session: Session) -> None:
    visitor = session.join()
    before = rest(session, visitor)
    moved = np.eye(4)
    moved[:3, 3] = (0.0, 0.9, 0.0)
    assert session.ask(visitor, lambda world, _: world.hold(2))  # the small box was part of the still scene
    assert not session.ask(visitor, lambda world, _: world.hold(2))
    session.ask(visitor, lambda world, _: world.place(2, moved))
    after = rest(session, visitor)
    assert np.abs(after.astype(int) - before).mean() > 3.0
    with pytest.raises(LuxelError, match="small-box"):
        session.ask(visitor, lambda world, _: world.place(2, np.zeros((4, 4))))
    assert not session.faults


def test_the_truth_beside_a_method_is_measured(session: Session) -> None:
    visitor = session.join()
    wanted = replace(visitor.comparison, rival="path", shows_map=True)
    session.ask(visitor, lambda world, visitor: setattr(visitor, "comparison", wanted))
    figures = wait_for(lambda: dict(visitor.figures), 90.0, "figures")
    assert set(figures) == {"regional", "bias", "rmse_tonemapped", "abs_error_mean", "samples"}
    assert all(np.isfinite(value) for value in figures.values())


def test_every_look_can_be_drawn(session: Session) -> None:
    from luxel.viewer.host_looks import looks_of

    visitor = session.join()
    rest(session, visitor)
    for method in ("gibs", "ddgi"):
        session.ask(visitor, lambda world, _, m=method: world.switch_method(m))
        for look in looks_of(method):
            session.ask(visitor, lambda world, visitor, n=look: visitor.show(look=n))
            after = visitor.frame_count
            wait_for(lambda after=after: visitor.frame_count > after + 1, what=look)
            assert visitor.look == look
    assert not session.faults, session.faults[0]


def test_an_animation_plays_steps_and_scrubs() -> None:
    session = start_session("moving")
    try:
        visitor = session.join()
        next_frame(visitor)
        session.ask(visitor, lambda world, _: world.play(True))
        wait_for(lambda: session.stats.now > 0.2, what="time")
        session.ask(visitor, lambda world, _: world.play(False))
        session.ask(visitor, lambda world, _: world.seek(1.5))
        wait_for(lambda: session.stats.now == 1.5, what="the wanted time")
        with pytest.raises(LuxelError, match="speed"):
            session.ask(visitor, lambda world, _: world.set_speed(0.0))
        assert not session.faults
    finally:
        session.stop(20.0)


def test_a_bad_scene_or_method_is_said_before_anything_runs() -> None:
    with pytest.raises(LuxelError, match="rays_per_surfel"):
        Session(luxel.load("cornell-box"), Choice("gibs", settings={"rays_per_surfel": 0}), size=(64, 64)).start()


def test_stop_is_quick(session: Session) -> None:
    next_frame(session.join())
    start = clock.perf_counter()
    session.stop(5.0)
    assert clock.perf_counter() - start < 5.0
    assert not session.running


def test_a_slot_holds_the_newest_and_keeps_what_it_answers() -> None:
    mailbox, pixels = Mailbox(), np.zeros((1, 1, 3), np.uint8)
    mailbox.put(DisplayFrame(pixels, 1, True, 1.0))
    mailbox.put(DisplayFrame(pixels, 2, True, 2.0))
    taken = mailbox.take(0.0)
    assert taken is not None and (taken.number, taken.asked) == (2, 1.0)
    assert mailbox.take(0.01) is None
    mailbox.put(DisplayFrame(pixels, 3, False, None))
    start = clock.perf_counter()
    assert mailbox.take(1.0, calm=0.1) is not None
    assert clock.perf_counter() - start >= 0.1
    mailbox.close()
    assert mailbox.take(10.0) is None


def test_passes_between_two_advances_draw_other_random_numbers() -> None:
    """A pixel that is looked at twice while the cache waits must not average one sample with itself."""
    import drjit as dr

    from luxel import runtime
    from luxel.methods import make_params
    from luxel.render.shared import Cache, CameraView
    from luxel.scene.device import upload

    runtime.start("cpu")
    data = luxel.load("cornell-box")
    cache = Cache(upload(data), "path", make_params("path"))
    eyes = [CameraView(cache, (32, 32)) for _ in range(2)]
    means = []
    for _ in range(2):
        for eye in eyes:
            eye.look(data.cameras[0])
        means.append([eye.layers().indirect for eye in eyes])
    dr.sync_thread()
    assert np.abs(means[0][0] - means[0][1]).max() > 0.0
    assert np.abs(means[0][0] - means[1][0]).max() > 0.0
    assert eyes[0].still_frames == 1


def test_at_rest_nothing_is_rendered_until_something_is_asked_for(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("luxel.viewer.visitor.REST_FRAMES", 3)
    visitor = session.join()
    rest(session, visitor)

    def is_quiet() -> bool:
        before = visitor.frame_count
        clock.sleep(0.4)
        return visitor.frame_count == before

    wait_for(is_quiet, what="rest")
    before = rest_free_frame(session, visitor)
    session.post(visitor, lambda world, visitor: visitor.show(look="albedo"))
    wait_for(lambda: np.abs(next_frame(visitor).pixels.astype(int) - before).mean() > 5.0, what="another look")


def rest_free_frame(session: Session, visitor: Visitor) -> np.ndarray:
    """Return the picture of a visitor at rest, which is rendered once more for that."""
    session.ask(visitor, lambda world, _: None)
    return next_frame(visitor).pixels


def test_a_look_that_cannot_be_drawn_is_said_and_the_image_goes_on(session: Session) -> None:
    visitor = session.join()
    session.ask(visitor, lambda world, _: world.switch_method("ddgi"))
    session.ask(visitor, lambda world, _: world.set_param("show_debug_layer", 900))
    session.ask(visitor, lambda world, visitor: visitor.show(look="irradiance-atlas"))
    wait_for(lambda: visitor.look == "image", what="the image")
    assert any("show_debug_layer" in sentence for _, sentence in visitor.notices)
    next_frame(visitor)
    assert not session.faults


def test_a_picture_of_a_method_that_is_left_is_finished(session: Session) -> None:
    visitor, kept = session.join(), []

    def start(world, visitor) -> None:  # noqa: ANN001
        visitor.snapshots.append(Snapshot(world, visitor.camera, (48, 48), 1, kept.append))
        world.switch_method("ambient")

    session.ask(visitor, start)
    wait_for(lambda: bool(kept), 60.0, "the picture")
    assert kept[0].image().shape == (48, 48, 3)
    session.leave(visitor)


def test_one_visitors_fault_is_that_visitors_alone(session: Session) -> None:
    broken, whole = session.join(), session.join()

    class Failing:
        method = "gibs"

        def step(self, world: object, encoder: object) -> bool:
            raise ValueError("a picture that cannot be")

    session.ask(broken, lambda world, visitor: visitor.snapshots.append(cast(Any, Failing())))
    before = whole.frame_count
    session.ask(whole, lambda world, visitor: world.reset())
    wait_for(lambda: whole.frame_count > before + 3, 30.0, "pictures of the other visitor")
    wait_for(lambda: not broken.snapshots, 30.0, "the picture to be dropped")
    assert any("a picture that cannot be" in fault for fault in session.faults)
    session.faults.clear()
    session.leave(broken)
    session.leave(whole)


def test_the_controls_know_where_an_object_was_moved_to(session: Session) -> None:
    visitor = session.join()
    there = np.array(session.facts.objects[1].matrix)
    there[0, 3] += 0.25
    session.ask(visitor, lambda world, _: world.place(1, there))
    wait_for(lambda: abs(session.facts.objects[1].matrix[0, 3] - there[0, 3]) < 1e-9, 30.0, "the new place")
    assert session.facts.objects[1].held
    session.leave(visitor)
