"""What a comparison is made of: jobs that any process can run by itself, and what comes out of them.

A job is plain data. It carries its scene as text, so a worker on another machine makes the scene from that. Three
kinds: the truth of a scene (`ViewJob`), one method with one seed (`RunJob`), the peer with one seed (`peers.PeerJob`).
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from luxel.image.tonemap import mean_exposure
from luxel.metrics.error import ambient_irradiance
from luxel.scene.choice import SceneChoice
from luxel.scene.model import SceneData

if TYPE_CHECKING:
    from luxel.image.layers import Layers
    from luxel.methods.base import Method
    from luxel.methods.own import MethodFile
    from luxel.render.truth import Truth
    from luxel.scene.device import Scene
    from luxel.scene.host import Looks

Progress = Callable[[str, float], None]
"""Gets what runs and the share done, 0..1."""
Work = Callable[..., Any]
"""Takes a job, then the results it needs, and by name `scenes` and `report`."""


@dataclass(frozen=True)
class MethodSetup:
    """A method with a preset and settings of its own."""

    label: str
    """What it is called in the report: `gibs`, `gibs:ekberg`, or a name that a suite gives it."""
    method: str
    preset: str | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    origin: MethodFile | None = None
    """The file that a method from outside is loaded from, by every process that runs it."""

    @property
    def file_name(self) -> str:
        """The stem of its files."""
        return safe_name(self.label)

    @property
    def baseline(self) -> bool:
        """Whether other methods' figures stand beside its own, and it never wins."""
        return self._found().baseline

    def shown_materials(self, wanted: Looks) -> Looks:
        """Return what its pictures show of materials where `wanted` is asked for."""
        return self._found().shown_materials(wanted)

    def params(self, irradiance: tuple[float, float, float] | None = None) -> Any:
        """Return its `Params`; one with an `irradiance_param` takes the truth's `irradiance` for it unless it is set.

        Raises LuxelError for an unknown method, preset or parameter.
        """
        from luxel.methods import make_params

        fitted = self._found().irradiance_param
        given = {fitted: irradiance} if fitted and irradiance is not None else {}
        return make_params(self.method, self.preset, given | self.settings)

    def _found(self) -> Method:
        from luxel.methods import find_method

        return find_method(self.method) if self.origin is None else self.origin.load()


def make_setup(
    text: str, *, label: str | None = None, preset: str | None = None, settings: dict[str, Any] | None = None,
    folder: str | Path = ".",
) -> MethodSetup:  # fmt: skip
    """Return the setup of `gibs`, `gibs:ekberg`, `FILE.py:Class` or `FILE.py:Class:PRESET`.

    A class of a file is called by its `name`; a relative path counts from `folder`. `label` None: method, preset and
    `settings` as text. Raises LuxelError for a file or class that cannot be used.
    """
    from luxel.methods.own import SOURCES, is_file, load_method, split_method

    name, own = split_method(text.strip())
    origin, preset = None, preset or own
    if is_file(name):
        name = load_method(name, folder).name
        origin = SOURCES[name]
    settings = settings or {}
    words = [f"{name}:{preset}" if preset else name, *(f"{key}={value}" for key, value in settings.items())]
    return MethodSetup(label or " ".join(words), name, preset, settings, origin)


@dataclass(frozen=True)
class ViewJob:
    """The truth of one scene."""

    key: str
    """Tells scenes apart, also those of two comparisons that one worker serves."""
    label: str
    scene: SceneChoice | SceneData
    materials: Looks
    """What counts of the scene's in the truth, and in the pictures of methods that can show it."""
    spp: int
    size: tuple[int, int]
    device: str


@dataclass
class ReferenceView:
    """What every method of one scene is measured against."""

    truth: Truth
    materials: Looks
    """What counts of the scene's in it."""
    exposure: float
    irradiance: tuple[float, float, float]
    """The one irradiance that gives the truth's total on diffuse surfaces."""
    camera: dict[str, Any]
    warnings: list[str]

    @property
    def split(self) -> bool:
        """Whether all methods' indirect light can be held against the truth's: only where all is diffuse."""
        return self.materials == "diffuse"

    @property
    def wanted(self) -> np.ndarray:
        """The linear image (H, W, 3) that methods should come near."""
        return self.truth.layers.image()


@dataclass(frozen=True)
class RunJob:
    """One method on one scene with one seed."""

    view: ViewJob
    setup: MethodSetup
    seed: int
    frames: int
    flight: bool
    pictured: bool
    """Whether its last frame is wanted, and not its figures alone."""


@dataclass
class Pictures:
    """Two linear images (H, W, 3) of a run."""

    image: np.ndarray
    indirect: np.ndarray
    """The part of it that indirect light adds, radiance."""


@dataclass
class Outcome:
    """What a `RunJob` gave."""

    figures: dict[str, Any]
    params: dict[str, Any]
    pictures: Pictures | None
    machine: dict[str, Any]


