"""What luxel reads of glTF 2.0's JSON, as plain classes; what a file leaves out is None.

Field names are those of the specification. `read_gltf` is quick where files are large: a scene may have 100,000 nodes.
"""

from __future__ import annotations

import unicodedata
from dataclasses import dataclass, field, fields
from functools import cache
from typing import Any, TypeVar

T = TypeVar("T")


@dataclass
class Entry:
    """What every object of the file may have."""

    name: str | None = None
    extensions: dict[str, Any] = field(default_factory=dict)


@dataclass
class TextureInfo(Entry):
    index: Any = None
    texCoord: Any = None
    scale: Any = None
    """Of a normal texture."""


@dataclass
class PbrMetallicRoughness(Entry):
    baseColorFactor: Any = None
    baseColorTexture: TextureInfo | None = None
    metallicFactor: Any = None
    roughnessFactor: Any = None
    metallicRoughnessTexture: TextureInfo | None = None


@dataclass
class GltfMaterial(Entry):
    pbrMetallicRoughness: PbrMetallicRoughness | None = None
    normalTexture: TextureInfo | None = None
    occlusionTexture: TextureInfo | None = None
    emissiveTexture: TextureInfo | None = None
    emissiveFactor: Any = None
    alphaMode: Any = None
    alphaCutoff: Any = None
    doubleSided: Any = None


@dataclass
class GltfTexture(Entry):
    sampler: Any = None
    source: Any = None


@dataclass
class Image(Entry):
    uri: str | None = None
    mimeType: Any = None
    bufferView: Any = None


@dataclass
class Sampler(Entry):
    magFilter: Any = None
    wrapS: Any = None
    wrapT: Any = None


@dataclass
class Buffer(Entry):
    uri: str | None = None
    byteLength: Any = None


@dataclass
class BufferView(Entry):
    buffer: Any = None
    byteOffset: Any = None
    byteLength: Any = None
    byteStride: Any = None


@dataclass
class SparsePart(Entry):
    bufferView: Any = None
    byteOffset: Any = None
    componentType: Any = None


@dataclass
class Sparse(Entry):
    count: Any = None
    indices: SparsePart | None = None
    values: SparsePart | None = None


@dataclass
class Accessor(Entry):
    bufferView: Any = None
    byteOffset: Any = None
    componentType: Any = None
    normalized: Any = None
    count: Any = None
    type: Any = None
    sparse: Sparse | None = None


@dataclass
class GltfPrimitive(Entry):
    attributes: dict[str, Any] = field(default_factory=dict)
    indices: Any = None
    material: Any = None
    mode: Any = None
    targets: list[dict[str, Any]] | None = None


@dataclass
class GltfMesh(Entry):
    primitives: list[GltfPrimitive] = field(default_factory=list)
    weights: Any = None


@dataclass
class GltfNode(Entry):
    children: list[Any] = field(default_factory=list)
    mesh: Any = None
    skin: Any = None
    camera: Any = None
    weights: Any = None
    matrix: Any = None
    translation: Any = None
    rotation: Any = None
    scale: Any = None


@dataclass
class GltfSkin(Entry):
    joints: list[Any] = field(default_factory=list)
    inverseBindMatrices: Any = None


@dataclass
class AnimationTarget(Entry):
    node: Any = None
    path: Any = None


@dataclass
class AnimationChannel(Entry):
    sampler: Any = None
    target: AnimationTarget | None = None


@dataclass
class AnimationSampler(Entry):
    input: Any = None
    output: Any = None
    interpolation: Any = None


@dataclass
class Animation(Entry):
    channels: list[AnimationChannel] = field(default_factory=list)
    samplers: list[AnimationSampler] = field(default_factory=list)


@dataclass
class Lens(Entry):
    """Perspective: `yfov` and `aspectRatio`; orthographic: `xmag` and `ymag`."""

    yfov: Any = None
    aspectRatio: Any = None
    xmag: Any = None
    ymag: Any = None


@dataclass
class GltfCamera(Entry):
    type: Any = None
    perspective: Lens | None = None
    orthographic: Lens | None = None


@dataclass
class GltfScene(Entry):
    nodes: list[Any] = field(default_factory=list)


@dataclass
class Gltf(Entry):
    scene: Any = None
    scenes: list[GltfScene] = field(default_factory=list)
    nodes: list[GltfNode] = field(default_factory=list)
    meshes: list[GltfMesh] = field(default_factory=list)
    materials: list[GltfMaterial] = field(default_factory=list)
    textures: list[GltfTexture] = field(default_factory=list)
    images: list[Image] = field(default_factory=list)
    samplers: list[Sampler] = field(default_factory=list)
    accessors: list[Accessor] = field(default_factory=list)
    bufferViews: list[BufferView] = field(default_factory=list)
    buffers: list[Buffer] = field(default_factory=list)
    skins: list[GltfSkin] = field(default_factory=list)
    animations: list[Animation] = field(default_factory=list)
    cameras: list[GltfCamera] = field(default_factory=list)
    extensionsUsed: list[Any] = field(default_factory=list)
    extensionsRequired: list[Any] = field(default_factory=list)


KINDS: dict[str, type[Entry]] = {
    kind.__name__: kind
    for kind in (
        TextureInfo, PbrMetallicRoughness, GltfMaterial, GltfTexture, Image, Sampler, Buffer, BufferView, SparsePart,
        Sparse, Accessor, GltfPrimitive, GltfMesh, GltfNode, GltfSkin, AnimationTarget, AnimationChannel,
        AnimationSampler, Animation, Lens, GltfCamera, GltfScene,
    )
}  # fmt: skip


def read_gltf(raw: dict[str, Any]) -> Gltf:
    """The JSON `raw` as objects. Raises `TypeError` where a list, an object or a text stands in another's place."""
    return read_entry(Gltf, raw, "the file")


def read_entry(kind: type[T], raw: Any, where: str) -> T:
    """The JSON object `raw` as a `kind`; fields that it has not are left out. Raises `TypeError`, as `read_gltf`."""
    if not isinstance(raw, dict):
        raise TypeError(f"{where} is not an object")
    plan, values = _plan(kind), {}
    for name, value in raw.items():
        if value is None or name not in plan:
            continue
        nested, form = plan[name]
        if form is not None and not isinstance(value, form):
            raise TypeError(f"{name} of {where} is a {type(value).__name__}, not a {form.__name__}")
        if nested is not None:
            listed = [read_entry(nested, one, name) for one in value] if form is list else None
            value = read_entry(nested, value, name) if listed is None else listed
        values[name] = value
    return kind(**values)


@cache
def _plan(kind: type) -> dict[str, tuple[type | None, type | None]]:
    """Each field's name: the class of what it holds, if it is one of ours, and the JSON type it must have, if one."""
    plan: dict[str, tuple[type | None, type | None]] = {}
    for one in fields(kind):
        text = str(one.type).removesuffix(" | None")
        inner = text.removeprefix("list[").removesuffix("]")
        form = {"list": list, "dict": dict, "str": str}.get(text.partition("[")[0])
        plan[one.name] = (KINDS.get(inner), form)
    return plan


def clean_name(name: str) -> str:
    """`name` with each character that cannot be printed or written (controls, half surrogates) as U+FFFD."""
    if name.isprintable():
        return name
    return "".join("\ufffd" if unicodedata.category(letter) in ("Cc", "Cs") else letter for letter in name)
