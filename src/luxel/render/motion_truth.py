"""The truth of a flight: each judged frame path traced at the moment and from the place at which it is flown.

Frames are cached as half-precision direct and indirect light; albedo and emission take one ray a pixel. For the scenes
of the docs sums over blocks are committed: all that `motion_regional` needs, and small enough to be kept.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.files import write_npz
from luxel.image.layers import Layers
from luxel.image.tonemap import mean_exposure
from luxel.metrics.error import truth_noise
from luxel.metrics.motion import TruthSums, sum_truth, sums_irradiance
from luxel.render.frame import make_film
from luxel.render.motion_path import CUT_FRAMES, MotionPath, frame_time
from luxel.render.references import references_folder, view_key
from luxel.render.truth import FULL_VERSION, Truth, cache_folder, render_truth, trace_layers
from luxel.render.truth import VERSION as TRUTH_VERSION
from luxel.scene.axes import camera_axes
from luxel.scene.device import Scene, set_time
from luxel.scene.digest import hash_camera
from luxel.scene.local import local_camera
from luxel.scene.model import Camera

MOTION_SPP = 512
"""Paths a pixel of each judged frame unless told otherwise."""
VERSION = 1
"""Raised whenever the files' meaning changes; part of their keys."""
HALF_PEAK = 2.0**15
"""What the largest value of a layer becomes in half precision, so that lamps do not overflow and shade is kept."""
CAMERA = ("eye", "target", "up", "fov")
"""What makes the camera after the jump."""
STORED = {item.name for item in fields(Layers)} - {"hit", "throughput"}
"""Layers of a frame that is cached whole, at the least."""
SUMS = ("light", "albedo", "total", "reflected")


@dataclass
class FrameTruth:
    """The truth of one frame."""

    frame: int
    """Its number, from 1; those after the jump go on from the last one flown."""
    layers: Layers | None
    """None where only sums are kept."""
    sums: TruthSums


@dataclass
class MotionTruth:
    """The truth of a flight."""

    frames: list[FrameTruth]
    """The judged frames."""
    cuts: list[FrameTruth]
    """Those after the jump."""
    spp: int
    """Paths a pixel, both halves together."""
    seconds: float
    """What it cost when it was made."""
    noise: float
    """Mean `truth_noise` of the judged frames."""
    exposure: float
    """The one factor that brings the mean luminance of all judged frames to 0.18."""
    cut: Camera
    """Where the camera is after the jump."""
    device: str = ""

    @property
    def irradiance(self) -> tuple[float, float, float]:
        """Return the one irradiance that gives the indirect light of all judged frames."""
        return sums_irradiance(frame.sums for frame in self.frames)


