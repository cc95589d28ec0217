"""How many pixels to render now."""

from __future__ import annotations

import pytest

from luxel.viewer.resolution import STRIDES, StrideController, complete_side, even_sides, fit_size, order_offsets


@pytest.mark.parametrize("window", [(1440, 860), (300, 900), (1, 1), (4000, 2000), (1280, 720)])
def test_a_full_size_has_the_windows_shape_and_divides_by_every_stride(window: tuple[int, int]) -> None:
    width, height = fit_size(window, (1280, 720))
    assert all(width % stride == height % stride == 0 for stride in STRIDES)
    assert width * height <= 1.1 * 1280 * 720
    if min(window) > 200:
        assert width / height == pytest.approx(window[0] / window[1], rel=0.06)


@pytest.mark.parametrize("stride", STRIDES)
def test_the_passes_cover_every_pixel_once(stride: int) -> None:
    order = order_offsets(stride)
    assert len(order) == len(set(order)) == stride * stride
    for side in even_sides(stride):
        step = stride // side
        assert set(order[: side * side]) == {(x * step, y * step) for x in range(side) for y in range(side)}


def test_a_picture_sharpens_in_steps() -> None:
    assert [complete_side(4, passes) for passes in (0, 1, 3, 4, 15, 16, 99)] == [0, 1, 1, 2, 2, 4, 4]
    assert [complete_side(1, passes) for passes in (0, 1)] == [0, 1]


def settle(stride_controller: StrideController, cost_ms: float, fixed_ms: float, frames: int = 60) -> list[int]:
    """Let passes cost `fixed_ms`, and `cost_ms` at stride 1 on top; return the strides chosen."""
    strides = []
    for _ in range(frames):
        strides.append(stride_controller.choose())
        stride_controller.observe(fixed_ms + cost_ms / stride_controller.stride**2)
    return strides


def test_a_fast_machine_renders_every_pixel() -> None:
    assert settle(StrideController(), cost_ms=10.0, fixed_ms=2.0)[-1] == 1


def test_a_slow_machine_answers_in_time() -> None:
    stride_controller = StrideController()
    stride = settle(stride_controller, cost_ms=700.0, fixed_ms=10.0)[-1]
    assert 10.0 + 700.0 / stride**2 <= stride_controller.allowed_ms


def test_a_hopeless_machine_takes_the_coarsest() -> None:
    assert settle(StrideController(), cost_ms=1e6, fixed_ms=100.0)[-1] == STRIDES[-1]


@pytest.mark.parametrize("cost_ms", [20.0, 60.0, 150.0, 400.0, 1500.0])
def test_the_stride_does_not_swing(cost_ms: float) -> None:
    """Each change of stride throws a picture away."""
    last = settle(StrideController(), cost_ms, fixed_ms=8.0, frames=200)[100:]
    assert len(set(last)) == 1


def test_it_follows_a_machine_that_gets_busy_and_free_again() -> None:
    stride_controller = StrideController()
    free = settle(stride_controller, 40.0, 2.0)[-1]
    busy = settle(stride_controller, 900.0, 5.0)[-1]
    assert busy > free
    assert settle(stride_controller, 40.0, 2.0)[-1] == free


@pytest.mark.parametrize("window", [(10_000_000, 1), (1, 10_000_000), (1, 1)])
def test_no_window_asks_for_more_pixels_than_the_budget(window: tuple[int, int]) -> None:
    width, height = fit_size(window, (1280, 720))
    assert 0 < width * height <= 1280 * 720
