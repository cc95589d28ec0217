"""What the colours of a look mean: a scale with numbers and a unit, or a list of names; and its picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from luxel.image.tonemap import to_display
from luxel.inspect.ramps import colorize

NICE = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
TICKS_MOST = 6
PAPER, INK, FAINT = (20, 22, 25), (232, 234, 237), (150, 156, 164)
"""Colours of a legend's strip: ground, numbers, words."""
MARGIN, BAR = 10, 10
"""Pixels of a strip: around everything, and the height of the bar."""
LINE, RAISED = 16, 9
"""Pixels of a line of text, and the size of a raised figure."""


@dataclass(frozen=True)
class Scale:
    """Which number has which place on a ramp."""

    low: float
    high: float
    logarithmic: bool = False

    def place(self, values: np.ndarray) -> np.ndarray:
        """Return where `values` lie, 0 at `low` and 1 at `high`; beyond them it goes on."""
        if self.logarithmic:
            floor = np.maximum(np.nan_to_num(values), 0.5 * self.low)
            return np.log(floor / self.low) / math.log(self.high / self.low)
        return (values - self.low) / (self.high - self.low)

    def ticks(self) -> list[float]:
        """Return the numbers to write: round ones, two to `TICKS_MOST`, from the low end to the high one."""
        if self.logarithmic:
            first, last = math.ceil(math.log10(self.low) - 1e-9), math.floor(math.log10(self.high) + 1e-9)
            step = max(1, math.ceil((last - first + 1) / TICKS_MOST))
            return [10.0**power for power in range(first, last + 1, step)]
        span = self.high - self.low
        step = ceil_nice(span / (TICKS_MOST - 1), (1.0, 2.0, 2.5, 5.0, 10.0))
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [number * step for number in range(first, last + 1)]


@dataclass(frozen=True)
class Legend:
    """The meaning of a look's colours."""

    title: str
    unit: str = ""
    scale: Scale | None = None
    ramp: str = ""
    """The ramp of a scale: `field`, `heat` or `signed`; `light` from black to white as a display shows it."""
    entries: tuple[tuple[str, tuple[float, float, float]], ...] = ()
    """Names and their displayed colours, where there is no scale."""

    def colors(self, steps: int) -> np.ndarray:
        """Return the scale's colours from low to high, (steps, 3) displayed."""
        place = np.linspace(0.0, 1.0, steps)
        return to_display(np.repeat(place[:, None], 3, axis=1)) if self.ramp == "light" else colorize(place, self.ramp)


def fit_scale(values: np.ndarray, span: tuple[float, float] | None = None, logarithmic: bool = False) -> Scale:
    """Return the scale of `values`: `span` where it is given, else from 0 (or 1) to a round number that holds 99 %."""
    if span is not None:
        return Scale(*span, logarithmic)
    values = values[np.isfinite(values)]
    most = float(np.quantile(values, 0.99)) if values.size else 0.0
    if logarithmic:
        return Scale(1.0, 10.0 ** max(1, math.ceil(math.log10(max(most, 1.0)))), True)
    return Scale(0.0, ceil_nice(most) if most > 0.0 else 1.0)


def ceil_nice(value: float, steps: tuple[float, ...] = NICE) -> float:
    """Return the next round number from `value` (> 0) upwards."""
    power = 10.0 ** math.floor(math.log10(value))
    return next((step * power for step in steps if step * power >= value * (1.0 - 1e-9)), 10.0 * power)


def format_tick(value: float) -> str:
    """Return a number for a scale: short, thousands as k."""
    if abs(value) >= 1000.0:
        return f"{value / 1000.0:g}k"
    return f"{value:.4g}"


# ---------- The strip ----------


