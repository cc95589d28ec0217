"""Sequences of frames as files: numbered images in a folder, an animated GIF, an MP4."""

from __future__ import annotations

import importlib
import io
import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from luxel.errors import LuxelError
from luxel.files import replacing, require_writable, write_bytes
from luxel.image.write import to_bytes, write_png
from luxel.scene.rules import is_number, show

VIDEO_SUFFIXES = (".gif", ".mp4")
GIF_SHORTEST, GIF_LONGEST = 2, 65535
"""Hundredths of a second that a frame of a GIF can stand: players slow down below, and the file ends above."""
GIF_FPS = 100.0 / GIF_SHORTEST


def is_sequence(path: str | Path) -> bool:
    """Return whether `path` asks for a sequence: a folder (ends in `/`, or has no suffix), `.gif` or `.mp4`."""
    text, path = str(path), Path(path)
    return text.endswith(("/", "\\")) or path.is_dir() or path.suffix.lower() in ("", *VIDEO_SUFFIXES)


@contextmanager
def open_sequence(path: str | Path, fps: float = 30.0) -> Iterator[Callable[[np.ndarray], None]]:
    """Yield a function that takes one displayed image, (H, W, 3) in 0..1, a call.

    A folder gets `frame_0000.png` onwards, each as it comes; `.gif` and `.mp4` appear whole when the block ends well.
    A GIF leaves frames out above 50 a second, and lasts as long as the scene all the same.
    Raises LuxelError where the place cannot be written or the extra for MP4 is missing, before the first image.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if not (is_number(fps) and fps > 0.0):
        raise LuxelError(f"cannot write {path}: {show(fps)} is no rate; give frames a second above 0")
    if suffix == ".gif":
        if 100.0 / fps > GIF_LONGEST:
            raise LuxelError(f"cannot write {path}: a GIF holds no {fps:g} frames a second; choose a higher --fps")
        require_writable(path)
        frames: list[np.ndarray] = []
        yield lambda display: frames.append(to_bytes(display))
        write_bytes(path, _encode_gif(frames, fps))
    elif suffix == ".mp4":
        with _open_mp4(path, fps) as add:
            yield add
    else:
        require_writable(path / "frame_0000.png")
        numbers = itertools.count()
        yield lambda display: write_png(path / f"frame_{next(numbers):04d}.png", display)


@contextmanager
def _open_mp4(path: Path, fps: float) -> Iterator[Callable[[np.ndarray], None]]:
    try:
        imageio = importlib.import_module("imageio")
        # imageio finds its encoder through this one, but would say so only at the first frame.
        importlib.import_module("imageio_ffmpeg")
    except ImportError as error:
        raise LuxelError(
            f"cannot write {path}: MP4 needs an extra; run `pip install luxel[video]`, or write a .gif or a folder"
        ) from error
    with replacing(path) as beside:
        writer = imageio.get_writer(beside, format="FFMPEG", fps=fps, macro_block_size=1)
        with writer:
            yield lambda display: writer.append_data(_even(to_bytes(display)))


def _even(image: np.ndarray) -> np.ndarray:
    """Repeat the last row and column where needed: the codec halves the colour planes."""
    height, width, _ = image.shape
    return np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def _encode_gif(frames: list[np.ndarray], fps: float) -> bytes:
    from PIL import Image

    if not frames:
        raise LuxelError("a sequence needs at least one frame")
    chosen, hundredths = plan_gif(len(frames), fps)
    pictures = [Image.fromarray(frames[index]).quantize(256) for index in chosen]
    stream = io.BytesIO()
    durations = [10 * count for count in hundredths]
    pictures[0].save(stream, format="GIF", save_all=True, append_images=pictures[1:], duration=durations, loop=0)
    return stream.getvalue()


def plan_gif(count: int, fps: float) -> tuple[list[int], list[int]]:
    """Return which of `count` frames a GIF shows, and each one's hundredths of a second.

    GIF counts in whole hundredths, so what a frame's share is cut by is carried on to the next; players slow down
    below two of them, so at more than 50 frames a second some are left out.
    """
    shown = count if fps <= GIF_FPS else max(1, int(count / fps * GIF_FPS + 1e-6))
    rate = min(fps, GIF_FPS)
    chosen = [min(int(slot * fps / rate), count - 1) for slot in range(shown)]
    starts = [int(100.0 * slot / rate + 0.5) for slot in range(shown)]
    end = max(int(100.0 * count / fps + 0.5), starts[-1] + GIF_SHORTEST)
    return chosen, np.diff([*starts, end]).tolist()
