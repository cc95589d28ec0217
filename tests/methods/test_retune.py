"""New parameters for a cache that goes on: what is kept is kept, what cannot be is said."""

from __future__ import annotations

import numpy as np
import pytest

import luxel
from luxel.errors import LuxelError
from luxel.methods import METHODS, make_params
from luxel.render.renderer import Renderer
from luxel.scene.device import upload


@pytest.mark.parametrize(
    ("method", "change", "kept"),
    [
        ("gibs", {"short_blend": 0.3}, True),
        ("gibs", {"rays_per_surfel": 2}, True),
        ("gibs", {"plane_scale": 2.0}, True),
        ("gibs", {"surfel_target": 1500}, False),
        ("ddgi", {"normal_bias": 0.3}, True),
        ("ddgi", {"corrected_weights": False}, True),
        ("ddgi", {"probe_target": 300}, False),
        ("ddgi", {"depth_resolution": 8}, False),
        ("path", {"samples": 2}, True),
    ],
)
def test_a_cache_goes_on_where_it_can(method: str, change: dict[str, object], kept: bool) -> None:
    start = {"gibs": {"surfel_target": 1000}, "ddgi": {"probe_target": 200}}.get(method, {})
    renderer = Renderer("cornell-box", method, start, size=(32, 32))
    renderer.run(3)
    params = make_params(method, None, {**start, **change})
    state = renderer.method.retune(renderer.scene, renderer.state, params)
    assert (state is not None) == kept
    if state is None:
        return
    renderer.state = state
    renderer.run(2)
    assert np.isfinite(renderer.image()).all()


def test_what_was_learned_stays() -> None:
    renderer = Renderer("cornell-box", "gibs", {"surfel_target": 1000}, size=(32, 32))
    renderer.run(6)
    before = np.array(renderer.state.surfels.estimate.mean)
    params = make_params("gibs", None, {"surfel_target": 1000, "fade_in": 2})
    state = renderer.method.retune(renderer.scene, renderer.state, params)
    assert state is not None
    np.testing.assert_array_equal(np.array(state.surfels.estimate.mean), before)
    assert float(np.array(state.dials.fade_in)[0]) == 2.0


@pytest.mark.parametrize("method", METHODS)
def test_every_method_answers(method: str) -> None:
    scene = upload(luxel.load("cornell-box"))
    params = make_params(method)
    state = METHODS[method].build(scene, params, 0)
    again = METHODS[method].retune(scene, state, params)
    assert again is None or type(again) is type(state)


def test_bad_parameters_are_refused() -> None:
    scene = upload(luxel.load("cornell-box"))
    state = METHODS["gibs"].build(scene, make_params("gibs", None, {"surfel_target": 500}), 0)
    with pytest.raises(LuxelError, match="rays_per_surfel"):
        METHODS["gibs"].retune(scene, state, make_params("gibs", None, {"rays_per_surfel": 0}))
