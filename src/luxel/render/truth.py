"""The truth: many paths a pixel, in two halves with seeds of their own, cached on disk under a hash of what made it."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import time as clock
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from numbers import Integral
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel import runtime
from luxel.errors import LuxelError
from luxel.files import write_npz
from luxel.image.layers import Layers
from luxel.kernels.camera import Pinhole, make_pinhole
from luxel.kernels.direct import direct_irradiance
from luxel.kernels.film import Film
from luxel.kernels.full_path import trace_full
from luxel.kernels.gbuffer import trace_gbuffer
from luxel.kernels.records import PathLight, Surface
from luxel.kernels.surface_bsdf import prepare_bsdf
from luxel.methods.path_tracer import trace_indirect
from luxel.render.collection import collection_paused
from luxel.render.frame import make_film, separate
from luxel.render.references import find_reference, reference_key, view_key
from luxel.scene.check import check_camera
from luxel.scene.choice import check_materials
from luxel.scene.device import Scene, choose_layer, set_time, upload
from luxel.scene.edit import default_camera
from luxel.scene.host import Looks
from luxel.scene.model import Camera, SceneData
from luxel.scene.rules import show

VERSION, FULL_VERSION = 1, 2
"""Raised whenever the integrator's meaning changes, of diffuse and of full materials; part of the cache key."""
TRUTH_SEED = 0x5EED0000
"""Keeps the truth's random numbers apart from every method's."""


@dataclass
class Truth:
    """A path-traced image, taken apart by luxel's rule."""

    layers: Layers
    """Mean of both halves."""
    halves: list[np.ndarray]
    """Two (H, W, 3) indirect irradiances from separate paths."""
    direct_halves: list[np.ndarray]
    """Two (H, W, 3) direct irradiances; of a committed truth only their mean."""
    spp: int
    """Paths a pixel, both halves together."""
    seconds: float
    """What it cost when it was made; 0 where it came from a committed reference."""
    device: str = ""
    image_halves: list[np.ndarray] | None = None
    """With full materials: two (H, W, 3) composed radiances; else the other halves tell all."""


