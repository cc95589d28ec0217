"""`luxel render --look`: what is drawn beside the image."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from luxel.cli import options
from luxel.errors import LuxelError

if TYPE_CHECKING:
    from luxel.image.layers import Layers
    from luxel.render.exposure import Exposure
    from luxel.render.renderer import Renderer

LIST = "list"
"""The word that names all looks instead of drawing one."""


def parse_looks(texts: list[str] | None, method: str, place: str, has_truth: bool) -> list[str] | None:
    """Return the names in `texts`, each once; None where the list of all is asked for.

    Raises LuxelError, before anything heavy starts, for what the names alone tell.
    """
    names = [name.strip() for text in texts or [] for name in text.split(",") if name.strip()]
    if not names:
        if texts:
            raise LuxelError("--look names nothing; see --look list")
        return []
    if LIST in names:
        return None
    from luxel.inspect.looks import find_look
    from luxel.inspect.looks.frame import NEEDS_TRUTH
    from luxel.methods.params import find_method
    from luxel.render.sequence import is_sequence

    if is_sequence(place):
        raise LuxelError(f"--look draws beside a single image, not beside the sequence {place}")
    for name in names:
        find_look(name, find_method(method))
        if name in NEEDS_TRUTH and not has_truth:
            raise LuxelError(f"--look {name} compares with the truth; add --truth")
    return list(dict.fromkeys(names))


def parse_point(text: str | None, size: tuple[int, int], names: list[str], method: str) -> tuple[int, int] | None:
    """Return the pixel that looks of one point are drawn for; None: the middle of the picture.

    Raises LuxelError for a text that names no pixel of an image of `size`, and where no look asks for one.
    """
    if text is None:
        return None
    from luxel.inspect.looks import find_look, list_looks
    from luxel.methods.params import find_method

    pixel = options.parse_pixel(text, size)
    if not any(find_look(name, find_method(method)).kind == "source" for name in names):
        askers = [look.name for look in list_looks(find_method(method)) if look.kind == "source"]
        hint = f"add --look {askers[0]}" if askers else f"method '{method}' has none; see `luxel explain`"
        raise LuxelError(f"--pixel chooses the point of a look that shows what lights one: {hint}")
    return pixel


def print_looks(method: str, as_json: bool) -> None:
    """Print every look that `method` has, a line each."""
    from luxel.cli.console import print_rows, warn
    from luxel.files import to_json
    from luxel.inspect.looks import list_looks
    from luxel.methods.inspect import say_uninspected
    from luxel.methods.params import find_method

    found = find_method(method)
    looks = list_looks(found)
    if found.inspector is None:
        warn([say_uninspected(found.name)])
    if as_json:
        print(to_json({look.name: {"doc": look.doc, "unit": look.unit} for look in looks}))
    else:
        print_rows([(look.name, f"{look.doc} [{look.unit}]" if look.unit else look.doc) for look in looks])


def write_looks(
    renderer: Renderer,
    names: list[str],
    place: str,
    truth: Layers | None,
    exposure: Exposure,
    pixel: tuple[int, int] | None = None,
) -> dict[str, str]:
    """Draw the last frame's looks, with their legends, beside the image `place`; return their files by name."""
    from luxel.image.write import write_png
    from luxel.inspect.looks import draw_look, take_shot

    shot = take_shot(renderer, truth=truth, exposure=exposure, pixel=pixel)
    written = {}
    for name in names:
        image = Path(place)
        path = image.with_name(f"{image.stem}_{name}.png")
        write_png(path, draw_look(name, shot).with_legend())
        written[name] = str(path)
    return written
