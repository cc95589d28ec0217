"""glTF accessors to NumPy arrays: every component type, strides, normalised integers, sparse storage."""

from __future__ import annotations

from typing import Any

import numpy as np

from luxel.scene.gltf.compressed import decode_meshopt, find_decoder, meshopt_of
from luxel.scene.gltf.document import Document
from luxel.scene.gltf.schema import Accessor, Buffer
from luxel.scene.gltf.uris import OutsideError, is_embedded

COMPONENT_TYPES: dict[int, np.dtype] = {
    5120: np.dtype("<i1"),
    5121: np.dtype("<u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
INDEX_TYPES = (5121, 5123, 5125)
# (columns, rows): vectors are one column.
ELEMENT_SHAPES: dict[str, tuple[int, int]] = {
    "SCALAR": (1, 1),
    "VEC2": (1, 2),
    "VEC3": (1, 3),
    "VEC4": (1, 4),
    "MAT2": (2, 2),
    "MAT3": (3, 3),
    "MAT4": (4, 4),
}
COLUMN_ALIGNMENT = 4
MOST_WITHOUT_DATA = 1 << 24
"""Elements that an accessor may have of zeros, so that a lie does not fill the memory."""


class AccessorReader:
    """Reads accessors of one document; buffers are fetched once, on first use."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self._buffers: dict[int, bytes] = {}
        self._unpacked: dict[int, bytes] = {}
        self._supplied: dict[int, np.ndarray] = {}

    def read_floats(self, index: int | None, types: tuple[str, ...], *, unit: bool = False) -> np.ndarray:
        """Accessor `index` as float32, shape (N,), (N, C), or (N, rows, columns) for matrices.

        `types` are the element types allowed ("VEC3", ...). Normalised integers become 0..1 or -1..1, and with
        `unit` integers do so even where the file forgot to say that they are normalised.
        Raises `LuxelError` for anything out of range or missing.
        """
        accessor = self._accessor(index, types)
        values = self._read(accessor, index)
        if values.dtype.kind != "f" and (accessor.normalized or unit):
            limit = np.iinfo(values.dtype).max
            return np.maximum(values.astype(np.float64) / limit, -1.0).astype(np.float32)
        return values.astype(np.float32)

    def read_integers(self, index: int | None, types: tuple[str, ...]) -> np.ndarray:
        """Accessor `index` as int64, shape (N,) or (N, C). Raises `LuxelError` where it holds floats."""
        accessor = self._accessor(index, types)
        if accessor.componentType not in INDEX_TYPES:
            self.document.fail(f"accessor {index} must hold unsigned integers (component type 5121, 5123 or 5125)")
        return self._read(accessor, index).astype(np.int64)

    def has_data(self, index: int | None) -> bool:
        """False where an accessor has neither a buffer view nor sparse values: its data is in an extension."""
        accessor = self.document.item(self.document.gltf.accessors, index, "accessor")
        return accessor.bufferView is not None or accessor.sparse is not None

    def supply(self, index: int | None, values: np.ndarray, label: str) -> None:
        """Let accessor `index` read the (N, C) `values`, which came out of a compressed mesh.

        Raises `LuxelError` where the accessor declares another count or kind of element.
        """
        accessor = self.document.item(self.document.gltf.accessors, index, "accessor")
        columns, rows = ELEMENT_SHAPES.get(accessor.type, (0, 0))
        if values.shape != (accessor.count, columns * rows) or index is None:
            self.document.fail(
                f"the compressed data of {label} has {values.shape[0]} elements of {values.shape[1]} numbers, "
                f"but accessor {index} declares {accessor.count} of type {accessor.type}"
            )
        kind = COMPONENT_TYPES.get(accessor.componentType, values.dtype)
        self._supplied[index] = values if values.dtype.kind == "f" else values.astype(kind)

    def view_bytes(self, index: int | None) -> bytes:
        """All bytes of a buffer view."""
        data, start, length, _ = self._view(index)
        return data[start : start + length]

    def _accessor(self, index: int | None, types: tuple[str, ...]) -> Accessor:
        accessor = self.document.item(self.document.gltf.accessors, index, "accessor")
        if accessor.type not in types:
            self.document.fail(f"accessor {index} has type {accessor.type} where {' or '.join(types)} is needed")
        if accessor.componentType not in COMPONENT_TYPES:
            self.document.fail(f"accessor {index} has the unknown component type {accessor.componentType}")
        if not isinstance(accessor.count, int) or accessor.count < 0:
            self.document.fail(f"accessor {index} has the count {accessor.count}")
        return accessor

    def _read(self, accessor: Accessor, index: int | None) -> np.ndarray:
        """Dense values in the stored component type; sparse values replace those of the base."""
        kind = COMPONENT_TYPES[accessor.componentType]
        columns, rows = ELEMENT_SHAPES[accessor.type]
        if index is not None and index in self._supplied:
            values = self._supplied[index].reshape(accessor.count, columns, rows)
        elif accessor.bufferView is not None:
            offset = accessor.byteOffset or 0
            values = self._strided(accessor.bufferView, offset, accessor.count, kind, columns, rows, index)
        else:
            if accessor.count > MOST_WITHOUT_DATA:
                self.document.fail(f"accessor {index} declares {accessor.count} elements without any data")
            values = np.zeros((accessor.count, columns, rows), kind)
        if accessor.sparse is not None:
            values = self._apply_sparse(accessor, values.copy(), index)
        if columns > 1:
            return values.transpose(0, 2, 1)
        return values.reshape(accessor.count, rows) if rows > 1 else values.reshape(accessor.count)

    def _apply_sparse(self, accessor: Accessor, values: np.ndarray, index: int | None) -> np.ndarray:
        sparse = accessor.sparse
        assert sparse is not None
        if sparse.indices is None or sparse.values is None or sparse.indices.componentType not in INDEX_TYPES:
            self.document.fail(f"the sparse part of accessor {index} is incomplete")
        kind = COMPONENT_TYPES[sparse.indices.componentType]
        where = self._strided(
            sparse.indices.bufferView, sparse.indices.byteOffset or 0, sparse.count, kind, 1, 1, index
        ).reshape(-1)
        if where.size and int(where.max()) >= len(values):
            self.document.fail(f"a sparse index of accessor {index} is {where.max()} but it has {len(values)} elements")
        offset, (_, columns, rows) = sparse.values.byteOffset or 0, values.shape
        values[where] = self._strided(
            sparse.values.bufferView, offset, sparse.count, values.dtype, columns, rows, index
        )
        return values

    def _strided(
        self,
        view_index: int | None,
        offset: int,
        count: int,
        kind: np.dtype,
        columns: int,
        rows: int,
        index: int | None,
    ) -> np.ndarray:
        """A (count, columns, rows) window on a buffer view, without a copy.

        Matrix columns start at multiples of four bytes (glTF 2.0, section 3.6.2.4).
        """
        if not isinstance(count, int) or count < 0:
            self.document.fail(f"accessor {index} has the count {count}")
        data, start, length, stated_stride = self._view(view_index)
        column_bytes = rows * kind.itemsize
        if columns > 1:
            column_bytes = -(-column_bytes // COLUMN_ALIGNMENT) * COLUMN_ALIGNMENT
        element_bytes = column_bytes * (columns - 1) + rows * kind.itemsize
        stride = stated_stride or column_bytes * columns
        if stride < element_bytes:
            self.document.fail(f"buffer view {view_index} has a stride of {stride} bytes, too small for its elements")
        if count == 0:
            return np.zeros((0, columns, rows), kind)
        if offset < 0 or offset + stride * (count - 1) + element_bytes > length:
            self.document.fail(f"accessor {index} reads past the end of buffer view {view_index}")
        return np.ndarray(
            (count, columns, rows),
            kind,
            buffer=data,
            offset=start + offset,
            strides=(stride, column_bytes, kind.itemsize),
        )

    def _view(self, index: int | None) -> tuple[bytes, int, int, int | None]:
        """Buffer view `index`, checked: the bytes it lies in, its first byte, its length and its stride."""
        view = self.document.item(self.document.gltf.bufferViews, index, "buffer view")
        part = meshopt_of(view.extensions)
        if part is not None and index is not None and self._is_packed(view.buffer):
            if index not in self._unpacked:
                data, start = self._slice(part.get("buffer"), part.get("byteOffset"), part.get("byteLength"), index)
                packed = data[start : start + part["byteLength"]]
                label = f"buffer view {index}"
                self._unpacked[index] = decode_meshopt(self.document, part, packed, view.byteLength, label)
            return self._unpacked[index], 0, len(self._unpacked[index]), view.byteStride or part["byteStride"]
        data, start = self._slice(view.buffer, view.byteOffset, view.byteLength, index)
        return data, start, view.byteLength, view.byteStride

    def _is_packed(self, buffer: int | None) -> bool:
        """Return whether compressed data must be read: its decoder is there, or no plain copy is."""
        entry = self.document.item(self.document.gltf.buffers, buffer, "buffer")
        plain = entry.uri is not None or (buffer == 0 and self.document.blob is not None)
        return not plain or find_decoder("meshopt") is not None

    def _slice(self, buffer: int | None, offset: Any, length: Any, index: int | None) -> tuple[bytes, int]:
        """The buffer of view `index` and the view's first byte in it, checked."""
        start = offset or 0
        data = self._buffer(buffer)
        if not isinstance(length, int) or length < 0 or not isinstance(start, int) or start < 0:
            self.document.fail(f"buffer view {index} has a broken byteOffset or byteLength")
        if start + length > len(data):
            self.document.fail(f"buffer view {index} reads past the end of buffer {buffer}")
        return data, start

    def _buffer(self, index: int | None) -> bytes:
        buffer = self.document.item(self.document.gltf.buffers, index, "buffer")
        assert index is not None
        if index not in self._buffers:
            self._buffers[index] = self._fetch(buffer, index)
        return self._buffers[index]

    def _fetch(self, buffer: Buffer, index: int) -> bytes:
        if buffer.uri is not None:
            label = "embedded" if is_embedded(buffer.uri) else buffer.uri
            try:
                data = self.document.read_uri(buffer.uri)
            except OutsideError as error:
                self.document.fail(f"its buffer file {error}; put it beside the file", error)
            except OSError as error:
                self.document.fail(f"its buffer file {label} is missing or cannot be read", error)
            except ValueError as error:
                self.document.fail(f"its buffer {index} ({label}) cannot be decoded, {error}", error)
        elif index == 0 and self.document.blob is not None:
            data = self.document.blob
        else:
            self.document.fail(f"its buffer {index} has no data in the file")
        if len(data) < (buffer.byteLength or 0):
            self.document.fail(f"its buffer {index} is truncated: {len(data)} bytes of {buffer.byteLength}")
        return data
