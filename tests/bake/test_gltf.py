"""The .glb: two independent readers find the same surfaces, and unlit they show the texels."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
import pytest
import trimesh
from PIL import Image

from luxel.bake.core import Baked, bake_scene
from luxel.bake.files import write_bake
from luxel.bake.gltf import sheet_of, shown, write_glb
from luxel.bake.gltf_materials import UNLIT, VARIANTS
from luxel.image.tonemap import to_display
from luxel.render.renderer import Renderer
from luxel.scene import load

from .conftest import LEAF, SMALL, leaf


@pytest.fixture(scope="module")
def written(cornell: Baked, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, float]:
    path = tmp_path_factory.mktemp("bake") / "box.glb"
    return path, write_glb(cornell, path)


def open_file(path: Path) -> Any:
    file = pygltflib.GLTF2().load(str(path))
    assert file is not None
    return file


def read_accessor(file: Any, number: int) -> np.ndarray:
    accessor = file.accessors[number]
    view = file.bufferViews[accessor.bufferView]
    kind = {pygltflib.FLOAT: np.float32, pygltflib.UNSIGNED_INT: np.uint32}[accessor.componentType]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor.type]
    start = view.byteOffset + (accessor.byteOffset or 0)
    return np.frombuffer(file.binary_blob(), kind, accessor.count * width, start).reshape(-1, width)


def read_picture(file: Any) -> np.ndarray:
    view = file.bufferViews[file.images[0].bufferView]
    return np.asarray(Image.open(io.BytesIO(file.binary_blob()[view.byteOffset :][: view.byteLength])))


def sample(picture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Look a picture up as a viewer does: bilinear, clamped, (0, 0) the first pixel's corner."""
    height, width = picture.shape[:2]
    x, y = np.clip(uv[:, 0] * width - 0.5, 0, width - 1), np.clip(uv[:, 1] * height - 0.5, 0, height - 1)
    i, j = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    u, v = (x - i)[:, None], (y - j)[:, None]
    rows = picture.astype(float)
    low = rows[j, i] * (1 - u) + rows[j, i + 1] * u
    return low * (1 - v) + (rows[j + 1, i] * (1 - u) + rows[j + 1, i + 1] * u) * v


def test_the_file_shows_itself_unlit_by_its_second_coordinates(written: tuple[Path, float]) -> None:
    file = open_file(written[0])
    assert {UNLIT, VARIANTS} <= set(file.extensionsUsed) and not file.extensionsRequired
    for part in (part for mesh in file.meshes for part in mesh.primitives):
        material = file.materials[part.material]
        assert UNLIT in material.extensions
        assert material.pbrMetallicRoughness.baseColorTexture.index == 0
        assert material.pbrMetallicRoughness.baseColorTexture.texCoord == 1
        assert material.pbrMetallicRoughness.baseColorFactor == [1.0, 1.0, 1.0, 1.0]
    assert [node.name for node in file.nodes] == ["room", "large-box", "small-box", "lamp"]


def test_unlit_rendering_equals_the_texels(cornell: Baked, written: tuple[Path, float]) -> None:
    file = open_file(written[0])
    picture = read_picture(file)
    want = to_display(sheet_of(cornell.layout, shown(cornell, False)), written[1]) * 255.0
    seen = 0
    for part in (part for mesh in file.meshes for part in mesh.primitives):
        uv = read_accessor(file, part.attributes.TEXCOORD_1)
        p = read_accessor(file, part.attributes.POSITION)
        triangles = read_accessor(file, part.indices).reshape(-1, 3)
        for weights in ((1 / 3, 1 / 3, 1 / 3), (0.8, 0.1, 0.1), (0.05, 0.5, 0.45)):
            place = np.einsum("i,tij->tj", weights, p[triangles])
            colour = sample(picture, np.einsum("i,tij->tj", weights, uv[triangles]))
            # The same points of luxel's own faces, found by place.
            points = np.einsum("i,fij->fj", weights, cornell.corners)
            near = np.linalg.norm(points[None] - place[:, None], axis=2)
            index = near.argmin(axis=1)
            exact = near.min(axis=1) < 1e-5
            own = np.einsum("i,fij->fj", weights, cornell.layout.uv)[index]
            size = [cornell.layout.width, cornell.layout.height]
            np.testing.assert_allclose(colour[exact], sample(want, (own[exact] + 0.5) / size), atol=1.0)
            seen += int(exact.sum())
    assert seen >= 3 * 30


