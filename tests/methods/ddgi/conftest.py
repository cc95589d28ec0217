"""What the tests of DDGI share: small scenes, states built on them, states and rays written by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.fibonacci import fibonacci_direction, random_rotation, rotate
from luxel.methods import METHODS
from luxel.methods.base import Frame
from luxel.methods.ddgi.method import pack
from luxel.methods.ddgi.state import DdgiState, ProbeRayResults
from luxel.methods.params import make_params
from luxel.scene.device import Scene, upload
from luxel.scene.library.shapes import quad
from luxel.scene.model import Camera, Material, Object, SceneData


@pytest.fixture(scope="session")
def bare() -> Scene:
    """A floor of 8 x 8 m at y = -4, without any light."""
    floor = quad((-4, -4, 4), (4, -4, 4), (4, -4, -4), (-4, -4, -4), 0)
    return upload(SceneData("bare", [Object("floor", [floor])], [Material()], cameras=[Camera()]))


@pytest.fixture(scope="session")
def build() -> Callable[..., DdgiState]:
    """(scene, settings) -> a fresh state."""

    def make(scene: Scene, preset: str | None = None, **settings: object) -> DdgiState:
        return METHODS["ddgi"].build(scene, make_params("ddgi", preset, dict(settings)), 1)

    return make


@pytest.fixture(scope="session")
def lit() -> Callable[..., DdgiState]:
    """(state, colours (total, 3)) -> the state whose probes all know these irradiances, and see everything."""

    def make(state: DdgiState, colors: np.ndarray, scale: float = 1.0) -> DdgiState:
        texels = state.settings.irradiance_resolution**2
        rows = np.repeat(np.asarray(colors, np.float32), texels, axis=0)
        mean = mi.Color3f(*(mi.Float(np.ascontiguousarray(rows[:, i])) for i in range(3)))
        count = dr.full(mi.Float, 100.0, len(rows))
        state = replace(state, irradiance=replace(state.irradiance, mean=mean, short=mean, count=count))
        state = replace(state, probes=replace(state.probes, age=dr.full(mi.UInt32, 1, state.settings.total)))
        return pack(replace(state, scale=dr.opaque(mi.Float, scale)))

    return make


@pytest.fixture(scope="session")
def rays() -> Callable[..., ProbeRayResults]:
    """(state, radiance of directions, distance of origins and directions, frame) -> what the probes' rays bring."""

    def make(
        state: DdgiState,
        radiance: Callable[[np.ndarray], np.ndarray] | float = 0.0,
        distance: Callable[[np.ndarray, np.ndarray], np.ndarray] | float = 1.0,
        frame: int = 0,
    ) -> ProbeRayResults:
        count = state.settings.rays_per_probe
        lane = dr.arange(mi.UInt32, state.settings.total * count)
        probe = lane // count
        d = rotate(random_rotation(probe, mi.UInt32(frame)), fibonacci_direction(lane % count, mi.UInt32(count)))
        directions = np.array(d).T
        origins = np.array(dr.gather(mi.Point3f, state.probes.p, probe)).T
        light = radiance(directions) if callable(radiance) else np.full(len(directions), radiance)
        far = distance(origins, directions) if callable(distance) else np.full(len(directions), distance)
        rows = np.concatenate([directions, far[:, None]], axis=1).astype(np.float32)
        lights = np.concatenate([np.repeat(light[:, None], 3, axis=1), np.zeros((len(light), 1))], axis=1)
        width = len(directions)
        return ProbeRayResults(
            direction_depth=mi.Float(np.ascontiguousarray(rows).ravel()),
            radiance=mi.Float(np.ascontiguousarray(lights, np.float32).ravel()),
            p=mi.Point3f(dr.gather(mi.Point3f, state.probes.p, probe) + d),
            hit=dr.full(mi.Bool, True, width),
        )

    return make


@pytest.fixture
def frame() -> Frame:
    """The first frame of a still scene."""
    return Frame(dr.opaque(mi.UInt32, 0), dr.opaque(mi.UInt32, 1), dr.opaque(mi.Bool, True))


@pytest.fixture(scope="session")
def numbers() -> Callable[[Any], np.ndarray]:
    """Dr.Jit values as (N,) or (N, dims)."""

    def convert(value: Any) -> np.ndarray:
        array = np.array(value)
        return array.T if array.ndim == 2 else array

    return convert
