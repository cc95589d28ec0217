"""Mitsuba files: geometry, materials, lights and cameras against Mitsuba's own answers."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.scene import load
from luxel.scene.diffuse import as_diffuse
from luxel.scene.edit import scene_bounds
from luxel.scene.model import Mesh, SceneData

GREY = '<bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.4, 0.6"/></bsdf>'
LAMP = '<emitter type="area"><rgb name="radiance" value="3, 2, 1"/></emitter>'


def load_text(folder: Path, body: str) -> SceneData:
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{body}</scene>')
    return load(path)


def message_of(folder: Path, text: str) -> str:
    path = folder / "scene.xml"
    path.write_text(text)
    with pytest.raises(LuxelError) as caught:
        load(path)
    assert "\n" not in str(caught.value) and str(caught.value).endswith(".")
    return str(caught.value)


def full_scene(data: SceneData) -> Any:
    """The scene as Mitsuba loaded it."""
    assert data.mitsuba_full is not None
    scene = data.mitsuba_full()
    assert isinstance(scene, mi.Scene)
    return scene


def face_normals(mesh: Mesh) -> np.ndarray:
    corners = mesh.positions[mesh.faces].astype(float)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def area_of(mesh: Mesh) -> float:
    corners = mesh.positions[mesh.faces].astype(float)
    return (
        float(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()) / 2
    )


@pytest.mark.parametrize(
    ("shape", "area"),
    [
        ('type="sphere"><point name="center" x="1" y="2" z="3"/><float name="radius" value="0.5"/>', math.pi),
        ('type="cylinder"><point name="p0" x="0" y="0" z="0"/><point name="p1" x="0" y="2" z="0"/>', 4 * math.pi),
        ('type="disk"><transform name="to_world"><scale value="2"/></transform>', 4 * math.pi),
        ('type="rectangle"><transform name="to_world"><rotate y="1" angle="30"/></transform>', 4.0),
        ('type="cube">', 24.0),
    ],
)
@pytest.mark.parametrize("flipped", [False, True])
def test_shapes_have_mitsubas_area_place_and_front(tmp_path: Path, shape: str, area: float, flipped: bool) -> None:
    flag = '<boolean name="flip_normals" value="true"/>' if flipped else ""
    data = load_text(tmp_path, f"<shape {shape}{flag}{GREY}{LAMP}</shape>")
    mesh = data.objects[0].meshes[0]
    assert area_of(mesh) == pytest.approx(area, rel=0.01)
    full = full_scene(data)
    bounds = full.bbox()
    assert np.allclose(mesh.positions.min(axis=0), np.array(bounds.min).ravel(), atol=0.02)
    assert np.allclose(mesh.positions.max(axis=0), np.array(bounds.max).ravel(), atol=0.02)
    # Mitsuba's normal at the middle of our triangles, met from both sides.
    middle, normal = mesh.positions[mesh.faces].mean(axis=1).astype(float), face_normals(mesh)
    start = middle + normal * 0.05
    ray = mi.Ray3f(mi.Point3f(*start.T.astype(np.float32)), mi.Vector3f(*(-normal).T.astype(np.float32)))
    hit = full.ray_intersect(ray)
    assert np.allclose(np.array(hit.t), 0.05, atol=0.02)
    agreement = np.einsum("ij,ij->i", np.array(hit.n).T, normal)
    assert (agreement > 0.97).all(), "our fronts are Mitsuba's"
    if mesh.uv is not None:
        ours = mesh.uv[mesh.faces].mean(axis=1)
        assert np.abs(np.array(hit.uv).T - ours).mean() < 0.02
    if mesh.normals is not None:
        smooth = mesh.normals[mesh.faces].mean(axis=1)
        assert (np.einsum("ij,ij->i", smooth, normal) > 0.9).all()


def test_plain_materials(tmp_path: Path) -> None:
    data = load_text(
        tmp_path,
        f"""
        <shape type="rectangle" id="one">{GREY}</shape>
        <shape type="rectangle" id="two"><bsdf type="twosided">{GREY}</bsdf></shape>
        <shape type="rectangle" id="glass"><bsdf type="dielectric" id="pane"/></shape>
        <shape type="rectangle" id="thin"><bsdf type="thindielectric" id="film"/></shape>
        <shape type="rectangle" id="metal"><bsdf type="roughconductor" id="steel"/></shape>
        <shape type="rectangle" id="plastic"><bsdf type="plastic" id="cup">
          <rgb name="diffuse_reflectance" value="0.1, 0.2, 0.3"/></bsdf></shape>
        <shape type="rectangle" id="mask"><bsdf type="mask"><float name="opacity" value="0.25"/>{GREY}</bsdf></shape>
        <shape type="rectangle" id="lamp">{GREY}{LAMP}</shape>""",
    )
    by_object = {item.name: as_diffuse(data.materials[item.meshes[0].material]) for item in data.objects}
    assert np.allclose(by_object["one"].base_color, (0.2, 0.4, 0.6)) and not by_object["one"].reflect_back
    assert by_object["one"].base_color_texture is None and by_object["one"].alpha_mode == "opaque"
    assert by_object["two"].reflect_back
    for name in ("glass", "thin"):
        assert by_object[name].alpha < by_object[name].alpha_cutoff and by_object[name].alpha_mode == "mask"
    assert by_object["metal"].base_color == (0.0, 0.0, 0.0)
    assert np.allclose(by_object["plastic"].base_color, (0.1, 0.2, 0.3))
    assert by_object["mask"].alpha == pytest.approx(0.25) and by_object["mask"].alpha_mode == "blend"
    assert np.allclose(by_object["mask"].base_color, (0.2, 0.4, 0.6))
    assert np.allclose(by_object["lamp"].emission, (3, 2, 1)) and not by_object["lamp"].emit_back
    said = " ".join(data.warnings)
    assert "pane, film" in said and "steel" in said and "cup" in said
    assert len(data.warnings) == len(set(data.warnings)) == 3


def write_texture(folder: Path) -> np.ndarray:
    pixels = np.random.default_rng(3).integers(20, 230, (8, 4, 3)).astype(np.uint8)
    mi.Bitmap(pixels).write(str(folder / "texture.png"))
    return pixels


def read_texture(data: SceneData, uv: np.ndarray) -> np.ndarray:
    """Nearest texel, by the model's own rules, as linear RGB."""
    texture = data.materials[0].base_color_texture
    assert texture is not None and texture.image.dtype == np.uint8 and texture.srgb
    st = uv @ texture.transform[:2, :2].T + texture.transform[:2, 2]
    height, width = texture.image.shape[:2]
    column, row = (np.floor(st[:, axis] * size).astype(int) % size for axis, size in ((0, width), (1, height)))
    return srgb_to_linear(texture.image[row, column, :3] / 255.0)


