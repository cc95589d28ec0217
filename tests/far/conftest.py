"""A small room as a glTF and as a Mitsuba file, carried anywhere by a node or by to_world, and Mitsuba's picture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

SIZE = (48, 36)
EYE, TARGET, FOV = (0.3, 1.4, 2.6), (0.1, 1.1, -2.0), 75.0
LAMP = (0.8, 2.2, 0.4)
"""A point light beside the glowing panel."""
INTENSITY = (3.0, 2.8, 2.4)
BALL = (-1.0, 1.1, -0.6)
"""Of the Mitsuba file."""
PARTS: dict[str, tuple[Any, tuple[float, float, float], float]] = {
    "floor": (((-2, 0, -2), (-2, 0, 3), (2, 0, 3), (2, 0, -2)), (0.7, 0.7, 0.7), 0.0),
    "ceiling": (((-2, 3, -2), (2, 3, -2), (2, 3, 3), (-2, 3, 3)), (0.7, 0.7, 0.7), 0.0),
    "left": (((-2, 0, -2), (-2, 3, -2), (-2, 3, 3), (-2, 0, 3)), (0.7, 0.2, 0.1), 0.0),
    "right": (((2, 0, -2), (2, 0, 3), (2, 3, 3), (2, 3, -2)), (0.1, 0.3, 0.7), 0.0),
    "back": (((-2, 0, -2), (2, 0, -2), (2, 3, -2), (-2, 3, -2)), (0.6, 0.6, 0.5), 0.0),
    "front": (((-2, 0, 3), (-2, 3, 3), (2, 3, 3), (2, 0, 3)), (0.6, 0.6, 0.5), 0.0),
    "table": (((-1.2, 0.8, -1.2), (-1.2, 0.8, 0), (0.2, 0.8, 0), (0.2, 0.8, -1.2)), (0.5, 0.4, 0.3), 0.0),
    "panel": (((-0.8, 2.95, -1), (0.2, 2.95, -1), (0.2, 2.95, 0), (-0.8, 2.95, 0)), (0.0, 0.0, 0.0), 4.0),
}
"""Four corners, the front by their order; colour; radiance."""


def corners_of(name: str) -> np.ndarray:
    """The two triangles of a part, (2, 3, 3) float32."""
    quad = np.array(PARTS[name][0], np.float32)
    return quad[[[0, 1, 2], [0, 2, 3]]]


def write_room(write_gltf: Callable[..., Path], name: str, place: Any, by: str = "node", **more: Any) -> Path:
    """The room `place` (3,) away, by a node above all or by its own vertices, with its camera and its lamp."""
    place = np.asarray(place, np.float64)
    own = place if by == "vertices" else np.zeros(3)
    parts = []
    for title, (_, colour, glow) in PARTS.items():
        material: dict[str, Any] = {
            "pbrMetallicRoughness": {"baseColorFactor": [*colour, 1.0], "metallicFactor": 0.0},
            "emissiveFactor": [min(glow, 1.0)] * 3,
        }
        if glow > 0.0:
            material["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": glow}}
        parts.append((title, (corners_of(title).astype(np.float64) + own).astype(np.float32), material))
    count = len(parts)
    view = np.eye(4)
    view[:3, 2] = np.subtract(EYE, TARGET) / np.linalg.norm(np.subtract(EYE, TARGET))
    view[:3, 0] = np.cross((0.0, 1.0, 0.0), view[:3, 2])
    view[:3, 0] /= np.linalg.norm(view[:3, 0])
    view[:3, 1] = np.cross(view[:3, 2], view[:3, 0])
    view[:3, 3] = np.asarray(EYE) + own
    aspect = SIZE[0] / SIZE[1]
    y_fov = 2.0 * np.arctan(np.tan(np.deg2rad(FOV) / 2.0) / aspect)
    nodes = [
        *({"name": title, "mesh": index} for index, title in enumerate(PARTS)),
        {"name": "view", "camera": 0, "matrix": view.T.ravel().tolist()},
        {
            "name": "lamp",
            "translation": (np.asarray(LAMP) + own).tolist(),
            "extensions": {"KHR_lights_punctual": {"light": 0}},
        },
        {"name": "all", "children": list(range(count + 2)), "translation": (place - own).tolist()},
    ]
    lens = {"yfov": float(y_fov), "aspectRatio": aspect, "znear": 0.01}
    lamp = {"type": "point", "color": [c / 3.0 for c in INTENSITY], "intensity": 3.0}
    settings: dict[str, Any] = {
        "nodes": nodes,
        "scenes": [{"nodes": [count + 2]}],
        "cameras": [{"type": "perspective", "perspective": lens}],
        "extensions": {"KHR_lights_punctual": {"lights": [lamp]}},
    }
    return write_gltf(name, parts, **(settings | more))


def write_room_xml(path: Path, place: Any) -> Path:
    """The room `place` (3,) away by to_world, with a sphere by its centre."""
    x, y, z = (float(axis) for axis in place)
    move = f'<translate x="{x!r}" y="{y!r}" z="{z!r}"/>'

    def point(values: Any) -> str:
        return ",".join(repr(float(v) + p) for v, p in zip(values, (x, y, z), strict=True))

    lines = [
        '<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="-1"/></integrator>',
        f'<sensor type="perspective"><float name="fov" value="{FOV}"/><string name="fov_axis" value="x"/>',
        f'<film type="hdrfilm"><integer name="width" value="{SIZE[0]}"/>',
        f'<integer name="height" value="{SIZE[1]}"/></film>',
        f'<transform name="to_world"><lookat origin="{point(EYE)}" target="{point(TARGET)}" up="0,1,0"/></transform>',
        "</sensor>",
        f'<emitter type="point"><point name="position" value="{point(LAMP)}"/>',
        f'<rgb name="intensity" value="{",".join(map(str, INTENSITY))}"/></emitter>',
        f'<shape type="sphere"><point name="center" value="{point(BALL)}"/><float name="radius" value="0.3"/>',
        '<bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></shape>',
    ]
    for title, (quad, colour, glow) in PARTS.items():
        first, second, _, fourth = (np.array(corner, float) for corner in quad)
        across, along = (second - first) / 2.0, (fourth - first) / 2.0
        normal = np.cross(across, along)
        matrix = np.eye(4)
        matrix[:3, :3] = np.stack([across, along, normal / np.linalg.norm(normal)], axis=1)
        matrix[:3, 3] = first + across + along
        values = " ".join(repr(float(v)) for v in matrix.ravel())
        lines.append(
            f'<shape type="rectangle" id="{title}"><transform name="to_world"><matrix value="{values}"/>{move}'
        )
        lines.append(
            f'</transform><bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="{colour}"/>'
        )
        lines[-1] = lines[-1].replace("(", "").replace(")", "")
        glows = f'<emitter type="area"><rgb name="radiance" value="{glow}"/></emitter>' if glow else ""
        lines.append(f"</bsdf></bsdf>{glows}</shape>")
    path.write_text("\n".join([*lines, "</scene>"]))
    return path


def make_mitsuba_room() -> Any:
    """The room of the glTF file at the origin, as a Mitsuba scene with its sensor."""
    content: dict[str, Any] = {"type": "scene", "integrator": {"type": "path", "max_depth": -1}}
    for title, (_, colour, glow) in PARTS.items():
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(
            {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(colour)}}}
        )
        if glow:
            properties["emitter"] = mi.load_dict({"type": "area", "radiance": {"type": "rgb", "value": glow}})
        mesh = mi.Mesh(title, 6, 2, properties)
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = mi.Float(corners_of(title).ravel())
        parameters["faces"] = mi.UInt32(np.arange(6, dtype=np.uint32))
        parameters.update()
        content[title] = mesh
    content["lamp"] = {
        "type": "point", "position": list(LAMP), "intensity": {"type": "rgb", "value": list(INTENSITY)},
    }  # fmt: skip
    content["sensor"] = {
        "type": "perspective",
        "fov": FOV,
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f().look_at(list(EYE), list(TARGET), [0.0, 1.0, 0.0]),
        "film": {"type": "hdrfilm", "width": SIZE[0], "height": SIZE[1], "rfilter": {"type": "box"}},
    }
    return mi.load_dict(content)


def render_centres(scene: Any, spp: int) -> np.ndarray:
    """Mitsuba's picture (H, W, 3) by rays through the middles of pixels, as luxel's."""
    width, height = SIZE
    integrator, sampler = mi.load_dict({"type": "path", "max_depth": -1}), mi.load_dict({"type": "independent"})
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    middle = mi.Point2f(mi.Float(np.repeat(x.ravel(), spp)), mi.Float(np.repeat(y.ravel(), spp)))
    sampler.seed(1, width * height * spp)
    ray, _ = scene.sensors()[0].sample_ray_differential(0.0, 0.5, middle, mi.Point2f(0.5))
    light, _, _ = integrator.sample(scene, sampler, ray)
    return np.array(light).T.reshape(height, width, spp, 3).mean(axis=2)


def free_irradiance(scene: Any, points: np.ndarray, normals: np.ndarray, count: int = 20_000) -> np.ndarray:
    """Indirect irradiance (N, 3) that Mitsuba finds at free points: rays by the cosine, no emitter seen directly."""
    integrator = mi.load_dict({"type": "path", "max_depth": -1, "hide_emitters": True})
    rng = np.random.default_rng(5)
    about = np.repeat(normals, count, axis=0)
    ways = rng.normal(size=about.shape)
    ways = about + ways / np.linalg.norm(ways, axis=1, keepdims=True)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(2, len(ways))
    start, way = (np.ascontiguousarray(rows.T, np.float32) for rows in (np.repeat(points, count, axis=0), ways))
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(start), mi.Vector3f(way)))
    light, _, _ = integrator.sample(scene, sampler, ray)
    return np.pi * np.array(light).T.reshape(len(points), count, 3).mean(axis=1)


@dataclass
class Room:
    """What tests know of the room, and its files."""

    write: Callable[..., Path]
    folder: Path
    size: tuple[int, int] = SIZE
    eye: tuple[float, float, float] = EYE
    target: tuple[float, float, float] = TARGET
    fov: float = FOV
    lamp: tuple[float, float, float] = LAMP
    intensity: tuple[float, float, float] = INTENSITY
    parts: dict[str, Any] = field(default_factory=lambda: PARTS)

    def gltf(self, place: Any = (0, 0, 0), by: str = "node", **more: Any) -> Path:
        return write_room(self.write, "room.gltf", place, by, **more)

    def xml(self, place: Any = (0, 0, 0)) -> Path:
        return write_room_xml(self.folder / "room.xml", place)

    def file(self, kind: str, place: Any = (0, 0, 0)) -> Path:
        return self.gltf(place) if kind == "gltf" else self.xml(place)

    def mitsuba(self, kind: str) -> Any:
        """Mitsuba's own scene of the room at (0, 0, 0)."""
        return make_mitsuba_room() if kind == "gltf" else mi.load_file(str(self.xml()))

    def corners(self, name: str) -> np.ndarray:
        return corners_of(name)


@pytest.fixture
def room(write_gltf: Callable[..., Path], tmp_path: Path) -> Room:
    """The room at any place, as files."""
    return Room(write_gltf, tmp_path)


@pytest.fixture(scope="session")
def oracle(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], np.ndarray]:
    """A function kind -> Mitsuba's own picture (H, W, 3) of the room at (0, 0, 0)."""
    known: dict[str, np.ndarray] = {}

    def render(kind: str) -> np.ndarray:
        if kind not in known:
            path = tmp_path_factory.mktemp("oracle") / "room.xml"
            scene: Any = make_mitsuba_room() if kind == "gltf" else mi.load_file(str(write_room_xml(path, (0, 0, 0))))
            known[kind] = render_centres(scene, 512)
        return known[kind]

    return render
