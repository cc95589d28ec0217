"""Rooms with many lamps and many glowing triangles: noise of direct light, and the frame beside that of eight lamps.

python benchmarks/many_lights.py [FILE ...] [--size 640x360] [--spp 2048] [--method gibs]

Without files: a pillared room with 100 and 1,024 lamps (with and without a range of 4 m) and with 10,000 glowing
triangles. `1` and `64`: relative RMS of direct light after so many frames, over its mean, judged by a converged sum
(lamps: eight at a time with a ray each, free of noise; triangles: `--spp` frames).
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Iterator
from dataclasses import replace
from datetime import date

import numpy as np

import luxel
from luxel import runtime
from luxel.scene.library.shapes import box
from luxel.scene.lights import DELTA_EACH_LIMIT
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData

HALF, HEIGHT = 12.0, 6.0
GLOWS = 6
"""Materials that glow, each with a radiance of its own."""
WARM_UP, TIMED = 48, 96


def make_room(cubes: int, lamps: int, reach: float = float("inf")) -> SceneData:
    """Return a room of 24 x 6 x 24 m with nine pillars, `cubes` little cubes that glow and `lamps` lamps."""
    rng = np.random.default_rng(5)
    meshes = [box((-HALF, 0.0, -HALF), (HALF, HEIGHT, HALF), 0, inward=True)]
    meshes += [
        box((x - 0.5, 0.0, z - 0.5), (x + 0.5, 4.0, z + 0.5), 0) for x in (-7.0, 0.0, 7.0) for z in (-7.0, 0.0, 7.0)
    ]
    materials = [Material("wall", base_color=(0.7, 0.7, 0.7))]
    for index in range(GLOWS):
        red, green, blue = rng.uniform(2.0, 40.0, 3).tolist()
        materials.append(Material(f"glow-{index}", base_color=(0.0, 0.0, 0.0), emission=(red, green, blue)))
    glowing: list[list[Mesh]] = [[] for _ in range(GLOWS)]
    low, high = np.array([1.0 - HALF, 0.5, 1.0 - HALF]), np.array([HALF - 1.0, HEIGHT - 0.3, HALF - 1.0])
    for index in range(cubes):
        middle, half, kind = rng.uniform(low, high), rng.uniform(0.02, 0.06), index % GLOWS
        glowing[kind].append(box(tuple(middle - half), tuple(middle + half), 1 + kind))
    meshes += [join(parts, 1 + kind) for kind, parts in enumerate(glowing) if parts]
    lights = [
        Light("point", (9.0, 8.0, 7.0), tuple(rng.uniform(low, high).tolist()), range=reach) for _ in range(lamps)
    ]
    camera = Camera((-10.5, 2.5, 10.5), (0.0, 2.0, 0.0), fov=70.0)
    return SceneData(f"room-{cubes}-{lamps}", [Object("all", meshes)], materials, lights=lights, cameras=[camera])


def join(parts: list[Mesh], material: int) -> Mesh:
    """Return meshes as one."""
    starts = np.cumsum([0, *(len(part.positions) for part in parts)])[:-1]
    faces = [part.faces + start for part, start in zip(parts, starts, strict=True)]
    return Mesh(np.concatenate([part.positions for part in parts]), np.concatenate(faces).astype(np.uint32), material)


def direct_of(data: SceneData, size: tuple[int, int], frames: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return direct irradiance (H, W, 3) after `frames` still frames, and what was hit (H, W)."""
    renderer = luxel.Renderer(data, "none", size=size, seed=seed)
    renderer.run(frames)
    layers = renderer.layers()
    return layers.direct.astype(np.float64), layers.hit


def sum_lamps(data: SceneData, size: tuple[int, int]) -> np.ndarray:
    """Return the direct irradiance of all lamps, eight at a time with a shadow ray each: free of noise."""
    total = np.zeros((size[1], size[0], 3))
    for first in range(0, len(data.lights), DELTA_EACH_LIMIT):
        some = replace(data, lights=data.lights[first : first + DELTA_EACH_LIMIT])
        total += direct_of(some, size, 1, 0)[0]
    return total


def relative_rms(found: np.ndarray, truth: np.ndarray, hit: np.ndarray) -> float:
    """Return the error over the truth's mean, on what was hit."""
    return float(np.sqrt(((found - truth)[hit] ** 2).mean()) / truth[hit].mean())


def time_frames(data: SceneData, method: str, size: tuple[int, int]) -> float:
    """Return the median frame after warm-up, milliseconds."""
    renderer = luxel.Renderer(data, method, size=size)
    renderer.run(WARM_UP)
    return statistics.median(renderer.run(TIMED))


def own_rooms() -> Iterator[tuple[str, SceneData]]:
    """Yield what is measured without files."""
    for lamps in (100, 1024):
        for reach in (4.0, float("inf")):
            ending = f", range {reach:g} m" if reach < 1e9 else ""
            yield f"{lamps:,} lamps{ending}", make_room(0, lamps, reach)
    yield "9,996 glowing triangles", make_room(833, 0)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*")
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--spp", type=int, default=2048)
    parser.add_argument("--method", default="gibs")
    given = parser.parse_args()
    device = runtime.start("auto")
    width, height = (int(part) for part in given.size.split("x"))
    size = (width, height)
    print(f"{device.name}, {date.today()}, {given.size}, frames of `{given.method}`\n")
    print("| scene | 1 frame | 64 frames | ms | ms of 8 lamps | ratio |\n| --- | --- | --- | --- | --- | --- |")
    scenes = ((file, luxel.load(file)) for file in given.files) if given.files else own_rooms()
    for name, data in scenes:
        eight = replace(data, lights=data.lights[:DELTA_EACH_LIMIT]) if data.lights else make_room(0, DELTA_EACH_LIMIT)
        one, hit = direct_of(data, size, 1, 3)
        many, _ = direct_of(data, size, 64, 3)
        truth = sum_lamps(data, size) if data.lights else direct_of(data, size, given.spp, 11)[0]
        before, ms = time_frames(eight, given.method, size), time_frames(data, given.method, size)
        errors = f"{relative_rms(one, truth, hit):.3f} | {relative_rms(many, truth, hit):.4f}"
        print(f"| {name} | {errors} | {ms:.2f} | {before:.2f} | {ms / before:.2f} |", flush=True)


if __name__ == "__main__":
    main()
