"""Two speeds of a method, staged and whole frame, beside the floor measured in the same run."""

from __future__ import annotations

import datetime
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from luxel.bench.machine import machine_name, machine_record
from luxel.errors import LuxelError
from luxel.files import to_json
from luxel.scene.model import SceneData

if TYPE_CHECKING:
    from luxel.render.renderer import Renderer
    from luxel.scene.host import Looks

STAGED_FRAMES = 9
RESULTS = Path("benchmarks") / "results"
"""Where `record` appends, below the current folder."""


def bench(
    method: str = "gibs",
    scene: str | Path | SceneData = "cornell-box",
    *,
    size: tuple[int, int] = (512, 512),
    frames: int = 64,
    seed: int = 0,
    materials: str = "diffuse",
    preset: str | None = None,
    params: dict[str, Any] | None = None,
    flight: bool = False,
    device: str = "auto",
    progress: Callable[[str, float], None] | None = None,
) -> dict[str, Any]:
    """Warm up, then time `frames` whole frames, the stages and the floor; return the figures and the machine.

    `frame_ms` holds median, min and max of the whole frame, as a user gets it; `stages` the median milliseconds of
    each stage, evaluated one by one; `kernels_ms` their sum; `pipelined_ms` the mean of frames that nothing waits for,
    and `python_overhead_ms` what the median frame takes beyond the kernels; `covered_share` the share of pixels with
    weight 1 or more when the timing began; `floor_ms` the bare ray casts and memory traffic of such a frame; `ratio`
    the median over the floor; `method_rays_ms` the bare casts of the method's own rays
    alone. `rays_per_frame` and `rays_per_second`, which leaves short ones out, are None where the method does not count
    its rays. `size` is (width, height). `warmup_ms` is what the warm-up frames took, compilation included; `warnings`
    is what scene and method have to say, a sentence each. Raises LuxelError for an unknown scene, method, preset,
    parameter or device, and for `materials` `full` with a method that does not show them.
    """
    from luxel import runtime
    from luxel.methods import find_method
    from luxel.scene.choice import check_materials, scene_label

    check_materials(materials)
    wanted = cast("Looks", materials)
    if find_method(method).shown_materials(wanted) != wanted:
        raise LuxelError(f"frames of '{method}' are lit with diffuse materials: time them with --materials diffuse")
    if frames < 1:
        raise LuxelError(f"a benchmark of {frames} frames times nothing; ask for 1 or more")
    tell = progress or (lambda text, share: None)
    chosen = runtime.start(device)

    from luxel.render.animate import cover_view
    from luxel.render.flight import fly_through
    from luxel.render.floor import count_rays, measure_floor, measure_method_rays
    from luxel.render.renderer import WARM_UP_FRAMES, Renderer

    if isinstance(scene, str | Path):
        from luxel.render.loading import load

        label, data = scene_label(scene), load(scene)
    else:
        label, data = scene.name, scene
    renderer = Renderer(
        data, method=method, params=params, preset=preset, size=size, seed=seed, progress=tell, materials=wanted
    )
    if flight:
        fly_through(renderer)
    tell("warm-up", 0.0)
    warmup = renderer.run(WARM_UP_FRAMES)
    covered = cover_view(renderer)
    compiled = renderer.compilations
    tell("frames", 0.1)
    times = renderer.run(frames, progress=lambda done: tell("frames", 0.1 + 0.6 * done / frames))
    compiled = renderer.compilations - compiled
    pipelined_ms = time_pipelined(renderer, frames)
    tell("stages", 0.7)
    stages = renderer.staged(STAGED_FRAMES)
    tell("floor", 0.8)
    floor_ms = measure_floor(renderer)
    method_rays_ms = measure_method_rays(renderer)
    rays = count_rays(renderer)
    whole = sum(count for kind, count in (rays or {}).items() if kind != "short")
    untrue = data.diffuse_warnings if materials == "full" else []
    said = [sentence for sentence in data.warnings if sentence not in untrue]
    median = statistics.median(times)
    result = {
        "method": renderer.method.name,
        "preset": preset,
        "params": {key: str(value) for key, value in (params or {}).items()},
        "scene": label,
        "size": list(size),
        "frames": frames,
        "seed": seed,
        "materials": materials,
        "flight": flight,
        "device": chosen.name,
        "warmup_ms": sum(warmup),
        "frame_ms": {"median": median, "min": min(times), "max": max(times)},
        "pipelined_ms": pipelined_ms,
        "stages": stages,
        "kernels_ms": sum(stages.values()),
        "python_overhead_ms": median - sum(stages.values()),
        "covered_share": covered,
        "floor_ms": floor_ms,
        "method_rays_ms": method_rays_ms,
        "ratio": median / floor_ms if floor_ms else None,
        "rays_per_frame": rays,
        "rays_per_second": 1e3 * whole / median if rays and median > 0.0 else None,
        "cache": renderer.cache(),
        "compilations_after_warmup": compiled,
        "gpu_memory_mb" if chosen.name == "cuda" else "memory_mb": runtime.memory_mb(),
        "warnings": [*said, *renderer.method.warnings(renderer.state)],
        "machine": machine_record(),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }
    tell("done", 1.0)
    return result


def time_pipelined(renderer: Renderer, frames: int) -> float:
    """Return milliseconds a frame of `frames` frames that run without waiting for one another."""
    import drjit as dr

    dr.sync_thread()
    start = time.perf_counter()
    for _ in range(frames):
        renderer.step()
    dr.sync_thread()
    return 1e3 * (time.perf_counter() - start) / frames


def record(result: dict[str, Any], folder: Path = RESULTS) -> Path:
    """Append `result` as one line to `folder`/<machine>.jsonl and return that file.

    Raises LuxelError where it cannot be written.
    """
    path = folder / f"{machine_name(result['machine'])}.jsonl"
    line = to_json(result) + "\n"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as stream:
            stream.write(line)
    except OSError as error:
        raise LuxelError(f"cannot append to {path}: {error.strerror or error}") from error
    return path