class SceneCache:
    """Keeps the scene that was uploaded last, so that jobs of one scene that follow each other share it."""

    def __init__(self, loaded: dict[str, SceneData] | None = None) -> None:
        """`loaded` holds scenes that have been read already, by the keys of their jobs; each is handed out once."""
        self._loaded = loaded or {}
        self._key: str | None = None
        self._data: SceneData | None = None
        self._scene: Scene | None = None

    def scene(self, job: ViewJob, materials: Looks = "diffuse") -> Scene:
        """Return the scene of `job`, uploaded with `materials`. Raises LuxelError where it cannot be made."""
        from luxel import runtime
        from luxel.render.loading import load_choice
        from luxel.scene.device import upload

        runtime.start(job.device)
        if self._data is None or self._key != job.key:
            self.clear()
            data = self._loaded.pop(job.key, None)
            if data is None:
                data = job.scene if isinstance(job.scene, SceneData) else load_choice(job.scene)
            self._key, self._data = job.key, data
        if self._scene is None or self._scene.host.looks != materials:
            self._scene = None  # let go first: there may be no room for two
            self._scene = upload(self._data, recentre=True, materials=materials)
        return self._scene

    def clear(self) -> None:
        """Let the scene go: at the end, and after a failure, which may have left its lights or its time changed."""
        self._key = self._data = self._scene = None


class Handle(Protocol):
    """A job that was handed to a runner."""

    def result(self) -> Any:
        """Return what the job gave, once it is done. Raises what it raised."""
        ...


class Runner(Protocol):
    """Runs jobs, here or elsewhere."""

    def submit(
        self, function: Callable[..., Any], job: Any, *inputs: Handle, report: Progress, urgent: int = 0
    ) -> Handle:
        """Hand in `function(job, *results of inputs)`; more `urgent` jobs go first where several are ready."""
        ...


class LocalRunner:
    """Runs each job in this process when its result is first asked for, so that one scene is worked on at a time."""

    def __init__(self, scenes: SceneCache) -> None:
        self._scenes = scenes

    def submit(
        self, function: Callable[..., Any], job: Any, *inputs: Handle, report: Progress, urgent: int = 0
    ) -> Handle:
        return _Deferred(lambda: function(job, *(each.result() for each in inputs), scenes=self._scenes, report=report))


class _Deferred:
    """Calls a function once and keeps what it returned."""

    def __init__(self, call: Callable[[], Any]) -> None:
        self._call = call
        self._results: list[Any] = []

    def result(self) -> Any:
        if not self._results:
            self._results.append(self._call())
        return self._results[0]


def run_view(job: ViewJob, *, scenes: SceneCache, report: Progress) -> ReferenceView:
    """Return the truth of a scene with the materials of the job."""
    from luxel.render.truth import render_truth
    from luxel.scene.edit import default_camera

    scene = scenes.scene(job, job.materials)
    data = scene.host.data
    camera = default_camera(data, job.size[0] / job.size[1])
    truth = render_truth(
        scene,
        camera=camera,
        size=job.size,
        spp=job.spp,
        progress=lambda share: report(f"{job.label}: truth", share),
    )
    # One irradiance lights diffuse surfaces alone: what others reflect is none of it.
    diffuse = replace(truth.layers, glossy=np.zeros_like(truth.layers.glossy))
    return ReferenceView(
        truth,
        job.materials,
        mean_exposure(truth.layers.image()),
        ambient_irradiance(diffuse),
        {"eye": camera.eye, "target": camera.target, "fov": camera.fov, "name": camera.name},
        list(data.warnings),
    )


def run_method(job: RunJob, view: ReferenceView, *, scenes: SceneCache, report: Progress) -> Outcome:
    """Run a method on its scene, with as much of the materials as it shows, and measure it against `view`."""
    from luxel.render.renderer import Renderer
    from luxel.report.measure import measure_run

    scene = scenes.scene(job.view, job.setup.shown_materials(job.view.materials))
    params = job.setup.params(view.irradiance)

    def make() -> Renderer:
        return Renderer(scene, job.setup.method, params, size=job.view.size, seed=job.seed)

    run = measure_run(
        make,
        view.truth,
        frames=job.frames,
        exposure=view.exposure,
        flight=job.flight,
        split=view.split,
        progress=lambda share: report(f"{job.view.label}: {job.setup.label}, seed {job.seed}", share),
    )
    return Outcome(run.figures, asdict(params), take_pictures(run.layers, job.pictured), this_machine())


def take_pictures(layers: Layers, wanted: bool = True) -> Pictures | None:
    """Return the pictures of a frame, or None where they are not wanted."""
    return Pictures(layers.image(), layers.indirect_radiance()) if wanted else None


@functools.cache
def this_machine() -> dict[str, Any]:
    """Return the record of the machine that this process runs on, asked for once: it calls other programs."""
    from luxel.bench.machine import machine_record

    return machine_record()


def safe_name(label: str) -> str:
    """Return a label without what file systems dislike: `gibs-ekberg` for `gibs:ekberg`."""
    return re.sub(r"[^\w.=,+-]+", "-", label).strip(".") or "unnamed"


def nested(report: Progress | None, start: float, share: float) -> Progress:
    """Return a report for a part of the work that begins at `start` and is `share` of it."""

    def tell(text: str, done: float) -> None:
        if report:
            report(text, start + share * done)

    return tell
