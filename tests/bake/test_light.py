"""What stands in the texels: the path tracer's light, by every method, and no hole anywhere."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.bake.core import Baked, bake_scene
from luxel.errors import LuxelError
from luxel.scene import load

from .conftest import SMALL

ATLAS = {"texel_target": SMALL["texel_target"]}


@pytest.fixture(scope="module")
def truth() -> Baked:
    return bake_scene(load("cornell-box"), "path", dict(ATLAS), samples=32)


def test_texels_hold_what_the_path_tracer_finds(cornell: Baked, truth: Baked) -> None:
    np.testing.assert_array_equal(cornell.layout.slot, truth.layout.slot)
    own = cornell.layout.source == np.arange(len(cornell.layout.slot))
    assert cornell.light.indirect[own].mean() == pytest.approx(truth.light.indirect[own].mean(), rel=0.03)
    assert cornell.light.direct[own].mean() == pytest.approx(truth.light.direct[own].mean(), rel=0.02)
    difference = np.abs(cornell.light.indirect - truth.light.indirect)[own].mean()
    assert difference < 0.15 * truth.light.indirect[own].mean()


def test_probes_bake_too(truth: Baked) -> None:
    baked = bake_scene(load("cornell-box"), "ddgi", dict(ATLAS), frames=48, samples=8)
    own = truth.layout.source == np.arange(len(truth.layout.slot))
    assert baked.light.indirect[own].mean() == pytest.approx(truth.light.indirect[own].mean(), rel=0.1)


def test_texels_inside_things_take_their_neighbours_light(cornell: Baked) -> None:
    inside = cornell.layout.source != np.arange(len(cornell.layout.slot))
    assert inside.any()
    assert (cornell.light.albedo[inside].max(axis=1) > 0.0).all()


def test_a_method_that_needs_a_camera_is_refused() -> None:
    with pytest.raises(LuxelError, match="'gibs' cannot bake"):
        bake_scene(load("cornell-box"), "gibs")
