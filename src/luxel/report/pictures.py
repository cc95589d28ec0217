"""The pictures of a report: read from the comparison's folder, coded to fit one page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from luxel.image.tonemap import to_display
from luxel.image.write import to_bytes
from luxel.report.codec import FINEST_STEP, EncodedPicture, encode, encode_within, transform
from luxel.report.results import Results, SceneResults, as_number
from luxel.report.strips import read_strips, to_address

BUDGET = 18_000_000
"""Bytes of all pictures together, before they are written as text (base64: a third more): a page below 25 MB."""
THUMB_WIDTH = 176
THUMB_QUALITY = 82
FLIP_QUALITY = 84
LEAST_BYTES = 0.25
"""Bytes a pixel below which rounding would show: pictures are halved instead, all of a scene alike."""
LAYERS = {"image": "", "indirect": "_indirect"}
"""What of each entry is embedded, and how its file's stem ends."""


@dataclass
class ScenePictures:
    """The pictures of one scene."""

    coded: dict[str, EncodedPicture] = field(default_factory=dict)
    """By `<entry's number>-<layer>`, where entry 0 is the truth and the others follow as in the tables."""
    flips: dict[str, str] = field(default_factory=dict)
    """FLIP maps by the entry's number, data addresses."""
    thumbs: dict[str, str] = field(default_factory=dict)
    """Small pictures by the entry's number, data addresses."""
    strips: dict[str, str] = field(default_factory=dict)
    """Pictures of a flight side by side, by the stem of the entry's files, data addresses."""
    missing: list[str] = field(default_factory=list)
    """Files that were not there or could not be read, relative to the comparison's folder."""
    sources: dict[str, tuple[Path, float]] = field(default_factory=dict)
    """Where each coded picture came from: file and exposure."""

    def addresses(self) -> list[str]:
        """Return every picture that is a data address."""
        return [*self.flips.values(), *self.thumbs.values(), *self.strips.values()]


