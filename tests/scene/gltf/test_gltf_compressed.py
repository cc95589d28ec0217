"""Draco and meshopt: files made by the encoders read as the plain ones; lies and damage end in one sentence."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.scene.model import Mesh

if TYPE_CHECKING:
    from conftest import GltfBuilder

DracoPy = pytest.importorskip("DracoPy", reason="needs the extra `compressed`")
meshopt = pytest.importorskip("meshopt", reason="needs the extra `compressed`")

DRACO = "KHR_draco_mesh_compression"
KINDS = ("EXT_meshopt_compression", "KHR_meshopt_compression")
SIDE = 12


def patch() -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) float32 positions and (F, 3) uint32 faces of a wavy square."""
    x, y = np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij")
    positions = np.stack([x, y, np.sin(x + 0.5 * y)], axis=-1).reshape(-1, 3)
    corner = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    lower = np.stack([corner, corner + SIDE, corner + 1], axis=1)
    upper = np.stack([corner + 1, corner + SIDE, corner + SIDE + 1], axis=1)
    return positions.astype(np.float32), np.concatenate([lower, upper]).astype(np.uint32)


def sorted_corners(positions: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 9): triangles in an order of their own, each from its smallest corner on, so that encoders may reorder."""
    corners = positions[faces].round(2)
    first = [min(range(3), key=lambda k, t=t: tuple(t[k])) for t in corners]
    turned = np.stack([np.roll(t, -k, axis=0) for t, k in zip(corners, first, strict=True)]).reshape(-1, 9)
    return turned[np.lexsort(turned.T[::-1])]


def complaint(builder: GltfBuilder) -> str:
    builder.json.pop("buffers", None)
    with pytest.raises(LuxelError) as caught:
        builder.load()
    assert "\n" not in str(caught.value) and str(caught.value).endswith(".")
    return str(caught.value)


# --- Draco ---------------------------------------------------------------------------------------------------------


def add_draco(builder: GltfBuilder, *, order: bool = False) -> dict[str, Any]:
    """A Draco mesh on a node; returns its primitive."""
    positions, faces = patch()
    normals = np.tile([0.0, 0.6, 0.8], (len(positions), 1))
    joints = np.tile(np.array([1, 0, 0, 0], np.uint8), (len(positions), 1))
    data = DracoPy.encode(
        positions.astype(np.float64), faces, quantization_bits=16, preserve_order=order, normals=normals,
        tex_coord=positions[:, :2].astype(np.float64) / SIDE, generic_attributes={7: joints},
    )  # fmt: skip
    decoded = DracoPy.decode(data)
    identity = {one["attribute_type"]: one["unique_id"] for one in decoded.attributes}
    count = len(decoded.points)
    plain = {"componentType": 5126, "count": count}
    add = builder.add
    attributes = {
        "POSITION": add("accessors", {**plain, "type": "VEC3"}),
        "NORMAL": add("accessors", {**plain, "type": "VEC3"}),
        "TEXCOORD_0": add("accessors", {**plain, "type": "VEC2"}),
        # Read as vertex colours, so that integers are seen to be normalised as the accessor says.
        "COLOR_0": add("accessors", {"componentType": 5121, "count": count, "type": "VEC4", "normalized": True}),
    }
    corners = int(np.asarray(decoded.faces).size)
    indices = add("accessors", {"componentType": 5125, "count": corners, "type": "SCALAR"})
    stored = {"POSITION": identity[0], "NORMAL": identity[1], "TEXCOORD_0": identity[3], "COLOR_0": 7}
    part = {"bufferView": builder.view(data), "attributes": stored}
    primitive = {"attributes": attributes, "indices": indices, "extensions": {DRACO: part}}
    builder.node(mesh=add("meshes", {"primitives": [primitive]}))
    builder.json["extensionsUsed"] = builder.json["extensionsRequired"] = [DRACO]
    return primitive


@pytest.mark.parametrize("order", [False, True])
def test_draco_mesh(builder: GltfBuilder, order: bool) -> None:
    add_draco(builder, order=order)
    data = builder.load()
    mesh = data.objects[0].meshes[0]
    positions, faces = patch()
    np.testing.assert_allclose(sorted_corners(mesh.positions, mesh.faces), sorted_corners(positions, faces), atol=0.011)
    assert mesh.normals is not None and mesh.uv is not None and mesh.colors is not None
    np.testing.assert_allclose(mesh.normals, np.tile([0.0, 0.6, 0.8], (len(mesh.positions), 1)), atol=0.01)
    np.testing.assert_allclose(mesh.uv, mesh.positions[:, :2] / SIDE, atol=1e-3)
    np.testing.assert_allclose(mesh.colors[:, 0], 1.0 / 255.0, atol=1e-6)
    assert not any("Draco" in warning or "draco" in warning for warning in data.warnings)


def test_draco_lies_and_damage(builder: GltfBuilder) -> None:
    primitive = add_draco(builder)
    part, accessors = primitive["extensions"][DRACO], builder.json["accessors"]
    count = accessors[0]["count"]
    for wrong in (count + 1, count - 1, 10**9):
        accessors[0]["count"] = wrong
        assert f"but accessor 0 declares {wrong}" in complaint(builder)
    accessors[0]["count"] = count
    accessors[4]["count"] += 3
    assert "corners but the file declares" in complaint(builder)
    accessors[4]["count"] -= 3
    part["attributes"]["NORMAL"] = 99
    assert "has no attribute 99, which NORMAL asks for" in complaint(builder)
    del part["attributes"]["NORMAL"]
    length = builder.json["bufferViews"][part["bufferView"]]["byteLength"]
    builder.json["bufferViews"][part["bufferView"]]["byteLength"] = length // 2
    assert "damaged or no mesh" in complaint(builder)
    builder.json["bufferViews"][part["bufferView"]]["byteLength"] = 10**7
    assert "past the end of buffer 0" in complaint(builder)


def test_damaged_draco_never_crashes(builder: GltfBuilder) -> None:
    add_draco(builder)
    whole, rng = bytes(builder.blob), np.random.default_rng(3)
    for _ in range(150):
        builder.blob = bytearray(whole)
        for place in rng.integers(0, len(whole), 3):
            builder.blob[place] = int(rng.integers(256))
        try:
            builder.load()
        except LuxelError as error:
            assert "\n" not in str(error)


def test_missing_draco_decoder(builder: GltfBuilder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    primitive = add_draco(builder)
    assert "pip install 'luxel[compressed]'" in complaint(builder)
    # A plain copy beside it serves as well.
    positions, faces = patch()
    primitive["attributes"] = {"POSITION": builder.accessor(positions)}
    primitive["indices"] = builder.accessor(faces.ravel(), "uint32")
    builder.json.pop("buffers", None)
    assert builder.load().objects[0].meshes[0].positions.tolist() == positions.tolist()


# --- meshopt -------------------------------------------------------------------------------------------------------


def packed_view(
    builder: GltfBuilder,
    values: np.ndarray,
    mode: str,
    kind: str = KINDS[0],
    coder: str | None = None,
    version: int = 0,
) -> int:
    """A buffer view whose bytes are compressed, with no plain copy; `values` (N, ...) are what is stored."""
    data = meshopt.encode_gltf_buffer(values, mode, version)
    stride = values.nbytes // len(values)
    packed = builder.view(data)
    entry = builder.json["bufferViews"][packed]
    part = {**entry, "byteStride": stride, "count": len(values), "mode": mode}
    if coder is not None:
        part["filter"] = coder
    entry.update(buffer=1, byteOffset=0, byteLength=values.nbytes, extensions={kind: part})
    if mode == "ATTRIBUTES":
        entry["byteStride"] = stride
    return packed


def add_meshopt(builder: GltfBuilder, kind: str = KINDS[0], mode: str = "TRIANGLES", version: int = 0) -> None:
    positions, faces = patch()
    place = packed_view(builder, np.pad(positions, ((0, 0), (0, 1))), "ATTRIBUTES", kind, version=version)
    order = packed_view(builder, faces.ravel(), mode, kind)
    add = builder.add
    attributes = {
        "POSITION": add(
            "accessors", {"bufferView": place, "componentType": 5126, "count": len(positions), "type": "VEC3"}
        )
    }
    indices = add("accessors", {"bufferView": order, "componentType": 5125, "count": faces.size, "type": "SCALAR"})
    builder.node(mesh=add("meshes", {"primitives": [{"attributes": attributes, "indices": indices}]}))
    builder.json["extensionsUsed"] = builder.json["extensionsRequired"] = [kind]
    declare(builder, kind)


def declare(builder: GltfBuilder, kind: str) -> None:
    plain = {"byteLength": 1 << 20, "extensions": {kind: {"fallback": True}}}
    builder.json["buffers"] = [{"byteLength": len(builder.blob)}, plain]


def first_mesh(builder: GltfBuilder) -> Mesh:
    return builder.load().objects[0].meshes[0]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mode", ["TRIANGLES", "INDICES"])
def test_meshopt_mesh(builder: GltfBuilder, kind: str, mode: str) -> None:
    add_meshopt(builder, kind, mode, version=int(kind.startswith("KHR")))
    mesh = first_mesh(builder)
    positions, faces = patch()
    assert mesh.positions.tolist() == positions.tolist(), "the codec is exact"
    np.testing.assert_allclose(sorted_corners(mesh.positions, mesh.faces), sorted_corners(positions, faces))


def test_meshopt_filters(builder: GltfBuilder) -> None:
    positions, faces = patch()
    wide = np.pad(positions, ((0, 0), (0, 1)))
    rng = np.random.default_rng(5)
    normals = rng.normal(size=(len(positions), 3))
    normals = np.pad(normals / np.linalg.norm(normals, axis=1, keepdims=True), ((0, 0), (0, 1)))
    colors = rng.random((len(positions), 4))
    kind, count = KINDS[1], {"count": len(positions)}
    views = [
        packed_view(builder, meshopt.encode_filter_exp(wide, 20), "ATTRIBUTES", kind, "EXPONENTIAL"),
        packed_view(builder, meshopt.encode_filter_oct(normals, 8, 16), "ATTRIBUTES", kind, "OCTAHEDRAL"),
        packed_view(builder, meshopt.encode_filter_color(colors, 8, 14), "ATTRIBUTES", kind, "COLOR"),
    ]
    add = builder.add
    attributes = {
        "POSITION": add("accessors", {**count, "bufferView": views[0], "componentType": 5126, "type": "VEC3"}),
        "NORMAL": add(
            "accessors", {**count, "bufferView": views[1], "componentType": 5122, "type": "VEC3", "normalized": True}
        ),
        "COLOR_0": add(
            "accessors", {**count, "bufferView": views[2], "componentType": 5123, "type": "VEC4", "normalized": True}
        ),
    }
    indices = builder.accessor(faces.ravel(), "uint32")
    builder.node(mesh=add("meshes", {"primitives": [{"attributes": attributes, "indices": indices}]}))
    declare(builder, kind)
    mesh = first_mesh(builder)
    np.testing.assert_allclose(mesh.positions, positions, atol=1e-3)
    assert mesh.normals is not None and mesh.colors is not None
    np.testing.assert_allclose(mesh.normals, normals[:, :3], atol=1e-3)
    np.testing.assert_allclose(mesh.colors, colors, atol=2e-3)


def test_meshopt_turns_of_instances(builder: GltfBuilder) -> None:
    angle = np.linspace(0.0, 3.0, 20)
    turns = np.stack([0.0 * angle, np.sin(angle / 2.0), 0.0 * angle, np.cos(angle / 2.0)], axis=1)
    view = packed_view(builder, meshopt.encode_filter_quat(turns, 8, 16), "ATTRIBUTES", KINDS[0], "QUATERNION")
    rotation = builder.add(
        "accessors", {"bufferView": view, "componentType": 5122, "count": 20, "type": "VEC4", "normalized": True}
    )
    extension = {"EXT_mesh_gpu_instancing": {"attributes": {"ROTATION": rotation}}}
    builder.node(mesh=builder.mesh(), extensions=extension)
    declare(builder, KINDS[0])
    found = np.array([item.to_world[:3, 2] for item in builder.load().objects])
    np.testing.assert_allclose(found, np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=1), atol=1e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"count": 145}, "holds 2320 bytes unpacked but declares 2304"),
        ({"count": 143}, "holds 2288 bytes unpacked but declares 2304"),
        ({"count": -1}, "declares -1 compressed rows"),
        ({"count": "many"}, "declares many compressed rows"),
        ({"byteStride": 15}, "rows of 15 bytes"),
        ({"byteStride": 512}, "rows of 512 bytes"),
        ({"mode": "SPLINES"}, "unknown mode SPLINES"),
        ({"filter": "SEPIA"}, "filter SEPIA"),
        ({"filter": "QUATERNION"}, "rows of 16 bytes"),
        ({"byteLength": 40}, "is damaged"),
        ({"byteLength": 10**8}, "past the end of buffer 0"),
        ({"byteLength": -4}, "broken byteOffset or byteLength"),
        ({"byteOffset": 9}, "is damaged"),
        ({"buffer": 5}, "buffer 5"),
    ],
)
def test_meshopt_lies(builder: GltfBuilder, change: dict[str, Any], words: str) -> None:
    add_meshopt(builder)
    builder.json["bufferViews"][0]["extensions"][KINDS[0]].update(change)
    with pytest.raises(LuxelError) as caught:
        builder.load()
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_meshopt_claims_are_held_against_the_data(builder: GltfBuilder) -> None:
    """A view of a terabyte out of a kilobyte is refused before it is made."""
    add_meshopt(builder)
    view = builder.json["bufferViews"][0]
    view["extensions"][KINDS[0]]["count"], view["byteLength"] = 2**36, 2**40
    with pytest.raises(LuxelError, match="more than its .* compressed bytes can hold"):
        builder.load()


def test_damaged_meshopt_never_crashes(builder: GltfBuilder) -> None:
    add_meshopt(builder)
    whole, rng = bytes(builder.blob), np.random.default_rng(4)
    refused = 0
    for _ in range(150):
        builder.blob = bytearray(whole)
        for place in rng.integers(0, len(whole), 3):
            builder.blob[place] = int(rng.integers(256))
        try:
            builder.load()
        except LuxelError as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused > 0


def test_missing_meshopt_decoder(builder: GltfBuilder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "meshopt", None)
    add_meshopt(builder)
    with pytest.raises(LuxelError, match=r"pip install 'luxel\[compressed\]'"):
        builder.load()


def test_plain_copy_serves_without_a_decoder(builder: GltfBuilder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "meshopt", None)
    builder.node(mesh=builder.mesh())
    part = {"buffer": 0, "byteOffset": 0, "byteLength": 4, "byteStride": 12, "count": 3, "mode": "ATTRIBUTES"}
    builder.json["bufferViews"][0]["extensions"] = {KINDS[0]: part}
    builder.json["extensionsUsed"] = [KINDS[0]]
    assert first_mesh(builder).positions.tolist() == [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
