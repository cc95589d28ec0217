"""Methods beside the truth on any number of scenes: `results.json`, EXR and PNG images, FLIP maps."""

from __future__ import annotations

import re
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from luxel.errors import LuxelError
from luxel.metrics.error import ambient_irradiance
from luxel.metrics.flip import flip_map
from luxel.render.tonemap import auto_exposure, to_display
from luxel.render.write import require_writable, to_json, write_exr, write_png, write_text
from luxel.report.page import write_report
from luxel.scene.model import Camera, SceneData

if TYPE_CHECKING:
    from luxel.render.layers import Layers
    from luxel.render.truth import Truth
    from luxel.report.measure import Run
    from luxel.scene.device import Scene

TRIVIAL = ("none", "ambient")
"""What every figure stands beside."""
REFERENCE_SPP = 512
"""Samples a pixel of the truth unless told otherwise."""
AVERAGED = (
    "regional", "bias", "relmse", "rmse_tonemapped", "rmse_gi_tonemapped", "abs_error_mean", "abs_error_max",
    "block_error_max", "flip", "flicker", "flicker_absolute", "lag_frames", "leak", "truth_noise", "frame_ms",
    "floor_ms",
)  # fmt: skip
"""Figures that are one number: the mean over the seeds is reported, and each seed's own under `seeds`."""

Report = Callable[[str, float], None]


@dataclass(frozen=True)
class Contender:
    """A method with a preset, written `gibs` or `gibs:ekberg`."""

    label: str
    method: str
    preset: str | None

    @property
    def file_name(self) -> str:
        return self.label.replace(":", "-")


def compare(
    scenes: Sequence[str | Path | SceneData],
    methods: Sequence[str],
    *,
    reference: str = "diffuse",
    reference_spp: int | None = None,
    seeds: Sequence[int] = (0,),
    size: tuple[int, int] = (512, 512),
    frames: int = 64,
    flight: bool = False,
    device: str = "auto",
    out: Path,
    progress: Report | None = None,
) -> dict[str, Any]:
    """Run every method on every scene and write `out`; return what `results.json` holds.

    `none` and `ambient` always run too, `ambient` with the irradiance of the truth. A method may carry a preset
    (`gibs:ekberg`). `size` is (width, height); `progress` gets what runs and the share done, 0..1.
    Raises LuxelError for an unknown scene, method or preset, and where `out` cannot be written, before any rendering.
    """
    from luxel.runtime import start

    out = Path(out)
    require_writable(out / "results.json")
    contenders = _contenders(methods)
    if not scenes or not seeds:
        raise LuxelError("compare needs at least one scene and one seed")
    if reference not in ("diffuse", "full"):
        raise LuxelError(f"there is no reference {reference!r}; it is diffuse or full")
    start(device)
    loaded = _load_all(scenes)
    job = _Job(contenders, reference, reference_spp or REFERENCE_SPP, tuple(seeds), size, frames, flight, out)
    results: dict[str, Any] = {"scenes": {}}
    for number, (name, data) in enumerate(loaded.items()):
        report = _nested(progress, number / len(loaded), 1.0 / len(loaded))
        results["scenes"][name] = _compare_scene(job, name, data, report)
        # After each scene, so that an interrupted comparison keeps what it has.
        write_text(out / "results.json", to_json(results, indent=2) + "\n")
    write_report(out)
    return results


@dataclass(frozen=True)
class _Job:
    contenders: list[Contender]
    reference: str
    reference_spp: int
    seeds: tuple[int, ...]
    size: tuple[int, int]
    frames: int
    flight: bool
    out: Path


def _compare_scene(job: _Job, name: str, data: SceneData, report: Report) -> dict[str, Any]:
    """Render the truth of one scene, run every method with every seed, write the images; return the results."""
    from luxel.render.truth import render_truth
    from luxel.scene.device import upload
    from luxel.scene.edit import default_camera

    parts = 1 + len(job.contenders) * len(job.seeds)
    told = _nested(report, 0.0, 1.0 / parts)
    camera, scene = default_camera(data), upload(data)
    truth = render_truth(
        scene,
        camera=camera,
        size=job.size,
        spp=job.reference_spp,
        progress=lambda share: told(f"{name}: truth", share),
    )
    full = _render_full(job, name, data, camera, told) if job.reference == "full" else None
    wanted = truth.layers.image() if full is None else full
    view = _View(name, scene, camera, truth, full, auto_exposure(wanted), ambient_irradiance(truth.layers))
    folder = job.out / _folder_name(name)
    _write_image(folder, "truth", wanted, view.exposure)
    _write_image(folder, "truth_indirect", truth.layers.indirect_radiance(), view.exposure)
    methods: dict[str, Any] = {}
    done = 1
    for contender in job.contenders:
        runs: dict[int, dict[str, Any]] = {}
        for seed in job.seeds:
            run = _run(job, view, contender, seed, _nested(report, done / parts, 1.0 / parts))
            runs[seed] = run.figures
            done += 1
            if seed == job.seeds[0]:
                _write_run(folder, contender.file_name, run.layers, wanted, view.exposure)
        methods[contender.label] = average_seeds(runs)
    return {"reference": _describe_reference(job, view), "methods": methods}


@dataclass(frozen=True)
class _View:
    """What every method of one scene is measured on, and against."""

    name: str
    scene: Scene
    camera: Camera
    truth: Truth
    full: np.ndarray | None
    exposure: float
    irradiance: tuple[float, float, float]


