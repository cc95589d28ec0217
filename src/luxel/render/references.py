"""Committed truths: path-traced images made once at many samples and kept as float16 EXR beside their metadata.

The file holds direct and indirect irradiance; albedo and emission are traced anew, since one ray a pixel gives them
exactly. What the two halves of the truth differ by is kept as block means, which is all that its noise figure needs.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
from pathlib import Path

import mitsuba as mi
import numpy as np

from luxel.kernels.camera import camera_axes
from luxel.render.layers import Layers
from luxel.scene.device import Scene
from luxel.scene.model import Camera

BLOCK = 16
KEY = "luxel"


def references_folder() -> Path | None:
    """Return where committed truths are: $LUXEL_REFERENCES, else `benchmarks/references` of a source checkout."""
    chosen = os.environ.get("LUXEL_REFERENCES")
    folder = Path(chosen) if chosen else Path(__file__).parents[3] / "benchmarks" / "references"
    return folder if folder.is_dir() else None


def reference_key(scene: Scene, camera: Camera, size: tuple[int, int], time: float) -> str:
    """Return a hash of what a scene and view look like, rounded so that it is the same on every machine."""
    host = scene.host
    data = host.data

    def rounded(*values: float) -> list[str]:
        return [f"{value + 0.0:.3f}" for value in values]

    facts = {
        "triangles": sum(group.prim_count for group in scene.groups),
        "bounds": rounded(*host.lower, *host.upper),
        "area": f"{host.area:.3g}",
        "vertices": rounded(*_moments(scene.geometry.vertices, 4), *_moments(scene.geometry.normals, 4)),
        "colors": rounded(*_moments(scene.geometry.colors, 4)),
        "materials": rounded(*np.array(scene.materials.factors).astype(float)),
        "flags": np.array(scene.materials.slots).reshape(-1, 8)[:, 4].tolist(),
        "textures": [np.array(scene.materials.textures).tolist(), _texel_means(scene)],
        "lights": [[light.kind, *rounded(*light.color, *light.direction, *light.position)] for light in data.lights],
        "sky": rounded(*data.sky.color, data.sky.rotation, *_moments(scene.lights.sky_image, 4)),
        "camera": rounded(*(value for axis in camera_axes(camera, time) for value in axis), camera.fov),
        "size": list(size),
        "time": f"{time:.3f}",
        "scale": f"{float(np.array(scene.lights.scale)[0]):.4g}",
    }
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:16]


def _moments(array: mi.Float, columns: int) -> list[float]:
    """Return mean and spread of each column: the same on every machine to three digits, another for another array."""
    rows = np.array(array, np.float64).reshape(-1, columns)
    return [*rows.mean(axis=0), *rows.std(axis=0)]


def _texel_means(scene: Scene) -> list[int]:
    """Return the mean byte of each image's first 64 kB of texels, rounded down to even values."""
    words = np.array(scene.materials.texels)
    starts = np.array(scene.materials.textures).reshape(-1, 4)[:, 0]
    return [int(words[start : start + 65536].view(np.uint8).mean()) // 2 for start in starts]


def write_reference(path: Path, key: str, layers: Layers, halves: list[np.ndarray], about: dict[str, object]) -> None:
    """Write a truth to `path` (.exr): six float16 channels and `about` as metadata."""
    difference = block_means(halves[0] - halves[1], layers.albedo).astype(np.float16)
    about = {
        **about,
        "key": key,
        "blocks": list(difference.shape),
        "halves_differ_by": base64.b64encode(difference.tobytes()).decode(),
    }
    pixels = np.concatenate([layers.direct, layers.indirect], axis=2).astype(np.float16)
    names = [f"{layer}.{channel}" for layer in ("direct", "indirect") for channel in "RGB"]
    bitmap = mi.Bitmap(pixels, mi.Bitmap.PixelFormat.MultiChannel, names)
    bitmap.metadata()[KEY] = json.dumps(about)
    beside = path.with_name(f".{path.name}")
    bitmap.write(str(beside), mi.Bitmap.FileFormat.OpenEXR)
    os.replace(beside, path)


def find_reference(key: str, spp: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, object]] | None:
    """Return (direct, indirect, half difference, about) of a committed truth with `key` and at least `spp` paths."""
    folder = references_folder()
    for path in sorted(folder.glob(f"*-{key}.exr")) if folder else []:
        try:
            bitmap = mi.Bitmap(str(path))
            about = json.loads(str(bitmap.metadata()[KEY]))
        except (RuntimeError, KeyError, ValueError):  # damaged: the truth is made anew
            continue
        if about["key"] != key or about["spp"] < spp:
            continue
        pixels = np.array(bitmap).astype(np.float32)
        names = [field.name for field in bitmap.struct_()]
        direct, indirect = (
            pixels[..., [names.index(f"{layer}.{channel}") for channel in "RGB"]] for layer in ("direct", "indirect")
        )
        blocks = np.frombuffer(base64.b64decode(about["halves_differ_by"]), np.float16).reshape(about["blocks"])
        spread = blocks.astype(np.float32).repeat(BLOCK, axis=0).repeat(BLOCK, axis=1)
        return direct, indirect, spread[: direct.shape[0], : direct.shape[1]], about
    return None


def block_means(values: np.ndarray, albedo: np.ndarray) -> np.ndarray:
    """Return albedo-weighted means of (H, W, 3) `values` over 16 x 16 blocks; partial blocks count as blocks."""
    height, width = values.shape[:2]
    pad = ((0, -height % BLOCK), (0, -width % BLOCK), (0, 0))
    weight = np.where(albedo > 0.02, albedo, 0.0)
    tall, wide = -(-height // BLOCK), -(-width // BLOCK)

    def total(array: np.ndarray) -> np.ndarray:
        return np.pad(array, pad).reshape(tall, BLOCK, wide, BLOCK, 3).sum(axis=(1, 3))

    return total(values * weight) / np.maximum(total(weight), 1e-9)
