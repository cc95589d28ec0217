"""`report.html`: one file that opens from disk, drawn from results.json and the pictures beside it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any

from luxel.report.conclusions import (
    Ranking,
    best_at_equal_time,
    describe_all,
    describe_scene,
    equal_time,
    fastest,
    leaking,
    main_error,
    nearest,
    warn_all,
)
from luxel.report.figures import FIGURES, round_figure, write_figure, write_time
from luxel.report.motion_page import describe_motion
from luxel.report.pictures import LAYERS, ScenePictures, complain, entry_names, read_all_pictures
from luxel.report.plots import Line, plot_error, style_of
from luxel.report.results import BASELINES, ResultEntry, Results, SceneResults, as_number, read_results
from luxel.report.strips import to_text
from luxel.report.tables import list_facts, make_bars, make_counts, make_parameters, make_table, name_entry, run_ms

KNOWN_COLOURS = ("gibs", "ddgi", "path", "lightmap", "surfel-path", "truth", *BASELINES)
"""Methods whose colour is fixed in report.css; all others share its spare ones in turn."""
SPARE_COLOURS = 4
SCRIPTS = ("codec.js", "viewer.js", "page.js")
SHOWN = ("regional", "flip", "bias", "frame_ms")
"""Figures that stand beside the picture pair."""


def write_report(folder: str | Path, progress: Callable[[str, float], None] | None = None) -> tuple[Path, str]:
    """Draw `folder`/report.html from the results.json and pictures in `folder`; return its path and what is missing.

    The second is one sentence on pictures that were not found, empty where all were. Renders nothing and starts no
    device. Raises LuxelError where there are no results, or where the page cannot be written.
    """
    from luxel.files import write_text

    folder = Path(folder)
    results = read_results(folder)
    all_pictures = read_all_pictures(folder, results, progress=progress)
    complaint = complain(all_pictures)
    path = folder / "report.html"
    write_text(path, draw_page(results, all_pictures, complaint))
    return path, complaint


def draw_page(results: Results, all_pictures: list[ScenePictures], complaint: str = "") -> str:
    """Return the whole page as HTML."""
    import jinja2
    from markupsafe import Markup, escape

    def mark_code(text: str) -> Markup:
        return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("luxel.report"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["code"] = mark_code
    scenes = [_describe(number, scene, all_pictures[number]) for number, scene in enumerate(results.scenes)]
    return environment.get_template("report.html.j2").render(
        style=Markup(_read_template("report.css")),
        scripts=[Markup(_read_template(name)) for name in SCRIPTS],
        svg=Markup,
        colours=spare_colours(results),
        headline=describe_all(results.scenes),
        warnings=[*warn_all(results.scenes), *_warn_of_machines(results)],
        complaint=complaint,
        facts=_overview(results),
        machines=[_machine(results, machine) for machine in results.machines],
        command=results.about.get("command"),
        denoiser=(results.about.get("denoiser") or {}).get("reason"),
        scenes=scenes,
        data=[scene["viewer"] for scene in scenes],
        pictures=_list_pictures(all_pictures),
        glossary=[FIGURES[name] for name in FIGURES],
    )


def spare_colours(results: Results) -> dict[str, str]:
    """Return which spare colour of the style sheet each method has that has none of its own there."""
    names = dict.fromkeys(entry.colour for scene in results.scenes for entry in scene.entries)
    strange = [name for name in names if name not in KNOWN_COLOURS]
    return {name: f"spare-{number % SPARE_COLOURS}" for number, name in enumerate(strange)}


def _read_template(name: str) -> str:
    return (resources.files("luxel.report") / "templates" / name).read_text(encoding="utf-8")


# ---------- The whole comparison ----------


def _overview(results: Results) -> list[tuple[str, str]]:
    reference, about = results.scenes[0].reference, results.about
    methods = dict.fromkeys(entry.label for scene in results.scenes for entry in scene.pick("method"))
    seeds = max(entry.seed_count for scene in results.scenes for entry in scene.entries)
    size = reference.get("size")
    return list_facts(
        [
            (_plural(len(results.scenes), "scene"), len(results.scenes)),
            (_plural(len(methods), "method"), len(methods)),
            (_plural(seeds, "seed"), seeds),
            ("pixels", "×".join(map(str, size)) if isinstance(size, list) else None),
            ("frames", reference.get("frames")),
            ("", str(about.get("date") or "")[:10]),
        ]
    )


def _plural(count: int, word: str) -> str:
    return word if count == 1 else f"{word}s"


def _machine(results: Results, machine: dict[str, Any]) -> list[tuple[str, str]]:
    about = results.about
    versions = machine.get("versions") or {}
    on_gpu = machine.get("device") == "cuda"
    return list_facts(
        [
            ("computed on", {"cuda": "GPU (CUDA)", "cpu": "CPU (LLVM)"}.get(str(machine.get("device")))),
            ("luxel", about.get("luxel")),
            ("GPU", machine.get("gpu") if on_gpu else None),
            ("driver", machine.get("driver") if on_gpu else None),
            ("CPU", machine.get("cpu")),
            ("cores", machine.get("cores")),
            ("system", machine.get("os")),
            ("Python", machine.get("python")),
            ("LLVM", machine.get("llvm")),
            *((name, version) for name, version in versions.items() if name != "luxel"),
            ("commit", machine.get("commit")),
            ("date", about.get("date")),
        ]
    )


def _warn_of_machines(results: Results) -> list[str]:
    count = len(results.machines)
    return [f"{count} different machines took part: their times do not compare."] if count > 1 else []


def _list_pictures(all_pictures: list[ScenePictures]) -> Iterator[tuple[str, str]]:
    """Yield (id, base64 text) of every coded picture; the page decodes one when it is first looked at."""
    for number, scene_pictures in enumerate(all_pictures):
        for name, coded in scene_pictures.coded.items():
            yield f"picture-{number}-{name}", to_text(coded.data)


# ---------- One scene ----------


def _describe(number: int, scene: SceneResults, scene_pictures: ScenePictures) -> dict[str, Any]:
    reference = scene.reference
    facts = [
        ("materials", reference.get("kind") or "diffuse"),
        ("paths a pixel", f"{reference['spp']:,}" if reference.get("spp") else None),
        ("its noise", write_figure(main_error(scene), scene.noise) if scene.noise else None),
        ("pixels", "×".join(map(str, reference.get("size") or []))),
        ("shown here at", _shown_size(scene, scene_pictures)),
        ("frames", reference.get("frames")),
        ("flight", "flown before" if reference.get("flight") else None),
    ]
    return {
        "id": f"scene-{number}",
        "name": scene.name,
        "thumb": scene_pictures.thumbs.get("0"),
        "facts": list_facts(facts),
        "sentences": describe_scene(scene),
        "overview": _overview_row(scene),
        "table": make_table(scene, main=True),
        "more": make_table(scene, main=False),
        "plots": _draw_plots(scene),
        "motion": describe_motion(scene, scene_pictures.strips),
        "bars": make_bars(scene),
        "rays": make_counts(scene, "rays_per_frame"),
        "cache": make_counts(scene, "cache"),
        "parameters": make_parameters(scene),
        "viewer": _describe_viewer(number, scene, scene_pictures),
    }


def _shown_size(scene: SceneResults, scene_pictures: ScenePictures) -> str | None:
    """Return the size of the page's pictures where it had to be less than that of the files."""
    sizes = {(coded.width, coded.height) for coded in scene_pictures.coded.values()}
    size = scene.reference.get("size")
    if len(sizes) != 1 or not isinstance(size, list) or tuple(size) in sizes:
        return None
    width, height = sizes.pop()
    return f"{width}×{height}"


