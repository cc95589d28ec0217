"""Full materials in a bake: the .glb keeps them, and the paths of `path` see them."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
import pytest
from PIL import Image

import luxel
from luxel.bake.core import Baked, bake_scene
from luxel.bake.files import relight, transport_of, write_bake
from luxel.bake.gltf_materials import UNLIT, VARIANTS
from luxel.bake.light import fingerprint_light
from luxel.errors import LuxelError
from luxel.scene.device import upload
from luxel.scene.library.shapes import quad
from luxel.scene.model import Camera, Material, Object, SceneData, Texture

from .conftest import SMALL
from .test_gltf_keeps import Parts

TINY = {**SMALL, "texel_target": 512, "rays_per_texel": 32, "surfel_target": 64}
MATERIALS: list[dict[str, Any]] = [
    {"name": "gold", "pbrMetallicRoughness": {"baseColorFactor": [1.0, 0.7, 0.3, 1], "metallicFactor": 0.75,
                                              "roughnessFactor": 0.25}},
    {"name": "ball", "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.125},
     "extensions": {"KHR_materials_transmission": {"transmissionFactor": 0.875},
                    "KHR_materials_volume": {"thicknessFactor": 1.0, "attenuationDistance": 0.5,
                                             "attenuationColor": [0.25, 0.5, 0.75]},
                    "KHR_materials_ior": {"ior": 1.75}}},
    {"name": "pane", "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0},
     "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1.0, "transmissionTexture": {"index": 0}}}},
    {"name": "paint", "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.0625, 0.0625, 1], "metallicFactor": 0},
     "emissiveFactor": [0.5, 1.0, 0.25],
     "extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": 0.5, "clearcoatTexture": {"index": 0},
                                                "clearcoatRoughnessFactor": 0.25,
                                                "clearcoatRoughnessTexture": {"index": 0}},
                    "KHR_materials_emissive_strength": {"emissiveStrength": 4.0},
                    "KHR_materials_specular": {"specularFactor": 0.5, "specularTexture": {"index": 0},
                                               "specularColorFactor": [2.0, 1.0, 0.5],
                                               "specularColorTexture": {"index": 0, "extensions": {
                                                   "KHR_texture_transform": {"scale": [2.0, 0.5]}}}}}},
]  # fmt: skip
"""Every extension that luxel writes; all numbers are exact in binary."""
USED = {
    f"KHR_materials_{name}"
    for name in ("clearcoat", "emissive_strength", "ior", "specular", "transmission", "unlit", "variants", "volume")
} | {"KHR_texture_transform"}
PIXELS = np.random.default_rng(5).integers(40, 250, (8, 8, 4), dtype=np.uint8)


def write_shelf(folder: Path) -> Path:
    """Squares of all `MATERIALS` side by side, and a lamp above."""
    parts, stream, meshes = Parts(), io.BytesIO(), []
    Image.fromarray(PIXELS).save(stream, format="PNG")
    flat = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]], float)
    for index in range(len(MATERIALS)):
        attributes = {"POSITION": parts.array(flat + [1.5 * index, 0, 0]), "TEXCOORD_0": parts.array(flat[:, [0, 2]])}
        indices = parts.array(np.array([0, 1, 2, 0, 2, 3]))
        meshes.append({"primitives": [{"attributes": attributes, "indices": indices, "material": index}]})
    nodes: list[dict[str, Any]] = [{"mesh": index} for index in range(len(meshes))]
    lamp = {"extensions": {"KHR_lights_punctual": {"light": 0}}, "translation": [2.0, 2.0, 0.5]}
    picture = parts.view(stream.getvalue())
    file = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(len(meshes) + 1))}],
        "nodes": [*nodes, lamp], "meshes": meshes, "materials": MATERIALS, "textures": [{"source": 0}],
        "images": [{"bufferView": picture, "mimeType": "image/png"}],
        "accessors": parts.accessors, "bufferViews": parts.views,
        "buffers": [{"byteLength": len(parts.blob), "uri": "data:application/octet-stream;base64,"
                     + base64.b64encode(parts.blob).decode()}],
        "extensions": {"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 10}]}},
        "extensionsUsed": ["KHR_lights_punctual", *sorted(USED - {"KHR_materials_unlit", "KHR_materials_variants"})],
    }  # fmt: skip
    path = folder / "shelf.gltf"
    path.write_text(json.dumps(file))
    return path


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The source, and its bake."""
    folder = tmp_path_factory.mktemp("shelf")
    source = write_shelf(folder)
    write_bake(
        bake_scene(luxel.load(source), "lightmap", dict(TINY), frames=2, samples=1, materials="full"),
        folder / "baked.glb",
    )
    return source, folder / "baked.glb"


