"""A glTF container opened: its JSON as objects, its binary chunk, and the errors and warnings that name the file."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np

from luxel.errors import LuxelError
from luxel.scene.gltf.schema import Gltf, clean_name, read_gltf
from luxel.scene.gltf.uris import find_file, is_embedded, read_embedded
from luxel.scene.warnings import Warnings

T = TypeVar("T")

GLB_MAGIC = b"glTF"
GLB_HEADER_BYTES = 12
CHUNK_HEADER_BYTES = 8
CHUNK_JSON = b"JSON"
CHUNK_BINARY = b"BIN\0"

CHUNK_ALIGNMENT = 4
MOST_LIGHT = 1e18
"""Radiance or intensity; squares of it must fit into float32."""
PADDING = b"\0 \t\r\n"
"""What exporters fill chunks up with; the specification wants spaces after JSON."""
# Bytes that are no UTF-8 come out of `surrogateescape` as U+DC80..U+DCFF; most such files are Windows-1252.
ESCAPED_BYTES = {0xDC00 + byte: bytes([byte]).decode("cp1252", errors="replace") for byte in range(0x80, 0x100)}
ESCAPED_TEXT = re.compile('"([^"]*[\udc80-\udcff][^"]*)"')

SUPPORTED_EXTENSIONS = frozenset(
    {
        "EXT_mesh_gpu_instancing",
        "EXT_meshopt_compression",
        "EXT_texture_avif",
        "EXT_texture_webp",
        "KHR_animation_pointer",
        "KHR_draco_mesh_compression",
        "KHR_lights_punctual",
        "KHR_materials_diffuse_transmission",
        "KHR_materials_dispersion",
        "KHR_materials_emissive_strength",
        "KHR_materials_ior",
        "KHR_materials_pbrSpecularGlossiness",
        "KHR_materials_transmission",
        "KHR_materials_unlit",
        "KHR_materials_volume",
        "KHR_mesh_quantization",
        "KHR_meshopt_compression",
        "KHR_node_visibility",
        "KHR_texture_basisu",
        "KHR_texture_transform",
        "MSFT_texture_dds",
    }
)
"""Read, approximated or left out; what is not read in full is named where it is used."""
GLOSS_EXTENSIONS = ("KHR_materials_clearcoat", "KHR_materials_specular")
"""Read; the diffuse condition does not show them."""
UNSEEN_EXTENSIONS = frozenset(
    {
        "EXT_structural_metadata",
        "KHR_materials_variants",
        "KHR_node_hoverability",
        "KHR_node_selectability",
        "KHR_xmp",
        "KHR_xmp_json_ld",
    }
)
"""They change nothing that can be seen; of variants of materials the file's default is."""
# A required extension of this family changes how a surface looks, not whether it can be read.
LOOK_PREFIX = "KHR_materials_"


@dataclass
class Document:
    """One open glTF file."""

    path: Path
    gltf: Gltf
    blob: bytes | None = None
    """The binary chunk of a .glb, or None."""
    warnings: Warnings = field(default_factory=Warnings)

    def fail(self, cause: str, origin: BaseException | None = None) -> NoReturn:
        """Raise `LuxelError` with one sentence that names the file and the cause."""
        raise LuxelError(f"cannot load {self.path}: {cause}.") from origin

    def warn(self, sentence: str, name: str = "", *, diffuse_only: bool = False) -> None:
        """Keep `sentence` for the user, once; its "{names}" becomes the list of all names given with it.

        `diffuse_only`: full materials do what it says is not done.
        """
        self.warnings.add(sentence, name, diffuse_only=diffuse_only)

    def clean(self, name: str) -> str:
        """`name` without characters that no terminal or file can take; a repair is named."""
        cleaned = clean_name(name)
        if cleaned != name:
            self.warn("Names that hold characters which cannot be shown are repaired: {names}.", cleaned)
        return cleaned

    def item(self, items: Sequence[T] | None, index: Any, kind: str) -> T:
        """`items[index]`, or a `LuxelError` that names `kind` and both numbers."""
        count = len(items or ())
        if items is None or not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < count:
            self.fail(f"{kind} {index} is asked for but the file has {count} (indices start at 0)")
        return items[index]

    def numbers(self, value: Any, count: int, where: str) -> np.ndarray:
        """`value` as (count,) finite float64, or a `LuxelError` that names `where`."""
        if value is None:
            self.fail(f"{where} is missing")
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            self.fail(f"{where} must be {count} number(s), not {value!r}", error)
        if array.reshape(-1).shape != (count,) or array.ndim > 1:
            self.fail(f"{where} must be {count} number(s), not {value!r}")
        if not np.isfinite(array).all():
            self.fail(f"{where} holds NaN or infinity")
        return array.reshape(count)

    def power(self, value: Any, where: str, name: str) -> np.ndarray:
        """`value` (3,) as light: below zero is none, with a warning for `name`; more than float32 bears is refused."""
        light = self.numbers(value, 3, where)
        if (light > MOST_LIGHT).any():
            self.fail(f"{where} is {light.max():g}, more than luxel can add up ({MOST_LIGHT:g})")
        if (light < 0.0).any():
            self.warn("Light below zero is read as none: {names}.", name)
        return np.maximum(light, 0.0)

    def number(self, value: Any, where: str) -> float:
        """`value` as one finite float, or a `LuxelError` that names `where`."""
        return float(self.numbers(value, 1, where)[0])

    def read_uri(self, uri: str) -> bytes:
        """The bytes behind a `data:` URI or a path relative to the file.

        Raises `OSError` where the file cannot be read (remote addresses and places outside the file's folder count as
        that), `ValueError` where the data URI is damaged; the caller knows whether it can go on without. Raises
        `LuxelError` where several files fit.
        """
        if is_embedded(uri):
            return read_embedded(uri)
        return find_file(self.path, uri).read_bytes()