@pytest.mark.parametrize(
    "to_uv", ["", '<scale x="2.5" y="3"/>', '<rotate z="1" angle="30"/><translate x="0.2" y="0.7"/>']
)
def test_textures_are_baked_as_mitsuba_reads_them(tmp_path: Path, to_uv: str) -> None:
    write_texture(tmp_path)
    transform = f'<transform name="to_uv">{to_uv}</transform>' if to_uv else ""
    data = load_text(
        tmp_path,
        f"""<shape type="rectangle"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">
        <string name="filename" value="texture.png"/><string name="filter_type" value="nearest"/>{transform}
        </texture></bsdf></shape><emitter type="constant"/>""",
    )
    assert not [text for text in data.warnings if "repeat" in text]
    uv = np.random.default_rng(4).uniform(0.0, 1.0, (500, 2))
    scene = full_scene(data)
    points = np.stack([uv[:, 0] * 2 - 1, uv[:, 1] * 2 - 1, np.ones(500)]).astype(np.float32)
    hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(*points), mi.Vector3f(0, 0, -1)))
    theirs = np.array(hit.bsdf().eval_diffuse_reflectance(hit)).T
    close = np.abs(read_texture(data, np.array(hit.uv).T) - theirs).max(axis=1) < 0.01
    assert close.mean() > 0.97, "all but points on the edge of a texel"


