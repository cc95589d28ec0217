"""What the figures say, in sentences: who is nearest, who is fastest, who leaks, where the path tracer wins.

A difference counts only where it exceeds what the measurement itself wavers by: the spread over the seeds and, for
errors, the noise of the truth. Less than that is a tie, and is called one.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from luxel.report.figures import FIGURES, round_figure, write_figure, write_time
from luxel.report.results import ResultEntry, SceneResults, as_number

TIME_TIE = 0.05
"""Frame times nearer than this share to one another are a tie: a shared machine wavers by as much."""
LEAK_SEEN = 0.001
"""Leaks up to this share of the lit room's light are not called one."""
NOISE_SHARE = 3.0
"""An error must be this many times the truth's noise to count."""


@dataclass(frozen=True)
class Ranking:
    """Who is best in one figure."""

    figure: str
    best: tuple[ResultEntry, ...]
    """The best one, then those that tie with it."""
    others: tuple[ResultEntry, ...]
    """The rest, best first."""

    @property
    def is_tie(self) -> bool:
        return len(self.best) > 1

    @property
    def value(self) -> float:
        value = self.best[0].get(self.figure)
        assert value is not None
        return value

    def write_values(self) -> str:
        """Return the best value with its unit; of a tie all that differ, such as `40 and 41 ms`."""
        values = list(dict.fromkeys(write_figure(self.figure, entry.get(self.figure)) for entry in self.best))
        unit = FIGURES[self.figure].unit
        return f"{join(values)} {unit}" if unit else join(values)


@dataclass(frozen=True)
class EqualTimeComparison:
    """The path tracer against a method whose time it was given."""

    peer: ResultEntry
    method: ResultEntry
    outcome: str
    """`wins`, `loses` or `ties`, as seen from the path tracer."""


@dataclass(frozen=True)
class EqualTimeResult:
    """What the path tracer at equal time comes to against one method, bare and denoised together."""

    method: ResultEntry
    outcome: str
    verb: str
    how: str
    """Which denoiser it needed for that; empty where none."""


VERBS = {"wins": "beats", "ties": "ties with", "loses": "loses to"}
"""Outcomes of a comparison, the path tracer's best first, as verbs."""


# ---------- Comparing ----------


def main_error(scene: SceneResults) -> str:
    """Return the error that decides: `regional`, or `flip` where the truth has full materials and no split light."""
    known = any(entry.get("regional") is not None for entry in scene.entries)
    return "regional" if known else "flip"


def margin(scene: SceneResults, figure: str, first: ResultEntry, second: ResultEntry) -> float:
    """Return how much of the difference of two entries in `figure` the measurement itself may explain."""
    wavering = math.hypot(first.spread(figure) or 0.0, second.spread(figure) or 0.0)
    if figure == main_error(scene):
        return max(wavering, scene.noise)
    if figure in ("motion_regional", "motion_regional_worst", "cut_regional"):
        return max(wavering, as_number(scene.motion.get("noise")) or 0.0)
    if figure == "frame_ms":
        return max(wavering, TIME_TIE * min(first.get(figure) or 0.0, second.get(figure) or 0.0))
    return wavering


def rank(scene: SceneResults, figure: str, entries: Sequence[ResultEntry]) -> Ranking | None:
    """Return the entries by a figure of which less is better; None where no entry has it."""
    known = sorted((entry for entry in entries if entry.get(figure) is not None), key=lambda one: one.get(figure) or 0)
    if not known:
        return None
    first = known[0]
    ties = [entry for entry in known[1:] if _gap(figure, first, entry) <= margin(scene, figure, first, entry)]
    return Ranking(figure, (first, *ties), tuple(entry for entry in known[1:] if entry not in ties))


def nearest(scene: SceneResults) -> Ranking | None:
    """Return the methods, baselines and peers aside, by their error."""
    return rank(scene, main_error(scene), scene.pick("method"))


def motion_error(scene: SceneResults) -> str:
    """Return the error that decides in motion: as at rest, or what is known where that is not."""
    wanted = f"motion_{main_error(scene)}"
    known = any(entry.get(wanted) is not None for entry in scene.entries)
    return wanted if known else "motion_flip"


def nearest_in_motion(scene: SceneResults) -> Ranking | None:
    """Return the methods by their error along a flight; None where none was flown."""
    return rank(scene, motion_error(scene), scene.pick("method"))


def fastest(scene: SceneResults) -> Ranking | None:
    """Return the methods by the time of a frame: those that beat `ambient`, where any does.

    A frame that computes nothing of use is quick.
    """
    return rank(scene, "frame_ms", _useful(scene))


