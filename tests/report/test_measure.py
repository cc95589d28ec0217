"""The figures of a run whose behaviour is known exactly."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from luxel.image.layers import Layers
from luxel.metrics.error import bias
from luxel.report.measure import measure_run, series_frames
from luxel.scene.model import Camera, SceneData

HERE = [Camera()]
EMPTY = SceneData("empty", [], [], flight=HERE)
SEALED = SceneData(
    "sealed",
    [],
    [],
    flight=HERE,
    facts={f"sealed_{end}_{axis}": value for axis in "xyz" for end, value in (("lo", 0), ("hi", 1))},
)


SIZE = (32, 32)
"""(width, height)."""


def make_layers(indirect: float, *, direct: float = 1.0) -> Layers:
    """Return layers whose left half gets `indirect` and whose right half twice that."""
    light = np.full((SIZE[1], SIZE[0], 3), indirect, np.float32)
    light[:, SIZE[0] // 2 :] *= 2.0

    def fill(value: float) -> np.ndarray:
        return np.full_like(light, value)

    ones = np.ones(light.shape[:2], np.float32)
    return Layers(fill(0.5), fill(0.0), fill(direct), light, fill(0.0), ones, ones > 0.0)


@dataclass
class FakeTruth:
    """What `render_truth` returns."""

    layers: Layers = field(default_factory=lambda: make_layers(1.0))
    spp: int = 16
    seconds: float = 0.5

    @property
    def halves(self) -> tuple[np.ndarray, np.ndarray]:
        return self.layers.indirect * 0.99, self.layers.indirect * 1.01


class FakeRenderer:
    """Goes a share `speed` of the way to `level` times the lamps each frame; `wobble` alternates around it."""

    method, state = SimpleNamespace(warnings=lambda state: []), None

    def __init__(
        self, data: SceneData, *, level: float = 1.0, speed: float = 0.5, wobble: float = 0.0, leak: float = 0.0
    ) -> None:
        self.scene = SimpleNamespace(host=SimpleNamespace(data=data))
        self.level, self.speed, self.wobble, self.leak = level, speed, wobble, leak
        self.lamps, self.light, self.frame = 1.0, 0.0, 0
        self.flights = 0
        self.compilations = 2

    def step(self, time: float | None = None, camera: Any = None) -> None:
        self.frame += 1
        self.light += self.speed * (self.level * self.lamps - self.light)

    def run(self, frames: int, *, time_of: Any = None, progress: Any = None) -> list[float]:
        for _ in range(frames):
            self.step()
        # The first frame compiles.
        return [1000.0 if self.frame - frames + index == 0 else 2.0 for index in range(frames)]

    def layers(self) -> Layers:
        # The direct light is noisy on purpose: flicker must not see it.
        return make_layers(self.light + self.wobble * (-1) ** self.frame, direct=1.0 + 0.1 * (self.frame % 3))

    def set_light_scale(self, factor: float) -> None:
        self.lamps = factor

    def staged(self, frames: int = 5) -> dict[str, float]:
        return {"gbuffer": 0.5, "direct": 0.25}

    def cache(self) -> dict[str, int]:
        return {"surfel_count": 3}

    def irradiance_at(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        return np.full(points.shape, self.leak, np.float32)


@pytest.fixture(autouse=True)
def no_device(monkeypatch: pytest.MonkeyPatch) -> None:
    def fly(renderer: FakeRenderer) -> None:
        renderer.flights += 1

    monkeypatch.setattr("luxel.render.flight.fly_through", fly)
    monkeypatch.setattr("luxel.render.floor.measure_floor", lambda renderer: 0.5)
    monkeypatch.setattr("luxel.render.floor.count_rays", lambda renderer: {"closest": 10, "shadow": 20})


def measure(data: SceneData = EMPTY, frames: int = 40, flight: bool = False, **behaviour: float) -> Any:
    made: list[FakeRenderer] = []

    def make() -> Any:
        made.append(FakeRenderer(data, **behaviour))
        return made[-1]

    run = measure_run(make, FakeTruth(), frames=frames, exposure=0.5, flight=flight)  # type: ignore[arg-type]
    return run, made


def test_series_looks_at_powers_of_two_and_the_end() -> None:
    assert series_frames(1) == [1]
    assert series_frames(8) == [1, 2, 4, 8]
    assert series_frames(100) == [1, 2, 4, 8, 16, 32, 64, 100]


def test_the_series_falls_and_leaves_compilation_out() -> None:
    run, _ = measure(frames=40)
    series = run.figures["series"]
    assert series["frame"] == [1, 2, 4, 8, 16, 32, 40]
    assert series["regional"] == sorted(series["regional"], reverse=True)
    # After one frame half of the light is there: sqrt((0.5^2 + 1^2) / 2) / 1.5.
    assert series["regional"][0] == pytest.approx((0.625**0.5) / 1.5, rel=1e-3)
    assert series["ms"] == [2.0 * frame for frame in series["frame"]]
    assert run.figures["frame_ms"] == 2.0


def test_the_judged_image_is_that_after_the_frames() -> None:
    run, _ = measure(frames=3)
    assert run.figures["bias"] == pytest.approx(-0.125, rel=1e-3)
    assert bias(run.layers, FakeTruth().layers) == pytest.approx(-0.125, rel=1e-3)


def test_lag_is_counted_in_frames() -> None:
    # Each frame halves the distance: 0.5, 0.75, 0.875, 0.9375 of the step.
    assert measure(speed=0.5)[0].figures["lag_frames"] == 4
    assert measure(speed=1.0)[0].figures["lag_frames"] == 1
    # 0.995^n <= 0.1 only after 459 frames.
    assert measure(frames=2000, speed=0.005)[0].figures["lag_frames"] is None
    assert measure(level=0.0)[0].figures["lag_frames"] is None


def test_lamps_are_turned_up_again() -> None:
    _, made = measure()
    assert made[0].lamps == 1.0


def test_flicker_ignores_the_direct_light() -> None:
    calm, _ = measure(speed=1.0)
    assert calm.figures["flicker_absolute"] == pytest.approx(0.0, abs=1e-6)
    restless, _ = measure(speed=1.0, wobble=0.05)
    assert restless.figures["flicker_absolute"] > 0.01
    # The absolute figure sums three channels, the relative one divides by the mean of one: more than 0.01 / 1.
    assert restless.figures["flicker"] > restless.figures["flicker_absolute"]


def test_leak_only_where_there_is_a_sealed_room() -> None:
    assert measure(EMPTY)[0].figures["leak"] is None
    run, made = measure(SEALED, leak=0.03)
    # The lit view has 1 on the left and 2 on the right.
    assert run.figures["leak"] == pytest.approx(0.03 / 1.5, rel=1e-3)
    assert [one.flights for one in made] == [0, 1]


def test_a_flight_comes_first_when_asked_for() -> None:
    assert [one.flights for one in measure(flight=True)[1]] == [1]
    # A scene that names none gets one that is found for it.
    assert [one.flights for one in measure(SceneData("no flight", [], []), flight=True)[1]] == [1]
