"""What a class says of itself is what bake, report and viewer go by: methods that they have never heard of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import luxel
from luxel.bake.core import bake_scene
from luxel.errors import LuxelError
from luxel.methods import METHODS, Light, Method
from luxel.report.jobs import MethodSetup
from luxel.report.results import _read_method
from luxel.viewer.world import list_methods


@dataclass
class Flat:
    level: mi.Color3f
    seed: mi.UInt32


class Constant(Method):
    """One irradiance everywhere."""

    @dataclass
    class Params:
        level: tuple[float, float, float] | None = None
        """Irradiance everywhere, W/m^2."""

    name: ClassVar[str] = "constant"
    bakeable: ClassVar[bool] = True
    irradiance_param: ClassVar[str] = "level"

    def build(self, scene, params, seed, *, workdir=None, progress=None):
        return Flat(mi.Color3f(*(dr.opaque(mi.Float, c) for c in params.level)), dr.opaque(mi.UInt32, seed))

    def query(self, scene, state, surface):
        return Light(mi.Color3f(state.level), mi.Color3f(0.0), dr.select(surface.active, mi.Float(1.0), 0.0))


class Dice(Constant):
    """Draws 0 or 2 with equal chance, by the seed of its state."""

    name: ClassVar[str] = "dice"
    bakeable: ClassVar[bool] = True
    progressive: ClassVar[bool] = True

    def query(self, scene, state, surface):
        drawn = mi.Float((state.seed >> 4) & 1) * 2.0
        return Light(mi.Color3f(drawn), mi.Color3f(0.0), dr.select(surface.active, mi.Float(1.0), 0.0))


class Floor(Constant):
    """A baseline."""

    name: ClassVar[str] = "floor"
    bakeable: ClassVar[bool] = False
    baseline: ClassVar[bool] = True


@pytest.fixture(autouse=True)
def known() -> Iterator[None]:
    for method in (Constant(), Dice(), Floor()):
        METHODS[method.name] = method
    yield
    for name in ("constant", "dice", "floor"):
        del METHODS[name]


def baked(method: str, **changes):
    settings = {"level": (0.25, 0.5, 1.0), "texel_target": 512}
    return bake_scene(luxel.load("cornell-box"), method, settings, seed=3, indirect_only=True, **changes)


def test_a_bakeable_method_is_baked() -> None:
    light = baked("constant", frames=1, samples=1).light.indirect
    np.testing.assert_allclose(light, np.broadcast_to((0.25, 0.5, 1.0), light.shape), rtol=1e-5)


def test_a_progressive_method_is_sampled_and_runs_no_frame() -> None:
    done = baked("dice", samples=64)
    assert done.frames_run == 0
    # The mean of 64 draws of 0 or 2 is 1 with a deviation of 0.125.
    assert 0.5 < done.light.indirect.mean() < 1.5


def test_what_is_not_bakeable_is_refused_with_those_that_are() -> None:
    with pytest.raises(LuxelError, match=r"'floor' cannot bake: take one of path, ddgi, lightmap, constant, dice"):
        baked("floor")


def test_the_report_and_the_viewer_know_baselines() -> None:
    assert MethodSetup("floor", "floor").baseline and not MethodSetup("constant", "constant").baseline
    assert _read_method("floor", {"method": "floor", "baseline": True}).kind == "baseline"
    assert _read_method("constant", {"method": "constant", "baseline": False}).kind == "method"
    # Results of older versions say nothing of it.
    assert _read_method("ambient", {"method": "ambient"}).kind == "baseline"
    names = list_methods()
    assert names.index("constant") < names.index("dice") < names.index("floor")


def test_a_comparison_fits_the_parameter_that_the_class_names() -> None:
    fitted = MethodSetup("constant", "constant").params((0.1, 0.2, 0.3))
    assert fitted.level == (0.1, 0.2, 0.3)
    own = MethodSetup("constant", "constant", settings={"level": "0.5"})
    assert own.params((0.1, 0.2, 0.3)).level == (0.5, 0.5, 0.5)
