"""The oracle of glTF: small files beside an equal Mitsuba scene, luxel's truth beside `mi.render`.

The Mitsuba side is built from arithmetic of its own: positions, texture coordinates and colours are brought to world
space here, by the glTF specification, and go through PLY files.
"""

from __future__ import annotations

import importlib.util
import io
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from luxel.render.truth import render_truth
from luxel.scene.edit import apply_sky
from luxel.scene.gltf import load_gltf

if TYPE_CHECKING:
    from tests.scene.gltf.conftest import GltfBuilder

WIDTH, HEIGHT, BLOCK = 64, 48, 16
FINER = 4
"""Luxel's rays go through pixel centres: its image is made larger and averaged, as the reference's box filter does."""
SPP = 16
MEAN_LIMIT, BLOCK_LIMIT = 0.01, 0.02
BRIGHT = 8.0
"""Pixels are clamped at so many times the reference's mean, in both images: edges of lamps decide nothing."""
EYE, TARGET = np.array([1.1, 2.6, 5.2]), np.array([0.1, 0.6, 0.0])
Y_FOV = math.radians(40.0)
SKY = 0.35

QUAD = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
QUAD_FACES = np.array([[0, 1, 2], [0, 2, 3]])
QUAD_UV = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
WEDGE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.6], [0.0, 1.2, 0.0]])
WEDGE_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
"""A corner piece that looks the same in no mirror; faces counter-clockwise from outside."""
CHECKS = np.array([[[230, 40, 40], [40, 200, 60]], [[60, 60, 240], [240, 230, 80]]], np.uint8)
DOWN = Rotation.from_euler("x", -90, degrees=True)


def matrix(move: Any = (0.0, 0.0, 0.0), turn: Rotation | None = None, size: Any = (1.0, 1.0, 1.0)) -> np.ndarray:
    """(4, 4) translation times rotation times scale."""
    result = np.eye(4)
    result[:3, :3] = (np.eye(3) if turn is None else turn.as_matrix()) * np.asarray(size, float)
    result[:3, 3] = move
    return result


FLOOR, WALL = matrix(turn=DOWN, size=(4, 4, 4)), matrix((0, 0, -2.5), size=(4, 4, 4))
CARD = matrix((-0.2, 1.0, 0.2), Rotation.from_euler("y", 20, degrees=True), (0.9, 0.7, 1.0))
LAMP = matrix((0.6, 1.9, 0.3), Rotation.from_euler("x", 60, degrees=True), (0.5, 0.4, 1.0))


@dataclass
class Pair:
    """One scene written twice: `gltf` by the builder, `reference` as Mitsuba's dictionary."""

    folder: Path
    gltf: GltfBuilder
    reference: dict[str, Any] = field(default_factory=lambda: {"type": "scene"})
    sky: float = SKY

    def add_mesh(
        self,
        place: np.ndarray,
        material: dict[str, Any],
        reference: dict[str, Any],
        *,
        positions: np.ndarray = QUAD,
        faces: np.ndarray = QUAD_FACES,
        attributes: dict[str, np.ndarray] | None = None,
        normals: np.ndarray | None = None,
        uv: np.ndarray | None = None,
        colors: np.ndarray | None = None,
        places: list[np.ndarray] | None = None,
        node: dict[str, Any] | None = None,
    ) -> None:
        """A mesh at `place`; Mitsuba gets it at each of `places` (default: there), with what else is given."""
        builder = self.gltf
        stored = {name: builder.accessor(values) for name, values in (attributes or {}).items()}
        indices = builder.accessor(faces.ravel(), "uint16")
        mesh = builder.mesh(positions, attributes=stored, indices=indices, material=builder.add("materials", material))
        placed: dict[str, Any] = {"matrix": place.T.ravel().tolist()} if node is None else node
        builder.node(mesh=mesh, **placed)
        for number, to_world in enumerate([place] if places is None else places):
            name = f"mesh{len(self.reference)}_{number}"
            world = positions @ to_world[:3, :3].T + to_world[:3, 3]
            turned = faces if np.linalg.det(to_world[:3, :3]) > 0.0 else faces[:, ::-1]
            columns = {"x y z": world, "nx ny nz": normals, "u v": uv, "r g b": colors}
            write_ply(self.folder / f"{name}.ply", columns, turned)
            shape = {"type": "ply", "filename": str(self.folder / f"{name}.ply"), "face_normals": normals is None}
            self.reference[name] = {**shape, **reference}

    def add_light(self, place: np.ndarray, light: dict[str, Any], reference: dict[str, Any]) -> None:
        self.gltf.node(matrix=place.T.ravel().tolist(), extensions=self.gltf.light(**light))
        self.reference[f"light{len(self.reference)}"] = reference

    def texture(self, pixels: np.ndarray, **more: Any) -> dict[str, Any]:
        """A textureInfo without filtering."""
        stream = io.BytesIO()
        Image.fromarray(pixels).save(stream, "PNG")
        image = self.gltf.add("images", {"bufferView": self.gltf.view(stream.getvalue())})
        sampler = self.gltf.add("samplers", {"magFilter": 9728})
        return {"index": self.gltf.add("textures", {"source": image, "sampler": sampler}), **more}