def test_masks_emission_and_wraps_are_baked(tmp_path: Path) -> None:
    write_texture(tmp_path)
    bitmap = '<string name="filename" value="texture.png"/>'
    data = load_text(
        tmp_path,
        f"""
        <shape type="rectangle"><bsdf type="mask"><texture type="checkerboard" name="opacity">
          <float name="color0" value="0"/><float name="color1" value="1"/></texture>{GREY}</bsdf></shape>
        <shape type="rectangle">{GREY}<emitter type="area"><texture type="bitmap" name="radiance">{bitmap}
          </texture></emitter></shape>
        <shape type="rectangle"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">{bitmap}
          <string name="wrap_mode" value="clamp"/></texture></bsdf></shape>
        <shape type="rectangle"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">{bitmap}
          <string name="wrap_mode" value="mirror"/></texture></bsdf></shape>""",
    )
    mask, lamp, clamp, mirror = data.materials
    assert mask.base_color_texture is not None and mask.base_color_texture.image.shape[2] == 4
    assert mask.base_color_texture.image[..., 3].mean() == pytest.approx(127.5, abs=2) and mask.alpha_cutoff == 0.5
    assert lamp.emission_texture is not None
    image = lamp.emission_texture.image
    assert image.dtype == np.float32 and image.max() == pytest.approx(1.0) and lamp.emission[0] > 0
    assert not lamp.emission_texture.srgb and lamp.base_color_texture is None
    assert clamp.base_color_texture is not None and clamp.base_color_texture.wrap_u == "clamp"
    assert mirror.base_color_texture is not None and mirror.base_color_texture.wrap_v == "mirror"


def test_lights(tmp_path: Path) -> None:
    data = load_text(
        tmp_path,
        f"""<shape type="cube">{GREY}</shape>
        <emitter type="point"><point name="position" x="1" y="2" z="3"/>
          <rgb name="intensity" value="4, 5, 6"/></emitter>
        <emitter type="directional"><vector name="direction" x="0" y="-2" z="0"/>
          <rgb name="irradiance" value="7, 8, 9"/></emitter>
        <emitter type="spot">
          <transform name="to_world"><lookat origin="0, 5, 0" target="1, 5, 0" up="0, 1, 0"/></transform>
          <rgb name="intensity" value="2, 2, 2"/><float name="cutoff_angle" value="30"/>
          <float name="beam_width" value="10"/></emitter>
        <emitter type="constant"><rgb name="radiance" value="0.1, 0.2, 0.3"/></emitter>""",
    )
    point, sun, spot = data.lights
    assert point.kind == "point" and point.position == (1, 2, 3) and np.allclose(point.color, (4, 5, 6))
    assert sun.kind == "directional" and np.allclose(sun.direction, (0, -1, 0)) and np.allclose(sun.color, (7, 8, 9))
    assert spot.kind == "spot" and np.allclose(spot.direction, (1, 0, 0), atol=1e-6)
    assert np.allclose(spot.position, (0, 5, 0)) and spot.cos_outer == pytest.approx(math.cos(math.radians(30)))
    assert np.allclose(data.sky.color, (0.1, 0.2, 0.3)) and data.sky.image is None and not data.warnings