def _overview_row(scene: SceneResults) -> dict[str, Any]:
    """Return the scene's row in the summary."""
    found, error = leaking(scene), main_error(scene)
    ambient = scene.find("ambient")
    return {
        "nearest": _overview_rank(nearest(scene)),
        "fastest": _overview_rank(fastest(scene)),
        "leaks": None
        if found is None
        else [(entry, write_figure("leak", entry.get("leak"), with_unit=True)) for entry in found],
        "comparisons": best_at_equal_time(equal_time(scene)),
        "ambient": write_figure(error, ambient.get(error)) if ambient is not None else "",
        "noise": write_figure(main_error(scene), scene.noise) if scene.noise else "",
    }


def _overview_rank(ranking: Ranking | None) -> dict[str, Any] | None:
    if ranking is None:
        return None
    return {"best": ranking.best, "value": ranking.write_values(), "tie": ranking.is_tie}


def _describe_viewer(number: int, scene: SceneResults, scene_pictures: ScenePictures) -> dict[str, Any]:
    """Return what the picture pair of the page needs: who can be shown, and where the pictures lie."""
    entries = []
    for place, (label, _) in enumerate(entry_names(scene)):
        pictures = _describe_pictures(number, place, scene_pictures)
        if pictures:
            entries.append(
                {
                    **_describe_shown(label, scene.entries[place - 1] if place else None),
                    "pictures": pictures,
                    "flip": scene_pictures.flips.get(str(place)),
                    "thumb": scene_pictures.thumbs.get(str(place)),
                }
            )
    best = nearest(scene)
    exposure = as_number(scene.reference.get("exposure")) or 1.0
    first = best.best[0].label if best else None
    return {"name": scene.name, "entries": entries, "first": first, "exposure": exposure}


