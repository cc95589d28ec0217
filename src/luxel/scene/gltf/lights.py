"""glTF cameras and KHR_lights_punctual to `Camera` and `Light`.

Both look along -Z of their node and ignore its scale. Photometric units are read as radiometric ones: candela as
W/sr, lux as W/m^2. An animated light or camera gets its pose at time 0 and a motion.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from luxel.scene.gltf.document import Document
from luxel.scene.gltf.nodes import NodeTree, RigidMotion, rigid
from luxel.scene.gltf.schema import GltfNode, Lens
from luxel.scene.model import Camera, Colour, Light

LIGHTS_EXTENSION = "KHR_lights_punctual"
DEFAULT_OUTER_ANGLE = math.pi / 4.0


def read_light(document: Document, tree: NodeTree, index: int, node: GltfNode) -> Light | None:
    """The light of node `index`, or None. Raises `LuxelError` for a light out of range or broken numbers."""
    reference = node.extensions.get(LIGHTS_EXTENSION)
    if reference is None:
        return None
    lights = document.gltf.extensions.get(LIGHTS_EXTENSION, {}).get("lights", [])
    entry: dict[str, Any] = document.item(lights, reference.get("light"), "light")
    label = f"light {reference['light']}"
    kind = entry.get("type")
    if kind not in ("directional", "point", "spot"):
        document.warn(f"The light type {kind} is unknown and is ignored.")
        return None
    name = node.name or document.clean(str(entry.get("name") or label))
    color = document.numbers(entry.get("color", (1.0, 1.0, 1.0)), 3, f"color of {label}")
    color = color * document.number(entry.get("intensity", 1.0), f"intensity of {label}")
    color = document.power(color, f"color times intensity of {label}", name)
    pose = rigid(tree.world(index))
    light = Light(
        kind=kind,
        color=_triple(color),
        position=_triple(pose[:3, 3]),
        direction=_triple(-pose[:3, 2]),
        name=name,
    )
    if kind != "directional" and entry.get("range") is not None:
        reach = document.number(entry["range"], f"range of {label}")
        if reach > 0.0:
            light.range = reach
        else:
            document.warn("A range of zero or less is read as no limit of range: {names}.", light.name)
    if kind == "spot":
        light.cos_inner, light.cos_outer = _cone(document, entry.get("spot") or {}, label)
    if tree.moving[index]:
        # Relative to the pose at time 0, as the motion is applied to that position and direction.
        light.motion = RigidMotion(tree, index, np.linalg.inv(pose))
    return light


def _cone(document: Document, spot: dict[str, Any], label: str) -> tuple[float, float]:
    """Cosines of the inner and outer half-angle; the fall-off needs the inner one to be smaller."""
    inner = document.number(spot.get("innerConeAngle", 0.0), f"innerConeAngle of {label}")
    outer = document.number(spot.get("outerConeAngle", DEFAULT_OUTER_ANGLE), f"outerConeAngle of {label}")
    outer = min(max(outer, 0.0), math.pi / 2.0)
    return math.cos(min(max(inner, 0.0), outer)), math.cos(outer)


def read_camera(document: Document, tree: NodeTree, index: int, node: GltfNode) -> Camera | None:
    """The camera of node `index`, or None where it has none. Clipping planes are not read."""
    if node.camera is None:
        return None
    entry = document.item(document.gltf.cameras, node.camera, "camera")
    name = node.name or entry.name or f"camera-{node.camera}"
    label = f"camera {node.camera}"
    pose = rigid(tree.world(index))
    camera = Camera(
        eye=_triple(pose[:3, 3]),
        target=_triple(pose[:3, 3] - pose[:3, 2]),
        up=_triple(pose[:3, 1]),
        name=name,
        motion=RigidMotion(tree, index, np.eye(4)) if tree.moving[index] else None,
    )
    if entry.type == "perspective" and entry.perspective is not None:
        camera.fov = _horizontal_fov(document, entry.perspective, label)
    elif entry.type == "orthographic" and entry.orthographic is not None:
        # xmag is half the width of what is seen; the height follows from the image.
        camera.orthographic_width = 2.0 * abs(document.number(entry.orthographic.xmag, f"xmag of {label}"))
        if camera.orthographic_width == 0.0:
            document.fail(f"{label} has the xmag 0, which sees nothing")
    else:
        document.warn("Cameras that are neither perspective nor orthographic are left out: {names}.", name)
        return None
    return camera


def _horizontal_fov(document: Document, lens: Lens, label: str) -> float:
    """Degrees, from the vertical angle and the file's own aspect ratio."""
    y_fov = document.number(lens.yfov, f"yfov of {label}")
    aspect = 1.0 if lens.aspectRatio is None else document.number(lens.aspectRatio, f"aspectRatio of {label}")
    if not 0.0 < y_fov < math.pi or aspect <= 0.0:
        document.fail(f"{label} has the yfov {y_fov} and aspect ratio {aspect}, which see nothing")
    return math.degrees(2.0 * math.atan(math.tan(0.5 * y_fov) * aspect))


def _triple(vector: np.ndarray) -> Colour:
    # Adding zero turns -0.0 into 0.0.
    return float(vector[0] + 0.0), float(vector[1] + 0.0), float(vector[2] + 0.0)
