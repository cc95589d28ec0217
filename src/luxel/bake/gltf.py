"""A bake as a .glb that any viewer shows: unlit surfaces, the light in one texture on the second coordinates.

Vertices are split where the atlas cuts a chart. The first texture coordinates are the scene's own; a mesh without
any repeats the second, as the format wants sets without gaps.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib as gltf
from scipy.ndimage import distance_transform_edt

from luxel import __version__
from luxel.bake.core import Baked
from luxel.bake.layout import Layout
from luxel.render.tonemap import auto_exposure, to_display
from luxel.render.write import to_bytes, write_bytes

UNLIT = "KHR_materials_unlit"
CUTOFF = 0.5
"""Share of a texel that is no hole, from which the texel shows."""
BACK_GAP = 4.0
"""How far backs stand off their fronts, in ray offsets (1e-5 of the scene's diagonal)."""


def sheet_of(layout: Layout, values: np.ndarray) -> np.ndarray:
    """Return texels (M, C) as an image (height, width, C) float32; the gutter repeats the nearest texel."""
    channels = values.shape[1]
    image = np.zeros((layout.height * layout.width, channels), np.float32)
    image[layout.slot] = values
    empty = np.ones(layout.height * layout.width, bool)
    empty[layout.slot] = False
    nearest = distance_transform_edt(
        empty.reshape(layout.height, layout.width), return_distances=False, return_indices=True
    )
    return image.reshape(layout.height, layout.width, channels)[tuple(nearest)]  # type: ignore[arg-type]


def shown(baked: Baked, light_only: bool) -> np.ndarray:
    """Return what the texture holds, (M, 3) linear: the surface's radiance, or what a white one would send."""
    return baked.light.irradiance / np.pi if light_only else baked.light.radiance


def exposure_of(values: np.ndarray) -> float:
    """Return the factor that brings the mean luminance of texels (M, 3) to middle grey."""
    return auto_exposure(values[None])


def write_glb(baked: Baked, path: str | Path, light_only: bool = False, exposure: float | None = None) -> float:
    """Write the bake to `path` (.glb), whole or not at all; return the exposure of its texture.

    Raises LuxelError where it cannot be written.
    """
    values = shown(baked, light_only)
    factor = exposure_of(values) if exposure is None else exposure
    picture = to_display(sheet_of(baked.layout, values), factor)
    cut = _find_cut(baked)
    if cut.any():
        picture = np.concatenate([picture, sheet_of(baked.layout, baked.light.opacity[:, None])], axis=2)
    writer = _Writer()
    for number, name in enumerate(_names(baked), start=1):
        found = _mesh_arrays(baked, number)
        if found is not None:
            faces, arrays, triangles = found
            writer.add_mesh(name, arrays, [triangles[~cut[faces]], triangles[cut[faces]]])
    extras = {"luxel": __version__, "holds": "light" if light_only else "light and albedo", "exposure": factor}
    write_bytes(path, writer.finish(_png(picture), extras, bool(cut.any())))
    return factor


def _names(baked: Baked) -> list[str]:
    return [item.name for item in baked.data.objects]


def _find_cut(baked: Baked) -> np.ndarray:
    """Return which of the layout's faces (F,) may have holes."""
    prim, cut = baked.layout.prim, np.zeros(len(baked.layout.prim), bool)
    for group in baked.scene.groups:
        if group.cutout:
            cut |= (prim >= group.prim_offset) & (prim < group.prim_offset + group.prim_count)
    return cut


def _mesh_arrays(baked: Baked, number: int) -> tuple[np.ndarray, dict[str, np.ndarray], np.ndarray] | None:
    """Return faces (n,), vertex arrays and triangles (n, 3) of object `number`; None where the atlas holds none."""
    layout, geometry = baked.layout, baked.scene.geometry
    rows = np.array(geometry.triangles).reshape(-1, 4)[layout.prim].astype(np.int64)
    held = np.flatnonzero((layout.chart >= 0) & (rows[:, 3] >> 16 == number))
    if not len(held):
        return None
    corner = rows[held, :3]
    packed = np.array(geometry.vertices).reshape(-1, 4)[corner]
    turned = np.array(geometry.normals).reshape(-1, 4)[corner]
    atlas = (layout.uv[held] + 0.5) / [layout.width, layout.height]
    own = np.stack([packed[..., 3], turned[..., 3]], axis=2)
    first = own if np.ptp(own) > 0.0 else atlas
    # A back is a triangle of its own that faces the other way, a hair apart: some viewers draw both sides of both.
    apart = BACK_GAP * float(np.array(baked.scene.epsilon)[0]) * layout.back[held, None, None]
    places = packed[..., :3] + apart * baked.normals[held]
    turn = np.where(layout.back[held][:, None], [0, 2, 1], [0, 1, 2])[..., None]
    table = np.concatenate([places, baked.normals[held], first, atlas], axis=2)
    table = np.take_along_axis(table, turn, axis=1).reshape(-1, 10).astype(np.float32)
    unique, index = np.unique(table, axis=0, return_inverse=True)
    columns = {"POSITION": (0, 3), "NORMAL": (3, 6), "TEXCOORD_0": (6, 8), "TEXCOORD_1": (8, 10)}
    arrays = {name: unique[:, a:b] for name, (a, b) in columns.items()}
    return held, arrays, index.reshape(-1, 3).astype(np.uint32)


def _png(display: np.ndarray) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(to_bytes(display)).save(stream, format="PNG")
    return stream.getvalue()


class _Writer:
    """Collects meshes, then gives the file's bytes."""

    def __init__(self) -> None:
        self.nodes: list[int] = []
        self.file = gltf.GLTF2(scene=0, scenes=[gltf.Scene(nodes=self.nodes)])
        self.data = bytearray()

    def add_mesh(self, name: str, arrays: dict[str, np.ndarray], triangles: list[np.ndarray]) -> None:
        """Add a mesh with a node of its own: `triangles` of the first material, of the second."""
        places = {key: self._add(array, gltf.ARRAY_BUFFER) for key, array in arrays.items()}
        low, high = arrays["POSITION"].min(axis=0), arrays["POSITION"].max(axis=0)
        self.file.accessors[places["POSITION"]].min = low.tolist()
        self.file.accessors[places["POSITION"]].max = high.tolist()
        primitives = []
        for material, chosen in enumerate(triangles):
            if len(chosen):
                indices = self._add(chosen.reshape(-1, 1), gltf.ELEMENT_ARRAY_BUFFER)
                attributes = gltf.Attributes(**places)
                primitives.append(gltf.Primitive(attributes=attributes, indices=indices, material=material))
        self.file.nodes.append(gltf.Node(name=name, mesh=len(self.file.meshes)))
        self.file.meshes.append(gltf.Mesh(name=name, primitives=primitives))
        self.nodes.append(len(self.file.nodes) - 1)

    def finish(self, picture: bytes, extras: dict[str, Any], cut: bool) -> bytes:
        """Return the whole .glb: what was added, under an unlit material that shows `picture` (PNG).

        `cut` adds a second one, whose holes are where the picture's alpha is below `CUTOFF`.
        """
        file = self.file
        file.images.append(gltf.Image(bufferView=self._view(picture, None), mimeType="image/png", name="lightmap"))
        # No mip levels: charts stand a texel apart, and smaller pictures would mix them.
        clamp = gltf.CLAMP_TO_EDGE
        file.samplers.append(gltf.Sampler(magFilter=gltf.LINEAR, minFilter=gltf.LINEAR, wrapS=clamp, wrapT=clamp))
        file.textures.append(gltf.Texture(sampler=0, source=0))
        rough = gltf.PbrMetallicRoughness(
            baseColorTexture=gltf.TextureInfo(index=0, texCoord=1), metallicFactor=0.0, roughnessFactor=1.0
        )
        opaque = {"pbrMetallicRoughness": rough, "extensions": {UNLIT: {}}, "alphaCutoff": None}
        file.materials.append(gltf.Material(name="baked", **opaque))
        if cut:
            holes = opaque | {"alphaMode": "MASK", "alphaCutoff": CUTOFF}
            file.materials.append(gltf.Material(name="baked with holes", **holes))
        file.extensionsUsed = [UNLIT]
        file.asset = gltf.Asset(generator=f"luxel {__version__}", version="2.0", extras=extras)
        file.buffers = [gltf.Buffer(byteLength=len(self.data))]
        file.set_binary_blob(bytes(self.data))
        return b"".join(file.save_to_bytes())

    def _add(self, array: np.ndarray, target: int) -> int:
        kind = gltf.UNSIGNED_INT if array.dtype == np.uint32 else gltf.FLOAT
        view = self._view(np.ascontiguousarray(array).tobytes(), target)
        shape = {1: gltf.SCALAR, 2: gltf.VEC2, 3: gltf.VEC3}[array.shape[1]]
        self.file.accessors.append(gltf.Accessor(bufferView=view, componentType=kind, count=len(array), type=shape))
        return len(self.file.accessors) - 1

    def _view(self, data: bytes, target: int | None) -> int:
        self.data += b"\0" * (-len(self.data) % 4)
        self.file.bufferViews.append(
            gltf.BufferView(buffer=0, byteOffset=len(self.data), byteLength=len(data), target=target)
        )
        self.data += data
        return len(self.file.bufferViews) - 1
