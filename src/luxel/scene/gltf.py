"""The glTF 2.0 loader: a .gltf or .glb file to `SceneData`.

The order follows the file's own dependencies: container, materials, animation, node tree, then what hangs on the
nodes. Each step is a module `gltf_*.py` beside this one. What luxel does not do is named in `SceneData.warnings`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from pygltflib import Node

from luxel.errors import LuxelError
from luxel.scene.gltf_accessors import AccessorReader
from luxel.scene.gltf_animation import read_tracks
from luxel.scene.gltf_deform import MIRROR, Deformation, Skin, read_skin
from luxel.scene.gltf_document import Document, open_document
from luxel.scene.gltf_lights import read_camera, read_light
from luxel.scene.gltf_materials import MaterialTable
from luxel.scene.gltf_meshes import MeshReader, Primitive
from luxel.scene.gltf_nodes import NodeMotion, NodeTree
from luxel.scene.model import Object, SceneData

# What broken values of the wrong kind raise deep inside the conversion.
SCHEMA_ERRORS = (TypeError, ValueError, KeyError, IndexError, AttributeError, OverflowError, MemoryError)


def load_gltf(path: Path | str) -> SceneData:
    """Load a glTF 2.0 file, text or binary.

    One `Object` per node with a mesh. The first animation plays; its callables hold their end poses outside the
    keys, and `duration` is the last key's time. Cameras are those of the file (none: the list is empty).
    Raises `LuxelError` with one sentence for anything that keeps the scene from being read.
    """
    document = open_document(Path(path))
    try:
        # Overflow and NaN are looked for where they matter, and refused in words.
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return _convert(document)
    except LuxelError:
        raise
    except SCHEMA_ERRORS as error:
        cause = " ".join(str(error).split()) or type(error).__name__
        document.fail(f"its content breaks the glTF schema ({cause})", error)


def _convert(document: Document) -> SceneData:
    reader = AccessorReader(document)
    materials = MaterialTable(document, reader)
    tracks, duration = read_tracks(document, reader)
    tree = NodeTree(document, tracks)
    meshes = MeshReader(document, reader, materials)
    data = SceneData(name=document.path.stem, objects=[], materials=materials.materials, duration=duration)
    names: set[str] = set()
    for index in _visible_nodes(document):
        node = document.item(document.gltf.nodes, index, "node")
        if node.mesh is not None:
            converted = _object(document, reader, meshes, tree, index, node)
            if converted is not None:
                converted.name = _unique(converted.name, names)
                data.objects.append(converted)
        light = read_light(document, tree, index, node)
        if light is not None:
            data.lights.append(light)
        camera = read_camera(document, tree, index, node)
        if camera is not None:
            camera.name = _unique(camera.name, {other.name for other in data.cameras})
            data.cameras.append(camera)
    if not any(len(mesh.faces) for item in data.objects for mesh in item.meshes):
        document.fail("its scene has no triangles")
    data.warnings = document.warnings
    return data


def _visible_nodes(document: Document) -> list[int]:
    """Nodes of the default scene, parents first and otherwise in file order; all nodes where there is no scene."""
    gltf = document.gltf
    nodes = gltf.nodes or []
    if not gltf.scenes:
        return list(range(len(nodes)))
    if len(gltf.scenes) > 1:
        document.warn(f"The file has {len(gltf.scenes)} scenes; only its default scene is loaded.")
    scene = document.item(gltf.scenes, gltf.scene or 0, "scene")
    found: dict[int, None] = {}
    waiting = list(reversed(scene.nodes or []))
    while waiting:
        index = waiting.pop()
        if index not in found:
            node = document.item(nodes, index, "node")
            found[index] = None
            waiting.extend(reversed(node.children or []))
    return list(found)


def _object(
    document: Document, reader: AccessorReader, meshes: MeshReader, tree: NodeTree, index: int, node: Node
) -> Object | None:
    """The `Object` of a node with a mesh, posed at time 0; None where its mesh has no triangles."""
    primitives = meshes.read(_mesh_index(node))
    if not primitives:
        return None
    skin = None if node.skin is None else read_skin(document, reader, node.skin)
    to_world = tree.world(index)
    turned = skin.matrices(tree, 0.0) if skin else to_world
    mirrored = bool(np.linalg.det(turned[..., :3, :3]).sum() < 0.0)
    deform = _deformation(document, primitives, tree, index, node, skin, mirrored)
    posed = []
    for primitive, (positions, normals) in zip(primitives, deform(0.0), strict=True):
        if not np.isfinite(positions).all():
            document.fail(f"the vertices of node {index} become NaN or infinite when it is posed")
        faces = np.ascontiguousarray(primitive.mesh.faces[:, ::-1]) if mirrored else primitive.mesh.faces
        posed.append(replace(primitive.mesh, positions=positions, normals=normals, faces=faces))
    inner = MIRROR if mirrored else np.eye(4)
    mesh_name = (document.gltf.meshes or [])[_mesh_index(node)].name
    return Object(
        name=node.name or mesh_name or f"node-{index}",
        meshes=posed,
        to_world=np.eye(4) if skin else to_world @ inner,
        motion=NodeMotion(tree, index, inner) if tree.moving[index] and not skin else None,
        deform=deform if deform.moves else None,
    )


def _deformation(
    document: Document,
    primitives: list[Primitive],
    tree: NodeTree,
    index: int,
    node: Node,
    skin: Skin | None,
    mirrored: bool,
) -> Deformation:
    """Checks joints and morph weights against the mesh; weights come from the track, the node, or the mesh."""
    target_count = max(len(primitive.morph_positions) for primitive in primitives)
    track = tree.tracks.get((index, "weights"))
    if track is not None and track.values.shape[-1] != target_count:
        document.fail(f"the animated weights of node {index} do not match its {target_count} morph targets")
    mesh = document.item(document.gltf.meshes, _mesh_index(node), "mesh")
    weights = document.raw["nodes"][index].get("weights") or mesh.weights or [0.0] * target_count
    for primitive in primitives:
        if skin is None or primitive.joints is None:
            continue
        largest = int(primitive.joints.max())
        if largest >= len(skin.joints):
            document.fail(f"a vertex of node {index} names joint {largest} but its skin has {len(skin.joints)}")
    values = document.numbers(weights, target_count, f"weights of node {index}")
    return Deformation(primitives, tree, index, values, track, skin, mirrored)


def _mesh_index(node: Node) -> int:
    assert node.mesh is not None
    return node.mesh


def _unique(name: str, taken: set[str]) -> str:
    """`name`, or `name-2`, `name-3`, ... where it is taken; the result is added to `taken`."""
    candidate, number = name, 1
    while candidate in taken:
        number += 1
        candidate = f"{name}-{number}"
    taken.add(candidate)
    return candidate
