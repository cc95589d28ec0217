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

from luxel.files import write_bytes
from luxel.image.layers import Layers
from luxel.kernels.camera import camera_axes
from luxel.scene.device import Scene
from luxel.scene.digest import hash_camera, hash_numbers, hash_scene
from luxel.scene.host import Looks
from luxel.scene.local import local_camera
from luxel.scene.model import Camera

BLOCK = 16
KEY = "luxel"


def references_folder() -> Path | None:
    """Return where committed truths are: $LUXEL_REFERENCES, else `benchmarks/references` of a source checkout."""
    chosen = os.environ.get("LUXEL_REFERENCES")
    folder = Path(chosen) if chosen else Path(__file__).parents[3] / "benchmarks" / "references"
    return folder if folder.is_dir() else None


def view_key(scene: Scene, camera: Camera, size: tuple[int, int], time: float, materials: Looks = "diffuse") -> str:
    """Return 64 hexadecimal digits that tell a view of a scene at `time`, live edits included.

    They are made of the scene as data, not of what the device makes of it: the same on every machine. `materials` is
    what counts of the scene's (`scene.choice.MATERIALS`).
    """
    scale = float(np.array(scene.lights.scale)[0])
    parts = [
        hash_scene(scene.host.data, time, materials),
        hash_camera(camera, camera_axes(local_camera(camera, scene.host.origin), time)),
        hash_numbers(*size),
        hash_numbers(scale),
    ]
    if materials != "diffuse":  # the only ones there were once: files of that time keep their names
        parts.append(materials)
    return hashlib.sha256("".join(parts).encode()).hexdigest()


def reference_key(
    scene: Scene, camera: Camera, size: tuple[int, int], time: float, materials: Looks = "diffuse"
) -> str:
    """Return what a committed truth of this view is called by."""
    return view_key(scene, camera, size, time, materials)[:16]


def write_reference(path: Path, layers: Layers, halves: list[np.ndarray], about: dict[str, object]) -> None:
    """Write a truth to `path` (NAME-KEY.exr): six float16 channels and `about` as metadata."""
    difference = block_means(halves[0] - halves[1], layers.albedo).astype(np.float16)
    about = {
        **about,
        "blocks": list(difference.shape),
        "halves_differ_by": base64.b64encode(difference.tobytes()).decode(),
    }
    pixels = np.concatenate([layers.direct, layers.indirect], axis=2).astype(np.float16)
    names = [f"{layer}.{channel}" for layer in ("direct", "indirect") for channel in "RGB"]
    bitmap = mi.Bitmap(pixels, mi.Bitmap.PixelFormat.MultiChannel, names)
    bitmap.metadata()[KEY] = json.dumps(about)
    stream = mi.MemoryStream()
    bitmap.write(stream, mi.Bitmap.FileFormat.OpenEXR)
    write_bytes(path, stream.raw_buffer())


Found = tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, object]]
"""Direct and indirect irradiance, what the halves of the truth differ by, each (H, W, 3), and what made it."""


def find_reference(key: str, spp: int) -> Found | None:
    """Return the committed truth that is called by `key`, if it has at least `spp` paths a pixel."""
    folder = references_folder()
    for path in sorted(folder.glob(f"*-{key}.exr")) if folder else []:
        found = read_reference(path)
        if found is not None and int(str(found[3]["spp"])) >= spp:
            return found
    return None


def read_reference(path: Path) -> Found | None:
    """Return what `write_reference` wrote; None where the file is damaged, so that the truth is made anew."""
    try:
        bitmap = mi.Bitmap(str(path))
        about = json.loads(str(bitmap.metadata()[KEY]))
        pixels = np.array(bitmap).astype(np.float32)
        names = [field.name for field in bitmap.struct_()]
        direct, indirect = (
            pixels[..., [names.index(f"{layer}.{channel}") for channel in "RGB"]] for layer in ("direct", "indirect")
        )
        blocks = np.frombuffer(base64.b64decode(about["halves_differ_by"]), np.float16).reshape(about["blocks"])
    except (RuntimeError, KeyError, ValueError):
        return None
    spread = blocks.astype(np.float32).repeat(BLOCK, axis=0).repeat(BLOCK, axis=1)
    return direct, indirect, spread[: direct.shape[0], : direct.shape[1]], about


def block_means(values: np.ndarray, albedo: np.ndarray) -> np.ndarray:
    """Return albedo-weighted means of (H, W, 3) `values` over 16 x 16 blocks; partial blocks count as blocks."""
    height, width = values.shape[:2]
    pad = ((0, -height % BLOCK), (0, -width % BLOCK), (0, 0))
    weight = np.where(albedo > 0.02, albedo, 0.0)
    tall, wide = -(-height // BLOCK), -(-width // BLOCK)

    def total(array: np.ndarray) -> np.ndarray:
        return np.pad(array, pad).reshape(tall, BLOCK, wide, BLOCK, 3).sum(axis=(1, 3))

    return total(values * weight) / np.maximum(total(weight), 1e-9)
