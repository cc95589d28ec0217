"""Writes tiny glTF files for the loader's tests."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxel.scene.gltf import load_gltf
from luxel.scene.model import SceneData

COMPONENTS = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
WIDTHS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
TRIANGLE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]


class GltfBuilder:
    """A glTF document under construction: `json` may be edited freely before `write` or `load`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.blob = bytearray()
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}]}

    def add(self, kind: str, entry: dict[str, Any]) -> int:
        """Append `entry` to one of the document's lists; its index."""
        self.json.setdefault(kind, []).append(entry)
        return len(self.json[kind]) - 1

    def view(self, data: bytes, **more: Any) -> int:
        self.blob.extend(b"\0" * (-len(self.blob) % 4))
        entry = {"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data), **more}
        self.blob.extend(data)
        return self.add("bufferViews", entry)

    def accessor(self, values: Any, dtype: str = "float32", **more: Any) -> int:
        array = np.ascontiguousarray(np.asarray(values, dtype=dtype))
        width = "MAT4" if array.ndim == 3 else WIDTHS[1 if array.ndim == 1 else array.shape[1]]
        # glTF stores matrices column by column.
        data = (array.transpose(0, 2, 1) if array.ndim == 3 else array).tobytes()
        entry = {"bufferView": self.view(data), "componentType": COMPONENTS[dtype], "count": len(array), "type": width}
        return self.add("accessors", {**entry, **more})

    def mesh(self, positions: Any = TRIANGLE, *, name: str | None = None, **primitive: Any) -> int:
        """A mesh of one primitive; `attributes` in `primitive` adds to POSITION."""
        attributes = {"POSITION": self.accessor(positions), **primitive.pop("attributes", {})}
        entry: dict[str, Any] = {"primitives": [{"attributes": attributes, **primitive}]}
        return self.add("meshes", entry if name is None else {**entry, "name": name})

    def node(self, *, root: bool = True, **entry: Any) -> int:
        index = self.add("nodes", entry)
        if root:
            self.json["scenes"][0]["nodes"].append(index)
        return index

    def animate(self, node: int, path: str, times: Any, values: Any, interpolation: str | None = "LINEAR") -> None:
        """Add a channel to the first animation."""
        animation = self.json.setdefault("animations", [{"name": "first", "channels": [], "samplers": []}])[0]
        sampler: dict[str, Any] = {"input": self.accessor(times), "output": self.accessor(values)}
        if interpolation is not None:
            sampler["interpolation"] = interpolation
        animation["samplers"].append(sampler)
        target = {"node": node, "path": path}
        animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": target})

    def light(self, **entry: Any) -> dict[str, Any]:
        """A punctual light; returns the `extensions` of the node that carries it."""
        lights = self.json.setdefault("extensions", {}).setdefault("KHR_lights_punctual", {"lights": []})["lights"]
        lights.append(entry)
        return {"KHR_lights_punctual": {"light": len(lights) - 1}}

    def bytes_of_glb(self) -> bytes:
        if self.blob:
            self.json.setdefault("buffers", [{"byteLength": len(self.blob)}])
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        if self.blob:
            blob = bytes(self.blob) + b"\0" * (-len(self.blob) % 4)
            chunks += struct.pack("<I4s", len(blob), b"BIN\0") + blob
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def write(self, name: str = "scene.glb", *, buffer: str | None = None) -> Path:
        """Write a .glb, or a .gltf whose buffer is embedded, or the file `buffer`."""
        path = self.folder / name
        if path.suffix == ".glb":
            path.write_bytes(self.bytes_of_glb())
            return path
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.blob).decode()
        if buffer is not None:
            (self.folder / buffer).write_bytes(self.blob)
            uri = buffer.replace(" ", "%20")
        self.json.setdefault("buffers", [{"byteLength": len(self.blob), "uri": uri}])
        path.write_text(json.dumps(self.json))
        return path

    def load(self, name: str = "scene.glb") -> SceneData:
        return load_gltf(self.write(name))


@pytest.fixture
def builder(tmp_path: Path) -> GltfBuilder:
    return GltfBuilder(tmp_path)