def write_ply(path: Path, columns: dict[str, np.ndarray | None], faces: np.ndarray) -> None:
    """Write the columns that there are, under their names."""
    parts = {names: values for names, values in columns.items() if values is not None}
    names = " ".join(parts).split()
    count = len(next(iter(parts.values())))
    lines = ["ply", "format ascii 1.0", f"element vertex {count}", *(f"property float {n}" for n in names)]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(f"{value:.9g}" for value in row) for row in np.concatenate(list(parts.values()), axis=1)]
    lines += [f"3 {a} {b} {c}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")


def bitmap(pixels: np.ndarray, *, raw: bool = False) -> dict[str, Any]:
    return {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": raw, "filter_type": "nearest"}


def diffuse(color: Any) -> dict[str, Any]:
    """A two-sided diffuse surface of one colour or a texture."""
    made = color if isinstance(color, dict) else {"type": "rgb", "value": list(color)}
    return {"bsdf": {"type": "twosided", "inner": {"type": "diffuse", "reflectance": made}}}


def paint(*color: float, **more: Any) -> dict[str, Any]:
    pbr = {"metallicFactor": 0.0, "baseColorFactor": [*(color or (1.0, 1.0, 1.0)), 1.0]}
    return {"pbrMetallicRoughness": {**pbr, **more}}


@pytest.fixture
def pair(tmp_path: Path) -> Pair:
    """A floor and a wall under a constant sky, and the camera."""
    source = Path(__file__).parents[1] / "scene" / "gltf" / "conftest.py"
    spec = importlib.util.spec_from_file_location("gltf_builder", source)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    made = Pair(tmp_path, module.GltfBuilder(tmp_path))
    made.add_mesh(FLOOR, paint(0.6, 0.6, 0.6), diffuse((0.6, 0.6, 0.6)))
    made.add_mesh(WALL, paint(0.2, 0.3, 0.7), diffuse((0.2, 0.3, 0.7)))
    lens = {"yfov": Y_FOV, "aspectRatio": WIDTH / HEIGHT, "znear": 0.1}
    look_from_gltf(made, {"type": "perspective", "perspective": lens})
    look_at = mi.ScalarTransform4f().look_at(EYE.tolist(), TARGET.tolist(), [0.0, 1.0, 0.0])
    made.reference["sensor"] = {
        "type": "perspective", "fov": math.degrees(Y_FOV), "fov_axis": "y", "to_world": look_at, **film(),
    }  # fmt: skip
    return made


def look_from_gltf(made: Pair, camera: dict[str, Any]) -> None:
    backward = (EYE - TARGET) / np.linalg.norm(EYE - TARGET)
    right = np.cross([0.0, 1.0, 0.0], backward)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(backward, right), backward, EYE], axis=1)
    made.gltf.node(camera=made.gltf.add("cameras", camera), matrix=pose.T.ravel().tolist())


