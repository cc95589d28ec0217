"""Names, URIs and containers as real exporters write them."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from luxel.errors import LuxelError
from luxel.scene.gltf import load_gltf
from luxel.scene.gltf.uris import find_file

if TYPE_CHECKING:
    from conftest import GltfBuilder


def make_files(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(name)
    return folder / "scene.gltf"


@pytest.mark.parametrize(
    ("uri", "files", "wanted"),
    [
        ("a b.bin", ["a b.bin"], "a b.bin"),
        ("a%20b.bin", ["a b.bin"], "a b.bin"),
        ("a%20b.bin", ["a%20b.bin"], "a%20b.bin"),
        ("a%20b.bin", ["a b.bin", "a%20b.bin"], "a b.bin"),
        ("50%25.bin", ["50%.bin", "50%25.bin"], "50%.bin"),
        ("tex\\sub\\a.bin", ["tex/sub/a.bin"], "tex/sub/a.bin"),
        ("tex%5Ca.bin", ["tex/a.bin"], "tex/a.bin"),
        ("a.bin?v=3&w=1", ["a.bin"], "a.bin"),
        ("a.bin#part", ["a.bin"], "a.bin"),
        ("a#1.bin", ["a", "a#1.bin"], "a#1.bin"),
        ("TEX\\A.BIN?x", ["tex/a.bin"], "tex/a.bin"),
        ("./tex/../tex/a.bin", ["tex/a.bin"], "tex/a.bin"),
        ("Tex/wood.png", ["tex/Wood.PNG"], "tex/Wood.PNG"),
        ("a.bin", ["A.bin", "a.bin"], "a.bin"),
        ("caf\u00e9.bin", ["cafe\u0301.bin"], "cafe\u0301.bin"),
        ("caf%C3%A9.bin", ["caf\u00e9.bin"], "caf\u00e9.bin"),
        ("a.bin", ["sub/A.bin", "a.BIN"], "a.BIN"),
    ],
)
def test_uris_are_found(tmp_path: Path, uri: str, files: list[str], wanted: str) -> None:
    found = find_file(make_files(tmp_path, *files), uri)
    assert found.read_text() == wanted


@pytest.mark.parametrize(
    "uri",
    ["../secret.bin", "a/../../secret.bin", "%2e%2e/secret.bin", "..\\secret.bin", "a\\..\\..\\SECRET.bin",
     "{folder}/secret.bin", "file://{folder}/secret.bin", "C:\\secret.bin", "link.bin",
     "out/secret.bin", "..%5csecret.bin"],
)  # fmt: skip
def test_nothing_outside_the_folder_is_read(tmp_path: Path, uri: str) -> None:
    (tmp_path / "secret.bin").write_text("secret")
    inside = tmp_path / "inside"
    make_files(inside, "a/x.bin")
    (inside / "link.bin").symlink_to(tmp_path / "secret.bin")
    (inside / "out").symlink_to(tmp_path)
    with pytest.raises(OSError, match="out of the file's folder|outside the file's folder"):
        find_file(inside / "scene.gltf", uri.format(folder=tmp_path))


def test_links_within_the_folder_are_followed(tmp_path: Path) -> None:
    path = make_files(tmp_path, "store/a.bin", "store/real.gltf")
    (tmp_path / "b.bin").symlink_to(tmp_path / "store/a.bin")
    assert find_file(path, "b.bin").read_text() == "store/a.bin"
    # A cache keeps the files elsewhere and links all of them.
    view = tmp_path / "view"
    view.mkdir()
    (view / "scene.gltf").symlink_to(tmp_path / "store/real.gltf")
    (view / "a.bin").symlink_to(tmp_path / "store/a.bin")
    assert find_file(view / "scene.gltf", "a.bin").read_text() == "store/a.bin"


@pytest.mark.parametrize("kind", ["buffer", "image"])
def test_two_files_that_differ_only_in_case(builder: GltfBuilder, kind: str) -> None:
    make_files(builder.folder, "DATA.bin", "Data.bin")
    texture = builder.add("textures", {"source": builder.add("images", {"uri": "data.bin"})})
    pbr = {"baseColorTexture": {"index": texture}} if kind == "image" else {}
    builder.node(mesh=builder.mesh(material=builder.add("materials", {"pbrMetallicRoughness": pbr})))
    if kind == "buffer":
        builder.json["buffers"] = [{"byteLength": len(builder.blob), "uri": "data.bin"}]
    with pytest.raises(LuxelError) as caught:
        load_gltf(builder.write("scene.gltf"))
    message = str(caught.value)
    assert "'DATA.bin' and 'Data.bin', which differ only in letter case" in message and "\n" not in message


@pytest.mark.parametrize("uri", ["my%20data.bin", "MY DATA.BIN", ".\\my data.bin", "my data.bin?raw=1"])
def test_buffers_are_found(builder: GltfBuilder, uri: str) -> None:
    builder.node(mesh=builder.mesh())
    (builder.folder / "my data.bin").write_bytes(builder.blob)
    builder.json["buffers"] = [{"byteLength": len(builder.blob), "uri": uri}]
    assert len(load_gltf(builder.write("scene.gltf")).objects) == 1


@pytest.mark.parametrize("uri", ["pic%20ture.png", "PIC TURE.png", "pic ture.png?v=2"])
def test_images_are_found(builder: GltfBuilder, uri: str) -> None:
    stream = io.BytesIO()
    Image.fromarray(np.full((1, 1, 3), 7, np.uint8)).save(stream, "PNG")
    (builder.folder / "pic ture.png").write_bytes(stream.getvalue())
    texture = builder.add("textures", {"source": builder.add("images", {"uri": uri})})
    pbr = {"baseColorTexture": {"index": texture}, "metallicFactor": 0.0}
    builder.node(mesh=builder.mesh(material=builder.add("materials", {"pbrMetallicRoughness": pbr})))
    found = builder.load().materials[0].base_color_texture
    assert found is not None and found.image.tolist() == [[[7, 7, 7]]]


def test_images_outside_are_named(builder: GltfBuilder) -> None:
    texture = builder.add("textures", {"source": builder.add("images", {"uri": "../up.png"})})
    pbr = {"baseColorTexture": {"index": texture}, "metallicFactor": 0.0}
    builder.node(mesh=builder.mesh(material=builder.add("materials", {"pbrMetallicRoughness": pbr})))
    assert any("../up.png lies outside the file's folder" in warning for warning in builder.load().warnings)


def test_data_uris_in_other_spellings(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh())
    path = builder.write("scene.gltf")
    text = path.read_text()
    for change in ("DATA:application/octet-stream;base64,", "data:;base64,%20"):
        path.write_text(text.replace("data:application/octet-stream;base64,", change))
        assert len(load_gltf(path).objects) == 1


# --- containers ----------------------------------------------------------------------------------------------------


def repacked(builder: GltfBuilder, padding: bytes, *, counted: bool = True, total: int = 0) -> Path:
    """A .glb whose JSON chunk is padded by `padding`, which its length counts or not."""
    text = json.dumps(builder.json).encode()
    pad = padding * (-len(text) % 4)
    text = text + (pad if pad or not counted else padding * 4)
    length = len(text) if counted else len(text.rstrip(padding))
    chunks = struct.pack("<I4s", length, b"JSON") + text
    chunks += struct.pack("<I4s", len(builder.blob), b"BIN\0") + builder.blob
    path = builder.folder / "padded.glb"
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks) + total) + chunks)
    return path


@pytest.mark.parametrize("extra", range(4))
@pytest.mark.parametrize("padding", [b"\0", b" ", b"\n", b"\t"])
def test_padding_of_every_kind(builder: GltfBuilder, padding: bytes, extra: int) -> None:
    builder.node(mesh=builder.mesh(), name="n" * (extra + 1))
    builder.json["buffers"] = [{"byteLength": len(builder.blob)}]
    assert len(load_gltf(repacked(builder, padding)).objects) == 1


@pytest.mark.parametrize("extra", range(4))
def test_padding_that_the_chunk_does_not_count(builder: GltfBuilder, extra: int) -> None:
    builder.node(mesh=builder.mesh(), name="n" * (extra + 1))
    builder.json["buffers"] = [{"byteLength": len(builder.blob)}]
    assert len(load_gltf(repacked(builder, b" ", counted=False)).objects) == 1


def test_length_of_the_file_that_leaves_out_the_last_padding(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh())
    builder.json["buffers"] = [{"byteLength": len(builder.blob)}]
    assert len(load_gltf(repacked(builder, b" ", total=-2)).objects) == 1


def test_text_file_with_a_mark_and_zero_bytes_at_its_end(builder: GltfBuilder) -> None:
    builder.node(mesh=builder.mesh())
    path = builder.write("scene.gltf")
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes() + b"\r\n\0\0")
    assert len(load_gltf(path).objects) == 1


# --- names ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".gltf", ".glb"])
def test_names_in_latin_1_are_repaired(builder: GltfBuilder, suffix: str) -> None:
    builder.node(mesh=builder.mesh(), name="K1che 20 m3")
    builder.node(mesh=builder.mesh(), name="plain")
    path = builder.write("scene" + suffix)
    path.write_bytes(path.read_bytes().replace(b"K1che 20 m3", b"K\xfcche 20 m\xb2"))
    data = load_gltf(path)
    assert [item.name for item in data.objects] == ["Küche 20 m²", "plain"]
    assert sum("not UTF-8" in one and "Küche 20 m²" in one for one in data.warnings) == 1


def test_sound_names_bring_no_warning(builder: GltfBuilder) -> None:
    names = ["Küche", "台所", "naïve \u00a0 space", "🌲"]
    for name in names:
        builder.node(mesh=builder.mesh(), name=name)
    data = builder.load()
    assert [item.name for item in data.objects] == names
    assert not any("repaired" in warning or "UTF-8" in warning for warning in data.warnings)


def test_half_letters_and_controls_are_repaired(builder: GltfBuilder) -> None:
    lamp = builder.light(type="point", name="la\ud800mp")
    builder.node(mesh=builder.mesh(name="two\nlines"))
    builder.node(extensions=lamp)
    data = builder.load()
    assert data.objects[0].name == "two\ufffdlines" and data.lights[0].name == "la\ufffdmp"
    assert any("repaired: two\ufffdlines, la\ufffdmp" in warning for warning in data.warnings)
    "".join(data.warnings).encode()


def test_bytes_that_are_no_text_at_all(tmp_path: Path) -> None:
    path = tmp_path / "bad.gltf"
    path.write_bytes(b"\x93NUMPY\x01\x00v\x00")
    with pytest.raises(LuxelError, match="not valid JSON"):
        load_gltf(path)