def render_motion_truth(
    scene: Scene,
    path: MotionPath,
    size: tuple[int, int],
    spp: int | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> MotionTruth:
    """Return the truth of every judged frame of `path` for (width, height) `size`, with the scene's materials.

    `spp` None: 512 paths a pixel, or on a CPU the committed sums where there are any of as many paths; the layers are
    None then. A number is rendered in any case. Leaves the scene at time 0. Raises LuxelError as `render_truth`.
    """
    from luxel import runtime

    try:
        views = _judged_views(path)
        if spp is None and runtime.start("auto").name == "cpu":
            found = find_sums(motion_key(scene, path, size), MOTION_SPP)
            if found is not None:
                return found
        return _render_all(scene, views, len(path.judged), size, spp or MOTION_SPP, seed, progress)
    finally:
        set_time(scene, 0.0)


def _judged_views(path: MotionPath) -> list[tuple[int, Camera]]:
    """Return number and camera of each judged frame, those after the jump behind the others."""
    flown = [(frame, path.views[frame - 1]) for frame in path.judged]
    return flown + [(len(path.views) + after, path.cut) for after in CUT_FRAMES]


def _render_all(
    scene: Scene,
    views: list[tuple[int, Camera]],
    flown: int,
    size: tuple[int, int],
    spp: int,
    seed: int,
    progress: Callable[[float], None] | None,
) -> MotionTruth:
    truths: list[FrameTruth] = []
    keys = _Keys(scene, size)
    known: dict[str, _Kept] = {}
    noises: list[float] = []
    for number, (frame, camera) in enumerate(views):

        def tell(share: float, number: int = number) -> None:
            if progress is not None:
                progress((number + share) / len(views))

        time = frame_time(frame)
        set_time(scene, time)
        key = keys.frame(camera, time, spp, seed)
        # What stands still after the jump is one picture.
        if key not in known:
            known[key] = _read(key, size) or _render(scene, camera, size, spp, seed, time, key, tell)
        kept = known[key]
        layers = kept.restore(scene, camera, size, time)
        # What mirrors and gloss bring is no light of a diffuse surface, which the sums are of.
        diffuse = replace(layers, glossy=np.zeros_like(layers.glossy))
        truths.append(FrameTruth(frame, layers, sum_truth(diffuse)))
        noises.append(kept.noise)
        tell(1.0)
    images = np.concatenate([truth.layers.image() for truth in truths[:flown] if truth.layers is not None])
    first = next(iter(known.values()))
    return MotionTruth(
        truths[:flown],
        truths[flown:],
        first.spp,
        sum(kept.seconds for kept in known.values()),
        float(np.mean(noises[:flown])),
        mean_exposure(images),
        views[-1][1],
        first.device,
    )


class _Keys:
    """Names of frames. What stands still is hashed once: a scene with its textures takes a while."""

    def __init__(self, scene: Scene, size: tuple[int, int]) -> None:
        self._scene, self._size = scene, size
        self._moves = bool(scene.host.moving or scene.host.deforming or scene.host.lights_move)
        self._known: dict[float, str] = {}

    def view(self, camera: Camera, time: float) -> str:
        """Return what tells a view of the scene at `time` from any other; the scene is at that time."""
        scene, at = self._scene, time if self._moves else 0.0
        if at not in self._known:
            # From one place and for one size: what is left is the scene, with its lights and materials.
            self._known[at] = view_key(scene, Camera(), self._size, at, scene.host.looks)
        axes = camera_axes(local_camera(camera, scene.host.origin), time)
        return hashlib.sha256(f"{self._known[at]}{hash_camera(camera, axes)}".encode()).hexdigest()

    def frame(self, camera: Camera, time: float, spp: int, seed: int) -> str:
        """Return what a cached frame is called by: its view, paths, seed and versions."""
        half = max((spp + 1) // 2, 1)
        made_by = [half, seed, TRUTH_VERSION, FULL_VERSION, VERSION, mi.__version__, dr.__version__]
        made_of = self.view(camera, time)
        return f"motion-{hashlib.sha256(json.dumps([made_of, *made_by]).encode()).hexdigest()[:32]}"


# ---------- One frame on disk ----------


@dataclass
class _Kept:
    """A frame as it is cached."""

    layers: dict[str, np.ndarray]
    """Direct and indirect light; of scenes whose surfaces are not seen by one ray a pixel, every layer."""
    spp: int
    seconds: float
    noise: float
    device: str

    def restore(self, scene: Scene, camera: Camera, size: tuple[int, int], time: float) -> Layers:
        """Return the frame's layers; the scene is at its time."""
        if len(self.layers) == 2:
            return trace_layers(scene, camera, make_film(size), time, **self.layers)
        return Layers(**{**self.layers, "hit": self.layers["weight"] > 0.0})


def _render(
    scene: Scene,
    camera: Camera,
    size: tuple[int, int],
    spp: int,
    seed: int,
    time: float,
    key: str,
    progress: Callable[[float], None],
) -> _Kept:
    """Render a frame and keep it for the next time; a cache that cannot be written is no reason to fail."""
    truth: Truth = render_truth(
        scene, camera=camera, size=size, spp=spp, seed=seed, time=time, progress=progress, cache=False
    )
    many = scene.features.gloss or scene.features.blended
    names = [name for name in vars(truth.layers) if name != "hit"] if many else ["direct", "indirect"]
    found = {name: getattr(truth.layers, name) for name in names}
    packed = {name: to_half(values) for name, values in found.items() if values is not None}
    noise = truth_noise(truth.layers, truth.halves)
    kept = _Kept(
        {name: from_half(*pair) for name, pair in packed.items()}, truth.spp, truth.seconds, noise, truth.device
    )
    arrays: dict[str, Any] = {"spp": kept.spp, "seconds": kept.seconds, "noise": noise, "device": kept.device}
    for name, (values, scale) in packed.items():
        arrays |= {f"layer_{name}": values, f"scale_{name}": scale}
    with contextlib.suppress(LuxelError):
        write_npz(cache_folder() / f"{key}.npz", arrays)
    return kept


def _read(key: str, size: tuple[int, int]) -> _Kept | None:
    """Return a cached frame; None where there is none or the file is damaged, so that it is made again."""
    try:
        with (cache_folder() / f"{key}.npz").open("rb") as stream, np.load(stream) as file:
            names = [name[6:] for name in file.files if name.startswith("layer_")]
            layers = {name: from_half(file[f"layer_{name}"], float(file[f"scale_{name}"])) for name in names}
            whole = {"direct", "indirect"} if len(names) == 2 else STORED
            if not whole <= set(names) or any(values.shape[1::-1] != size for values in layers.values()):
                return None
            return _Kept(
                layers, int(file["spp"]), float(file["seconds"]), float(file["noise"]), str(file["device"])
            )  # fmt: skip
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile):
        return None


def to_half(values: np.ndarray) -> tuple[np.ndarray, float]:
    """Return `values` over a scale as float16, and the scale: the largest becomes 2^15."""
    peak = float(np.abs(values).max(initial=0.0))
    scale = peak / HALF_PEAK if peak > 0.0 else 1.0
    return (values.astype(np.float64) / scale).astype(np.float16), scale


def from_half(values: np.ndarray, scale: float) -> np.ndarray:
    """Return what `to_half` was given, float32, rounded to 11 bits."""
    return (values.astype(np.float64) * scale).astype(np.float32)


# ---------- Sums that are committed ----------


def motion_key(scene: Scene, path: MotionPath, size: tuple[int, int]) -> str:
    """Return what the committed sums of a flight are called by: every judged view of the scene. Sets its time.

    The view after the jump is none of them: where a scene names no key views it is found by rays, whose last bits
    differ between devices. So the sums bring their own.
    """
    keys, views = _Keys(scene, size), []
    for frame in path.judged:
        set_time(scene, frame_time(frame))
        views.append(keys.view(path.views[frame - 1], frame_time(frame)))
    return hashlib.sha256("".join([*views, str(CUT_FRAMES), str(VERSION)]).encode()).hexdigest()[:16]


def write_sums(path: Path, truth: MotionTruth, about: dict[str, object] | None = None) -> None:
    """Write the sums of a flight to `path`, NAME-KEY.npz in the folder `motion` of the committed truths.

    `about` says where they come from. Raises LuxelError where it cannot be written.
    """
    every = [*truth.frames, *truth.cuts]
    arrays: dict[str, Any] = {}
    for name in SUMS:
        values, scale = to_half(np.stack([getattr(one.sums, name) for one in every]))
        arrays |= {name: values, f"scale_{name}": scale}
    record = {
        **(about or {}),
        "frames": [one.frame for one in truth.frames],
        "cuts": [one.frame for one in truth.cuts],
        "cut": {name: getattr(truth.cut, name) for name in CAMERA},
        **{name: getattr(truth, name) for name in ("spp", "seconds", "noise", "exposure", "device")},
    }
    write_npz(path, {**arrays, "about": json.dumps(record)}, compress=True)


def find_sums(key: str, spp: int) -> MotionTruth | None:
    """Return the committed sums that are called by `key`, if they have at least `spp` paths a pixel."""
    folder = references_folder()
    for path in sorted((folder / "motion").glob(f"*-{key}.npz")) if folder else []:
        found = read_sums(path)
        if found is not None and found.spp >= spp:
            return found
    return None


def read_sums(path: Path) -> MotionTruth | None:
    """Return what `write_sums` wrote; None where the file is damaged, so that the truth is made anew."""
    try:
        with path.open("rb") as stream, np.load(stream) as file:
            about = json.loads(str(file["about"]))
            # The sums of a small image's block are no larger than those of one pixel: precision is that of halves.
            arrays = [file[name].astype(np.float64) * float(file[f"scale_{name}"]) for name in SUMS]
            numbers = [*about["frames"], *about["cuts"]]
            every = [FrameTruth(number, None, TruthSums(*sums)) for number, *sums in zip(numbers, *arrays, strict=True)]
            flown = len(about["frames"])
            eye, target, up = (tuple(map(float, about["cut"][name])) for name in CAMERA[:3])
            cut = Camera(eye, target, up, float(about["cut"]["fov"]), name="cut")  # type: ignore[arg-type]
            return MotionTruth(
                every[:flown], every[flown:], int(about["spp"]), float(about["seconds"]), float(about["noise"]),
                float(about["exposure"]), cut, str(about["device"]),
            )  # fmt: skip
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile):
        return None
