"""Acceleration structures, by device.

With Embree each group of triangles is a scene of its own. Rays are brought to the space of a moving group instead of
rebuilding anything, which Embree would do for the whole scene. OptiX allows a kernel only one structure, so there the
groups are shapes and instances of one scene, and moving an instance rebuilds its small top level.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.scene.arrays import from_numpy, vectors_from_numpy

CRACK_RATIO = 1e3
"""Coordinates so many times a triangle's longest edge leave cracks between triangles that a ray in 100,000 finds,
unless Embree takes its slower test (a fifth of the time for rays)."""


@dataclass
class Group:
    """Triangles that are traced together, and where they stand in the shared buffers."""

    name: str
    accel: mi.Scene | None
    """Its own structure; None where the groups share one."""
    prim_offset: int
    object_id: int
    """0: world space; else the moving object whose space its vertices are in."""
    cutout: bool
    """Alpha-tested: rays go on through holes."""
    prim_count: int


@dataclass
class OneAccel:
    """All groups in one structure."""

    accel: mi.Scene
    prim_offsets: mi.UInt32
    """By shape (or instance) id in Dr.Jit's registry."""
    several: bool
    """More than one shape: `prim_offsets` is needed."""
    cutout: bool


def make_accel(positions: np.ndarray, faces: np.ndarray) -> mi.Scene:
    """Return a Mitsuba scene that holds one mesh: (V, 3) positions, (F, 3) faces."""
    settings = _embree_settings(positions, faces)
    scene = mi.load_dict({"type": "scene", **settings, "mesh": _make_mesh("mesh", positions, faces)})
    assert isinstance(scene, mi.Scene)
    return scene


def _embree_settings(positions: np.ndarray, faces: np.ndarray) -> dict[str, bool]:
    """Return what to ask of Embree: the test without cracks where most triangles are small for where they stand."""
    if dr.backend_v(mi.Float) != dr.JitBackend.LLVM:
        return {}
    corners = np.asarray(positions, np.float64)[faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    far = np.median(np.abs(corners).max(axis=(1, 2)) / np.maximum(edges, 1e-30)) > CRACK_RATIO
    return {"embree_use_robust_intersections": bool(far)}


def build_one_accel(meshes: list[tuple[Group, np.ndarray, np.ndarray, bool]], matrices: np.ndarray) -> OneAccel:
    """Return the structure of all groups: (group, positions, faces, deforms) each; still ones become one mesh."""
    still = [mesh for mesh in meshes if mesh[0].object_id == 0]
    content: dict[str, object] = {"type": "scene"}
    offsets: dict[str, int] = {}
    if still:
        # Still groups come first in the shared buffers, so the merged mesh counts triangles as they do.
        starts = np.cumsum([0, *(len(positions) for _, positions, _, _ in still)])
        positions = np.concatenate([positions for _, positions, _, _ in still])
        faces = np.concatenate([faces + start for (_, _, faces, _), start in zip(still, starts, strict=False)])
        content["still"] = _make_mesh("still", positions, faces)
        offsets["still"] = 0
    for group, positions, faces, deforms in meshes:
        if group.object_id == 0:
            continue
        offsets[group.name] = group.prim_offset
        if deforms:
            # An instance would hide the mesh's vertices from updates, so a deforming mesh stands in world space.
            content[group.name] = _make_mesh(group.name, place(positions, matrices[group.object_id]), faces)
            continue
        mesh = _make_mesh(group.name, positions, faces)
        content[f"{group.name}-shapes"] = {"type": "shapegroup", "mesh": mesh}
        content[group.name] = {
            "type": "instance",
            "to_world": mi.ScalarTransform4f(matrices[group.object_id].astype(np.float64)),
            "shapes": {"type": "ref", "id": f"{group.name}-shapes"},
        }
    scene = mi.load_dict(content, parallel=False)
    assert isinstance(scene, mi.Scene)
    ids = np.array(dr.reinterpret_array(mi.UInt32, scene.shapes_dr())).ravel()
    table = np.zeros(int(ids.max()) + 1, np.uint32)
    for shape, registry_id in zip(scene.shapes(), ids, strict=True):
        table[registry_id] = offsets.get(shape.id(), 0)
    cutout = any(group.cutout for group, *_ in meshes)
    return OneAccel(scene, from_numpy(mi.UInt32, table), len(offsets) > 1, cutout)


def move_instance(one: OneAccel, names: list[str], matrix: np.ndarray) -> None:
    """Place the instances `names` at `matrix` (4, 4)."""
    params = mi.traverse(one.accel)
    for name in names:
        params[f"{name}.to_world"] = mi.Transform4f(matrix)
    params.update()


def write_mesh_positions(accel: mi.Scene, positions: np.ndarray, name: str) -> None:
    """Replace the vertices of mesh `name` (or of the only mesh). With `_make_mesh`, all that names mesh parameters."""
    params = mi.traverse(accel)
    keys = [key for key, _ in params if key.endswith("vertex_positions")]
    key = keys[0] if len(keys) == 1 else f"{name}.vertex_positions"
    params[key] = from_numpy(mi.Float, positions)
    params.update()


def place(positions: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Return (V, 3) positions moved by a (4, 4) matrix."""
    return positions @ matrix[:3, :3].T + matrix[:3, 3]


def _make_mesh(name: str, positions: np.ndarray, faces: np.ndarray) -> mi.Mesh:
    mesh = mi.Mesh(name, len(positions), len(faces))
    params = mi.traverse(mesh)
    params["vertex_positions"] = from_numpy(mi.Float, positions)
    params["faces"] = from_numpy(mi.UInt32, faces)
    params.update()
    mesh.set_id(name)
    return mesh


def find_hits(
    groups: list[Group], one: OneAccel | None, matrices: np.ndarray, origins: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return what rays meet first, holes of cut-outs included: distance (N,), infinite for a miss, and triangle (N,).

    `origins` and unit `directions` are (N, 3), world space; objects stand at `matrices`. For the host, while a scene is
    uploaded; kernels trace by `kernels/trace.py`.
    """
    found: list[tuple[mi.Float, mi.UInt32]] = []
    for group in groups if one is None else groups[:1]:
        o, d, accel = origins, directions, group.accel if one is None else one.accel
        if one is None and group.object_id:
            inverse = np.linalg.inv(matrices[group.object_id])
            o, d = place(o, inverse), d @ inverse[:3, :3].T
        assert accel is not None
        ray = mi.Ray3f(vectors_from_numpy(mi.Point3f, o), vectors_from_numpy(mi.Vector3f, d))
        hit = accel.ray_intersect_preliminary(ray, coherent=False)
        prim = hit.prim_index + (group.prim_offset if one is None else 0)
        if one is not None and one.several:
            instance = dr.reinterpret_array(mi.UInt32, hit.instance)
            owner = dr.select(instance != 0, instance, dr.reinterpret_array(mi.UInt32, hit.shape))
            prim += dr.gather(mi.UInt32, one.prim_offsets, owner, hit.is_valid())
        found.append((dr.select(hit.is_valid(), hit.t, dr.inf), mi.UInt32(prim)))
    dr.eval(found)
    t, prim = np.full(len(origins), np.inf), np.zeros(len(origins), np.int64)
    for distance, triangle in found:
        nearer = np.array(distance) < t
        t[nearer], prim[nearer] = np.array(distance)[nearer], np.array(triangle)[nearer]
    return t, prim
