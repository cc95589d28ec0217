"""A comparison as a file: `luxel compare SUITE.toml`. Scenes, methods, seeds and sizes, each key checked by name.

Every key is that of `compare` or the name of a flag. Paths count from the file's own folder.
"""

from __future__ import annotations

import difflib
import tomllib
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from luxel.errors import LuxelError
from luxel.report.compare import RENAMED
from luxel.report.jobs import MethodSetup, make_setup
from luxel.scene.choice import MATERIALS, SceneChoice, is_file

SUFFIX = ".toml"


def read_suite(path: str | Path, warn: Callable[[str], None] | None = None) -> dict[str, Any]:
    """Return what a suite file asks for, as arguments of `compare`; keys that it leaves out are missing.

    `scenes` become `SceneChoice`s and `methods` `MethodSetup`s. `warn` gets a sentence on each key of an old name;
    without it that is a FutureWarning. Raises LuxelError, with file, place and key, for a file that cannot be read, an
    unknown key, a value of the wrong kind, and an unknown method, preset or parameter.
    """
    path = Path(path)
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise LuxelError(f"There is no file '{path}'; check the path.") from error
    except OSError as error:
        raise LuxelError(f"'{path}' cannot be read: {error.strerror}.") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise LuxelError(f"'{path}' is not TOML: {error}.") from error
    place = _Place(path.name, "")
    readers: dict[str, Reader] = {
        "scenes": lambda where, value: _each(where, value, lambda at, one: _read_scene(at, one, path.parent)),
        "methods": lambda where, value: _each(where, value, lambda at, one: _read_method(at, one, path.parent)),
        "seeds": lambda where, value: _each(where, value, lambda at, one: _read_count(at, one, 0, 2**32 - 1)),
        "size": _read_size,
        "frames": _read_count,
        "materials": lambda where, value: _read_word(where, value, MATERIALS),
        "reference": lambda where, value: _read_word(where, value, MATERIALS),
        "reference_spp": _read_count,
        "flight": _read_switch,
        "peers": _read_switch,
        "motion": _read_switch,
        "motion_frames": _read_count,
        "motion_spp": _read_count,
    }
    suite = _read_table(place, table, readers)
    if "scenes" not in suite:
        raise LuxelError(f'{path.name} names no scenes: add scenes = ["cornell-box"]')
    if "reference" in suite:
        if "materials" in suite:
            raise LuxelError(f"{path.name}: 'reference' is the old name of 'materials'; leave it out")
        suite["materials"] = suite.pop("reference")
        said = f"{path.name}: {RENAMED.format(old='reference', new='materials')}"
        if warn is None:
            warnings.warn(said, FutureWarning, stacklevel=2)
        else:
            warn(said)
    return suite


class _Place:
    """Where in the file something stands."""

    def __init__(self, file: str, path: str) -> None:
        self.file, self.path = file, path

    def at(self, step: str | int) -> _Place:
        """Return the place of a key or of the list entry of that number."""
        if isinstance(step, int):
            return _Place(self.file, f"{self.path}[{step}]")
        return _Place(self.file, f"{self.path}.{step}" if self.path else step)

    def __str__(self) -> str:
        return f"{self.file}: {self.path}"

    def wrong(self, wanted: str, value: Any) -> LuxelError:
        return LuxelError(f"{self} must be {wanted}, not {_show(value)}")


Reader = Callable[[_Place, Any], Any]


