"""What the fields of the scene's records may hold, and what takes the place of a value that a file should not hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from luxel.errors import LuxelError

FINITE = 3e38
"""The largest number of single precision, which the device has."""
LARGEST = 1e9
"""Metres from (0, 0, 0) beyond which nothing stands: single precision could not hold a triangle's squared area."""
LARGEST_DISTANCE = 1e18
"""Metres beyond which no lamp stands: single precision could not hold the square."""
LOWEST_IOR, HIGHEST_IOR = 0.01, 100.0
"""Beyond them a dielectric is a mirror."""
BRIGHTEST = 1e9
"""Radiance of a sky and irradiance by a sun at most, fifty times that of the sun's disc: single precision still holds
the squares that noise is judged by."""
ROUNDING = 1e-6
"""What a share may be above one, as conversions leave it."""


@dataclass(frozen=True)
class Rule:
    """What a field may hold."""

    words: str
    """What to give instead: "three numbers from 0 to 1"."""
    accepts: Callable[[Any], bool]
    mend: Callable[[Any], Any] | None = None
    """Return the nearest value that can be; None: there is none."""
    convert: Callable[[Any], Any] | None = None
    """Bring lists and arrays to the field's own type; may raise TypeError or ValueError."""


def show(value: Any) -> str:
    """Return a value as a sentence holds it."""
    if isinstance(value, np.ndarray) and value.size > 4:
        return f"of shape {'x'.join(map(str, value.shape))}"
    if isinstance(value, tuple) and all(isinstance(part, int | float) for part in value):
        return "(" + ", ".join(f"{part:g}" for part in value) + ")"
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."


def is_number(value: Any) -> bool:
    """Return whether `value` is a number that single precision holds."""
    number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return number and bool(abs(value) <= FINITE)


# --- kinds of rules ------------------------------------------------------------------------------------------------


def number(low: float, high: float, words: str, mended: float | None = None) -> Rule:
    """A number from `low` to `high`; one that is not finite becomes `mended` where files hold it."""

    def mend(value: float) -> float:
        return min(max(value, low), min(high, FINITE)) if mended is None or np.isfinite(value) else mended

    return Rule(words, lambda value: low <= value <= high, mend, _to_number)


def triple(low: float, high: float, words: str, fits_files: bool = True) -> Rule:
    """Three numbers from `low` to `high`, as a tuple."""

    def accepts(value: tuple[float, ...]) -> bool:
        return len(value) == 3 and low <= value[0] <= high and low <= value[1] <= high and low <= value[2] <= high

    def mend(value: tuple[float, ...]) -> tuple[float, ...]:
        if len(value) != 3:
            raise LuxelError(f"{show(value)} cannot be: give {words}")
        kept = np.nan_to_num(np.asarray(value, np.float64), nan=max(low, 0.0), posinf=min(high, 1e6), neginf=low)
        red, green, blue = (float(part) for part in np.clip(kept, low, high))
        return red, green, blue

    return Rule(words, accepts, mend if fits_files else None, _to_tuple)


def pair(low: float, high: float, words: str) -> Rule:
    """Two numbers from `low` to `high`, as a tuple."""
    return Rule(
        words,
        lambda value: len(value) == 2 and low <= value[0] <= high and low <= value[1] <= high,
        convert=_to_tuple,
    )


def choice(*names: str) -> Rule:
    """One of some words."""
    return Rule(f"one of {', '.join(names)}", lambda value: isinstance(value, str) and value in names)


def records(kind: str) -> Rule:
    """A list of records of one class."""

    def accepts(value: Any) -> bool:
        return isinstance(value, list) and all(_has_base(each, kind) for each in set(map(type, value)))

    return Rule(f"a list of luxel.{kind}", accepts, None, lambda value: list(value) if type(value) is tuple else value)


def is_record(value: Any, kind: str) -> bool:
    """Return whether `value` is of the record class of that name."""
    return _has_base(type(value), kind)


def _has_base(kind: type, name: str) -> bool:
    return any(base.__name__ == name for base in kind.__mro__)