def film() -> dict[str, Any]:
    return {"film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}}}


def judge(pair: Pair) -> None:
    """Fail where the mean of the image is off by 1 %, or blocks of 16x16 pixels by 2 % beyond both noises."""
    data = load_gltf(pair.gltf.write())
    data = apply_sky(data, str(pair.sky))
    truth = render_truth(data, camera=data.cameras[0], size=(WIDTH * FINER, HEIGHT * FINER), spp=SPP, cache=False)
    ours = []
    for direct, indirect in zip(truth.direct_halves, truth.halves, strict=True):
        truth.layers.direct, truth.layers.indirect = direct, indirect
        ours.append(truth.layers.image().reshape(HEIGHT, FINER, WIDTH, FINER, 3).mean(axis=(1, 3)))
    if pair.sky > 0.0:
        pair.reference["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": [pair.sky] * 3}}
    pair.reference["integrator"] = {"type": "path", "max_depth": 24}
    scene: Any = mi.load_dict(pair.reference)
    theirs = [np.array(mi.render(scene, spp=SPP * FINER, seed=seed), float)[..., :3] for seed in (1, 2)]
    cap = BRIGHT * float(np.mean(theirs))
    images = [np.minimum(np.stack(halves), cap) for halves in (ours, theirs)]
    mean = float(images[1].mean())
    off = float(images[0].mean()) / mean - 1.0
    noise = sum(block_rmse(half[0], half[1]) / 2.0 for half in images) / mean
    error = block_rmse(images[0].mean(axis=0), images[1].mean(axis=0)) / mean
    said = f"mean {off:+.4f}, blocks {error:.4f}, noise {noise:.4f}"
    assert noise < BLOCK_LIMIT / 2.0, f"too noisy to judge: {said}"
    assert abs(off) <= MEAN_LIMIT and error <= BLOCK_LIMIT + noise, f"luxel is not as mi.render: {said}"


def block_rmse(a: np.ndarray, b: np.ndarray) -> float:
    blocks = (a - b).reshape(HEIGHT // BLOCK, BLOCK, WIDTH // BLOCK, BLOCK, 3).mean(axis=(1, 3))
    return float(np.sqrt((blocks**2).mean()))


# --- the rows ------------------------------------------------------------------------------------------------------


def vertex_colours(pair: Pair) -> None:
    colors = np.array([[1.0, 0.1, 0.1], [0.1, 1.0, 0.1], [0.2, 0.2, 1.0], [0.9, 0.9, 0.2]])
    attribute = {"type": "mesh_attribute", "name": "vertex_color"}
    shown = colors * [0.8, 0.9, 0.7]
    pair.add_mesh(CARD, paint(0.8, 0.9, 0.7), diffuse(attribute), attributes={"COLOR_0": colors}, colors=shown)


def unlit(pair: Pair) -> None:
    """Factor and vertex colours multiply; the front alone shines and nothing is reflected.

    The colours run from left to right, so that a picture can say the same: Mitsuba 3.9 samples emitters of
    `mesh_attribute` radiance with a bias of 3 % (its BSDF sampling has none).
    """
    left, right = np.array([1.0, 0.2, 0.2]), np.array([0.2, 1.0, 1.0])
    material = {**paint(0.9, 0.6, 0.3), "extensions": {"KHR_materials_unlit": {}}}
    along = (np.arange(256) + 0.5)[:, None] / 256
    ramp = ((left + along * (right - left)) * [0.9, 0.6, 0.3]).astype(np.float32)[None]
    black = {"bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}}
    reference = {**black, "emitter": {"type": "area", "radiance": bitmap(ramp, raw=True)}}
    colors = np.stack([left, right, right, left])
    pair.add_mesh(LAMP, material, reference, attributes={"COLOR_0": colors}, uv=QUAD_UV)


def emission_on_the_second_uv(pair: Pair) -> None:
    second = np.array([[0.1, 0.4], [0.9, 0.4], [0.9, 0.9], [0.1, 0.9]])
    material = {
        **paint(0.0, 0.0, 0.0), "emissiveFactor": [1.0, 0.8, 0.6], "emissiveTexture": pair.texture(CHECKS, texCoord=1),
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 4.0}},
    }  # fmt: skip
    linear = CHECKS / 255.0
    linear = np.where(linear <= 0.04045, linear / 12.92, ((linear + 0.055) / 1.055) ** 2.4)
    shown = (linear * 4.0 * [1.0, 0.8, 0.6]).astype(np.float32)
    reference = {**diffuse((0.0, 0.0, 0.0)), "emitter": {"type": "area", "radiance": bitmap(shown, raw=True)}}
    attributes = {"TEXCOORD_0": 0.0 * second, "TEXCOORD_1": second}
    pair.add_mesh(LAMP, material, reference, attributes=attributes, uv=second)


def lamp_of_two_sides(pair: Pair) -> None:
    material = {**paint(0.3, 0.3, 0.3), "emissiveFactor": [1.0, 0.5, 0.2], "doubleSided": True}
    glow = {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 0.5, 0.2]}}
    reference = {**diffuse((0.3, 0.3, 0.3)), "emitter": glow}
    # Mitsuba's lamps shine from their front alone: the back is a second one, a hair behind.
    behind = LAMP @ matrix((0.0, 0.0, -1e-4), Rotation.from_euler("y", 180, degrees=True))
    pair.add_mesh(LAMP, material, reference, places=[LAMP, behind])


