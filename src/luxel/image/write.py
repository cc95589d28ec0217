"""Pictures to files: PNG of what is displayed, EXR of linear light."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from luxel.files import write_bytes


def write_png(path: str | Path, display: np.ndarray) -> None:
    """Write a displayed image, (H, W, 3) float in 0..1, as 8-bit PNG; LuxelError where it cannot be written."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(to_bytes(display)).save(stream, format="PNG")
    write_bytes(path, stream.getvalue())


def write_exr(path: str | Path, linear: np.ndarray) -> None:
    """Write a linear image, (H, W, 3), as 32-bit float EXR; LuxelError where it cannot be written."""
    # Bitmap works before a device is started, but Dr.Jit loads LLVM with this import: see `luxel.runtime`.
    from luxel.runtime import use_llvm

    use_llvm()
    import mitsuba as mi

    stream = mi.MemoryStream()
    mi.Bitmap(np.ascontiguousarray(linear, np.float32)).write(stream, mi.Bitmap.FileFormat.OpenEXR)
    write_bytes(path, stream.raw_buffer())


def to_bytes(display: np.ndarray) -> np.ndarray:
    """Return a displayed image, floats in 0..1, as uint8."""
    return np.rint(np.clip(display, 0.0, 1.0) * 255.0).astype(np.uint8)
