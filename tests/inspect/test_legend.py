"""Legends: scales with round numbers, names, and the strip that shows them."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.inspect.looks.legend import PAPER, Legend, Scale, ceil_nice, draw_legend, fit_scale, format_tick
from luxel.inspect.ramps import colorize


def test_places_and_ticks_of_a_scale() -> None:
    scale = Scale(-2.0, 6.0)
    np.testing.assert_allclose(scale.place(np.array([-2.0, 2.0, 6.0, 10.0])), [0.0, 0.5, 1.0, 1.5])
    assert scale.ticks() == [-2.0, 0.0, 2.0, 4.0, 6.0]
    log = Scale(1.0, 1000.0, logarithmic=True)
    np.testing.assert_allclose(log.place(np.array([1.0, 10.0, 1000.0])), [0.0, 1.0 / 3.0, 1.0])
    assert log.place(np.array([0.0, np.nan])).max() < 0.0
    assert log.ticks() == pytest.approx([1.0, 10.0, 100.0, 1000.0])


@pytest.mark.parametrize("high", [1e-4, 0.2, 0.83, 1.0, 3.0, 7.7, 30.0, 1.2e6])
def test_ticks_are_few_and_inside(high: float) -> None:
    ticks = Scale(0.0, high).ticks()
    assert 2 <= len(ticks) <= 7 and ticks[0] == 0.0 and ticks[-1] <= high * (1.0 + 1e-6)


def test_a_scale_fits_what_is_there() -> None:
    values = np.concatenate([np.linspace(0.0, 7.1, 1000), [1e9]])  # one outlier is no reason for a dark picture
    assert fit_scale(values) == Scale(0.0, 8.0)
    assert fit_scale(values, (0.0, 1.0)) == Scale(0.0, 1.0)
    assert fit_scale(np.array([3.0, 400.0]), logarithmic=True) == Scale(1.0, 1000.0, True)
    for nothing in (np.zeros(0), np.zeros(9), np.array([np.inf, np.nan])):
        assert fit_scale(nothing) == Scale(0.0, 1.0)
        assert fit_scale(nothing, logarithmic=True) == Scale(1.0, 10.0, True)


def test_round_numbers() -> None:
    assert [ceil_nice(v) for v in (0.07, 1.0, 1.01, 7.0, 9.9)] == pytest.approx([0.08, 1.0, 2.0, 8.0, 10.0])
    assert [format_tick(v) for v in (0.0, 0.25, 20.0, 1000.0, 2.5e4)] == ["0", "0.25", "20", "1k", "25k"]


def test_the_strip_shows_the_ramp_from_end_to_end() -> None:
    legend = Legend("distance from the eye", "m", Scale(0.0, 4.0), "field")
    strip = draw_legend(legend, 256)
    assert strip.shape[1:] == (256, 3) and strip.dtype == np.float32 and 30 < strip.shape[0] < 90
    ends = colorize(np.array((0.0, 1.0)))
    bar = [y for y in range(len(strip)) if np.abs(strip[y, 10] - ends[0]).max() < 0.01]
    assert len(bar) >= 8 and all(np.abs(strip[y, 245] - ends[1]).max() < 0.01 for y in bar)
    # Numbers stand below it, the title and the unit above.
    ground = np.array(PAPER) / 255.0
    marked = np.abs(strip - ground).max(axis=2) > 0.2
    assert marked[bar[-1] + 5 :].any() and marked[: bar[0], :100].any() and marked[: bar[0], -30:].any()


def test_squares_are_drawn_as_raised_figures() -> None:
    """The unit is not the box that stands for a sign which the font lacks: it differs from another missing sign."""
    with_square = draw_legend(Legend("", "W/m²", Scale(0.0, 1.0), "heat"), 200)
    without = draw_legend(Legend("", "W/m", Scale(0.0, 1.0), "heat"), 200)
    missing = draw_legend(Legend("", "W/m\u2603", Scale(0.0, 1.0), "heat"), 200)
    assert not np.array_equal(with_square, without) and not np.array_equal(with_square, missing)


def test_names_are_listed_in_rows_that_fit() -> None:
    entries = tuple((f"object {i}", (i / 12.0, 0.5, 0.9)) for i in range(12))
    wide, narrow = (draw_legend(Legend("objects", entries=entries), width) for width in (900, 160))
    assert narrow.shape[0] > wide.shape[0] + 18 * 4
    for _, color in entries:
        for strip in (wide, narrow):
            assert (np.abs(strip - np.array(color)).max(axis=2) < 0.01).sum() >= 50


@pytest.mark.parametrize("width", [1, 16, 40, 64, 120, 2000])
@pytest.mark.parametrize("kind", ["scale", "names", "words"])
def test_any_width_is_drawn(width: int, kind: str) -> None:
    made = {
        "scale": Legend("a rather long title of a look", "W/(m² sr)", Scale(0.0, 1.0), "light"),
        "names": Legend("names", entries=(("one", (1.0, 0.0, 0.0)), ("another one", (0.0, 1.0, 0.0)))),
        "words": Legend("only words, many of them, so that they need lines of their own"),
    }[kind]
    strip = draw_legend(made, width)
    assert strip.shape[1] == width and np.isfinite(strip).all()