def _describe_shown(label: str, entry: ResultEntry | None) -> dict[str, Any]:
    """Return name, colour and figures of what can be shown; the truth, which is no entry, has no figures."""
    if entry is None:
        return {"label": label, "colour": "truth", "kind": "truth", "variant": 0, "figures": {}}
    figures = {name: write_figure(name, entry.get(name), with_unit=True) for name in SHOWN}
    return {**name_entry(entry), "figures": figures | {"run": write_time(run_ms(entry))}}


def _describe_pictures(number: int, place: int, scene_pictures: ScenePictures) -> dict[str, dict[str, Any]]:
    """Return what the page needs to decode the pictures of one entry, by layer."""
    found = {layer: scene_pictures.coded.get(f"{place}-{layer}") for layer in LAYERS}
    return {
        layer: {
            "id": f"picture-{number}-{place}-{layer}",
            "width": coded.width,
            "height": coded.height,
            "step": coded.step,
        }
        for layer, coded in found.items()
        if coded is not None
    }


# ---------- Plots ----------


def _draw_plots(scene: SceneResults) -> list[dict[str, str]]:
    """Return the error over frames and over milliseconds, each with a caption; what has no data is left out."""
    levels = [
        Line(entry.label, entry.colour, ((1.0, value),), "level")
        for entry in scene.pick("baseline")
        if (value := entry.get("regional")) is not None
    ]
    frames = [_trace(entry, "frame", "frame {x}: {y}") for entry in scene.pick("method")]
    times = [_trace(entry, "ms", "{y} after {x} ms, frame {frame}") for entry in scene.pick("method")]
    if scene.path_series:
        times.append(_trace_path(scene.path_series))
    for peer in scene.pick("peer"):
        ms, error = as_number(peer.data.get("ms")), peer.get("regional")
        if ms and error:
            tip = f"{round_figure(error)} in {round_figure(ms)} ms"
            times.append(Line(peer.label, peer.colour, ((ms, error),), "point", (tip,)))
    plots = [
        ("Error over frames", plot_error([*frames, *levels], "frames", "error (regional)", scene.noise)),
        ("Error over time", plot_error([*times, *levels], "milliseconds", "error (regional)", scene.noise)),
    ]
    return [{"title": title, "svg": svg} for title, svg in plots if svg]


def _trace(entry: ResultEntry, axis: str, tip: str) -> Line:
    series = entry.data.get("series") or {}
    points, tips = [], []
    frames = series.get("frame") or []
    for x, y, frame in zip(series.get(axis) or [], series.get("regional") or [], frames, strict=False):
        if as_number(x) and as_number(y):
            points.append((float(x), float(y)))
            tips.append(tip.format(x=round_figure(x), y=round_figure(y), frame=frame))
    return Line(entry.label, entry.colour, tuple(points), style_of(entry), tuple(tips))


def _trace_path(series: dict[str, list[Any]]) -> Line:
    points, tips = [], []
    rows = zip(series.get("ms") or [], series.get("regional") or [], series.get("samples") or [], strict=False)
    for ms, error, samples in rows:
        if as_number(ms) and as_number(error):
            points.append((float(ms), float(error)))
            tips.append(f"{round_figure(error)} after {round_figure(ms)} ms, {round_figure(samples)} paths a pixel")
    return Line("path tracer", "path", tuple(points), "dashed", tuple(tips))
