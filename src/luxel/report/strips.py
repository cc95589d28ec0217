"""The strips of a flight as the page embeds them: small, and all of a scene within two megabytes."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import Any

from luxel.report.results import MOTION_END, SceneResults

STRIP_BUDGET = 2_000_000
"""Bytes of all strips of a scene together, as they stand in the page."""
STRIP_QUALITIES = (88, 75, 60, 40, 20)
"""Of WebP: the first that keeps a scene within the budget."""


def read_strips(folder: Path, scene: SceneResults, budget: int = STRIP_BUDGET) -> tuple[dict[str, str], list[str]]:
    """Return the strips of a scene by the stem of their entry's files, as data addresses, and the missing files.

    Baselines have none. Nothing is missing where there was no flight, or where the truth is kept as sums alone.
    """
    if not scene.motion:
        return {}, []
    stems = [entry.file for entry in (*scene.pick("method"), *scene.motion_peers)]
    stems = ["truth", *stems] if scene.motion.get("kept") != "sums" else stems
    pictures, missing = {}, []
    for stem in stems:
        name = f"{scene.folder}/{stem}{MOTION_END}.png"
        picture = _read(folder / name)
        if picture is None:
            missing.append(name)
        else:
            pictures[stem] = picture
    return _encode(pictures, budget), missing


def _encode(pictures: dict[str, Any], budget: int) -> dict[str, str]:
    """Return the pictures as data addresses within `budget` bytes: of less quality, and halved if that is too much."""
    strips: dict[str, str] = {}
    while True:
        for quality in STRIP_QUALITIES:
            strips = {stem: to_address(picture, quality) for stem, picture in pictures.items()}
            if sum(map(len, strips.values())) <= budget:
                return strips
        if all(min(picture.size) <= 1 for picture in pictures.values()):
            return {}
        pictures = {stem: picture.reduce(2) for stem, picture in pictures.items()}


def _read(path: Path) -> Any:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as picture:
            return picture.convert("RGB")
    except (FileNotFoundError, UnidentifiedImageError, OSError, SyntaxError, ValueError):
        return None


def to_address(picture: Any, quality: int) -> str:
    """Return a Pillow image as a data address."""
    stream = io.BytesIO()
    picture.save(stream, "WEBP", quality=quality, method=4)
    return f"data:image/webp;base64,{to_text(stream.getvalue())}"


def to_text(data: bytes) -> str:
    """Return bytes as base64 text."""
    return base64.b64encode(data).decode("ascii")
