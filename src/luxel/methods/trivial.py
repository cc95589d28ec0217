"""The two methods that keep everyone honest: no indirect light, and one irradiance everywhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi

from luxel.errors import LuxelError
from luxel.kernels.records import Light, Surface
from luxel.methods.base import Method
from luxel.methods.inspect import Inspector
from luxel.methods.workload import Workload
from luxel.scene.device import Scene

TRIVIAL_CLAIMS = frozenset({"seeded", "saves", "finite", "compiled", "black"})


@dataclass
class NoState:
    """A state of one word."""

    nothing: mi.UInt32


class NoIndirect(Method):
    """No indirect light at all."""

    @dataclass
    class Params:
        """It has no dials."""

    name: ClassVar[str] = "none"
    claims: ClassVar[frozenset[str]] = TRIVIAL_CLAIMS
    baseline: ClassVar[bool] = True
    workload: ClassVar[Workload | None] = Workload()
    inspector: ClassVar[Inspector | None] = Inspector()

    def build(self, scene: Scene, params: Any, seed: int, *, workdir=None, progress=None) -> NoState:
        return NoState(dr.opaque(mi.UInt32, 0))

    def query(self, scene: Scene, state: NoState, surface: Surface) -> Light:
        covered = dr.select(surface.active, mi.Float(1.0), 0.0)
        return Light(mi.Color3f(0.0), mi.Color3f(0.0), covered)


@dataclass
class AmbientState:
    """One irradiance."""

    irradiance: mi.Color3f


class Ambient(Method):
    """The same irradiance everywhere: what a flat ambient term can do at best."""

    @dataclass
    class Params:
        """Dials of the ambient term."""

        irradiance: tuple[float, float, float] | None = None
        """E in W/m^2 per channel. None: estimated from a short path-traced image of the default camera (16 spp)."""

    name: ClassVar[str] = "ambient"
    irradiance_param: ClassVar[str] = "irradiance"
    claims: ClassVar[frozenset[str]] = TRIVIAL_CLAIMS
    baseline: ClassVar[bool] = True
    workload: ClassVar[Workload | None] = Workload()
    inspector: ClassVar[Inspector | None] = Inspector()

    def build(self, scene: Scene, params: Any, seed: int, *, workdir=None, progress=None) -> AmbientState:
        irradiance = params.irradiance
        if irradiance is None:
            from luxel.methods.path_tracer import estimate_ambient

            irradiance = estimate_ambient(scene, seed)
        if len(irradiance) != 3 or not all(0.0 <= float(c) < float("inf") for c in irradiance):
            raise LuxelError(f"ambient: parameter 'irradiance' is {irradiance}, but takes three numbers of 0 or more")
        return AmbientState(mi.Color3f(*(dr.opaque(mi.Float, float(c)) for c in irradiance)))

    def query(self, scene: Scene, state: AmbientState, surface: Surface) -> Light:
        covered = dr.select(surface.active, mi.Float(1.0), 0.0)
        # The light's run-time scale is part of the scene, so the term follows it.
        irradiance = state.irradiance * scene.lights.scale * covered
        return Light(irradiance, mi.Color3f(0.0), covered)
