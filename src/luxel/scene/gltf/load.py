"""The glTF 2.0 loader: a .gltf or .glb file to `SceneData`.

The order follows the file's own dependencies: container, materials, animation, node tree, then what hangs on the
nodes. Each step is a module beside this one. What luxel does not do is named in `SceneData.warnings`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from luxel.errors import LuxelError
from luxel.scene.gltf.accessors import AccessorReader
from luxel.scene.gltf.animation import read_tracks
from luxel.scene.gltf.document import Document, open_document
from luxel.scene.gltf.lights import read_camera, read_light
from luxel.scene.gltf.materials import MaterialTable
from luxel.scene.gltf.nodes import NodeTree, hidden_nodes, record_nodes
from luxel.scene.gltf.objects import ObjectReader
from luxel.scene.model import SceneData
from luxel.scene.origin import choose_origin

# What broken values of the wrong kind raise deep inside the conversion.
SCHEMA_ERRORS = (TypeError, ValueError, KeyError, IndexError, AttributeError, OverflowError, MemoryError)


def load_gltf(path: Path | str, animation: str | int | None = None) -> SceneData:
    """Load a glTF 2.0 file, text or binary.

    One `Object` per node with a mesh, or per instance of it. `animation` plays: a name, a number from 0, "all" (all of
    them at once) or None (the first). Its callables hold their end poses outside the keys, and `duration` is the last
    key's time. Cameras are those of the file (none: the list is empty).
    Raises `LuxelError` with one sentence for anything that keeps the scene from being read.
    """
    document = open_document(Path(path))
    try:
        # Overflow and NaN are looked for where they matter, and refused in words.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return _convert(document, animation)
    except LuxelError:
        raise
    except SCHEMA_ERRORS as error:
        cause = " ".join(str(error).split()) or type(error).__name__
        document.fail(f"its content breaks the glTF schema ({cause})", error)


def _convert(document: Document, animation: str | int | None) -> SceneData:
    reader = AccessorReader(document)
    materials = MaterialTable(document, reader)
    tracks, duration = read_tracks(document, reader, animation)
    tree = NodeTree(document, tracks)
    shapes = ObjectReader(document, reader, materials, tree)
    data = SceneData(name=document.path.stem, objects=[], materials=materials.materials, duration=duration)
    objects, cameras = UniqueNames(), UniqueNames()
    hidden = hidden_nodes(document, tree)
    chosen = _nodes_of_scene(document)
    place = {index: number for number, index in enumerate(sorted(chosen))}
    data.nodes = record_nodes(document, tree, place)
    for index in chosen:
        node = document.gltf.nodes[index]
        if node.mesh is not None and not hidden[index]:
            for item in shapes.objects_of(index, node):
                item.name, item.node = objects.add(item.name), place[index]
                data.objects.append(item)
        light = None if hidden[index] else read_light(document, tree, index, node)
        if light is not None:
            data.lights.append(light)
        camera = read_camera(document, tree, index, node)
        if camera is not None:
            camera.name = cameras.add(camera.name)
            data.cameras.append(camera)
    if not data.objects:
        why = ", as KHR_node_visibility hides its nodes" if hidden.any() else ""
        document.fail(f"its scene has no triangles{why}")
    data.warnings = document.warnings.sentences()
    data.diffuse_warnings = document.warnings.sentences(diffuse_only=True)
    choose_origin(data)
    return data


def _nodes_of_scene(document: Document) -> list[int]:
    """Nodes of the default scene, parents first and otherwise in file order; all nodes where there is no scene."""
    gltf = document.gltf
    if not gltf.scenes:
        return list(range(len(gltf.nodes)))
    if len(gltf.scenes) > 1:
        document.warn(f"The file has {len(gltf.scenes)} scenes; only its default scene is loaded.")
    scene = document.item(gltf.scenes, gltf.scene or 0, "scene")
    found: dict[int, None] = {}
    waiting = list(reversed(scene.nodes))
    while waiting:
        index = waiting.pop()
        if index not in found:
            node = document.item(gltf.nodes, index, "node")
            found[index] = None
            waiting.extend(reversed(node.children))
    return list(found)


class UniqueNames:
    """Names given out once each: `name`, then `name-2`, `name-3`, ..."""

    def __init__(self) -> None:
        self._taken: set[str] = set()
        self._last: dict[str, int] = {}

    def add(self, name: str) -> str:
        """`name`, or its next number where it is taken."""
        candidate = name
        while candidate in self._taken:
            self._last[name] = self._last.get(name, 1) + 1
            candidate = f"{name}-{self._last[name]}"
        self._taken.add(candidate)
        return candidate