def read_all_pictures(
    folder: Path, results: Results, budget: int = BUDGET, progress: Callable[[str, float], None] | None = None
) -> list[ScenePictures]:
    """Return the pictures of each scene, coded so that all of them together take at most `budget` bytes.

    Small pictures keep the finest step; those that must shrink are the large ones, that is the noisy ones, in which
    rounding shows least. Missing and damaged files are left out and named.
    """
    told = progress or (lambda text, share: None)
    count = sum(len(LAYERS) * len(entry_names(scene)) for scene in results.scenes)
    most_pixels = int(budget / LEAST_BYTES / count)
    all_pictures: list[ScenePictures] = []
    for number, scene in enumerate(results.scenes):
        told(f"{scene.name}: pictures", number / len(results.scenes))
        all_pictures.append(_read_scene(folder, scene, most_pixels))
    fixed = sum(len(text) * 3 // 4 for one in all_pictures for text in one.addresses())
    limit = share_out([len(coded.data) for one in all_pictures for coded in one.coded.values()], budget - fixed)
    for scene_pictures in all_pictures:
        for name, coded in scene_pictures.coded.items():
            # Few are too large, and read again: the coefficients of all of them would fill the memory.
            light = _read_light(*scene_pictures.sources[name], most_pixels) if len(coded.data) > limit else None
            if light is not None:
                told("fitting the pictures to the page", 1.0)
                scene_pictures.coded[name] = encode_within(transform(light), limit)
    return all_pictures


def share_out(sizes: Sequence[int], budget: int) -> int:
    """Return the largest size that each may have so that all together stay within `budget`."""
    left, waiting = budget, sorted(sizes)
    while waiting:
        share = max(left, 0) // len(waiting)
        if waiting[0] > share:
            return share
        left -= waiting.pop(0)
    return max(sizes, default=0)


def entry_names(scene: SceneResults) -> list[tuple[str, str]]:
    """Return (label, stem of the files) of all that has pictures: the truth first, then the entries."""
    return [("truth", "truth"), *((entry.label, entry.file) for entry in scene.entries)]


def _read_scene(folder: Path, scene: SceneResults, most_pixels: int) -> ScenePictures:
    scene_pictures, shape = ScenePictures(), None
    exposure = as_number(scene.reference.get("exposure")) or 1.0
    for number, (_, stem) in enumerate(entry_names(scene)):
        for layer, end in LAYERS.items():
            name = f"{scene.folder}/{stem}{end}.exr"
            light = _read_light(folder / name, exposure, most_pixels)
            if light is None or (shape is not None and light.shape != shape):
                scene_pictures.missing.append(name)
                continue
            shape = light.shape
            scene_pictures.coded[f"{number}-{layer}"] = encode(transform(light), FINEST_STEP)
            scene_pictures.sources[f"{number}-{layer}"] = (folder / name, exposure)
            if layer == "image":
                scene_pictures.thumbs[str(number)] = _make_thumb(light)
        if number > 0:
            _add_flip(scene_pictures, folder, f"{scene.folder}/{stem}_flip.png", str(number), most_pixels)
    scene_pictures.strips, missing = read_strips(folder, scene)
    scene_pictures.missing += missing
    return scene_pictures


def _read_light(path: Path, exposure: float, most_pixels: int) -> np.ndarray | None:
    """Return an image in units of display white, (H, W, 3) float32, small enough for a page; None where there is none.

    Mitsuba reads EXR too, but brings a compiler with it; a page must be drawn in a moment on any laptop.
    """
    import OpenEXR

    if not path.is_file():
        return None
    try:
        with OpenEXR.File(str(path)) as picture:
            channels = picture.channels()
            pixels: Any = channels["RGB"].pixels if "RGB" in channels else channels["RGBA"].pixels[..., :3]
            return _shrink(np.asarray(pixels, np.float32) * np.float32(exposure), most_pixels)
    except (RuntimeError, KeyError, ValueError, TypeError, OSError):
        return None


def _shrink(light: np.ndarray, most_pixels: int) -> np.ndarray:
    """Return the image averaged over 2x2 pixels until it has at most `most_pixels`."""
    while light.shape[0] * light.shape[1] > most_pixels and min(light.shape[:2]) > 1:
        height, width = light.shape[0] // 2 * 2, light.shape[1] // 2 * 2
        light = light[:height, :width].reshape(height // 2, 2, width // 2, 2, 3).mean(axis=(1, 3), dtype=np.float32)
    return light


def _make_thumb(light: np.ndarray) -> str:
    from PIL import Image

    picture = Image.fromarray(to_bytes(to_display(light)))
    if picture.width > THUMB_WIDTH:
        size = (THUMB_WIDTH, max(1, round(picture.height * THUMB_WIDTH / picture.width)))
        picture = picture.resize(size, Image.Resampling.LANCZOS)
    return to_address(picture, THUMB_QUALITY)


def _add_flip(scene_pictures: ScenePictures, folder: Path, name: str, number: str, most_pixels: int) -> None:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(folder / name) as picture:
            shown = picture.convert("RGB")
            while shown.width * shown.height > most_pixels and min(shown.size) > 1:
                shown = shown.reduce(2)
            scene_pictures.flips[number] = to_address(shown, FLIP_QUALITY)
    except (FileNotFoundError, UnidentifiedImageError, OSError, SyntaxError, ValueError):
        scene_pictures.missing.append(name)


def complain(all_pictures: Sequence[ScenePictures]) -> str:
    """Return one sentence on the pictures that are missing, or an empty text."""
    missing = [name for scene_pictures in all_pictures for name in scene_pictures.missing]
    if not missing:
        return ""
    shown = ", ".join(missing[:3]) + (f" and {len(missing) - 3} more" if len(missing) > 3 else "")
    verb = "picture is" if len(missing) == 1 else "pictures are"
    return f"{len(missing)} {verb} missing or damaged and left out: {shown}"
