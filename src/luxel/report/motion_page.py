"""The section "In motion" of a scene's report: a verdict in words, a table, error along the flight, strips."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from luxel.report.conclusions import VERBS, Ranking, join, margin, motion_error, nearest_in_motion, rank
from luxel.report.figures import round_figure, write_figure, write_time
from luxel.report.plots import Line, plot_error, style_of
from luxel.report.results import ResultEntry, SceneResults, as_number
from luxel.report.tables import list_facts, make_motion_table, name_entry

ALIKE = 1.15
"""Ratio of two errors up to which motion and rest are called alike."""
AXIS_NAMES = {"regional": "error (regional)", "flip": "FLIP"}


def describe_motion(scene: SceneResults, strips: dict[str, str]) -> dict[str, Any] | None:
    """Return what the page says of a scene's flight; None where none was flown.

    `strips` are data addresses by the stem of the entry's files.
    """
    motion = scene.motion
    if not motion:
        return None
    count = len(motion.get("judged") or [])
    way = "a straight line" if motion.get("path") else "a curve through the key views"
    facts = [
        ("frames flown", motion.get("frames")),
        ("judged", count),
        ("along", way),
        ("paths a pixel of the truth", f"{motion['spp']:,}" if motion.get("spp") else None),
        ("its noise", write_figure("regional", as_number(motion.get("noise")))),
    ]
    truth = {"label": "truth", "kind": "truth", "colour": "truth", "variant": 0}
    rows = [(truth, "truth"), *((name_entry(entry), entry.file) for entry in _flown(scene))]
    return {
        "facts": list_facts(facts),
        "sentences": [(topic, sentence) for topic, sentence in _say(scene) if sentence],
        "table": make_motion_table(scene),
        "plots": _draw(scene),
        "numbers": [f"frame {number}" for number in motion.get("pictured") or []],
        "strips": [{"entry": entry, "address": strips[stem]} for entry, stem in rows if stem in strips],
        "remark": "The truth is kept as sums over blocks: pictures have each method’s own direct light, and FLIP is "
        "left out. `--motion-spp` renders it."
        if motion.get("kept") == "sums"
        else "All pictures have the truth’s direct light; indirect light tells them apart.",
    }


def _flown(scene: SceneResults) -> list[ResultEntry]:
    return [*scene.pick("method"), *scene.motion_peers]


# ---------- In sentences ----------


def _say(scene: SceneResults) -> Iterable[tuple[str, str]]:
    """Yield (topic, sentence) pairs."""
    figure = motion_error(scene)
    yield "Nearest", _say_nearest(scene, figure, nearest_in_motion(scene))
    yield "Beside rest", _say_rest(scene, figure)
    yield "Calmest", _say_calmest(rank(scene, "motion_flicker", scene.pick("method")))
    yield "Jump", _say_cut(scene)
    yield "Equal time", " ".join(_say_peers(scene, figure))


def _say_nearest(scene: SceneResults, figure: str, ranking: Ranking | None) -> str:
    if ranking is None:
        return ""
    names = join([entry.label for entry in ranking.best])
    text = f"{names}{' tie' if ranking.is_tie else ''}, {figure} {ranking.write_values()}"
    worst = ranking.best[0].get("motion_regional_worst")
    if worst is not None and not ranking.is_tie:
        text += f", {write_figure(figure, worst)} in the worst frame"
    ambient = scene.find("ambient")
    bar = ambient.get(figure) if ambient is not None else None
    if bar is not None and ranking.value > 0.0:
        beaten = bar <= ranking.value
        text += "; no nearer than ambient" if beaten else f"; ambient is {_times(bar / ranking.value)} as far off"
    return f"{text}."


def _say_rest(scene: SceneResults, figure: str) -> str:
    """Say how much the flight costs each method beside its last frame at rest."""
    at_rest, parts = figure.removeprefix("motion_"), []
    for entry in scene.pick("method"):
        rest, motion = entry.get(at_rest), entry.get(figure)
        if not rest or not motion:
            continue
        ratio = motion / rest
        how = f"{_times(ratio)} as far off as" if ratio > ALIKE else "about as far off as"
        how = f"{_times(1.0 / ratio)} nearer than" if ratio < 1.0 / ALIKE else how
        parts.append(f"{entry.label} is {how} at rest ({write_figure(at_rest, rest)})")
    return f"{'; '.join(parts)}." if parts else ""


def _say_calmest(ranking: Ranking | None) -> str:
    if ranking is None or not ranking.others:
        return ""
    loudest = ranking.others[-1]
    value = write_figure("motion_flicker", loudest.get("motion_flicker"))
    return f"{join([entry.label for entry in ranking.best])}, {ranking.write_values()}; {loudest.label} {value}."


def _say_cut(scene: SceneResults) -> str:
    """Say how far off each method is in the frames after the jump."""
    parts = []
    for entry in scene.pick("method"):
        cut = (entry.data.get("motion") or {}).get("cut") or {}
        errors = [as_number(value) for value in cut.get("regional") or []]
        known = [
            f"{write_figure('regional', value)} in frame {frame}"
            for frame, value in zip(cut.get("frame") or [], errors, strict=False)
            if value is not None
        ]
        if known:
            parts.append(f"{entry.label} {join(known)}")
    return f"{'; '.join(parts)}." if parts else ""


def _say_peers(scene: SceneResults, figure: str) -> Iterable[str]:
    """Yield a sentence a method on the path tracers in its time."""
    for label in dict.fromkeys(str(peer.data["of"]) for peer in scene.motion_peers):
        method = scene.find(label)
        if method is None or method.get(figure) is None:
            continue
        parts = []
        for peer in scene.motion_peers:
            if peer.data["of"] == label and peer.get(figure) is not None:
                parts.append(f"{_name_peer(peer)} {_judge(scene, figure, peer, method)} it")
        if parts:
            value = write_figure(figure, method.get(figure))
            yield f"Given {label}’s {write_time(method.get('motion_ms'))} ({value}), the path tracer {join(parts)}."


def _name_peer(peer: ResultEntry) -> str:
    """Return what a peer is, with how many paths fit."""
    samples, history = (as_number(peer.data.get(name)) for name in ("samples", "history"))
    plural = "path" if samples == 1 else "paths"
    parts = [f"with {round_figure(samples)} {plural} a pixel" if samples is not None else ""]
    parts += [f"a history of {round_figure(history)}" if history is not None else "", peer.data.get("denoised") or ""]
    return join([part for part in parts if part])


def _judge(scene: SceneResults, figure: str, peer: ResultEntry, method: ResultEntry) -> str:
    """Return what the path tracer does to a method, with its own error: `beats (0.02)`."""
    own, other = peer.get(figure) or 0.0, method.get(figure) or 0.0
    outcome = "ties" if abs(own - other) <= margin(scene, figure, peer, method) else "wins" if own < other else "loses"
    return f"({write_figure(figure, own)}) {VERBS[outcome]}"


def _times(ratio: float) -> str:
    return f"{round_figure(ratio, 2)} times"


# ---------- Plots ----------


def _draw(scene: SceneResults) -> list[dict[str, str]]:
    """Return the error along the flight and after the jump, each with a caption; what has no data is left out."""
    figure = motion_error(scene).removeprefix("motion_")
    noise = (as_number(scene.motion.get("noise")) or 0.0) if figure == "regional" else 0.0
    entries = [*_flown(scene), *scene.pick("baseline")]
    name = AXIS_NAMES[figure]
    flown = [_trace(entry, entry.data.get("motion") or {}, figure) for entry in entries]
    cut = [_trace(entry, (entry.data.get("motion") or {}).get("cut") or {}, figure) for entry in entries]
    plots = [
        ("Error along the flight", plot_error(flown, "frame", name, noise, linear=True)),
        ("Error after the jump", plot_error(cut, "frames after the jump", name, noise)),
    ]
    return [{"title": title, "svg": svg} for title, svg in plots if svg]


def _trace(entry: ResultEntry, series: dict[str, Any], figure: str) -> Line:
    points = [
        (float(x), float(y))
        for x, y in zip(series.get("frame") or [], series.get(figure) or [], strict=False)
        if as_number(x) is not None and as_number(y) is not None and math.isfinite(y)
    ]
    tips = [f"frame {round_figure(x)}: {round_figure(y)}" for x, y in points]
    if entry.kind != "peer":
        return Line(entry.label, entry.colour, tuple(points), style_of(entry), tuple(tips))
    # At the end of a curve there is room for a word.
    preset, denoiser = str(entry.data.get("label")).partition(":")[2], entry.data.get("denoised")
    name, style = (denoiser, "variant-1") if denoiser else ("history", "variant-0") if preset else ("path", "dashed")
    return Line(f"{name} ({entry.data['of']})", entry.colour, tuple(points), style, tuple(tips))
