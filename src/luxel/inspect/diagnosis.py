"""Why a pixel is as dark or bright as it is, in words: from an `Explanation` to a verdict and a few sentences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from luxel.image.tonemap import MIDDLE_GREY, to_display
from luxel.inspect.explanation import Explanation
from luxel.methods.inspect import ANSWERING, WHYS, say_uninspected
from luxel.scene.colours import luminance

DARK = 0.04
"""Displayed value under which every channel of a black pixel is: 10 of 255."""
REFLECTS_NOTHING = 0.01
"""Albedo under which a surface is black whatever lights it."""
ANSWERS = 1e-3
"""Share of the answer from which an item is said to answer."""
GUESS = 0.05
"""Weight of an answer under which it is a guess: nothing that sees the point stands behind it."""
BACKS = 0.5
"""Share of backs around a point from which it counts as inside geometry."""
NOISE_FACTOR = 3.0
"""Standard errors within which a method agrees with the paths."""
MOST = 0.5
"""Share of the light that the paths find under which the method is said to miss it."""

VERDICTS = {
    "background": "no surface is there",
    "lit": "light arrives, and shows",
    "black-surface": "the surface reflects nothing",
    "back-side": "the back of a one-sided surface is seen",
    "no-light": "no light reaches the point",
    "inside": "the point is inside geometry",
    "exposure": "light arrives, but too little to show at this exposure",
    "unanswered": "the method gives no indirect light there",
    "unseen": "no item of the cache sees the point",
    "outside": "the point is outside the box of the probes",
    "missed": "items answer, but without the light that is there",
}
"""Each verdict and what it means."""


def diagnose(found: Explanation) -> tuple[str, tuple[str, ...]]:
    """Return the verdict and the sentences that explain a pixel."""
    if not found.hit:
        sky = max(found.shown) >= DARK
        what = f"the sky, of radiance {_number(_luminance(found.emission))} W/(m^2 sr)" if sky else "no light"
        because = "It shows the sky" if sky else "It is black because nothing is there"
        return "background", (f"{because}: the ray leaves the scene, and meets {what}.",)
    if max(found.shown) >= DARK:
        return "lit", (_say_lit(found), *_say_items(found), *_say_paths(found))
    verdict, because = _why_black(found)
    return verdict, (f"It is black because {because}.", *_say_items(found), *_say_paths(found))


# ---------- Black ----------


def _why_black(found: Explanation) -> tuple[str, str]:
    """Return the verdict on a black pixel, and the words that follow "because"."""
    assert found.paths is not None
    if max(found.albedo) < REFLECTS_NOTHING:
        if not found.front:
            return "back-side", "you look at the back of a surface that reflects on its front only"
        if found.metallic > 0.0:
            metal = "its surface is metal, which has no diffuse light; `luxel render --method path` shows it"
            return "black-surface", metal
        return "black-surface", f"its surface is black: it reflects {max(found.albedo):.1%} of the light"
    there = np.add(found.paths.direct, found.paths.indirect)
    if max(there) <= 0.0:
        if found.paths.backs > BACKS:
            share = f"{found.paths.backs:.0%}"
            return "inside", f"it is inside geometry: {share} of the rays around it hit backs of surfaces, and no light"
        return "no-light", f"no light reaches it: not one of {found.paths.count:,} paths from it found any"
    arrives = np.add(found.direct, found.indirect)
    if _luminance(arrives) >= MOST * _luminance(there) or not _would_show(found, there):
        return "exposure", _say_exposure(found, arrives)
    return _why_missed(found)


def _why_missed(found: Explanation) -> tuple[str, str]:
    """Return why the method does not bring the light that paths find."""
    whys = Counter(item.why for item in found.contributions)
    asked = len(found.contributions)
    if not found.item:
        return "unanswered", f"method '{found.method}' brings no indirect light there"
    if found.weight <= 0.0 and not asked:
        return "unseen", f"no {found.item} is near it yet"
    if asked and whys["dead"] + whys["unplaced"] + whys["borrowed"] == asked:
        return "inside", f"all {found.item}s around it are dead, as if it were inside geometry"
    if whys["outside"]:
        return "outside", f"it is outside the box of {found.item}s, and the nearest ones know no light"
    if found.weight < GUESS:
        return "unseen", f"no {found.item} sees it"
    return "missed", f"the {found.item}s that answer know too little of the light that is there"


def _would_show(found: Explanation, irradiance: np.ndarray) -> bool:
    light = np.asarray(found.albedo) / np.pi * irradiance
    return float(to_display(light, found.exposure).max()) >= DARK


def _say_exposure(found: Explanation, arrives: np.ndarray) -> str:
    radiance = _luminance(found.radiance)
    lit = f"so little light reaches it, {_number(_luminance(arrives))} W/m^2 in all, that this exposure shows none"
    if radiance <= 0.0:
        return lit
    return f"{lit}: {_number(MIDDLE_GREY / (radiance * found.exposure))} times the exposure would make it middle grey"


# ---------- What else there is to say ----------


def _say_lit(found: Explanation) -> str:
    direct, indirect = _luminance(found.direct), _luminance(found.indirect)
    if _luminance(found.emission) > 0.0 and direct + indirect <= 0.0:
        return f"It shines itself, at {_number(_luminance(found.emission))} W/(m^2 sr)."
    if direct > 0.0 and indirect > 0.0:
        parts = f"{_number(direct)} W/m^2 of direct and {_number(indirect)} of indirect light"
    else:
        kind = "direct" if direct > 0.0 else "indirect"
        parts = f"{_number(direct + indirect)} W/m^2 of {kind} light alone"
    shines = "; it also shines itself" if _luminance(found.emission) > 0.0 else ""
    return f"It is lit by {parts}, of which it reflects {_luminance(found.albedo):.0%}{shines}."


def _say_items(found: Explanation) -> list[str]:
    """Say who answers and why others do not."""
    asked = len(found.contributions)
    if not asked:
        if not found.inspected:
            sentence = say_uninspected(found.method)
            return [f"{sentence[:1].upper()}{sentence[1:]}."]
        return [f"No {found.item} was asked: none is near."] if found.item else []
    # Those that stand in were asked after the others.
    answer = [item for item in found.contributions if item.answers and item.weight > ANSWERS]
    silent = Counter(item.why for item in found.contributions if item not in answer)
    special = Counter(item.why for item in answer if item.why in ANSWERING)
    reasons = [f"{count} {WHYS[why]}" for why, count in silent.most_common() if why in WHYS]
    rest = f"; {', '.join(reasons)}" if reasons else ""
    who = "all answer" if len(answer) == asked > 1 else f"{len(answer)} answer{'s' * (len(answer) == 1)}"
    said = [f"Of {_count(asked, found.item)} asked, {who}{rest}."]
    if answer:
        heaviest = found.contributions[0]
        said[0] = f"{said[0][:-1]}. The heaviest, {found.item} {heaviest.item}, has {heaviest.weight:.0%} of the say."
    said += [f"{_count(count, found.item)} {WHYS[why]}." for why, count in special.items()]
    if found.weight < GUESS and any(item.weight > ANSWERS for item in found.contributions):
        said.append("None of them sees the point: the answer is a guess, the mean of those around it.")
    return said


def _say_paths(found: Explanation) -> list[str]:
    """Say what paths find, and how far the method is from it."""
    paths = found.paths
    if paths is None:
        return []
    mean, given = _luminance(paths.indirect), _luminance(found.indirect)
    sentence = f"{paths.count:,} paths from it find {_number(mean)} ± {_number(paths.noise)} W/m^2 of indirect light"
    if abs(given - mean) <= NOISE_FACTOR * paths.noise or given == mean:
        ratio = f" ({_number(given / mean)} times that)" if mean > 0.0 else ""
        return [f"{sentence}; '{found.method}' is within {NOISE_FACTOR:g} such errors of it{ratio}."]
    if mean <= 0.0:
        return [f"{sentence}, where '{found.method}' gives {_number(given)}."]
    return [f"{sentence}; '{found.method}' gives {_number(given)}, {_number(given / mean)} times that."]


def _luminance(color: Sequence[float] | np.ndarray) -> float:
    return float(luminance(np.asarray(color, np.float64)))


def _number(value: float) -> str:
    return f"{value:.3g}"


def _count(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"