def own_materials(path: Path) -> dict[str, Any]:
    """Return the materials of the file's variant by their names, each as JSON has it; a texture as its name."""
    file: Any = pygltflib.GLTF2().load(str(path))
    numbers = {part.extensions[VARIANTS]["mappings"][0]["material"] for mesh in file.meshes for part in mesh.primitives}
    found = json.loads(file.to_json())["materials"]
    return {found[number]["name"]: found[number] for number in sorted(numbers)}


def without_textures(part: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in part.items() if not key.endswith("Texture")}


def test_extensions_are_the_files(shelf: tuple[Path, Path]) -> None:
    """What the source says stands in the bake, but for factors at the specification's default."""
    own = own_materials(shelf[1])
    for source in MATERIALS:
        written, extensions = own[source["name"]], source.get("extensions", {})
        assert set(written.get("extensions") or {}) == set(extensions), source["name"]
        for name, part in extensions.items():
            given = written["extensions"][name]
            if name == "KHR_materials_volume":
                # A square has no thickness of its own.
                assert 0.0 < given.pop("thicknessFactor") < 1e-3
                part = {key: value for key, value in part.items() if key != "thicknessFactor"}
            assert without_textures(given) == without_textures(part)
            assert {key for key in given if key.endswith("Texture")} == {key for key in part if key.endswith("Texture")}
        for key in ("metallicFactor", "roughnessFactor"):
            assert written["pbrMetallicRoughness"][key] == source["pbrMetallicRoughness"].get(key, 1)
        base = source["pbrMetallicRoughness"].get("baseColorFactor", [1, 1, 1, 1])
        assert written["pbrMetallicRoughness"]["baseColorFactor"] == base
        assert written.get("alphaMode", "OPAQUE") == "OPAQUE"
    moved = own["paint"]["extensions"]["KHR_materials_specular"]["specularColorTexture"]["extensions"]
    assert moved["KHR_texture_transform"]["scale"] == pytest.approx([2.0, 0.5])
    file: Any = pygltflib.GLTF2().load(str(shelf[1]))
    assert set(file.extensionsUsed) == USED


def test_luxel_reads_the_materials_back(shelf: tuple[Path, Path]) -> None:
    source = {item.name: item for item in luxel.load(shelf[0]).materials}
    own = own_materials(shelf[1])
    again = {}
    for item in luxel.load(shelf[1]).materials:
        # Each stands in the file twice; what is shown is unlit, and reflects nothing.
        if item.name in own and item.specular > 0.0:
            again[item.name] = item
    assert set(again) == set(source)
    for name, item in source.items():
        for field, value in vars(item).items():
            other = getattr(again[name], field)
            if isinstance(value, Texture):
                np.testing.assert_array_equal(other.image, value.image, err_msg=f"{name}.{field}")
                np.testing.assert_allclose(other.transform, value.transform, atol=1e-6)
                assert other.srgb == value.srgb
            else:
                assert other == (pytest.approx(value) if isinstance(value, float | tuple) else value), (name, field)


def test_what_is_shown_is_unlit_and_diffuse(shelf: tuple[Path, Path], tmp_path: Path) -> None:
    """The light is that of diffuse materials, texel for texel, and so is the way it is shown."""
    place = tmp_path / "diffuse.glb"
    bake = bake_scene(luxel.load(shelf[0]), "lightmap", dict(TINY), frames=2, samples=1, materials="diffuse")
    write_bake(bake, place)
    files: list[Any] = [pygltflib.GLTF2().load(str(path)) for path in (shelf[1], place)]
    shown = []
    for file in files:
        numbers = [part.material for mesh in file.meshes for part in mesh.primitives]
        shown.append(
            [(file.materials[n].name, file.materials[n].alphaMode, file.materials[n].extensions) for n in numbers]
        )
        view = file.bufferViews[file.images[0].bufferView]
        shown[-1].append(bytes(file.binary_blob()[view.byteOffset :][: view.byteLength]))
    assert shown[0] == shown[1] and all(UNLIT in material[2] for material in shown[0][:-1])
    assert all(set(item.get("extensions") or {}) <= {"KHR_materials_emissive_strength"}
               for item in own_materials(place).values())  # fmt: skip