def test_envmap_is_turned_to_the_models_convention(tmp_path: Path) -> None:
    pixels = np.random.default_rng(5).random((16, 32, 3)).astype(np.float32)
    mi.Bitmap(pixels).write(str(tmp_path / "sky.exr"))
    data = load_text(
        tmp_path,
        f"""<shape type="cube">{GREY}</shape><emitter type="envmap"><string name="filename" value="sky.exr"/>
        <transform name="to_world"><rotate x="1" angle="40"/></transform></emitter>""",
    )
    image = data.sky.image
    # Twice as fine as the file's, so that turning it does not blur.
    assert image is not None and image.shape == (32, 64, 3)
    scene = full_scene(data)
    for row, column, towards in ((16, 32, (0, 0, -1)), (16, 48, (1, 0, 0)), (16, 16, (-1, 0, 0)), (16, 0, (0, 0, 1))):
        hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(0, 50, 0), mi.Vector3f(*towards)))
        theirs = np.array(scene.environment().eval(hit)).ravel()
        # The direction is the common corner of four texels.
        around = [image[r, c % 64] for r in (row - 1, row) for c in (column - 1, column)]
        assert np.allclose(np.mean(around, axis=0), theirs, atol=0.1)
    polar = (np.arange(32) + 0.5) / 32 * math.pi
    mean = (image * np.sin(polar)[:, None, None]).sum() / (np.sin(polar).sum() * 64 * 3)
    assert mean == pytest.approx(0.5, abs=0.05)


def test_broken_pixels_of_a_sky_take_their_neighbours_value(tmp_path: Path) -> None:
    pixels = np.full((16, 32, 3), 0.5, np.float32)
    pixels[4, 9] = np.inf
    pixels[9, 20, 1] = np.nan
    mi.Bitmap(pixels).write(str(tmp_path / "sky.exr"))
    body = f"""<shape type="cube">{GREY}</shape><emitter type="envmap"><string name="filename" value="sky.exr"/>
      </emitter>"""
    data = load_text(tmp_path, body)
    assert data.sky.image is not None and np.allclose(data.sky.image, 0.5, atol=1e-3)
    assert any("NaN or infinity" in text for text in data.warnings)
    mi.Bitmap(np.zeros((16, 32, 3), np.float32)).write(str(tmp_path / "sky.exr"))
    assert "no light" in message_of(tmp_path, f'<scene version="3.0.0">{body}</scene>')


def test_sun_and_sky_are_parted(tmp_path: Path) -> None:
    data = load_text(tmp_path, f'<shape type="cube">{GREY}</shape><emitter type="sunsky"/>')
    assert data.sky.image is not None
    scene = full_scene(data)
    sun = data.lights[0]
    assert sun.kind == "directional" and min(sun.color) > 0
    to_sun = -np.array(sun.direction)
    hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(0, 50, 0), mi.Vector3f(*to_sun.tolist())))
    disc = np.array(scene.environment().eval(hit)).ravel()
    assert disc.mean() > 50 * data.sky.image.mean(), "the sun is where the light says, and not in the sky"
    assert data.sky.image.max() < 0.2 * disc.mean()
    solid_angle = 2 * math.pi * (1 - math.cos(math.radians(0.5358 / 2)))
    assert 0.5 < np.mean(sun.color) / (disc.mean() * solid_angle) < 1.05, "limb darkening takes some of it"


@pytest.mark.parametrize(
    ("axis", "width", "height", "expected"),
    [("x", 200, 100, 50.0), ("smaller", 200, 100, None), ("y", 100, 200, None), ("larger", 100, 200, None)],
)
def test_fov_axes_become_horizontal(tmp_path: Path, axis: str, width: int, height: int, expected: float | None) -> None:
    data = load_text(
        tmp_path,
        f"""<shape type="cube">{GREY}</shape><sensor type="perspective"><float name="fov" value="50"/>
        <string name="fov_axis" value="{axis}"/>
        <transform name="to_world"><lookat origin="1, 2, 9" target="1, 2, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="{width}"/><integer name="height" value="{height}"/></film>
        </sensor>""",
    )
    camera = data.cameras[0]
    horizontal = expected or math.degrees(2 * math.atan(math.tan(math.radians(25)) * width / height))
    assert camera.fov == pytest.approx(horizontal, abs=1e-3)
    assert (
        np.allclose(camera.eye, (1, 2, 9))
        and np.allclose(camera.target, (1, 2, 8))
        and np.allclose(camera.up, (0, 1, 0))
    )


def test_scene_without_sensor_or_light_gets_luxels(tmp_path: Path) -> None:
    data = load_text(tmp_path, f'<shape type="cube">{GREY}</shape>')
    assert not data.cameras and data.sky.color == (0.7, 0.85, 1.0)
    assert len(data.warnings) == 1 and "no light, so it gets the default sky and sun" in data.warnings[0]
    assert data.mitsuba_full is None


