"""The frame gives a method that reprojects the pixels of its own last look, however the view and the world go on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import luxel
from luxel.methods import METHODS, Frame, GBuffer, Light, Method, make_params
from luxel.render.shared import Cache, CameraView
from luxel.scene.device import set_time, upload
from luxel.scene.model import Camera

SIZE = (50, 34)
VIEWS = [
    Camera((0.0, 0.1, 3.3), (0.0, 0.0, 0.0), fov=45.0),
    Camera((0.1, 0.15, 3.2), (0.05, 0.0, 0.0), fov=45.0),
    Camera((0.3, 0.2, 3.0), (0.1, -0.1, 0.0), fov=50.0),
]


@dataclass
class Places:
    p_object: mi.Point3f


class Traces(Method):
    """Tells in its irradiance how far the taps' places lie from the pixel's own, pixels; and whether there are any."""

    @dataclass
    class Params:
        asks: bool = True
        """Whether it asks for taps at all."""

    name = "traces"

    def build(self, scene, params, seed, *, workdir=None, progress=None):  # noqa: ANN001, ANN201
        return params.asks

    def reprojects(self, state: bool) -> bool:
        return state

    def query(self, scene: Any, state: bool, surface: Any) -> Light:
        return Light(mi.Color3f(0.0), mi.Color3f(0.0), mi.Float(1.0))

    def screen(self, scene: Any, state: bool, film: Any) -> Places:
        places = Places(dr.zeros(mi.Point3f, film.lane_count))
        dr.make_opaque(places)
        return places

    def shade(self, scene: Any, state: bool, screen: Places, frame: Frame, gbuffer: GBuffer) -> tuple[Light, Places]:
        own = mi.Point3f(gbuffer.surface.p_object)
        told = mi.Color3f(dr.zeros(mi.Float, dr.width(gbuffer.lane)))
        if gbuffer.taps is not None:
            pixel = gbuffer.depth * dr.norm(gbuffer.camera.right) * (2.0 / SIZE[0])
            facing = dr.fmax(dr.dot(gbuffer.surface.n_geometric, gbuffer.surface.wo), 0.05)
            off = dr.norm(gbuffer.taps.gather(screen.p_object) - own) / pixel * facing
            found = gbuffer.taps.found & gbuffer.surface.active
            told = mi.Color3f(dr.select(found, off, 0.0), dr.select(found, mi.Float(1.0), 0.0), 0.0)
        return Light(told, mi.Color3f(0.0), mi.Float(1.0)), Places(own)


@pytest.fixture
def traces() -> Iterator[None]:
    METHODS["traces"] = Traces()
    yield
    del METHODS["traces"]


def make_view(scene: str, asks: bool = True, **options: Any) -> CameraView:
    cache = Cache(upload(luxel.load(scene)), "traces", make_params("traces", None, {"asks": asks}))
    return CameraView(cache, SIZE, **options)


def told(eye: CameraView) -> tuple[float, float]:
    """Return the largest miss of the taps, pixels, and the share of hit pixels that have any."""
    layers = eye.layers()
    return float(layers.indirect[..., 0].max()), float(layers.indirect[layers.hit][:, 1].mean())


def test_taps_lead_to_the_last_look(traces: None) -> None:
    eye = make_view("cornell-box")
    eye.step(VIEWS[0])
    assert told(eye)[1] == 0.0  # nothing has been seen before
    order = [0, 1, 1, 1, 2, 0, 0, 2, 1]
    for before, now in zip([0, *order], order, strict=False):
        eye.step(VIEWS[now])
        miss, share = told(eye)
        assert miss < 0.05 if before == now else miss < 2.0, (before, now, miss)
        assert share > 0.99 if before == now else share > 0.85, (before, now)


def test_a_shifted_picture_leads_back_to_the_other_shift(traces: None) -> None:
    eye = make_view("cornell-box")
    for step in range(4):
        eye.cache.advance()
        eye.look(VIEWS[0], (1.5 * (step % 2) / SIZE[0], 0.0))
        miss, share = told(eye)
        assert step == 0 or (share > 0.9 and 0.2 < miss < 1.5)


@pytest.mark.parametrize("options", [{}, {"filter": "box"}])
def test_moving_objects_and_filters(traces: None, options: dict[str, Any]) -> None:
    eye = make_view("moving", **options)
    eye.average_direct = False  # then no mean over frames hides what one frame tells
    camera = Camera((0.0, 1.6, 2.4), (0.0, 1.0, 0.0), fov=70.0)
    for step in range(6):
        set_time(eye.cache.scene, 0.05 * step)
        eye.step(camera)
    miss, share = told(eye)
    assert share > 0.9 and miss < 2.0


def test_another_state_has_seen_nothing(traces: None) -> None:
    eye = make_view("cornell-box")
    for _ in range(3):
        eye.step(VIEWS[0])
    assert told(eye)[1] > 0.99
    eye.cache.rebuild(eye.cache.scene, make_params("traces"))
    eye.step(VIEWS[0])
    assert told(eye)[1] == 0.0


def test_who_does_not_ask_gets_none(traces: None) -> None:
    eye = make_view("cornell-box", asks=False)
    for _ in range(2):
        eye.step(VIEWS[0])
    view = eye.view
    assert view is not None and view.last is None and told(eye) == (0.0, 0.0)
    assert np.isfinite(eye.layers().image()).all()