def metal_on_the_second_uv(pair: Pair) -> None:
    """Colour by the first set, metal by the second, which mirrors the picture: each tile has its own share of metal."""
    metal = np.zeros((2, 2, 3), np.uint8)
    metal[..., 2] = [[255, 0], [102, 51]]
    maps = {"baseColorTexture": pair.texture(CHECKS), "metallicRoughnessTexture": pair.texture(metal, texCoord=1)}
    linear = CHECKS / 255.0
    linear = np.where(linear <= 0.04045, linear / 12.92, ((linear + 0.055) / 1.055) ** 2.4)
    shown = (linear * (1.0 - metal[:, ::-1, 2:] / 255.0)).astype(np.float32)
    attributes = {"TEXCOORD_0": QUAD_UV, "TEXCOORD_1": QUAD_UV * [-1.0, 1.0] + [1.0, 0.0]}
    pair.add_mesh(
        CARD, {"pbrMetallicRoughness": maps}, diffuse(bitmap(shown, raw=True)), attributes=attributes, uv=QUAD_UV
    )


def mirrored_repeat(pair: Pair) -> None:
    info = pair.texture(CHECKS)
    pair.gltf.json["samplers"][-1].update(wrapS=33648, wrapT=33648)
    uv = QUAD_UV * [3.0, 2.5] - [1.2, 0.4]
    shown = {**bitmap(CHECKS), "wrap_mode": "mirror"}
    pair.add_mesh(CARD, paint(baseColorTexture=info), diffuse(shown), attributes={"TEXCOORD_0": uv}, uv=uv)


def smooth_normals(pair: Pair) -> None:
    """A ball pressed and mirrored by its node: normals follow the inverse transpose."""
    polar, around = np.meshgrid(
        np.linspace(0.05, math.pi - 0.05, 9), np.linspace(0.0, 2.0 * math.pi, 13), indexing="ij"
    )
    ball = np.stack([np.sin(polar) * np.sin(around), np.cos(polar), np.sin(polar) * np.cos(around)], axis=-1)
    corner = (np.arange(8)[:, None] * 13 + np.arange(12)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 13, corner + 1], axis=1), np.stack([corner + 1, corner + 13, corner + 14], axis=1)]
    )
    place = matrix((0.1, 0.9, 0.3), Rotation.from_euler("xyz", [20, 30, 10], degrees=True), (-0.5, 0.8, 1.1))
    points, color = ball.reshape(-1, 3), (0.8, 0.4, 0.3)
    normals = points @ np.linalg.inv(place[:3, :3])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    pair.add_mesh(
        place,
        paint(*color),
        diffuse(color),
        positions=points,
        faces=faces,
        attributes={"NORMAL": points},
        normals=normals,
    )


def texture_transform(pair: Pair) -> None:
    """Scale, then turn counter-clockwise in the picture (whose v grows downwards), then shift."""
    shift, size, angle = np.array([0.3, 0.1]), np.array([2.5, 1.5]), 0.7
    transform = {"offset": shift.tolist(), "scale": size.tolist(), "rotation": angle, "texCoord": 1}
    info = pair.texture(CHECKS, texCoord=0, extensions={"KHR_texture_transform": transform})
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    uv = (QUAD_UV * size) @ turn.T + shift
    attributes = {"TEXCOORD_0": 0.0 * QUAD_UV, "TEXCOORD_1": QUAD_UV}
    pair.add_mesh(CARD, paint(baseColorTexture=info), diffuse(bitmap(CHECKS)), attributes=attributes, uv=uv)


