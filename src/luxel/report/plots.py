"""Error along a run as inline SVG, on a logarithmic axis; colours come from the page's style sheet."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass

from luxel.report.figures import round_figure
from luxel.report.results import ResultEntry

WIDTH, HEIGHT = 600.0, 380.0
LEFT, RIGHT, TOP, BOTTOM = 58.0, 112.0, 16.0, 46.0
LABEL_GAP = 15.0
"""Least distance of two labels at the right edge."""
DASHES = 3
"""Patterns that the style sheet has for presets and settings of a method."""
PADDING = 0.05
"""Share of an axis left free at either end."""


@dataclass(frozen=True)
class Line:
    """A curve, a single point, or (`level`) a horizontal line over the whole width."""

    label: str
    colour: str
    """A method's name: the page colours it by `--c-<name>`."""
    points: tuple[tuple[float, float], ...]
    style: str = "solid"
    """`solid`, `dashed`, `variant-0` to `variant-2` (other dashes), `level`, or `point` for markers alone."""
    tips: tuple[str, ...] = ()
    """What each point says when pointed at; its coordinates where none is given."""


def style_of(entry: ResultEntry) -> str:
    """Return the style of a method's curve: a preset has its method's colour, and the dashes tell them apart."""
    return f"variant-{entry.variant % DASHES}" if entry.variant else "solid"


@dataclass(frozen=True)
class _Axis:
    low: float
    high: float
    start: float
    length: float
    linear: bool = False

    def place(self, value: float) -> float:
        low, high, at = (number if self.linear else math.log10(number) for number in (self.low, self.high, value))
        return self.start + self.length * (at - low) / (high - low)

    def ticks(self) -> list[float]:
        return linear_ticks(self.low, self.high) if self.linear else log_ticks(self.low, self.high)


def plot_error(lines: Sequence[Line], x_label: str, y_label: str, noise: float = 0.0, *, linear: bool = False) -> str:
    """Return an SVG of error over `x_label`, both logarithmic, or an empty text where there is no point above 0.

    `linear` True: `x_label` is not logarithmic, such as the frames of a flight, of which each counts the same.
    `noise` is the truth's own: what lies below it cannot be told apart, and is hatched.
    """
    kept = [Line(line.label, line.colour, _positive(line.points), line.style, line.tips) for line in lines]
    kept = [line for line in kept if line.points]
    xs = [x for line in kept for x, _ in line.points if line.style != "level"]
    ys = [y for line in kept for _, y in line.points]
    if not xs:
        return ""
    across = _make_axis(xs, LEFT, WIDTH - LEFT - RIGHT, linear)
    up = _make_axis([*ys, noise] if noise > 0.0 else ys, HEIGHT - BOTTOM, -(HEIGHT - TOP - BOTTOM))
    parts = [_draw_axes(across, up, x_label, y_label)]
    if noise > 0.0:
        parts.append(_draw_noise(up, noise))
    parts += [_draw_line(line, across, up) for line in kept]
    parts.append(_draw_labels(kept, across, up))
    title = f"{y_label} over {x_label}: {', '.join(line.label for line in kept)}"
    return (
        f'<svg class="plot" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" aria-label="{_escape(title)}">'
        + "".join(parts)
        + "</svg>"
    )


# ---------- Axes ----------


def log_ticks(low: float, high: float) -> list[float]:
    """Return round values between `low` and `high`: 1, 2, 5 of each decade, or powers of ten where those are many."""
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    fine = [digit * 10.0**decade for decade in decades for digit in (1, 2, 5)]
    coarse = [10.0**decade for decade in decades]
    ticks = [value for value in fine if low <= value <= high]
    return ticks if len(ticks) <= 8 else [value for value in coarse if low <= value <= high]


def linear_ticks(low: float, high: float) -> list[float]:
    """Return at most eight whole numbers between `low` and `high`, evenly: multiples of 1, 2 or 5 times 10^n."""
    steps = (digit * 10**power for power in range(9) for digit in (1, 2, 5))
    step = next(step for step in steps if (high - low) / step <= 8.0)
    return [float(value) for value in range(math.ceil(low / step) * step, math.floor(high) + 1, step)]


def _make_axis(values: Sequence[float], start: float, length: float, linear: bool = False) -> _Axis:
    if linear:
        free = max(PADDING * (max(values) - min(values)), 0.5)
        # Frames have no numbers below zero.
        return _Axis(max(min(values) - free, 0.0), max(values) + free, start, length, linear=True)
    low, high = math.log10(min(values)), math.log10(max(values))
    if high - low < 0.3:
        low, high = low - 0.15, high + 0.15
    free = PADDING * (high - low)
    return _Axis(10.0 ** (low - free), 10.0 ** (high + free), start, length)