def array(rows: str, *columns: int, optional: bool = False) -> Rule:
    """An array of so many columns; empty ones may have any shape."""
    words = f"an array of shape ({rows}, {' or '.join(map(str, columns))})" + (" or None" if optional else "")

    def accepts(value: Any) -> bool:
        if value is None:
            return optional
        return value.size == 0 or (value.ndim == 2 and value.shape[1] in columns)

    return Rule(words, accepts, None, _to_array)


def matrix(side: int) -> Rule:
    """A square matrix."""
    return Rule(f"a {side}x{side} matrix", lambda value: np.shape(value) == (side, side), None, _to_array)


def _to_number(value: Any) -> float:
    if isinstance(value, str):
        raise TypeError(value)
    return value if type(value) in (float, int) else float(value)


def _to_tuple(value: Any) -> tuple[float, ...]:
    if type(value) is tuple and all(type(part) in (float, int) for part in value):
        return value
    if isinstance(value, str):
        raise TypeError(value)
    return tuple(float(part) for part in value)


def _to_array(value: Any) -> Any:
    return value if value is None or isinstance(value, np.ndarray) else np.asarray(value)


def image(words: str, *channels: int, optional: bool = False) -> Rule:
    """An image of so many channels; one channel may also be (H, W)."""

    def accepts(value: Any) -> bool:
        if value is None:
            return optional
        flat = value.ndim == 2 and 1 in channels
        return value.size > 0 and (flat or (value.ndim == 3 and value.shape[2] in channels))

    return Rule(words, accepts, None, _to_array)


def optional(rule: Rule) -> Rule:
    """The same, or None."""
    convert = rule.convert or (lambda value: value)
    return Rule(
        f"{rule.words}, or None",
        lambda value: value is None or rule.accepts(value),
        rule.mend,
        lambda value: None if value is None else convert(value),
    )


def _mend_ior(value: float) -> float:
    return min(max(value, LOWEST_IOR), HIGHEST_IOR) if np.isfinite(value) else 1.5


# --- the table -----------------------------------------------------------------------------------------------------

LIGHT = triple(0.0, FINITE, "three finite numbers of 0 or more")
RADIANCE = triple(0.0, BRIGHTEST, f"three numbers from 0 to {BRIGHTEST:.0e}")
SHARES = triple(0.0, 1.0 + ROUNDING, "three numbers from 0 to 1")
DIRECTION = triple(-FINITE, FINITE, "three finite numbers", fits_files=False)
PLACE = triple(-LARGEST, LARGEST, f"three finite numbers of {LARGEST:.0e} m at most", fits_files=False)
LAMP_PLACE = triple(
    -LARGEST_DISTANCE, LARGEST_DISTANCE, f"three finite numbers of {LARGEST_DISTANCE:.0e} m at most", fits_files=False
)
PAIR = pair(-FINITE, FINITE, "two finite numbers")
SHARE = number(0.0, 1.0 + ROUNDING, "a number from 0 to 1", 1.0)
WEIGHT = number(0.0, 1.0 + ROUNDING, "a number from 0 to 1", 0.0)
IOR = Rule(
    f"a number from {LOWEST_IOR:g} to {HIGHEST_IOR:g}, or 0",
    lambda value: value == 0.0 or LOWEST_IOR <= value <= HIGHEST_IOR,
    _mend_ior,
    _to_number,
)
INDEX = optional(triple(0.0, 1e6, "three numbers from 0 to 1e6"))
ANY_NUMBER = number(-FINITE, FINITE, "a finite number", 0.0)
NOT_NEGATIVE = number(0.0, FINITE, "a finite number of 0 or more", 0.0)
DISTANCE = Rule("a distance above 0, or infinity", lambda value: value > 0.0, lambda value: float("inf"))
COSINE = number(-1.0 - ROUNDING, 1.0 + ROUNDING, "a cosine, from -1 to 1", 1.0)
FLAG = Rule("True or False", lambda value: value in (True, False))
MOTION = Rule("a function of the time in seconds, or None", lambda value: value is None or callable(value))
WRAP = choice("repeat", "clamp", "mirror")
TEXTURE = Rule("a luxel.Texture or None", lambda value: value is None or is_record(value, "Texture"))
UV = array("V", 2, optional=True)