GROUP = f"""<shape type="shapegroup" id="group"><shape type="cube">
  <transform name="to_world"><scale value="0.5"/></transform>{GREY}</shape></shape>"""


def instance(place: str, group: str = "group") -> str:
    return f'<shape type="instance"><ref id="{group}"/><transform name="to_world">{place}</transform></shape>'


def test_instances_share_their_meshes(tmp_path: Path) -> None:
    write_grid(tmp_path / "grid.ply", 40)
    many = "".join(instance(f'<translate x="{index % 20}" z="{index // 20}"/>', "grids") for index in range(400))
    grid = f'<shape type="ply"><string name="filename" value="grid.ply"/>{GREY}</shape>'
    data = load_text(
        tmp_path, f'<shape type="shapegroup" id="grids">{grid}{grid}</shape>{many}<emitter type="constant"/>'
    )
    assert len(data.objects) == 400 and len(data.materials) == 2
    assert {len(item.meshes) for item in data.objects} == {2}
    for number in (0, 1):
        assert len({id(item.meshes[number].positions) for item in data.objects}) == 1
    assert [item.to_world[0, 3] for item in data.objects[:3]] == [0.0, 1.0, 2.0]
    full = full_scene(data)
    assert len(full.shapes()) == 400
    low, high = scene_bounds(data)
    assert np.allclose(low, np.array(full.bbox().min).ravel()) and np.allclose(high, np.array(full.bbox().max).ravel())


def write_grid(path: Path, side: int) -> None:
    """A flat square of 2 * side * side triangles."""
    x, y = np.meshgrid(np.linspace(0, 0.9, side + 1), np.linspace(0, 0.9, side + 1))
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    faces = [
        np.stack([first, first + 1, first + side + 2], 1),
        np.stack([first, first + side + 2, first + side + 1], 1),
    ]
    mesh = mi.Mesh("grid", (side + 1) ** 2, 2 * side * side)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.stack([x, y, 0 * x], axis=-1).astype(np.float32).ravel()
    parameters["faces"] = np.concatenate(faces).astype(np.uint32).ravel()
    parameters.update()
    mesh.write_ply(str(path))


def test_instances_stand_where_mitsuba_puts_them(tmp_path: Path) -> None:
    data = load_text(tmp_path, GROUP + instance('<translate x="10"/>') + instance('<scale x="-1"/><translate y="4"/>'))
    assert len(data.objects) == 2 and data.objects[0].meshes[0] is data.objects[1].meshes[0]
    low, high = scene_bounds(data)
    assert np.allclose(low, (-0.5, -0.5, -0.5)) and np.allclose(high, (10.5, 4.5, 0.5))


def test_what_is_included_is_found_in_its_folder(tmp_path: Path) -> None:
    (tmp_path / "parts" / "pictures").mkdir(parents=True)
    write_texture(tmp_path / "parts" / "pictures")
    (tmp_path / "parts" / "materials.xml").write_text(
        """<scene version="3.0.0"><path value="pictures"/><bsdf type="diffuse" id="paint"><texture type="bitmap"
        name="reflectance"><string name="filename" value="texture.png"/></texture></bsdf></scene>"""
    )
    (tmp_path / "parts" / "group.xml").write_text(
        """<scene version="3.0.0"><include filename="materials.xml"/><shape type="shapegroup" id="group">
        <shape type="cube"><ref id="paint"/></shape></shape></scene>"""
    )
    data = load_text(tmp_path, '<path value="parts"/><include filename="parts/group.xml"/>' + instance(""))
    assert data.materials[0].base_color_texture is not None and len(data.objects) == 1 and not data.warnings[1:]


def test_loading_leaves_mitsubas_search_path_alone(tmp_path: Path) -> None:
    before = str(mi.file_resolver())
    load_text(tmp_path, f'<path value="."/><shape type="cube">{GREY}</shape>')
    assert str(mi.file_resolver()) == before