def test_a_second_reader_finds_the_same_surfaces_and_picture(cornell: Baked, written: tuple[Path, float]) -> None:
    scene = trimesh.load(str(written[0]))
    file = open_file(written[0])
    assert isinstance(scene, trimesh.Scene)
    held = cornell.layout.chart >= 0
    area = 0.5 * np.linalg.norm(
        np.cross(cornell.corners[:, 1] - cornell.corners[:, 0], cornell.corners[:, 2] - cornell.corners[:, 0]), axis=1
    )
    assert sum(len(item.faces) for item in scene.geometry.values()) == held.sum()
    assert scene.area == pytest.approx(area[held].sum(), rel=1e-5)
    rows = np.array(cornell.scene.geometry.triangles).reshape(-1, 4)[cornell.layout.prim[held], 3] >> 16
    for number, part in enumerate(cornell.data.objects, start=1):
        # A primitive each: the reader calls them by their mesh, and numbers them.
        items = [item for name, item in scene.geometry.items() if name.partition("_")[0] == part.name]
        for item in items:
            picture = np.asarray(item.visual.material.baseColorTexture)[..., :3]
            np.testing.assert_array_equal(picture, read_picture(file))
        # Triangles face the side that was lit.
        np.testing.assert_allclose(
            sum((item.face_normals * item.area_faces[:, None]).sum(axis=0) for item in items),
            (cornell.layout.normal[held] * area[held, None])[rows == number].sum(axis=0),
            atol=1e-4,
        )


def test_holes_stay_holes(tmp_path: Path) -> None:
    baked = bake_scene(leaf(), "lightmap", dict(SMALL), frames=2, samples=1)
    write_glb(baked, tmp_path / "leaf.glb")
    file = open_file(tmp_path / "leaf.glb")
    picture = read_picture(file)
    parts = [(mesh.name, part, file.materials[part.material]) for mesh in file.meshes for part in mesh.primitives]
    assert all(UNLIT in item.extensions for _, _, item in parts)
    assert [(name, item.name, item.alphaMode, item.alphaCutoff) for name, _, item in parts] == [
        ("ground", "soil", "OPAQUE", None), ("plant", "leaf", "MASK", 0.5), ("plant", "soil", "OPAQUE", None),
    ]  # fmt: skip
    attributes, indices = parts[1][1].attributes, parts[1][1].indices
    triangles = read_accessor(file, indices).reshape(-1, 3)
    random = np.random.default_rng(1).dirichlet([1, 1, 1], 200)
    p, own, atlas = (
        np.einsum("ni,tij->tnj", random, read_accessor(file, number)[triangles]).reshape(-1, width)
        for number, width in ((attributes.POSITION, 3), (attributes.TEXCOORD_0, 2), (attributes.TEXCOORD_1, 2))
    )
    # The back stands off its front, so that a viewer that draws both sides of both does not mix them.
    assert p[:, 2].max() == 0.0 and -1e-3 < p[:, 2].min() < -1e-5
    # A texel and a half from the leaf's outline it is clear what the look-up must say.
    outside = np.maximum(LEAF[0] - own, own - LEAF[1]).max(axis=1)
    clear = np.abs(outside) > 1.5 * baked.layout.texel_size
    seen = sample(picture, atlas)
    assert ((seen[:, 3] >= 127.5) == (outside < 0.0))[clear].all()
    assert clear.mean() > 0.3 and (outside[clear] < 0.0).any()
    # The hole's black is nowhere in what shows.
    assert seen[seen[:, 3] >= 127.5, :3].min() > 0.6 * seen[seen[:, 3] >= 127.5, :3].max()


def test_the_gutter_is_filled(cornell: Baked) -> None:
    sheet = sheet_of(cornell.layout, np.full((len(cornell.layout.slot), 3), 2.0))
    assert (sheet == 2.0).all()


def test_luxel_shows_what_it_wrote(tmp_path: Path) -> None:
    """Loaded back, the box looks as it did when it was baked: its unlit surfaces shine by themselves."""
    data = load("cornell-box")
    baked = bake_scene(data, "lightmap", {**SMALL, "texel_target": 8192}, samples=16)
    exposure = write_bake(baked, tmp_path / "box.glb")["exposure"]
    again = load(str(tmp_path / "box.glb"))
    assert not [text for text in again.warnings if "unlit" in text or "no light" in text]
    size = (64, 64)
    before = Renderer(data, "lightmap", baked.params, size=size, state=baked.state)
    after = Renderer(again, "none", size=size, camera=data.cameras[0])
    for renderer in (before, after):
        renderer.run(64)
    wanted, seen = before.layers(), after.image()
    # Away from the lamp, which no picture of 8 bits holds, and from edges, which texels blur.
    plain = wanted.hit & (wanted.image().max(axis=2) * exposure < 1.0)
    off = np.abs(seen - wanted.image() * exposure)[plain].mean(axis=1)
    assert np.median(off) < 0.01 and np.quantile(off, 0.8) < 0.03