def draw_legend(legend: Legend, width: int) -> np.ndarray:
    """Return the legend as a strip to stand under a picture: (height, width, 3) float32, ready to be shown.

    Words that the width has no room for are left out.
    """
    from PIL import Image, ImageDraw, ImageFont

    large, small = ImageFont.load_default(13), ImageFont.load_default(12)
    tail = _length(legend.unit, small)
    words = _wrap(legend.title[:1].upper() + legend.title[1:], large, width - 2 * MARGIN - (tail + 12 if tail else 0))
    rows = _rows_of_entries(legend, small, width)
    top = MARGIN // 2 + LINE * len(words) + 5
    height = top + (BAR + 20 if legend.scale is not None else 18 * len(rows) if legend.entries else 0) + 4
    strip = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(strip)
    for number, line in enumerate(words):
        draw.text((MARGIN, MARGIN // 2 + LINE * number), line, fill=INK, font=large)
    if tail <= width - 2 * MARGIN:
        _write(draw, width - MARGIN - tail, MARGIN // 2 + 2, legend.unit, FAINT, small)
    if legend.scale is not None:
        _draw_scale(strip, draw, legend, legend.scale, small, top)
    for row, entries in enumerate(rows if legend.scale is None else ()):
        for x, name, color in entries:
            y = top + 18 * row
            draw.rounded_rectangle((x, y + 2, x + 10, y + 12), 2, fill=tuple(int(round(255 * c)) for c in color))
            draw.text((x + 15, y), name, fill=INK, font=small)
    return np.asarray(strip, np.float32) / 255.0


def _draw_scale(strip, draw, legend: Legend, scale: Scale, font, top: int) -> None:  # noqa: ANN001
    """Draw the bar with its numbers; numbers that would touch are left out."""
    from PIL import Image

    left, right = MARGIN, strip.width - MARGIN
    if right - left < 8:
        return
    colors = np.rint(255.0 * legend.colors(right - left)).astype(np.uint8)
    strip.paste(Image.fromarray(np.repeat(colors[None], BAR, axis=0)), (left, top))
    taken = -1e9
    for value in scale.ticks():
        x = left + float(scale.place(np.array(value))) * (right - left - 1)
        text = format_tick(value)
        half = 0.5 * draw.textlength(text, font=font)
        start = min(max(x - half, left - MARGIN + 2), right + MARGIN - 2 - 2 * half)
        draw.line((x, top + BAR, x, top + BAR + 3), fill=FAINT)
        if start > taken + 6:
            draw.text((start, top + BAR + 4), text, fill=INK, font=font)
            taken = start + 2 * half


def _wrap(text: str, font, width: float) -> list[str]:  # noqa: ANN001
    """Return `text` in lines that fit; words that do not fit at all are left out."""
    lines: list[str] = []
    for word in text.split():
        if lines and font.getlength(f"{lines[-1]} {word}") <= width:
            lines[-1] += f" {word}"
        elif font.getlength(word) <= width:
            lines.append(word)
    return lines


def _write(draw, x: float, y: float, text: str, fill: tuple[int, int, int], font) -> None:  # noqa: ANN001
    """Write `text` with its squares as raised small figures: the built-in font has no sign for them."""
    raised = font.font_variant(size=RAISED)
    for part, square in _parts(text):
        draw.text((x, y), part, fill=fill, font=font)
        x += font.getlength(part)
        if square:
            draw.text((x, y - 1), "2", fill=fill, font=raised)
            x += raised.getlength("2")


def _length(text: str, font) -> float:  # noqa: ANN001
    raised = font.font_variant(size=RAISED).getlength("2")
    return sum(font.getlength(part) + (raised if square else 0.0) for part, square in _parts(text))


def _parts(text: str) -> list[tuple[str, bool]]:
    """Return the pieces of `text` between squares, and whether one follows."""
    pieces = text.split("²")
    return [(piece, index < len(pieces) - 1) for index, piece in enumerate(pieces)]


def _rows_of_entries(legend: Legend, font, width: int) -> list[list[tuple[float, str, tuple[float, float, float]]]]:  # noqa: ANN001
    """Return the entries with their x, row by row."""
    rows: list[list[tuple[float, str, tuple[float, float, float]]]] = [[]]
    x = float(MARGIN)
    for name, color in legend.entries:
        wide = 15 + font.getlength(name) + 14
        if rows[-1] and x + wide > width:
            rows.append([])
            x = float(MARGIN)
        rows[-1].append((x, name, color))
        x += wide
    return rows