def test_groups_that_mitsuba_refuses(tmp_path: Path) -> None:
    lamp = f'<shape type="shapegroup" id="group"><shape type="cube">{GREY}{LAMP}</shape></shape>'
    assert "emitter" in message_of(tmp_path, f'<scene version="3.0.0">{lamp}{instance("")}</scene>')
    missing = message_of(tmp_path, f'<scene version="3.0.0">{instance("", "gone")}<shape type="cube"/></scene>')
    assert "gone" in missing
    (tmp_path / "other.xml").write_text('<scene version="3.0.0"><include filename="scene.xml"/></scene>')
    loop = message_of(tmp_path, '<scene version="3.0.0"><include filename="other.xml"/></scene>')
    assert "circle" in loop


SPECTRA = {
    "blackbody": '<spectrum type="blackbody" name="radiance"><float name="temperature" value="3000"/></spectrum>',
    "regular": """<spectrum type="regular" name="radiance"><float name="wavelength_min" value="400"/>
      <float name="wavelength_max" value="700"/><string name="values" value="1, 2, 5, 6"/></spectrum>""",
    "irregular": """<spectrum type="irregular" name="radiance"><string name="wavelengths" value="400, 480, 600, 700"/>
      <string name="values" value="1, 3, 5, 2"/></spectrum>""",
}
SPECTRAL = """
import sys
import mitsuba as mi
import numpy as np
mi.set_variant("scalar_spectral")
image = np.array(mi.render(mi.load_file(sys.argv[1]), spp=4096))
print(*image.reshape(-1, image.shape[-1])[:, :3].mean(axis=0))
"""


@pytest.mark.parametrize("kind", SPECTRA)
def test_spectra_have_the_colour_of_a_spectral_rendering(tmp_path: Path, kind: str) -> None:
    """The RGB variants refuse them, so a camera of Mitsuba's spectral variant that sees nothing else is the judge."""
    data = load_text(
        tmp_path,
        f"""<shape type="rectangle"><emitter type="area">{SPECTRA[kind]}</emitter></shape>
        <integrator type="direct"/><sensor type="perspective"><float name="fov" value="10"/><transform name="to_world">
        <lookat origin="0, 0, 3" target="0, 0, 0" up="0, 1, 0"/></transform><film type="hdrfilm">
        <integer name="width" value="8"/><integer name="height" value="8"/></film></sensor>""",
    )
    command = [sys.executable, "-c", SPECTRAL, str(tmp_path / "scene.xml")]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    theirs = np.array([float(word) for word in ran.stdout.split()[-3:]])
    ours = np.array(data.materials[0].emission)
    assert np.allclose(ours, np.maximum(theirs, 0.0), atol=0.02 * theirs.max()), (ours, theirs)


def test_incomplete_spectra_are_refused(tmp_path: Path) -> None:
    body = '<shape type="cube"><emitter type="area"><spectrum type="regular" name="radiance"/></emitter></shape>'
    assert "regular" in message_of(tmp_path, f'<scene version="3.0.0">{body}</scene>')


PRINCIPLED = """<bsdf type="principled" id="{id}"><rgb name="base_color" value="0.9, 0.5, 0.1"/>{more}</bsdf>"""
METAL = '<float name="metallic" value="1"/>'
METAL_MAP = """<texture type="checkerboard" name="metallic"><float name="color0" value="1"/>
  <float name="color1" value="1"/></texture>"""


DARK = [(around, more) for around in ("", "twosided", "mask", "bumpmap", "blendbsdf") for more in (METAL, METAL_MAP)]
REFRACTS = '<float name="spec_trans" value="1"/>'