RULES: dict[str, dict[str, Rule]] = {
    "Texture": {
        "image": image("an array (H, W) or (H, W, C) with C in 1, 3, 4", 1, 3, 4),
        "srgb": FLAG,
        "nearest": FLAG,
        "wrap_u": WRAP,
        "wrap_v": WRAP,
        "uv_set": Rule("0 or 1", lambda value: value in (0, 1), lambda value: 0),
        "transform": matrix(3),
    },
    "Material": {
        "base_color": SHARES,
        "base_color_texture": TEXTURE,
        "metallic": SHARE,
        "roughness": SHARE,
        "metallic_roughness_texture": TEXTURE,
        "emission": LIGHT,
        "emission_texture": TEXTURE,
        "normal_texture": TEXTURE,
        "normal_scale": ANY_NUMBER,
        "alpha": SHARE,
        "alpha_mode": choice("opaque", "mask", "blend"),
        "alpha_cutoff": NOT_NEGATIVE,
        "reflect_back": FLAG,
        "emit_back": FLAG,
        "emission_uses_colors": FLAG,
        "ior": IOR,
        "specular": WEIGHT,
        "specular_texture": TEXTURE,
        "specular_color": LIGHT,
        "specular_color_texture": TEXTURE,
        "transmission": WEIGHT,
        "transmission_texture": TEXTURE,
        "thin": FLAG,
        "attenuation_color": SHARES,
        "attenuation_distance": DISTANCE,
        "clearcoat": WEIGHT,
        "clearcoat_texture": TEXTURE,
        "clearcoat_roughness": WEIGHT,
        "clearcoat_roughness_texture": TEXTURE,
        "eta": INDEX,
        "k": INDEX,
        "distribution": choice("ggx", "beckmann"),
        "compensate": FLAG,
        "interface": choice("gltf", "plastic", "principled"),
        "nonlinear": FLAG,
        "diffuse": Rule("a luxel.Material or None", lambda value: value is None or is_record(value, "Material")),
    },
    "Mesh": {
        "positions": array("V", 3),
        "faces": array("F", 3),
        "material": Rule("an index into the scene's materials, from 0", lambda value: int(value) == value >= 0),
        "normals": array("V", 3, optional=True),
        "uv": UV,
        "uv2": UV,
        "colors": array("V", 3, 4, optional=True),
    },
    "Object": {"meshes": records("Mesh"), "to_world": matrix(4), "motion": MOTION, "deform": MOTION},
    "Light": {
        "kind": choice("directional", "point", "spot"),
        "color": LIGHT,
        "position": LAMP_PLACE,
        "direction": DIRECTION,
        "angular_diameter": number(0.0, 90.0, "degrees from 0 to 90", 0.0),
        "in_sky": FLAG,
        "cos_inner": COSINE,
        "cos_outer": COSINE,
        "motion": MOTION,
        "spot_falloff": choice("squared-cosine", "linear-angle"),
        "range": DISTANCE,
    },
    "Camera": {
        "eye": PLACE,
        "target": PLACE,
        "up": DIRECTION,
        "fov": number(1e-3, 179.9, "degrees above 0 and below 180", 60.0),
        "orthographic_width": NOT_NEGATIVE,
        "orthographic_height": NOT_NEGATIVE,
        "mirrored": FLAG,
        "lens_shift": PAIR,
        "motion": MOTION,
    },
    "Sky": {
        "color": RADIANCE,
        "image": image("an array (H, W, 3) or None", 3, 4, optional=True),
        "rotation": ANY_NUMBER,
        "suns": Rule("a list of luxel.Light or None", lambda value: value is None or records("Light").accepts(value)),
    },
    "SceneData": {
        "objects": records("Object"),
        "materials": records("Material"),
        "lights": records("Light"),
        "cameras": records("Camera"),
        "flight": records("Camera"),
        "sky": Rule("a luxel.Sky", lambda value: is_record(value, "Sky")),
        "hide_emitters": FLAG,
        "origin": PLACE,
        "duration": NOT_NEGATIVE,
        "default_sun": Rule("a luxel.Light or None", lambda value: value is None or is_record(value, "Light")),
    },
}
"""By class and field; what is not named may hold anything."""