def _useful(scene: SceneResults) -> list[ResultEntry]:
    beaten, methods = beaten_by_ambient(scene), scene.pick("method")
    return [entry for entry in methods if entry not in beaten] or methods


def leaking(scene: SceneResults) -> list[ResultEntry] | None:
    """Return the methods that leak visibly, worst first; None where no leak was measured."""
    known = [entry for entry in scene.pick("method") if entry.get("leak") is not None]
    if not known:
        return None
    found = [entry for entry in known if (entry.get("leak") or 0.0) > LEAK_SEEN]
    return sorted(found, key=lambda entry: -(entry.get("leak") or 0.0))


def equal_time(scene: SceneResults) -> list[EqualTimeComparison]:
    """Return the path tracer's comparisons with the methods whose time it was given."""
    figure, comparisons = main_error(scene), []
    for peer in scene.pick("peer"):
        method = scene.find(str(peer.data["of"]))
        if method is None or peer.get(figure) is None or method.get(figure) is None:
            continue
        gap = _gap(figure, peer, method)
        allowed = margin(scene, figure, peer, method)
        outcome = "ties" if abs(gap) <= allowed else "wins" if gap > 0.0 else "loses"
        comparisons.append(EqualTimeComparison(peer, method, outcome))
    return comparisons


def best_at_equal_time(comparisons: Sequence[EqualTimeComparison]) -> list[EqualTimeResult]:
    """Return one result a method: the best that the path tracer reaches against it, bare rather than denoised."""
    found = []
    for label in dict.fromkeys(comparison.method.label for comparison in comparisons):
        against = [comparison for comparison in comparisons if comparison.method.label == label]
        best = min(
            against,
            key=lambda comparison: (list(VERBS).index(comparison.outcome), bool(comparison.peer.data.get("denoised"))),
        )
        denoiser = best.peer.data.get("denoised")
        had_both = len({bool(comparison.peer.data.get("denoised")) for comparison in against}) > 1
        how = f"only with {denoiser}" if denoiser and had_both else f"with {denoiser}" if denoiser else ""
        how = "" if best.outcome == "loses" else how
        found.append(EqualTimeResult(best.method, best.outcome, VERBS[best.outcome], how))
    return sorted(found, key=lambda result: list(VERBS).index(result.outcome))


def beaten_by_ambient(scene: SceneResults) -> list[ResultEntry]:
    """Return the methods that are no nearer to the truth than one constant light everywhere."""
    figure, ambient = main_error(scene), scene.find("ambient")
    if ambient is None or ambient.get(figure) is None:
        return []
    known = [entry for entry in scene.pick("method") if entry.get(figure) is not None]
    return [entry for entry in known if _gap(figure, entry, ambient) <= margin(scene, figure, entry, ambient)]


def below_noise(scene: SceneResults) -> list[ResultEntry]:
    """Return the methods whose error is less than three times the truth's noise."""
    figure, limit = main_error(scene), NOISE_SHARE * scene.noise
    return [entry for entry in scene.pick("method") if (value := entry.get(figure)) is not None and value < limit]


def below_motion_noise(scene: SceneResults) -> list[ResultEntry]:
    """Return the methods whose error along a flight is less than three times the noise of its truth."""
    limit = NOISE_SHARE * (as_number(scene.motion.get("noise")) or 0.0)
    errors = [(entry, entry.get("motion_regional")) for entry in scene.pick("method")]
    return [entry for entry, value in errors if value is not None and value < limit]


def _gap(figure: str, better: ResultEntry, worse: ResultEntry) -> float:
    return (worse.get(figure) or 0.0) - (better.get(figure) or 0.0)


# ---------- One scene in sentences ----------


def describe_scene(scene: SceneResults) -> list[tuple[str, str]]:
    """Return (topic, sentence) pairs: a truth of full materials, error, speed, leaks, the path tracer at equal time."""
    said = [("Truth", _say_truth(scene))]
    said += [("Nearest", _say_nearest(scene)), ("Fastest", _say_fastest(scene)), ("Leaks", _say_leaks(scene))]
    comparisons = equal_time(scene)
    if comparisons:
        said.append(("Equal time", _say_equal_time(scene, comparisons)))
    return [(topic, sentence) for topic, sentence in said if sentence]


def _say_truth(scene: SceneResults) -> str:
    """Say what the truth holds and who shows it; nothing of diffuse materials, which all methods light."""
    methods = [entry for entry in scene.entries if entry.kind != "peer"]
    if scene.reference.get("kind") != "full" or not all(entry.data.get("materials") for entry in methods):
        return ""
    shown, others = ([one.label for one in methods if one.data["materials"] == kind] for kind in ("full", "diffuse"))
    parts = [f"{join(shown)} {'shows' if len(shown) == 1 else 'show'} all of it"] if shown else []
    parts += [f"{join(others)} {'lights' if len(others) == 1 else 'light'} its diffuse part alone"] if others else []
    return f"path traced by luxel with all that the materials do; {', '.join(parts)}; displayed images are judged"


