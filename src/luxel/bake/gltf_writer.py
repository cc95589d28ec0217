"""The bytes of a .glb: buffers, accessors, pictures, nodes. What they mean is up to `gltf.py`."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pygltflib as gltf

from luxel import __version__
from luxel.image.write import to_bytes

VECTORS = {1: gltf.SCALAR, 2: gltf.VEC2, 3: gltf.VEC3, 4: gltf.VEC4}
PNG_EFFORT = 4
"""Of 9: twice as fast as the usual 6, for files a few per cent larger."""


class Writer:
    """Collects a file's parts, then gives its bytes."""

    def __init__(self) -> None:
        self.file = gltf.GLTF2(scene=0, scenes=[gltf.Scene(nodes=[])])
        self.data = bytearray()
        self.extensions: set[str] = set()
        self._samplers: dict[tuple[int, ...], int] = {}

    def array(self, values: np.ndarray, target: int = gltf.ARRAY_BUFFER, bounds: bool = False) -> int:
        """Add an array (N, 1 to 4), uint32 or float32; return its accessor. `bounds`: with its least and largest."""
        kind = gltf.UNSIGNED_INT if values.dtype == np.uint32 else gltf.FLOAT
        view = self._view(np.ascontiguousarray(values).tobytes(), target)
        shape = VECTORS[values.shape[1]]
        entry = gltf.Accessor(bufferView=view, componentType=kind, count=len(values), type=shape)
        if bounds:
            entry.min, entry.max = values.min(axis=0).tolist(), values.max(axis=0).tolist()
        self.file.accessors.append(entry)
        return len(self.file.accessors) - 1

    def triangles(self, corners: np.ndarray) -> int:
        """Add triangles (n, 3) uint32; return their accessor."""
        return self.array(corners.reshape(-1, 1).astype(np.uint32), gltf.ELEMENT_ARRAY_BUFFER)

    def texture(self, image: np.ndarray, name: str, reach: tuple[int, int], wrap: tuple[int, int]) -> int:
        """Add a picture (H, W, 1 to 4), uint8 or 0..1; return the texture.

        `reach` are its filters where it is seen larger and smaller, `wrap` what lies beyond its borders along u and v.
        """
        from PIL import Image

        stream = io.BytesIO()
        pixels = image if image.dtype == np.uint8 else to_bytes(image)
        pixels = pixels[..., 0] if pixels.ndim == 3 and pixels.shape[2] == 1 else pixels
        Image.fromarray(pixels).save(stream, format="PNG", compress_level=PNG_EFFORT)
        view = self._view(stream.getvalue(), None)
        self.file.images.append(gltf.Image(bufferView=view, mimeType="image/png", name=name))
        key = (*reach, *wrap)
        if key not in self._samplers:
            self._samplers[key] = len(self.file.samplers)
            sampler = gltf.Sampler(magFilter=reach[0], minFilter=reach[1], wrapS=wrap[0], wrapT=wrap[1])
            self.file.samplers.append(sampler)
        self.file.textures.append(gltf.Texture(sampler=self._samplers[key], source=len(self.file.images) - 1))
        return len(self.file.textures) - 1

    def node(self, name: str | None, parent: int | None = None, **more: Any) -> int:
        """Add a node below `parent` (None: a root); return its number."""
        self.file.nodes.append(gltf.Node(name=name, **more))
        number = len(self.file.nodes) - 1
        siblings = self.file.scenes[0].nodes if parent is None else self.file.nodes[parent].children
        assert siblings is not None
        siblings.append(number)
        return number

    def finish(self, extras: dict[str, Any]) -> bytes:
        """Return the whole .glb."""
        file = self.file
        file.extensionsUsed = sorted(self.extensions)
        file.asset = gltf.Asset(generator=f"luxel {__version__}", version="2.0", extras=extras)
        file.buffers = [gltf.Buffer(byteLength=len(self.data))]
        file.set_binary_blob(bytes(self.data))
        return b"".join(file.save_to_bytes())

    def _view(self, data: bytes, target: int | None) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        self.file.bufferViews.append(
            gltf.BufferView(buffer=0, byteOffset=len(self.data), byteLength=len(data), target=target)
        )
        self.data += data
        return len(self.file.bufferViews) - 1