def test_a_relit_bake_keeps_its_materials(shelf: tuple[Path, Path], tmp_path: Path) -> None:
    write_bake(relight(transport_of(shelf[1]), luxel.load(shelf[0]), frames=1, samples=1), tmp_path / "relit.glb")
    assert own_materials(tmp_path / "relit.glb")["ball"]["extensions"]["KHR_materials_ior"] == {"ior": 1.75}


# ---------- What only Mitsuba knows ----------


def square(material: Material, *more: Material) -> SceneData:
    """Squares of the materials one above another, the first at the bottom."""
    objects = [
        Object(item.name, [quad((0, y, 1), (1, y, 1), (1, y, 0), (0, y, 0), y)])
        for y, item in enumerate([material, *more])
    ]
    return SceneData("square", objects, [material, *more], cameras=[Camera((0.5, 3.0, 0.5), (0.5, 0.0, 0.4))])


def test_conductors_and_plastics_become_metals_and_coats(tmp_path: Path) -> None:
    gold = Material(
        "gold", metallic=1.0, roughness=0.5, eta=(0.2, 0.4, 1.4), k=(3.0, 2.5, 2.0), distribution="beckmann",
        specular_color=(0.5, 1.0, 1.0),
    )  # fmt: skip
    plastic = Material("plastic", (0.5, 0.25, 0.125), specular=1.0, ior=1.5, interface="plastic", roughness=0.0)
    deep = Material("deep", (0.5, 0.5, 0.5), specular=1.0, ior=1.5, interface="plastic", nonlinear=True)
    chalk = Material("chalk", (0.75, 0.75, 0.75))
    bake = bake_scene(square(gold, plastic, deep, chalk), "lightmap", dict(TINY), frames=1, samples=1, materials="full")
    said = " ".join(bake.notes)
    assert "straight on: 'gold'." in said and "coat: 'plastic', 'deep'." in said and "GGX: 'gold'." in said
    write_bake(bake, tmp_path / "baked.glb")
    own = own_materials(tmp_path / "baked.glb")
    # ((eta - 1)^2 + k^2) / ((eta + 1)^2 + k^2), and half of it for red.
    wanted = [0.5 * 9.64 / 10.44, 6.61 / 8.21, 4.16 / 9.76, 1.0]
    rough = own["gold"]["pbrMetallicRoughness"]
    assert rough["baseColorFactor"] == pytest.approx(wanted) and rough["metallicFactor"] == 1.0
    assert rough["roughnessFactor"] == 0.5 and own["plastic"]["pbrMetallicRoughness"]["roughnessFactor"] == 0.0
    # glTF's default is a full coat of index 1.5; what is matt has to say so.
    assert not own["plastic"].get("extensions")
    assert own["plastic"]["pbrMetallicRoughness"]["baseColorFactor"] == [0.5, 0.25, 0.125, 1.0]
    assert own["chalk"]["extensions"] == {"KHR_materials_specular": {"specularFactor": 0.0}}
    # An index of 1.5 reflects 0.0918 of even light from outside, 0.5963 from inside (Egan and Hilgeman 1979).
    inside = 1.0 - (1.0 - 0.0918) / 1.5**2
    deeper = 0.5 * (1.0 - inside) / (1.0 - 0.5 * inside)
    assert own["deep"]["pbrMetallicRoughness"]["baseColorFactor"][0] == pytest.approx(deeper, rel=1e-3)


def test_indices_below_one_take_the_nearest_form(tmp_path: Path) -> None:
    """KHR_materials_ior knows 0 and 1 or more; ((n - 1) / (n + 1))^2 is the same for n and 1 / n."""
    coat = Material("coat", specular=1.0, ior=0.8)
    bubble = Material("bubble", (1.0, 1.0, 1.0), specular=1.0, ior=0.75, transmission=1.0, roughness=0.0)
    bake = bake_scene(square(coat, bubble), "lightmap", dict(TINY), frames=1, samples=1, materials="full")
    assert [note for note in bake.notes if "thinner" in note and "'bubble'" in note and "'coat'" not in note]
    write_bake(bake, tmp_path / "baked.glb")
    own = own_materials(tmp_path / "baked.glb")
    found = {name: own[name]["extensions"]["KHR_materials_ior"]["ior"] for name in ("coat", "bubble")}
    assert found == {"coat": pytest.approx(1.25), "bubble": 1.0}


# ---------- Light ----------


