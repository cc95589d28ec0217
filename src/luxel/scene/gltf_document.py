"""A glTF container opened: its JSON as objects, its binary chunk, and the errors and warnings that name the file."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn, TypeVar
from urllib.parse import unquote, unquote_to_bytes

import numpy as np
from pygltflib import GLTF2

from luxel.errors import LuxelError

T = TypeVar("T")

GLB_MAGIC = b"glTF"
GLB_HEADER_BYTES = 12
CHUNK_HEADER_BYTES = 8
CHUNK_JSON = b"JSON"
CHUNK_BINARY = b"BIN\0"

SUPPORTED_EXTENSIONS = frozenset(
    {
        "KHR_lights_punctual",
        "KHR_materials_emissive_strength",
        "KHR_materials_unlit",
        "KHR_mesh_quantization",
        "KHR_texture_transform",
        "EXT_texture_webp",
    }
)
# A required extension of this family changes how a surface looks, not whether it can be read: except for the
# one that replaces the metal-rough model itself.
LOOK_PREFIX = "KHR_materials_"
LOOK_REPLACED = "KHR_materials_pbrSpecularGlossiness"


@dataclass
class Document:
    """One open glTF file. `gltf` is the typed tree, `raw` the plain JSON (for what the typed tree leaves out)."""

    path: Path
    gltf: GLTF2
    raw: dict[str, Any]
    blob: bytes | None = None
    """The binary chunk of a .glb, or None."""
    warnings: list[str] = field(default_factory=list)

    def fail(self, cause: str, origin: BaseException | None = None) -> NoReturn:
        """Raise `LuxelError` with one sentence that names the file and the cause."""
        raise LuxelError(f"cannot load {self.path}: {cause}.") from origin

    def warn(self, sentence: str) -> None:
        """Keep `sentence` for the user, once."""
        if sentence not in self.warnings:
            self.warnings.append(sentence)

    def item(self, items: Sequence[T] | None, index: Any, kind: str) -> T:
        """`items[index]`, or a `LuxelError` that names `kind` and both numbers."""
        count = len(items or ())
        if items is None or not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < count:
            self.fail(f"{kind} {index} is asked for but the file has {count} (indices start at 0)")
        return items[index]

    def numbers(self, value: Any, count: int, where: str) -> np.ndarray:
        """`value` as (count,) finite float64, or a `LuxelError` that names `where`."""
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            self.fail(f"{where} must be {count} number(s), not {value!r}", error)
        if array.reshape(-1).shape != (count,) or array.ndim > 1:
            self.fail(f"{where} must be {count} number(s), not {value!r}")
        if not np.isfinite(array).all():
            self.fail(f"{where} holds NaN or infinity")
        return array.reshape(count)

    def number(self, value: Any, where: str) -> float:
        """`value` as one finite float, or a `LuxelError` that names `where`."""
        return float(self.numbers(value, 1, where)[0])

    def read_uri(self, uri: str) -> bytes:
        """The bytes behind a `data:` URI or a path relative to the file.

        Raises `OSError` where the file cannot be read (remote addresses count as that: nothing is downloaded) and
        `ValueError` where the data URI is damaged; the caller knows whether it can go on without.
        """
        if uri.startswith("data:"):
            header, comma, body = uri.partition(",")
            if not comma:
                raise ValueError("its data URI has no comma")
            if header.endswith(";base64"):
                try:
                    return base64.b64decode(body + "=" * (-len(body) % 4))
                except binascii.Error as error:
                    raise ValueError("its base64 data is damaged") from error
            return unquote_to_bytes(body)
        if "://" in uri:
            raise FileNotFoundError(f"{uri} is remote")
        if "\0" in uri:
            raise ValueError("its file name holds a zero byte")
        return (self.path.parent / unquote(uri)).read_bytes()


def open_document(path: Path) -> Document:
    """Open a .gltf or .glb (told apart by content, not by suffix).

    Raises `LuxelError` for a missing, empty, truncated or malformed file, for JSON that is not glTF 2, and for a
    required extension that luxel lacks.
    """
    document = Document(path, GLTF2(), {})
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
        offset += CHUNK_HEADER_BYTES
        if offset + size > length:
            document.fail(f"its {kind!r} chunk is truncated")
        chunks.setdefault(kind, data[offset : offset + size])
        offset += size
    if CHUNK_JSON not in chunks:
        document.fail("the GLB has no JSON chunk")
    return chunks[CHUNK_JSON], chunks.get(CHUNK_BINARY)


def _without_extras(entry: dict[str, Any]) -> dict[str, Any]:
    """Drop application data: glTF allows any JSON there, the typed tree only objects."""
    entry.pop("extras", None)
    return entry


def _parse_json(document: Document, data: bytes) -> None:
    """Fill `raw` and `gltf`; the asset is checked first, as the typed tree would supply a missing one."""
    try:
        text = data.decode("utf-8-sig")
        raw = json.loads(text, object_hook=_without_extras)
    except (ValueError, RecursionError) as error:
        document.fail(f"it is not valid JSON ({str(error) or 'nested too deeply'})".replace("\n", " "), error)
    asset = raw.get("asset") if isinstance(raw, dict) else None
    version = str(asset.get("version", "")) if isinstance(asset, dict) else ""
    if not version:
        document.fail("it is JSON but not glTF, as it has no asset.version")
    minimum = str(asset.get("minVersion", version)) if isinstance(asset, dict) else version
    if version.split(".")[0] != "2" or minimum not in ("2.0", version):
        document.fail(f"it is glTF {minimum if minimum != version else version}, and only glTF 2.0 is known")
    document.raw = raw
    try:
        document.gltf = GLTF2.from_json(text, infer_missing=True, object_hook=_without_extras)
    except (TypeError, ValueError, KeyError, AttributeError, OverflowError, RecursionError) as error:
        document.fail(f"its JSON breaks the glTF schema ({error})", error)


def _check_extensions(document: Document) -> None:
    required = set(document.gltf.extensionsRequired or ())
    for name in sorted(required | set(document.gltf.extensionsUsed or ())):
        if name in SUPPORTED_EXTENSIONS:
            continue
        if name in required and (not name.startswith(LOOK_PREFIX) or name == LOOK_REPLACED):
            document.fail(f"it requires the extension {name}, which luxel does not support; export it without")
        document.warn(f"The extension {name} is not supported and is ignored.")