# Mitsuba refuses what transmits in a twosided.
@pytest.mark.parametrize(("around", "more"), [*DARK, ("", REFRACTS), ("mask", REFRACTS), ("blendbsdf", REFRACTS)])
def test_what_a_principled_surface_keeps_for_gloss_is_dark_and_named(tmp_path: Path, around: str, more: str) -> None:
    inner = PRINCIPLED.format(id="gold", more=more)
    extra = {
        "mask": '<float name="opacity" value="0.5"/>',
        "bumpmap": '<texture type="checkerboard" name="arbitrary"/>',
        "blendbsdf": '<float name="weight" value="0.5"/>' + PRINCIPLED.format(id="brass", more=more),
    }.get(around, "")
    bsdf = inner if not around else f'<bsdf type="{around}">{extra}{inner}</bsdf>'
    data = load_text(tmp_path, f'<shape type="cube">{bsdf}</shape>')
    material = as_diffuse(data.materials[0])
    assert max(material.base_color) < 1e-3 and material.base_color_texture is None
    assert any("gold" in text or "brass" in text for text in data.warnings), data.warnings


def test_a_half_metal_keeps_half_its_colour(tmp_path: Path) -> None:
    bsdf = PRINCIPLED.format(id="worn", more='<float name="metallic" value="0.25"/>')
    data = load_text(tmp_path, f'<shape type="cube"><bsdf type="twosided">{bsdf}</bsdf></shape>')
    assert np.allclose(as_diffuse(data.materials[0]).base_color, (0.675, 0.375, 0.075), atol=1e-4)


def test_sensors_that_make_no_picture_are_named(tmp_path: Path) -> None:
    one = '<film type="hdrfilm"><integer name="width" value="1"/><integer name="height" value="1"/></film>'
    place = '<transform name="to_world"><lookat origin="0, 1, 5" target="0, 0, 0" up="0, 1, 0"/></transform>'
    data = load_text(
        tmp_path,
        f"""<shape type="cube">{GREY}<sensor type="irradiancemeter">{one}</sensor></shape>
        <sensor type="radiancemeter">{place}{one}</sensor><sensor type="distant">{place}{one}</sensor>
        <sensor type="batch"><sensor type="perspective">{place}</sensor><film type="hdrfilm"/></sensor>""",
    )
    assert not data.cameras
    for name in ("RadianceMeter", "IrradianceMeter", "Distant", "Batch"):
        assert any(name in text for text in data.warnings), (name, data.warnings)


def test_orthographic_and_thin_lens_cameras(tmp_path: Path) -> None:
    place = '<lookat origin="1, 2, 9" target="1, 2, 0" up="0, 1, 0"/>'
    data = load_text(
        tmp_path,
        f"""<shape type="cube">{GREY}</shape><emitter type="constant"/>
        <sensor type="orthographic"><transform name="to_world"><scale x="1.5" y="1.5"/>{place}</transform></sensor>
        <sensor type="thinlens" id="lens"><transform name="to_world">{place}</transform>
          <float name="fov" value="50"/><float name="aperture_radius" value="0.1"/></sensor>""",
    )
    flat, lens = data.cameras
    # Mitsuba's own ray through the left edge of the film.
    ray, _ = full_scene(data).sensors()[0].sample_ray(0.0, 0.5, mi.Point2f(0.0, 0.5), mi.Point2f(0.5))
    assert flat.orthographic_width == pytest.approx(2 * abs(float(np.array(ray.o).ravel()[0]) - 1.0))
    assert lens.fov == pytest.approx(50.0) and lens.orthographic_width == 0.0 and np.allclose(lens.eye, (1, 2, 9))
    assert any("Depth of field" in text and "lens" in text for text in data.warnings)


def test_odd_values_are_named_or_left_out(tmp_path: Path) -> None:
    dark = '<emitter type="area"><rgb name="radiance" value="-1, 2, 3"/></emitter>'
    stored = '<texture type="mesh_attribute" name="reflectance"><string name="name" value="vertex_color"/></texture>'
    data = load_text(
        tmp_path,
        f"""<shape type="sphere"><float name="radius" value="0"/></shape>
        <shape type="cube"><bsdf type="diffuse" id="lamp"/>{dark}</shape>
        <shape type="sphere" id="ball"><bsdf type="diffuse">{stored}</bsdf></shape>""",
    )
    by_object = {item.name: item.meshes[0] for item in data.objects}
    assert data.materials[by_object["cube-1"].material].emission == (0.0, 2.0, 3.0)
    assert by_object["ball"].colors is not None and np.allclose(by_object["ball"].colors, 0.5)
    assert len(by_object["sphere-0"].faces) == 0
    assert any("Negative radiance" in text and "lamp" in text for text in data.warnings)
    assert any("no meshes" in text and "ball" in text for text in data.warnings)