def open_document(path: Path) -> Document:
    """Open a .gltf or .glb (told apart by content, not by suffix).

    Raises `LuxelError` for a missing, empty, truncated or malformed file, for JSON that is not glTF 2, and for a
    required extension that luxel lacks.
    """
    document = Document(path, Gltf())
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        document.fail("the file does not exist", error)
    except OSError as error:
        document.fail(f"the file cannot be read ({error.strerror or error})", error)
    if not data:
        document.fail("the file is empty")
    text, document.blob = _split_glb(document, data) if data.startswith(GLB_MAGIC) else (data, None)
    _parse_json(document, text)
    _check_extensions(document)
    return document


def _split_glb(document: Document, data: bytes) -> tuple[bytes, bytes | None]:
    """Return the JSON and binary chunks of a .glb."""
    if len(data) < GLB_HEADER_BYTES:
        document.fail("the file is truncated inside its GLB header")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        document.fail(f"it is a GLB of version {version}, and only version 2 is known")
    if length > len(data):
        document.fail(f"the file is truncated: its header promises {length} bytes and it has {len(data)}")
    chunks: dict[bytes, bytes] = {}
    offset = GLB_HEADER_BYTES
    while offset + CHUNK_HEADER_BYTES <= length:
        size, kind = struct.unpack_from("<I4s", data, offset)
        if kind not in (CHUNK_JSON, CHUNK_BINARY) and offset % CHUNK_ALIGNMENT:
            # Some writers count a chunk without its padding.
            offset += CHUNK_ALIGNMENT - offset % CHUNK_ALIGNMENT
            continue
        offset += CHUNK_HEADER_BYTES
        if offset + size > len(data):
            document.fail(f"its {kind!r} chunk is truncated")
        chunks.setdefault(kind, data[offset : offset + size])
        offset += size
    if CHUNK_JSON not in chunks:
        document.fail("the GLB has no JSON chunk")
    return chunks[CHUNK_JSON], chunks.get(CHUNK_BINARY)


def _parse_json(document: Document, data: bytes) -> None:
    """Fill `gltf`; the asset is checked first."""
    try:
        raw = json.loads(_decode_text(document, data.rstrip(PADDING)))
    except (ValueError, RecursionError) as error:
        document.fail(f"it is not valid JSON ({str(error) or 'nested too deeply'})".replace("\n", " "), error)
    asset = raw.get("asset") if isinstance(raw, dict) else None
    version = str(asset.get("version", "")) if isinstance(asset, dict) else ""
    if not version:
        document.fail("it is JSON but not glTF, as it has no asset.version")
    minimum = str(asset.get("minVersion", version)) if isinstance(asset, dict) else version
    if version.split(".")[0] != "2" or minimum not in ("2.0", version):
        document.fail(f"it is glTF {minimum if minimum != version else version}, and only glTF 2.0 is known")
    try:
        gltf = document.gltf = read_gltf(raw)
    except (TypeError, RecursionError) as error:
        document.fail(f"its JSON breaks the glTF schema ({error})", error)
    for entry in (*gltf.nodes, *gltf.meshes, *gltf.materials, *gltf.cameras, *gltf.animations):
        if entry.name is not None and not entry.name.isprintable():
            entry.name = document.clean(entry.name)


def _decode_text(document: Document, data: bytes) -> str:
    """The text of the JSON; bytes that are no UTF-8 are read as Windows-1252 where they stand in a text."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        text = data.decode("utf-8-sig", errors="surrogateescape")
        if not text.lstrip().startswith("{"):
            raise error
    for found in ESCAPED_TEXT.finditer(text):
        repaired = found[1].translate(ESCAPED_BYTES)
        document.warn("The file is not UTF-8 throughout; these texts are read as Windows-1252: {names}.", repaired)
    return text.translate(ESCAPED_BYTES)


def _check_extensions(document: Document) -> None:
    required = {str(name) for name in document.gltf.extensionsRequired}
    for name in sorted(required | {str(name) for name in document.gltf.extensionsUsed}):
        if name in SUPPORTED_EXTENSIONS or name in UNSEEN_EXTENSIONS:
            continue
        if name in required and not name.startswith(LOOK_PREFIX):
            document.fail(f"it requires the extension {name}, which luxel does not support; export it without")
        if name in GLOSS_EXTENSIONS:
            document.warn(f"The extension {name} is gloss, which the diffuse part leaves out.", diffuse_only=True)
        else:
            document.warn(f"The extension {name} is not supported and is ignored.")