def _say_nearest(scene: SceneResults) -> str:
    ranking = nearest(scene)
    if ranking is None:
        return ""
    figure, ambient = ranking.figure, scene.find("ambient")
    text = f"{_names(ranking)}, {figure} {ranking.write_values()}"
    if ranking.is_tie:
        text = f"{_names(ranking)} tie, {figure} {ranking.write_values()}: no further apart than the measurement wavers"
    bar = ambient.get(figure) if ambient is not None else None
    if bar is not None and ranking.value > 0.0 and ranking.best[0] not in beaten_by_ambient(scene):
        text += f"; ambient, the best single constant, is {_times(bar / ranking.value)} as far off"
    return f"{text}."


def _say_fastest(scene: SceneResults) -> str:
    ranking = fastest(scene)
    if ranking is None:
        return ""
    text = f"{_names(ranking)}{' tie' if ranking.is_tie else ''}, {ranking.write_values()} a frame"
    if ranking.is_tie:
        text += ": no further apart than the measurement wavers"
    if ranking.others:
        slowest = ranking.others[-1]
        text += f"; {slowest.label} takes {_times((slowest.get('frame_ms') or 0.0) / ranking.value)} as long"
    idle = [entry for entry in scene.pick("method") if entry not in (*ranking.best, *ranking.others)]
    hasty = [entry.label for entry in idle if (entry.get("frame_ms") or ranking.value) < ranking.value]
    if hasty:
        text += f"; {join(hasty)} {'is' if len(hasty) == 1 else 'are'} quicker, but no nearer to the truth than ambient"
    return f"{text}."


def _say_leaks(scene: SceneResults) -> str:
    found = leaking(scene)
    if found is None:
        return ""
    tight = [
        entry.label for entry in scene.pick("method") if entry.get("leak") is not None and entry not in found
    ]  # fmt: skip
    limit = f"{round_figure(100.0 * LEAK_SEEN, 1)} %"
    clean = f"{join(tight)} {'stays' if len(tight) == 1 else 'stay'} at or below {limit}" if tight else ""
    if not found:
        return f"none: {clean} of the lit room’s light."
    worst = [f"{entry.label} lets {write_figure('leak', entry.get('leak'), with_unit=True)}" for entry in found]
    text = f"{join(worst)} of the lit room’s light into the sealed one"
    return f"{text}; {clean}." if clean else f"{text}."


def _say_equal_time(scene: SceneResults, comparisons: Sequence[EqualTimeComparison]) -> str:
    """Say for each method what the path tracer does in its time, and both errors."""
    figure, parts = main_error(scene), []
    for result in best_at_equal_time(comparisons):
        against = [comparison.peer for comparison in comparisons if comparison.method is result.method]
        errors = [f"{_name_tracer(peer)} {write_figure(figure, peer.get(figure))}" for peer in against]
        time = as_number(against[0].data.get("of_ms")) or as_number(against[0].data.get("ms"))
        how = f" {result.how}" if result.how else ""
        parts.append(
            f"Given {result.method.label}’s {write_time(time)}, the path tracer {result.verb} it{how}: "
            f"{join(errors)} against {write_figure(figure, result.method.get(figure))}."
        )
    return " ".join(parts)


def _name_tracer(peer: ResultEntry) -> str:
    denoiser = peer.data.get("denoised")
    return f"with {denoiser}" if denoiser else "bare"


def _names(ranking: Ranking) -> str:
    return join([entry.label for entry in ranking.best])


def _times(ratio: float) -> str:
    return f"{round_figure(ratio, 2)} times"


# ---------- All scenes in sentences ----------


def describe_all(scenes: Sequence[SceneResults]) -> list[tuple[str, str]]:
    """Return (topic, sentence) pairs over all scenes: the ten seconds that a reader has."""
    said = [
        ("Nearest to the truth", _count_best(scenes, [nearest(scene) for scene in scenes])),
        ("Nearest in motion", _count_best(scenes, [nearest_in_motion(scene) for scene in scenes])),
        ("Fastest", _count_best(scenes, [fastest(scene) for scene in scenes])),
        ("Leaks", _sum_leaks(scenes)),
        ("Path tracer at equal time", _sum_equal_time(scenes)),
    ]
    return [(topic, sentence) for topic, sentence in said if sentence]


