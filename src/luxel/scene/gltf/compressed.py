"""Compressed geometry: Draco meshes and meshopt buffer views, by the extra `compressed`.

What a file declares is held against what it stores before anything is decoded, so that damage ends in one sentence.
"""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any

import numpy as np

from luxel.scene.gltf.document import Document

DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("KHR_meshopt_compression", "EXT_meshopt_compression")
BASIS = "KHR_texture_basisu"
ADVICE = "install it with: pip install 'luxel[compressed]'"

MODES = ("ATTRIBUTES", "TRIANGLES", "INDICES")
# The row sizes in bytes that each filter can undo.
FILTER_STRIDES: dict[str | None, tuple[int, ...]] = {
    None: tuple(range(4, 257, 4)),
    "NONE": tuple(range(4, 257, 4)),
    "OCTAHEDRAL": (4, 8),
    "QUATERNION": (8,),
    "EXPONENTIAL": tuple(range(4, 257, 4)),
    "COLOR": (4, 8),
}
INDEX_STRIDES = (2, 4)
MOST_EXPANSION = 1024
"""No meshopt stream grows by more (two bits stand for at most 4 bytes of 256 rows), so that no lie fills the memory."""
SMALLEST_CLAIM = 1 << 16


def find_decoder(module: str) -> ModuleType | None:
    """Return the decoder `module`, or None where the extra is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError:
        return None


def meshopt_of(extensions: dict[str, Any]) -> dict[str, Any] | None:
    """Return the meshopt part of a buffer view's extensions, or None."""
    return next((extensions[name] for name in MESHOPT if name in extensions), None)


def decode_meshopt(document: Document, part: dict[str, Any], data: bytes, byte_length: int, label: str) -> bytes:
    """Return the plain bytes of the buffer view `label`, whose compressed `data` the extension `part` describes.

    Raises `LuxelError` where the sizes contradict one another, the data is damaged, or the decoder is missing.
    """
    count, stride, mode, filtered = (part.get(key) for key in ("count", "byteStride", "mode", "filter"))
    if mode not in MODES or filtered not in FILTER_STRIDES:
        document.fail(f"{label} is compressed in the unknown mode {mode} with filter {filtered}")
    strides = FILTER_STRIDES[filtered] if mode == "ATTRIBUTES" else INDEX_STRIDES
    sound = isinstance(count, int) and count >= 0 and stride in strides and (mode != "TRIANGLES" or count % 3 == 0)
    if not sound or count is None or stride is None:
        document.fail(f"{label} declares {count} compressed rows of {stride} bytes, which {mode} cannot hold")
    if count * stride != byte_length:
        document.fail(f"{label} holds {count * stride} bytes unpacked but declares {byte_length}")
    if byte_length > max(SMALLEST_CLAIM, MOST_EXPANSION * len(data)):
        document.fail(f"{label} declares {byte_length} bytes, more than its {len(data)} compressed bytes can hold")
    if count == 0:
        return b""
    decoder = find_decoder("meshopt")
    if decoder is None:
        document.fail(f"{label} is compressed with meshopt, whose decoder is missing; {ADVICE}")
    try:
        found = decoder.decode_gltf_buffer(data, count, stride, mode, filtered)
    except Exception as error:  # the decoder's own types, by its version
        document.fail(f"the compressed data of {label} is damaged ({' '.join(str(error).split())})", error)
    return found.tobytes()


def decode_draco(document: Document, data: bytes, label: str) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """Return the (F, 3) faces of a Draco mesh, and its attributes, (V, C) each, by their unique ids.

    Raises `LuxelError` where the data is damaged or no mesh, or the decoder is missing.
    """
    decoder = find_decoder("DracoPy")
    if decoder is None:
        document.fail(f"{label} is compressed with Draco, whose decoder is missing; {ADVICE}")
    try:
        mesh = decoder.decode(data)
        attributes = {int(one["unique_id"]): np.asarray(one["data"]) for one in mesh.attributes}
        faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # the decoder's own types, by its version
        document.fail(f"the Draco data of {label} is damaged or no mesh ({' '.join(str(error).split())})", error)
    return faces, {key: values.reshape(len(values), -1) for key, values in attributes.items()}


def decode_basis(data: bytes) -> np.ndarray:
    """Return the largest picture of a KTX2 file with Basis Universal texels, (H, W, 3 or 4) uint8.

    Raises `ValueError` where the decoder is missing or the data damaged.
    """
    decoder = find_decoder("opengl_basisu")
    if decoder is None:
        raise ValueError(f"its KTX2 decoder is missing; {ADVICE}")
    texture = decoder.open(data)
    pixels = np.asarray(texture.transcode("rgba8").data)
    return pixels if texture.has_alpha else np.ascontiguousarray(pixels[:, :, :3])