def render_truth(
    scene: SceneData | Scene | str,
    *,
    camera: Camera | None = None,
    size: tuple[int, int],
    spp: int,
    seed: int = 0,
    time: float = 0.0,
    device: str = "auto",
    progress: Callable[[float], None] | None = None,
    cache: bool = True,
    materials: Looks | None = None,
) -> Truth:
    """Return the truth of `scene` for (width, height) `size` at `spp` paths a pixel (even; both halves together).

    `materials`: "diffuse" for the diffuse part of all surfaces alone, "full" for all that they do; None is that of a
    scene on the device, else "diffuse".
    Raises LuxelError where `spp` is no whole number of 1 or more, and where the scene or the camera cannot be.
    """
    if isinstance(spp, bool) or not isinstance(spp, Integral) or spp < 1:
        raise LuxelError(f"{show(spp)} is no number of paths a pixel: give a whole number of 1 or more")
    chosen, film = runtime.start(device), make_film(size)
    if isinstance(scene, str):
        from luxel.render.loading import load

        scene = load(scene)
    loaded = _on_device(scene, materials)
    camera = camera if camera is not None else default_camera(loaded.host.data, size[0] / size[1])
    check_camera(camera)
    half = max((spp + 1) // 2, 1)
    set_time(loaded, time)
    kind: Looks = "full" if loaded.features.gloss else "diffuse"
    wanted = cache and seed == 0 and kind == "diffuse" and not loaded.features.blended
    committed = _committed(loaded, camera, size, spp, time) if wanted else None
    if committed is not None:
        return committed
    path = cache_folder() / f"{cache_key(loaded, camera, size, half, seed, time, kind)}.npz"
    if cache and path.exists():
        found = _read(path)
        if found is not None:
            return found
    truth = _render(loaded, camera, film, half, seed, time, progress)
    truth.device = chosen.name
    if cache:
        _write(path, truth)
    return truth


def _on_device(scene: SceneData | Scene, materials: Looks | None) -> Scene:
    """Return the uploaded scene, ready for its materials. Raises LuxelError where it was uploaded with others."""
    if materials is not None:
        check_materials(materials)
    if isinstance(scene, SceneData):
        scene = upload(scene, recentre=True, materials=materials or "diffuse")
    elif materials is not None and materials != scene.host.looks:
        raise LuxelError(
            f"this scene was uploaded with {scene.host.looks} materials, so there is no truth of {materials} ones: "
            "give the scene's data instead"
        )
    prepare_bsdf(scene)
    return scene


def cache_folder() -> Path:
    """Return where truths are kept: $LUXEL_CACHE, else the user's cache folder."""
    chosen = os.environ.get("LUXEL_CACHE")
    base = Path(chosen) if chosen else Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "luxel"
    return base / "truth"


def cache_key(
    scene: Scene, camera: Camera, size: tuple[int, int], half: int, seed: int, time: float, materials: Looks = "diffuse"
) -> str:
    """Return the hash of what shapes a truth: scene at `time`, camera, size, paths, seed, materials and versions."""
    version = VERSION if materials == "diffuse" else FULL_VERSION
    made_by = [half, seed, version, mi.__version__, dr.__version__]
    made_of = view_key(scene, camera, size, time, materials)
    return hashlib.sha256(json.dumps([made_of, *made_by]).encode()).hexdigest()[:32]


def _committed(scene: Scene, camera: Camera, size: tuple[int, int], spp: int, time: float) -> Truth | None:
    """Return the committed truth of this view, if there is one of at least `spp` paths a pixel."""
    found = find_reference(reference_key(scene, camera, size, time), spp)
    if found is None:
        return None
    direct, indirect, difference, about = found
    layers = trace_layers(scene, camera, make_film(size), time, direct, indirect)
    halves = [indirect + 0.5 * difference, indirect - 0.5 * difference]
    return Truth(layers, halves, [direct], int(str(about["spp"])), 0.0, str(about["device"]))


def trace_layers(
    scene: Scene, camera: Camera, film: Film, time: float, direct: np.ndarray, indirect: np.ndarray
) -> Layers:
    """Return the layers of a view whose irradiances (H, W, 3) are known: albedo and emission take one ray a pixel."""
    pinhole = make_pinhole(camera, film.width, film.height, time, origin=scene.host.origin)
    gbuffer = trace_gbuffer(scene, film, pinhole, pinhole)
    hit = film.to_image(gbuffer.surface.active).astype(bool)
    return Layers(
        albedo=film.to_image(gbuffer.surface.albedo),
        emission=film.to_image(gbuffer.surface.emission + gbuffer.background),
        direct=direct.astype(np.float32),
        indirect=indirect.astype(np.float32),
        glossy=np.zeros((film.height, film.width, 3), np.float32),
        weight=hit.astype(np.float32),
        hit=hit,
    )


def _render(
    scene: Scene,
    camera: Camera,
    film: Film,
    half: int,
    seed: int,
    time: float,
    progress: Callable[[float], None] | None,
) -> Truth:
    start = clock.perf_counter()
    pinhole = make_pinhole(camera, film.width, film.height, time, origin=scene.host.origin)
    if scene.features.gloss:
        return _render_full(scene, pinhole, film, half, seed, progress)
    if scene.features.blended:
        return _render_layers(scene, pinhole, film, half, seed, progress)
    gbuffer = trace_gbuffer(scene, film, pinhole, pinhole)
    surface = gbuffer.surface
    dr.eval(surface, gbuffer.background)
    sample = dr.freeze(_sample)
    lane = dr.arange(mi.UInt32, film.lane_count)
    dr.make_opaque(lane)

    def zeros() -> tuple[mi.Color3f, mi.Color3f]:
        return dr.zeros(mi.Color3f, film.lane_count), dr.zeros(mi.Color3f, film.lane_count)

    sums = _sum_halves(lambda *step: sample(scene, surface, lane, *step), zeros, half, seed, progress)
    direct, indirect = ([np.array(part[layer]).T / half for part in sums] for layer in (0, 1))
    lanes = film.lanes_of_image()
    means = (0.5 * (direct[0] + direct[1]))[lanes], (0.5 * (indirect[0] + indirect[1]))[lanes]
    layers = trace_layers(scene, camera, film, time, *means)
    halves = [part[lanes].astype(np.float32) for part in indirect]
    direct_halves = [part[lanes].astype(np.float32) for part in direct]
    return Truth(layers, halves, direct_halves, 2 * half, clock.perf_counter() - start)


def _sum_halves(
    sample: Callable[[mi.UInt32, Any], Any],
    zeros: Callable[[], Any],
    half: int,
    seed: int,
    progress: Callable[[float], None] | None,
) -> list[Any]:
    """Return what `sample` (seed, sums so far -> sums) adds to `zeros` over `half` paths, twice, by seeds apart."""
    halves = []
    for part in range(2):
        sums = zeros()
        dr.make_opaque(sums)
        first = mi.UInt32((TRUTH_SEED + seed * 0x9E3779B1 + part * 0x7FEB352D) & 0xFFFFFFFF)
        for index in range(half):
            seed_now = dr.opaque(mi.UInt32, index) * 0x01000193 + first
            with collection_paused():
                sums = sample(seed_now, sums)
            dr.eval(sums)
            if progress is not None and index % 8 == 7:
                dr.sync_thread()
                progress((part * half + index + 1) / (2 * half))
        halves.append(sums)
    return halves


def _sum_views(
    sample: Callable[..., Any], kind: type, scene: Scene, pinhole: Pinhole, film: Film, half: int, seed: int,
    progress: Callable[[float], None] | None,
) -> list[Any]:  # fmt: skip
    """Return two records of `kind`: what `sample`, whose paths start at the camera, has added up over `half` paths."""
    frozen = dr.freeze(sample)
    lane = dr.arange(mi.UInt32, film.lane_count)
    dr.make_opaque(lane)
    return _sum_halves(
        lambda *step: frozen(scene, film, pinhole, lane, *step),
        lambda: dr.zeros(kind, film.lane_count),
        half,
        seed,
        progress,
    )


def _sample(
    scene: Scene, surface: Surface, lane: mi.UInt32, seed: mi.UInt32, sums: tuple[mi.Color3f, mi.Color3f]
) -> tuple[mi.Color3f, mi.Color3f]:
    direct = direct_irradiance(scene, surface, seed + 3, lane, surface.active)
    indirect = trace_indirect(scene, surface, seed, lane, surface.active)
    return sums[0] + direct, sums[1] + indirect


def _render_layers(
    scene: Scene, pinhole: Pinhole, film: Film, half: int, seed: int, progress: Callable[[float], None] | None
) -> Truth:
    """Render a scene with blended surfaces: each path starts at a layer of its own."""
    start = clock.perf_counter()
    sums = _sum_views(_sample_layer, _LayerSums, scene, pinhole, film, half, seed, progress)
    means = [{name: film.to_image(value) / half for name, value in vars(part).items()} for part in sums]
    both = {name: 0.5 * (value + means[1][name]) for name, value in means[0].items()}
    albedo = np.maximum(both["albedo"], 1e-4)
    layers = Layers(
        albedo=both["albedo"],
        emission=both["emission"],
        direct=both["direct"] / albedo,
        indirect=both["indirect"] / albedo,
        glossy=np.zeros_like(albedo),
        weight=both["weight"],
        hit=both["weight"] > 0.0,
    )
    halves = [(mean["indirect"] / albedo).astype(np.float32) for mean in means]
    direct_halves = [(mean["direct"] / albedo).astype(np.float32) for mean in means]
    return Truth(layers, halves, direct_halves, 2 * half, clock.perf_counter() - start)


@dataclass
class _LayerSums:
    """Sums over layers; `direct` and `indirect` are reflected light: irradiance times the layer's own albedo."""

    albedo: mi.Color3f
    emission: mi.Color3f
    direct: mi.Color3f
    indirect: mi.Color3f
    weight: mi.Float


def _sample_layer(
    scene: Scene, film: Film, pinhole: Pinhole, lane: mi.UInt32, seed: mi.UInt32, sums: _LayerSums
) -> _LayerSums:
    scene = choose_layer(scene, seed)
    gbuffer = trace_gbuffer(scene, film, pinhole, pinhole)
    surface = gbuffer.surface
    nothing = mi.Color3f(0.0)
    direct, indirect = _sample(scene, surface, lane, seed, (nothing, nothing))
    return _LayerSums(
        sums.albedo + surface.albedo,
        sums.emission + surface.emission + gbuffer.background,
        sums.direct + surface.albedo * direct,
        sums.indirect + surface.albedo * indirect,
        sums.weight + dr.select(surface.active, mi.Float(1.0), 0.0),
    )


def _render_full(
    scene: Scene, pinhole: Pinhole, film: Film, half: int, seed: int, progress: Callable[[float], None] | None
) -> Truth:
    """Render a scene with all that its materials do."""
    start = clock.perf_counter()
    sums = _sum_views(_sample_full, _FullSums, scene, pinhole, film, half, seed, progress)
    seen = [part.seen.times(1.0 / half) for part in sums]
    both = (seen[0] + seen[1]).times(0.5)
    weight = film.to_image(sums[0].weight + sums[1].weight) / (2 * half)
    planes = {name: film.to_image(value) for name, value in separate(both).items()}
    layers = Layers(**planes, weight=weight, hit=weight > 0.0)
    # The halves' own radiance, by the albedo of both: what the noise of a mean is told from.
    halves, direct_halves = (
        [film.to_image(separate(replace(both, **{name: getattr(part, name)}))[name]) for part in seen]
        for name in ("indirect", "direct")
    )
    images = [film.to_image(part.emission + part.direct + part.indirect + part.glossy) for part in seen]
    return Truth(
        layers, halves, direct_halves, 2 * half, clock.perf_counter() - start,
        image_halves=[image.astype(np.float32) for image in images],
    )  # fmt: skip


@dataclass
class _FullSums:
    seen: PathLight
    weight: mi.Float


def _sample_full(
    scene: Scene, film: Film, pinhole: Pinhole, lane: mi.UInt32, seed: mi.UInt32, sums: _FullSums
) -> _FullSums:
    scene = choose_layer(scene, seed)
    gbuffer = trace_gbuffer(scene, film, pinhole, pinhole)
    covered = dr.select(gbuffer.surface.active, mi.Float(1.0), 0.0)
    return _FullSums(sums.seen + trace_full(scene, gbuffer, seed), sums.weight + covered)


def _write(path: Path, truth: Truth) -> None:
    """Keep a truth for the next time; a cache that cannot be written is no reason to fail."""
    layers = {f"layer_{name}": value for name, value in vars(truth.layers).items() if value is not None}
    if truth.image_halves is not None:
        layers["image_halves"] = np.array(truth.image_halves)
    arrays = {
        "halves": np.array(truth.halves), "direct_halves": np.array(truth.direct_halves),
        "spp": truth.spp, "seconds": truth.seconds, "device": truth.device, **layers,
    }  # fmt: skip
    with contextlib.suppress(LuxelError):
        write_npz(path, arrays)


def _read(path: Path) -> Truth | None:
    """Return a cached truth; None where the file is damaged, so that it is made again."""
    try:
        with path.open("rb") as stream, np.load(stream) as file:
            layers = Layers(**{name[6:]: file[name] for name in file.files if name.startswith("layer_")})
            return Truth(
                layers, list(file["halves"]), list(file["direct_halves"]),
                int(file["spp"]), float(file["seconds"]), str(file["device"]),
                list(file["image_halves"]) if "image_halves" in file.files else None,
            )  # fmt: skip
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile):
        return None