def _count_best(scenes: Sequence[SceneResults], rankings: Sequence[Ranking | None]) -> str:
    """Return who is best where; a tie counts for all that share it, and is called shared."""
    known = [(scene, ranking) for scene, ranking in zip(scenes, rankings, strict=True) if ranking is not None]
    if not known:
        return ""
    if len(known) == 1:
        ranking = known[0][1]
        return f"{_names(ranking)}{', a tie:' if ranking.is_tie else ','} {ranking.write_values()}"
    where: dict[str, list[str]] = {}
    shared: Counter[str] = Counter()
    for scene, ranking in known:
        for entry in ranking.best:
            where.setdefault(entry.label, []).append(scene.name)
            shared[entry.label] += ranking.is_tie
    if len(where) > 1 and all(ranking.is_tie and len(ranking.best) == len(where) for _, ranking in known):
        return f"{join(list(where))} tie on {_count_scenes([scene.name for scene, _ in known], len(known))}"
    order = sorted(where, key=lambda label: (-len(where[label]), shared[label]))
    parts = [f"{label} on {_count_scenes(where[label], len(known))}{_count_ties(shared[label])}" for label in order]
    return "; ".join(parts)


def _count_ties(count: int) -> str:
    return f" ({'a tie' if count == 1 else f'{count} ties'})" if count else ""


def _count_scenes(names: Sequence[str], of: int) -> str:
    """Return `all 4 scenes`, `both scenes`, the names where they are one or two, else `3 of 4 scenes`."""
    if len(names) == of > 1:
        return "both scenes" if of == 2 else f"all {of} scenes"
    return join(names) if len(names) <= 2 else f"{len(names)} of {of} scenes"


def _sum_leaks(scenes: Sequence[SceneResults]) -> str:
    measured = [(scene, found) for scene in scenes if (found := leaking(scene)) is not None]
    parts = [
        f"{entry.label} on {scene.name} ({write_figure('leak', entry.get('leak'), with_unit=True)})"
        for scene, found in measured
        for entry in found
    ]
    if parts:
        return join(parts)
    limit = f"{round_figure(100.0 * LEAK_SEEN, 1)} %"
    return f"none above {limit}" if measured else "not measured: no scene has a sealed room"


def _sum_equal_time(scenes: Sequence[SceneResults]) -> str:
    compared = [(scene, comparisons) for scene in scenes if (comparisons := equal_time(scene))]
    if not compared:
        return ""
    where: dict[tuple[str, str, str], list[str]] = {}
    for scene, comparisons in compared:
        for result in best_at_equal_time(comparisons):
            if result.outcome != "loses":
                where.setdefault((result.verb, result.method.label, result.how), []).append(scene.name)
    if not where:
        return "loses to every method" + (f" on {_count_scenes([s.name for s, _ in compared], len(compared))}")
    together: dict[tuple[str, str, tuple[str, ...]], list[str]] = {}
    for (verb, label, how), names in where.items():
        together.setdefault((verb, how, tuple(names)), []).append(label)
    parts = [
        f"{verb} {join(labels)} on {_count_scenes(names, len(compared))}" + (f" ({how})" if how else "")
        for (verb, how, names), labels in together.items()
    ]
    return "; ".join(parts)


def warn_all(scenes: Sequence[SceneResults]) -> list[str]:
    """Return what a reader must know before believing the figures, each thing once for all the scenes it is true of."""
    beaten: dict[str, list[str]] = {}
    below_noise_on: dict[str, list[str]] = {}
    below_in_motion: dict[str, list[str]] = {}
    for scene in scenes:
        for entry in beaten_by_ambient(scene):
            beaten.setdefault(entry.label, []).append(scene.name)
        for entry in below_noise(scene):
            below_noise_on.setdefault(entry.label, []).append(scene.name)
        for entry in below_motion_noise(scene):
            below_in_motion.setdefault(entry.label, []).append(scene.name)
    warnings = [
        f"{label} does not beat ambient, one constant light everywhere, on {join(names)}."
        for label, names in beaten.items()
    ]
    warnings += [
        f"The error of {label} is less than three times the truth’s noise on {join(names)}: a better truth needs more "
        "--reference-spp."
        for label, names in below_noise_on.items()
    ]
    warnings += [
        f"The error of {label} in motion is less than three times the truth’s noise on {join(names)}: a better truth "
        "needs more --motion-spp."
        for label, names in below_in_motion.items()
    ]
    warnings += [f"{scene.name}: {text}" for scene in scenes for text in scene.warnings]
    return warnings + [
        f"{scene.name}, {entry.label}: {text}"
        for scene in scenes
        for entry in scene.entries
        for text in entry.data.get("warnings") or []
    ]


def join(words: Sequence[str]) -> str:
    """Return `a`, `a and b` or `a, b and c`."""
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1]))) if words else ""