def mirror_box() -> SceneData:
    """A floor that glows with radiance 1 and reflects nothing, shut in by mirrors that keep all light."""
    floor = Material("floor", (0.0, 0.0, 0.0), emission=(1.0, 1.0, 1.0))
    mirror = Material("mirror", (1.0, 1.0, 1.0), metallic=1.0, roughness=0.0)
    corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
    sides = [
        quad((a, 0, b), (c, 0, d), (c, 1, d), (a, 1, b), 1)
        for (a, b), (c, d) in zip(corners, corners[1:] + corners[:1], strict=True)
    ]
    roof = quad((0, 1, 0), (1, 1, 0), (1, 1, 1), (0, 1, 1), 1)
    objects = [Object("floor", [quad((0, 0, 1), (1, 0, 1), (1, 0, 0), (0, 0, 0), 0)]), Object("box", [*sides, roof])]
    return SceneData("mirror-box", objects, [floor, mirror], cameras=[Camera((0.5, 0.5, 0.9), (0.5, 0.3, 0.1))])


def on(bake: Baked, material: int) -> np.ndarray:
    """Return which texels (M,) lie on what has the material."""
    from luxel.kernels.triangle import read_triangles

    starts = np.minimum(bake.layout.starts[:-1], len(bake.layout.face) - 1)
    of_texel = read_triangles(bake.scene).material[bake.layout.prim[bake.layout.face[starts]]]
    return (of_texel == material) & (np.diff(bake.layout.starts) > 0) & bake.layout.open


@pytest.mark.parametrize(("materials", "wanted"), [("full", np.pi), ("diffuse", 0.0)])
def test_paths_see_mirrors(materials: Any, wanted: float) -> None:
    """Wherever a ray from the floor goes, it comes back to the floor: E is pi times its radiance."""
    bake = bake_scene(mirror_box(), "path", {"texel_target": 256}, samples=16, materials=materials)
    light = bake.light.irradiance[on(bake, 0)]
    assert light.mean() == pytest.approx(wanted, rel=0.01)
    assert bool([note for note in bake.notes if "metals are black there" in note]) == (materials == "full")


def test_glass_is_shown_as_under_diffuse_materials(tmp_path: Path) -> None:
    """A half clear pane: half of what it shows is what lies behind it, the other half of its own colour."""
    half = np.full((2, 2, 3), 255, np.uint8)
    pane = Material(
        "pane", (0.5, 0.25, 0.75), specular=1.0, transmission=0.5, transmission_texture=Texture(half, srgb=False)
    )
    wall = Material("wall", (0.25, 0.25, 0.25))
    for materials in ("full", "diffuse"):
        bake = bake_scene(square(wall, pane), "path", {"texel_target": 256}, samples=1, materials=materials)
        texels = on(bake, 1)
        assert texels.any()
        np.testing.assert_allclose(bake.light.opacity[texels], 0.5, atol=1e-2)
        np.testing.assert_allclose(bake.light.albedo[texels], np.tile([0.5, 0.25, 0.75], (texels.sum(), 1)), atol=1e-2)
        write_bake(bake, tmp_path / "pane.glb")
        file: Any = pygltflib.GLTF2().load(str(tmp_path / "pane.glb"))
        modes = {
            file.materials[part.material].name: file.materials[part.material].alphaMode
            for mesh in file.meshes for part in mesh.primitives
        }  # fmt: skip
        assert modes == {"wall": "OPAQUE", "pane": "BLEND"}


# ---------- The rest ----------


def test_gloss_of_one_material_among_many_counts_for_what_is_kept() -> None:
    """A stopped bake must not go on from the light of other materials, however many there are."""
    grey = [Material(f"m{index}", specular=1.0) for index in range(400)]
    layout = bake_scene(square(Material("one")), "lightmap", dict(TINY), frames=1, samples=1).layout
    marks = []
    for roughness in (0.0, 0.5):
        grey[200] = Material("m200", specular=1.0, clearcoat=0.5, clearcoat_roughness=roughness)
        data = square(grey[0])
        data.materials = list(grey)
        scene = upload(data, materials="full")
        marks.append(fingerprint_light(scene, layout, "path", 0, True))
    assert marks[0] != marks[1]


def test_materials_that_are_none_are_refused() -> None:
    with pytest.raises(LuxelError, match="there are no materials 'shiny'"):
        bake_scene(mirror_box(), materials="shiny")  # type: ignore[arg-type]