def _run(job: _Job, view: _View, contender: Contender, seed: int, report: Report) -> Run:
    from luxel.render.renderer import Renderer
    from luxel.report.measure import measure_run

    def make() -> Renderer:
        return Renderer(
            view.scene,
            method=contender.method,
            params={"irradiance": view.irradiance} if contender.method == "ambient" else None,
            preset=contender.preset,
            size=job.size,
            seed=seed,
            camera=view.camera,
        )

    return measure_run(
        make,
        view.truth,
        frames=job.frames,
        exposure=view.exposure,
        flight=job.flight,
        full=view.full,
        progress=lambda share: report(f"{view.name}: {contender.label}, seed {seed}", share),
    )


def _render_full(job: _Job, name: str, data: SceneData, camera: Camera, report: Report) -> np.ndarray:
    from luxel.render.full_scene import render_full

    return render_full(
        data,
        camera,
        size=job.size,
        spp=job.reference_spp,
        progress=lambda share: report(f"{name}: full materials", share),
    )


# ---------- What goes into results.json ----------


def average_seeds(runs: Mapping[int, dict[str, Any]]) -> dict[str, Any]:
    """Return the means of the figures over the seeds, and under `seeds` each seed's own.

    A seed for which a figure does not apply (None or NaN) is left out of its mean. Stages and series are averaged
    entry by entry; rays and cache are the first seed's.
    """
    every = list(runs.values())
    result: dict[str, Any] = {name: _mean([figures.get(name) for figures in every]) for name in AVERAGED}
    stages = every[0]["stages"]
    result["stages"] = {name: _mean([figures["stages"].get(name) for figures in every]) for name in stages}
    result["rays_per_frame"] = every[0]["rays_per_frame"]
    result["cache"] = every[0]["cache"]
    series = [figures["series"] for figures in every]
    result["series"] = {
        "frame": series[0]["frame"],
        **{
            name: [_mean(values) for values in zip(*(one[name] for one in series), strict=True)]
            for name in ("ms", "regional")
        },
    }
    result["seeds"] = {str(seed): {name: figures.get(name) for name in AVERAGED} for seed, figures in runs.items()}
    return result


def _describe_reference(job: _Job, view: _View) -> dict[str, Any]:
    camera = view.camera
    return {
        "kind": job.reference,
        "spp": view.truth.spp,
        "seconds": view.truth.seconds,
        "size": list(job.size),
        "frames": job.frames,
        "flight": job.flight,
        "camera": {"eye": camera.eye, "target": camera.target, "fov": camera.fov, "name": camera.name},
        "exposure": view.exposure,
        "ambient_irradiance": view.irradiance,
    }


def _mean(values: Sequence[Any]) -> float | None:
    known = [float(value) for value in values if value is not None and np.isfinite(value)]
    return statistics.fmean(known) if known else None


# ---------- Images ----------


def _write_image(folder: Path, name: str, image: np.ndarray, exposure: float) -> None:
    """Write a linear image as NAME.exr and, at the truth's exposure, as NAME.png."""
    write_exr(folder / f"{name}.exr", image)
    write_png(folder / f"{name}.png", to_display(image, exposure))


def _write_run(folder: Path, name: str, layers: Layers, truth: np.ndarray, exposure: float) -> None:
    """Write a method's image, its indirect part (radiance) and its FLIP map against the truth's linear image."""
    image = layers.image()
    _write_image(folder, name, image, exposure)
    _write_image(folder, f"{name}_indirect", layers.indirect_radiance(), exposure)
    write_png(folder / f"{name}_flip.png", flip_map(to_display(image, exposure), to_display(truth, exposure)))


# ---------- Names ----------


def _contenders(methods: Sequence[str]) -> list[Contender]:
    """Return the trivial methods and then the others, each once; LuxelError for unknown ones."""
    from luxel.methods import make_params

    contenders = []
    for label in dict.fromkeys([*TRIVIAL, *(word.strip() for word in methods if word.strip())]):
        method, _, preset = label.partition(":")
        contenders.append(Contender(label, method, preset or None))
        make_params(method, preset or None, {})
    return contenders


def _load_all(scenes: Sequence[str | Path | SceneData]) -> dict[str, SceneData]:
    """Return the scenes by the names they have in the report, in order; a name that comes again gets a number."""
    from luxel.scene import load

    loaded: dict[str, SceneData] = {}
    for scene in scenes:
        data = scene if isinstance(scene, SceneData) else load(scene)
        plain = name = data.name if isinstance(scene, SceneData) else scene_label(scene)
        number = 2
        while name in loaded:
            name, number = f"{plain}-{number}", number + 1
        loaded[name] = data
    return loaded


def scene_label(scene: str | Path) -> str:
    """Return what a scene is called in reports: a file's stem, or a built-in scene's name with its dials."""
    text = str(scene)
    file = Path(text)
    return file.stem if file.suffix.lower() in (".gltf", ".glb", ".xml") else text


def _folder_name(name: str) -> str:
    return re.sub(r"[^\w.=,+-]+", "-", name).strip(".") or "scene"


def _nested(report: Report | None, start: float, share: float) -> Report:
    """Return a report for a part of the work that begins at `start` and is `share` of it."""

    def tell(text: str, done: float) -> None:
        if report:
            report(text, start + share * done)

    return tell