def srgb_to_linear(encoded: np.ndarray) -> np.ndarray:
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def test_emitters_that_luxel_lacks_are_named(tmp_path: Path) -> None:
    pixels = write_texture(tmp_path)
    picture = '<texture type="bitmap" name="{}"><string name="filename" value="texture.png"/></texture>'
    data = load_text(
        tmp_path,
        f"""<shape type="cube">{GREY}</shape><emitter type="projector">{picture.format("irradiance")}</emitter>
        <emitter type="spot">{picture.format("texture")}</emitter>
        <shape type="rectangle">{GREY}<emitter type="directionalarea"/></shape>""",
    )
    assert [light.kind for light in data.lights] == ["spot"]
    inside = srgb_to_linear(pixels / 255.0).mean(axis=(0, 1))
    assert np.allclose(data.lights[0].color, inside, rtol=0.2)
    said = " ".join(data.warnings)
    assert "DirectionalArea" in said and "Projector" in said and "image that a spot light projects" in said
    assert all(max(material.emission) == 0.0 for material in data.materials)


def test_shared_materials_are_converted_once(tmp_path: Path) -> None:
    body = '<bsdf type="diffuse" id="paint"/><shape type="cube"><ref id="paint"/></shape>'
    data = load_text(tmp_path, body + '<shape type="sphere"><ref id="paint"/></shape>')
    assert len(data.materials) == 1 and len(data.objects) == 2


def test_files_that_are_wrong(tmp_path: Path) -> None:
    assert "not well-formed XML" in message_of(tmp_path, "<scene version='3.0.0'><shape></scene>")
    assert "root is <html>" in message_of(tmp_path, "<html/>")
    assert "no triangles" in message_of(tmp_path, '<scene version="3.0.0"></scene>')
    missing = '<shape type="ply"><string name="filename" value="gone.ply"/></shape>'
    message = message_of(tmp_path, f'<scene version="3.0.0">{missing}</scene>')
    assert "gone.ply" in message and message.count("scene.xml") == 1
    unused = '<shape type="cube"><float name="fur" value="3"/></shape>'
    assert "fur" in message_of(tmp_path, f'<scene version="3.0.0">{unused}</scene>')
    volume = '<texture type="volume" name="reflectance"><volume type="constvolume"/></texture>'
    dump = message_of(
        tmp_path, f'<scene version="3.0.0"><shape type="cube"><bsdf type="diffuse">{volume}</bsdf></shape></scene>'
    )
    assert "volume" in dump and "[" not in dump
    assert "nonsense" in message_of(tmp_path, '<scene version="3.0.0"><shape type="nonsense"/></scene>')
    texture = '<texture type="bitmap" name="reflectance"><string name="filename" value="gone.png"/></texture>'
    shape = f'<shape type="cube"><bsdf type="diffuse">{texture}</bsdf></shape>'
    assert "gone.png" in message_of(tmp_path, f'<scene version="3.0.0">{shape}</scene>')


def test_the_bathroom_loads(scenes_folder: Path) -> None:
    path = scenes_folder / "bathroom" / "scene.xml"
    if not path.is_file():
        pytest.skip(f"no bathroom at {path}")
    data = load(path)
    assert sum(len(mesh.faces) for item in data.objects for mesh in item.meshes) > 300_000
    assert data.cameras[0].fov == pytest.approx(55.0) and len(data.objects) == 36
    lamps = [material for material in data.materials if max(material.emission) > 0]
    assert len(lamps) == 1 and np.allclose(lamps[0].emission, 30.0)
    assert any("BulbGlass" in text for text in data.warnings) and any("Mirror" in text for text in data.warnings)