def _read_table(place: _Place, table: dict[str, Any], readers: dict[str, Reader]) -> dict[str, Any]:
    """Read each key by its reader. Raises LuxelError for a key that has none."""
    for key in table:
        if key not in readers:
            close = difflib.get_close_matches(key, readers, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"it has {', '.join(readers)}"
            where = f"{place} has" if place.path else f"{place.file}: there is"
            raise LuxelError(f"{where} no key '{key}'; {hint}")
    return {key: readers[key](place.at(key), value) for key, value in table.items()}


def _each(place: _Place, value: Any, read: Reader) -> list[Any]:
    if not isinstance(value, list) or not value:
        raise place.wrong("a list with at least one entry", value)
    return [read(place.at(number), one) for number, one in enumerate(value)]


# ---------- Scenes and methods ----------


def _read_scene(place: _Place, value: Any, folder: Path) -> SceneChoice:
    """Read `"cornell-box"` or `{ scene = "cornell-box", sun = "120,40", … }`."""
    table = {"scene": value} if isinstance(value, str) else value
    if not isinstance(table, dict):
        raise place.wrong("a scene's name, its file or a table", value)
    readers = {"scene": _read_text, "sun": _read_numbers, "sky": _read_numbers}
    readers |= {key: _read_text for key in ("envmap", "camera", "animation", "name", "flight_path")}
    given = _read_table(place, table, readers)
    if "scene" not in given:
        raise LuxelError(f"{place} has no key 'scene': name a built-in scene or a file")
    source = given.pop("scene")
    if is_file(source):
        source = str(folder / source)
    if "envmap" in given:
        given["envmap"] = str(folder / given["envmap"])
    return SceneChoice(source, **given)


def _read_method(place: _Place, value: Any, folder: Path) -> MethodSetup:
    """Read `"gibs"`, `"gibs:ekberg"`, `"FILE.py:Class"`, or a table with the key `method` and more.

    `{ method = "gibs", preset = "ekberg", label = "…", params = { … } }`
    """
    table = {"method": value} if isinstance(value, str) else value
    if not isinstance(table, dict):
        raise place.wrong("a method's name or a table", value)
    texts = {key: _read_text for key in ("method", "preset", "label")}
    given = _read_table(place, table, {**texts, "params": _read_params})
    if "method" not in given:
        raise LuxelError(f"{place} has no key 'method': name one, such as gibs")
    try:
        setup = make_setup(
            given["method"], label=given.get("label"), preset=given.get("preset"), settings=given.get("params", {}),
            folder=folder,
        )  # fmt: skip
        setup.params()
    except LuxelError as error:
        raise LuxelError(f"{place}: {error}") from error
    return setup


def _read_params(place: _Place, value: Any) -> dict[str, str]:
    """Return the settings as text, which the method reads as it reads `--set`."""
    if not isinstance(value, dict):
        raise place.wrong("a table of parameters", value)
    return {key: _to_setting(place.at(key), one) for key, one in value.items()}


def _to_setting(place: _Place, value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str | int | float):
        return str(value)
    return _read_numbers(place, value)


# ---------- Values ----------


def _read_text(place: _Place, value: Any) -> str:
    if not isinstance(value, str) or not value.strip():
        raise place.wrong("a text", value)
    return value.strip()


def _read_word(place: _Place, value: Any, words: Iterable[str]) -> str:
    if value not in words:
        raise place.wrong(" or ".join(words), value)
    return value


def _read_switch(place: _Place, value: Any) -> bool:
    if not isinstance(value, bool):
        raise place.wrong("true or false", value)
    return value


def _read_count(place: _Place, value: Any, least: int = 1, most: int | None = None) -> int:
    whole = isinstance(value, int) and not isinstance(value, bool)
    if not whole or value < least or (most is not None and value > most):
        raise place.wrong(f"a whole number from {least}" + (f" to {most}" if most is not None else ""), value)
    return value


def _read_size(place: _Place, value: Any) -> tuple[int, int]:
    """Read `"640x360"` or `[640, 360]`."""
    parts = value.lower().split("x") if isinstance(value, str) else value
    if not isinstance(parts, list) or len(parts) != 2:
        raise place.wrong('a size such as "640x360" or [640, 360]', value)
    sides = [int(part) if isinstance(part, str) and part.strip().isdecimal() else part for part in parts]
    width, height = (_read_count(place, side) for side in sides)
    return width, height


def _read_numbers(place: _Place, value: Any) -> str:
    """Read a number, a list of numbers or the text of a flag; return that text."""
    if isinstance(value, str):
        return _read_text(place, value)
    numbers = value if isinstance(value, list) else [value]
    if not numbers or not all(isinstance(one, int | float) and not isinstance(one, bool) for one in numbers):
        raise place.wrong("a text, a number or a list of numbers", value)
    return ",".join(str(one) for one in numbers)


def _show(value: Any) -> str:
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