def mirrored_node(pair: Pair) -> None:
    place = matrix((0.2, 0.3, 0.0), Rotation.from_euler("xyz", [10, 40, 5], degrees=True), (-1.3, 1.0, 1.2))
    material = {**paint(0.7, 0.2, 0.1), "emissiveFactor": [0.6, 0.6, 0.6]}
    reference = {**diffuse((0.7, 0.2, 0.1)), "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 0.6}}}
    pair.add_mesh(place, material, reference, positions=WEDGE, faces=WEDGE_FACES)


def instances(pair: Pair) -> None:
    turns = Rotation.from_euler("xyz", [[0, 30, 0], [0, -70, 20], [0, 200, 0], [10, 0, 0]], degrees=True)
    moves = np.array([[-1.6, 0.0, 0.5], [0.2, 0.1, 1.2], [1.2, 0.0, -0.6], [-0.3, 0.0, -1.2]])
    sizes = np.array([[1.0, 1.0, 1.0], [0.7, 1.5, 0.7], [1.3, 0.6, -1.0], [0.9, 0.9, 0.9]])
    node = matrix((0.1, 0.0, 0.2), Rotation.from_euler("y", 15, degrees=True), (1.1, 0.9, 1.0))
    builder = pair.gltf
    attributes = {
        "TRANSLATION": builder.accessor(moves),
        "ROTATION": builder.accessor(np.rint(turns.as_quat() * 32767.0), "int16", normalized=True),
        "SCALE": builder.accessor(sizes),
    }
    made = {"extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}}, "matrix": node.T.ravel().tolist()}
    places = [node @ matrix(*parts) for parts in zip(moves, turns, sizes, strict=True)]
    color = (0.7, 0.5, 0.2)
    pair.add_mesh(node, paint(*color), diffuse(color), positions=WEDGE, faces=WEDGE_FACES, places=places, node=made)


def lamps(pair: Pair) -> None:
    pair.add_mesh(CARD, paint(0.7, 0.7, 0.2), diffuse((0.7, 0.7, 0.2)))
    sun = Rotation.from_euler("yx", [30, -50], degrees=True)
    color = [1.0, 0.9, 0.7]
    pair.add_light(
        matrix((9, 9, 9), sun, (3, 3, 3)), {"type": "directional", "color": color, "intensity": 1.5},
        {"type": "directional", "direction": sun.apply([0.0, 0.0, -1.0]).tolist(),
         "irradiance": {"type": "rgb", "value": [1.5 * part for part in color]}},
    )  # fmt: skip
    pair.add_light(
        matrix((-1.5, 1.5, 1.0)), {"type": "point", "intensity": 2.0},
        {"type": "point", "position": [-1.5, 1.5, 1.0], "intensity": {"type": "rgb", "value": 2.0}},
    )  # fmt: skip
    spot, eye = Rotation.from_euler("yx", [10, -70], degrees=True), np.array([1.4, 2.2, 0.6])
    aim = (eye + spot.apply([0.0, 0.0, -1.0])).tolist()
    # The fall-offs of the two differ between the cones, so there is nothing between them.
    cone = {"innerConeAngle": 0.4999, "outerConeAngle": 0.5}
    look_at = mi.ScalarTransform4f().look_at(eye.tolist(), aim, [0.0, 0.0, -1.0])
    pair.add_light(
        matrix(eye, spot), {"type": "spot", "intensity": 8.0, "spot": cone},
        {"type": "spot", "to_world": look_at, "cutoff_angle": math.degrees(0.5), "beam_width": math.degrees(0.4999),
         "intensity": {"type": "rgb", "value": 8.0}},
    )  # fmt: skip


def cut_out(pair: Pair) -> None:
    alpha = np.array([[255, 0, 200], [60, 255, 90]], np.uint8)
    pixels = np.concatenate([np.full((2, 3, 3), 255, np.uint8), alpha[..., None]], axis=2)
    material = {
        **paint(0.7, 0.3, 0.2, baseColorTexture=pair.texture(pixels)), "alphaMode": "MASK", "alphaCutoff": 0.3,
    }  # fmt: skip
    shown = (alpha / 255.0 >= 0.3).astype(np.float32)[..., None]
    inner = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.7, 0.3, 0.2]}}
    masked = {"type": "mask", "opacity": bitmap(shown, raw=True), "inner": {"type": "twosided", "inner": inner}}
    pair.add_mesh(CARD, material, {"bsdf": masked}, attributes={"TEXCOORD_0": QUAD_UV}, uv=QUAD_UV)


def blended(pair: Pair) -> None:
    material = {**paint(0.9, 0.2, 0.2), "alphaMode": "BLEND"}
    material["pbrMetallicRoughness"]["baseColorFactor"][3] = 0.35
    see_through(pair, material, 0.35)


def glass(pair: Pair) -> None:
    see_through(
        pair, {**paint(0.9, 0.2, 0.2), "extensions": {"KHR_materials_transmission": {"transmissionFactor": 0.6}}}, 0.4
    )


def see_through(pair: Pair, material: dict[str, Any], opacity: Any, **more: Any) -> None:
    inner = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.9, 0.2, 0.2]}}
    masked = {"type": "mask", "opacity": opacity, "inner": {"type": "twosided", "inner": inner}}
    pair.add_mesh(CARD, material, {"bsdf": masked}, **more)