def _draw_axes(across: _Axis, up: _Axis, x_label: str, y_label: str) -> str:
    right, bottom = WIDTH - RIGHT, HEIGHT - BOTTOM
    parts = []
    for value in across.ticks():
        x = across.place(value)
        parts.append(f'<path class="grid" d="M{x:.1f} {TOP:g}V{bottom:g}"/>')
        parts.append(f'<text class="tick" x="{x:.1f}" y="{bottom + 17:g}" text-anchor="middle">{_tick(value)}</text>')
    for value in up.ticks():
        y = up.place(value)
        parts.append(f'<path class="grid" d="M{LEFT:g} {y:.1f}H{right:g}"/>')
        parts.append(f'<text class="tick" x="{LEFT - 8:g}" y="{y + 4:.1f}" text-anchor="end">{_tick(value)}</text>')
    middle = (LEFT + right) / 2.0
    parts.append(
        f'<text class="axis" x="{middle:g}" y="{HEIGHT - 8:g}" text-anchor="middle">{_escape(x_label)}</text>'
        f'<text class="axis" transform="translate(14 {(TOP + bottom) / 2:g}) rotate(-90)" '
        f'text-anchor="middle">{_escape(y_label)}</text>'
        f'<path class="frame" d="M{LEFT:g} {TOP:g}V{bottom:g}H{right:g}"/>'
    )
    return "".join(parts)


def _tick(value: float) -> str:
    if value == 0.0:
        return "0"
    if value >= 1e6 or value < 1e-4:
        return f"10<tspan dy='-5' font-size='9'>{round(math.log10(value)):d}</tspan>".replace(">-", ">−")
    return f"{value:,.0f}" if value >= 1.0 else f"{value:.{-math.floor(math.log10(value) + 1e-9)}f}"


def _draw_noise(up: _Axis, noise: float) -> str:
    y, right, bottom = up.place(noise), WIDTH - RIGHT, HEIGHT - BOTTOM
    tip = f"Truth’s noise {round_figure(noise)}: below this line nothing can be told apart"
    return (
        f'<g class="noise" data-tip="{_escape(tip)}">'
        f'<rect x="{LEFT:g}" y="{y:.1f}" width="{right - LEFT:g}" height="{bottom - y:.1f}"/>'
        f'<path d="M{LEFT:g} {y:.1f}H{right:g}"/>'
        f'<text class="tick" x="{LEFT + 6:g}" y="{min(y + 13, bottom - 3):.1f}">truth’s noise</text></g>'
    )


# ---------- Curves ----------


def _draw_line(line: Line, across: _Axis, up: _Axis) -> str:
    colour = f'style="--c:var(--c-{_escape(line.colour)},var(--c-other))"'
    if line.style == "level":
        y, tip = up.place(line.points[0][1]), f"{line.label}: {round_figure(line.points[0][1])}"
        path = f'<path class="curve level" d="M{LEFT:g} {y:.1f}H{WIDTH - RIGHT:g}"/>'
        return f'<g {colour} data-line="{_escape(line.label)}" data-tip="{_escape(tip)}">{path}</g>'
    places = [(across.place(x), up.place(y)) for x, y in line.points]
    parts = []
    if line.style != "point" and len(places) > 1:
        steps = "L".join(f"{x:.1f} {y:.1f}" for x, y in places)
        parts.append(f'<path class="curve {line.style}" d="M{steps}"/>')
    for number, ((x, y), (a, b)) in enumerate(zip(places, line.points, strict=True)):
        tip = line.tips[number] if number < len(line.tips) else f"{round_figure(a)}: {round_figure(b)}"
        tip = _escape(f"{line.label} · {tip}")
        if line.style == "point":
            mark = f'<path class="mark hollow" d="M{x:.1f} {y - 5:.1f}l5 5l-5 5l-5 -5z" data-tip="{tip}"/>'
        else:
            mark = f'<circle class="mark" cx="{x:.1f}" cy="{y:.1f}" r="3.2" data-tip="{tip}"/>'
        parts.append(mark)
    return f'<g {colour} data-line="{_escape(line.label)}">{"".join(parts)}</g>'


def _draw_labels(lines: Sequence[Line], across: _Axis, up: _Axis) -> str:
    """Write each curve's name at its right end, moved apart where they would touch."""
    named = [line for line in lines if line.style != "point"]
    ends = sorted((up.place(line.points[-1][1]), number) for number, line in enumerate(named))
    places = spread_apart([y for y, _ in ends], LABEL_GAP, TOP + 4.0, HEIGHT - BOTTOM)
    parts = []
    for (y, number), moved in zip(ends, places, strict=True):
        line = named[number]
        x = WIDTH - RIGHT if line.style == "level" else across.place(line.points[-1][0])
        edge = WIDTH - RIGHT + 10.0
        parts.append(
            f'<g style="--c:var(--c-{_escape(line.colour)},var(--c-other))" data-line="{_escape(line.label)}">'
            f'<path class="leader" d="M{x + 5:.1f} {y:.1f}L{edge - 2:.1f} {moved:.1f}"/>'
            f'<text class="name" x="{edge:.1f}" y="{moved + 4:.1f}">{_escape(line.label)}</text></g>'
        )
    return "".join(parts)


def spread_apart(places: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """Return sorted places moved as little as needed so that neighbours are at least `gap` apart within low..high."""
    moved = [min(max(place, low), high) for place in places]
    for index in range(1, len(moved)):
        moved[index] = max(moved[index], moved[index - 1] + gap)
    overflow = moved[-1] - high if moved else 0.0
    if overflow > 0.0:
        moved[-1] = high
        for index in range(len(moved) - 2, -1, -1):
            moved[index] = min(moved[index], moved[index + 1] - gap)
    return moved


def _positive(points: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    return tuple((x, y) for x, y in points if x > 0.0 and y > 0.0 and math.isfinite(x) and math.isfinite(y))


def _escape(text: str) -> str:
    return html.escape(text, quote=True)