def blended_by_vertex_alpha(pair: Pair) -> None:
    """Factor and vertex colours multiply their alpha too."""
    material = {**paint(1.0, 0.4, 0.4), "alphaMode": "BLEND"}
    material["pbrMetallicRoughness"]["baseColorFactor"][3] = 0.7
    colors = np.tile([0.9, 0.5, 0.5, 0.5], (4, 1))
    see_through(pair, material, 0.35, attributes={"COLOR_0": colors})


def glass_by_texture(pair: Pair) -> None:
    """The red of the transmission texture lets pass; the alpha of the opaque colour has no meaning."""
    red = np.array([[255, 0, 102], [51, 204, 255]], np.uint8)
    pixels = np.stack([red, 255 - red, red], axis=2)
    colour = np.full((1, 1, 4), (255, 255, 255, 60), np.uint8)
    part = {"transmissionFactor": 0.8, "transmissionTexture": pair.texture(pixels)}
    material = paint(0.9, 0.2, 0.2, baseColorTexture=pair.texture(colour))
    material["extensions"] = {"KHR_materials_transmission": part}
    opacity = bitmap((1.0 - 0.8 * red / 255.0).astype(np.float32)[..., None], raw=True)
    see_through(pair, material, opacity, attributes={"TEXCOORD_0": QUAD_UV}, uv=QUAD_UV)


def clear_glass(pair: Pair) -> None:
    """A pane that transmits all of it, before Mitsuba's: a thin one that reflects nothing."""
    material = {**paint(), "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1.0}}}
    thin = {"type": "thindielectric", "int_ior": 1.0, "ext_ior": 1.0}
    pair.add_mesh(CARD, material, {"bsdf": thin})


def specular_glossiness(pair: Pair) -> None:
    part = {
        "diffuseFactor": [0.9, 0.8, 0.7, 1.0],
        "specularFactor": [0.0, 0.0, 0.0],
        "diffuseTexture": pair.texture(CHECKS),
    }
    material = {"extensions": {"KHR_materials_pbrSpecularGlossiness": part}}
    linear = CHECKS / 255.0
    linear = np.where(linear <= 0.04045, linear / 12.92, ((linear + 0.055) / 1.055) ** 2.4)
    shown = bitmap((linear * [0.9, 0.8, 0.7]).astype(np.float32), raw=True)
    pair.add_mesh(CARD, material, diffuse(shown), attributes={"TEXCOORD_0": QUAD_UV}, uv=QUAD_UV)


def hidden_node(pair: Pair) -> None:
    pair.add_mesh(
        CARD,
        paint(),
        diffuse((1.0, 1.0, 1.0)),
        places=[],
        node={"extensions": {"KHR_node_visibility": {"visible": False}}},
    )


def orthographic(pair: Pair) -> None:
    pair.add_mesh(CARD, paint(0.7, 0.7, 0.2), diffuse((0.7, 0.7, 0.2)))
    pair.gltf.json["cameras"][0] = {
        "type": "orthographic",
        "orthographic": {"xmag": 2.0, "ymag": 1.5, "znear": 0.1, "zfar": 99.0},
    }
    look_at = mi.ScalarTransform4f().look_at(EYE.tolist(), TARGET.tolist(), [0.0, 1.0, 0.0])
    pair.reference["sensor"] = {
        "type": "orthographic",
        "to_world": look_at @ mi.ScalarTransform4f().scale([2.0, 2.0, 1.0]),
        **film(),
    }


ROWS: tuple[Callable[[Pair], None], ...] = (
    smooth_normals, metal_on_the_second_uv, lamp_of_two_sides, mirrored_repeat,
    vertex_colours, unlit, emission_on_the_second_uv, texture_transform, mirrored_node, instances, lamps, cut_out,
    blended, blended_by_vertex_alpha, glass, glass_by_texture, clear_glass, specular_glossiness, hidden_node,
    orthographic,
)  # fmt: skip


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.__name__)
def test_gltf_is_as_mitsuba_renders_it(pair: Pair, row: Callable[[Pair], None]) -> None:
    row(pair)
    judge(pair)


def test_the_judge_tells_a_wrong_scene(pair: Pair) -> None:
    vertex_colours(pair)
    pair.gltf.json["materials"][-1]["pbrMetallicRoughness"]["baseColorFactor"] = [0.7, 0.9, 0.9, 1.0]
    with pytest.raises(AssertionError, match="not as mi.render"):
        judge(pair)
