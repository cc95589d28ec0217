"""Triangle meshes in code: the shapes that the built-in scenes are put together from.

Corners of neighbouring faces are equal to the last bit, so closed shapes are closed for rays too.
Faces wind counter-clockwise from the side that their normal points to.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from luxel.scene.model import Mesh

Point = Sequence[float] | np.ndarray

BOX_FACES: dict[str, tuple[int, int, int, int]] = {
    "-x": (0, 4, 6, 2),
    "+x": (1, 3, 7, 5),
    "-y": (0, 1, 5, 4),
    "+y": (2, 6, 7, 3),
    "-z": (0, 2, 3, 1),
    "+z": (4, 5, 7, 6),
}
"""Corners of each side, outward winding; bit 0 of a corner's number is x high, bit 1 y high, bit 2 z high."""


def make_mesh(
    positions: np.ndarray | Sequence[Point],
    faces: np.ndarray | Sequence[Sequence[int]],
    material: int,
    *,
    normals: np.ndarray | None = None,
    uv: np.ndarray | None = None,
) -> Mesh:
    """Return a `Mesh` with the array types of the contract. positions (V, 3), faces (F, 3)."""
    return Mesh(
        positions=np.asarray(positions, np.float32).reshape(-1, 3),
        faces=np.asarray(faces, np.uint32).reshape(-1, 3),
        material=material,
        normals=None if normals is None else np.asarray(normals, np.float32).reshape(-1, 3),
        uv=None if uv is None else np.asarray(uv, np.float32).reshape(-1, 2),
    )


def quad(a: Point, b: Point, c: Point, d: Point, material: int, *, uv_scale: tuple[float, float] = (1.0, 1.0)) -> Mesh:
    """Return the flat quadrilateral a, b, c, d (counter-clockwise); uv runs from (0, 0) at a to `uv_scale` at c."""
    u, v = uv_scale
    return make_mesh([a, b, c, d], [(0, 1, 2), (0, 2, 3)], material, uv=np.array([(0, 0), (u, 0), (u, v), (0, v)]))


def box(lo: Point, hi: Point, material: int, *, inward: bool = False, sides: Sequence[str] = tuple(BOX_FACES)) -> Mesh:
    """Return the named `sides` of the axis-aligned box, facing outwards, or into the box where `inward`."""
    corners = [[(lo, hi)[corner >> axis & 1][axis] for axis in range(3)] for corner in range(8)]
    walls = []
    for side in sides:
        around = BOX_FACES[side][::-1] if inward else BOX_FACES[side]
        a, b, c, d = (corners[corner] for corner in around)
        walls.append(quad(a, b, c, d, material))
    return merge(walls)


def framed_hole(outer: Sequence[Point], hole: Sequence[Point], material: int) -> Mesh:
    """Return the flat ring between the quadrilaterals `outer` and `hole` (four corners each, same order).

    Its outer edges are whole, so a wall with a hole meets its neighbours without a T-junction.
    """
    ring = [quad(outer[i], outer[(i + 1) % 4], hole[(i + 1) % 4], hole[i], material) for i in range(4)]
    return merge(ring)


def cylinder(
    base: Point,
    radius: float,
    height: float,
    material: int,
    *,
    top_radius: float | None = None,
    sides: int = 16,
    capped: bool = False,
) -> Mesh:
    """Return an upright column with smooth normals; `top_radius` makes a cone, `capped` closes both ends."""
    top = radius if top_radius is None else top_radius
    angle = np.arange(sides) * (2 * math.pi / sides)
    ring = np.stack([np.sin(angle), np.zeros(sides), np.cos(angle)], axis=1)
    lower = np.asarray(base, float) + ring * radius
    upper = np.asarray(base, float) + ring * top + [0, height, 0]
    slope = ring + [0, (radius - top) / height, 0]
    normals = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    here = np.arange(sides)
    after = (here + 1) % sides
    faces = np.concatenate(
        [np.stack([here, after, after + sides], axis=1), np.stack([here, after + sides, here + sides], axis=1)]
    )
    shell = make_mesh(np.concatenate([lower, upper]), faces, material, normals=np.concatenate([normals, normals]))
    if not capped:
        return shell
    fan = np.stack([np.zeros(sides - 2, int), here[1:-1], here[2:]], axis=1)
    return merge([shell, make_mesh(upper, fan, material), make_mesh(lower, fan[:, ::-1], material)])


def sphere(
    centre: Point, radius: float, material: int, *, rings: int = 16, sectors: int = 32, inward: bool = False
) -> Mesh:
    """Return a sphere of `rings` x `sectors` with smooth normals; poles on the Y axis."""
    return sphere_zone(centre, radius, material, np.linspace(0.0, math.pi, rings + 1), sectors, inward=inward)


def sphere_zone(
    centre: Point, radius: float, material: int, polar: np.ndarray, sectors: int, *, inward: bool = False
) -> Mesh:
    """Return the part of a sphere between rising angles `polar` (radians from +Y); 0 and pi close it at a pole."""
    angle = np.arange(sectors) * (2 * math.pi / sectors)
    rows = []
    for theta in polar:
        at_pole = theta < 1e-9 or theta > math.pi - 1e-9
        sine = 0.0 if at_pole else math.sin(theta)
        height = np.full(sectors, math.cos(theta))
        rows.append(np.stack([sine * np.sin(angle), height, sine * np.cos(angle)], axis=1))
    unit = np.concatenate(rows)
    faces = []
    for row in range(len(polar) - 1):
        here = row * sectors + np.arange(sectors)
        after = row * sectors + (np.arange(sectors) + 1) % sectors
        if polar[row] > 1e-9:
            faces.append(np.stack([here, after + sectors, after], axis=1))
        if polar[row + 1] < math.pi - 1e-9:
            faces.append(np.stack([here, here + sectors, after + sectors], axis=1))
    triangles = np.concatenate(faces)
    if inward:
        triangles = triangles[:, ::-1]
    return make_mesh(np.asarray(centre, float) + unit * radius, triangles, material, normals=-unit if inward else unit)


def arch(
    width: float, height: float, spring: float, radius: float, thickness: float, material: int, *, segments: int = 12
) -> Mesh:
    """Return a wall panel with a round-headed opening, x in -width/2..width/2, y in spring..height, centred on z = 0.

    The half circle of `radius` stands on y = spring; beside it the panel goes down to `spring` too.
    Its two ends (x = +-width/2) and its top are left open: panels stand side by side under a slab.
    """
    angle = np.linspace(math.pi, 0.0, segments + 1)
    curve = np.stack([radius * np.cos(angle), spring + radius * np.sin(angle)], axis=1)
    curve[0], curve[-1] = (-radius, spring), (radius, spring)
    half, depth = width / 2, thickness / 2
    lower = np.concatenate([[(-half, spring)], curve, [(half, spring)]])
    strips = []
    for (x0, y0), (x1, y1) in zip(lower[:-1], lower[1:], strict=True):
        if x1 - x0 > 1e-9:
            strips.append(quad((x0, y0, depth), (x1, y1, depth), (x1, height, depth), (x0, height, depth), material))
            strips.append(
                quad((x1, y1, -depth), (x0, y0, -depth), (x0, height, -depth), (x1, height, -depth), material)
            )
            strips.append(quad((x0, y0, -depth), (x1, y1, -depth), (x1, y1, depth), (x0, y0, depth), material))
    return merge(strips)


def cloth(surface: Callable[[np.ndarray, np.ndarray], np.ndarray], columns: int, rows: int, material: int) -> Mesh:
    """Return the grid mesh of `surface(u, v)` -> (N, 3), u and v in 0..1, with smooth normals along du x dv."""
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    flat_u, flat_v = u.ravel(), v.ravel()
    step = 1e-4
    along_u = surface(flat_u + step, flat_v) - surface(flat_u - step, flat_v)
    along_v = surface(flat_u, flat_v + step) - surface(flat_u, flat_v - step)
    normals = np.cross(along_u, along_v)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)[None, :]).ravel()
    over = first + columns + 1
    faces = np.concatenate([np.stack([first, first + 1, over + 1], axis=1), np.stack([first, over + 1, over], axis=1)])
    uv = np.stack([flat_u, flat_v], axis=1)
    return make_mesh(surface(flat_u, flat_v), faces, material, normals=normals, uv=uv)


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """Return one mesh of all triangles. All must share a material; flat ones get face normals beside smooth ones."""
    smooth = any(mesh.normals is not None for mesh in meshes)
    textured = all(mesh.uv is not None for mesh in meshes)
    starts = np.cumsum([0] + [len(mesh.positions) for mesh in meshes[:-1]])
    if smooth:
        meshes = [mesh if mesh.normals is not None else _with_face_normals(mesh) for mesh in meshes]
        starts = np.cumsum([0] + [len(mesh.positions) for mesh in meshes[:-1]])
    return make_mesh(
        np.concatenate([mesh.positions for mesh in meshes]),
        np.concatenate([mesh.faces + np.uint32(start) for mesh, start in zip(meshes, starts, strict=True)]),
        meshes[0].material,
        normals=np.concatenate([mesh.normals for mesh in meshes if mesh.normals is not None]) if smooth else None,
        uv=np.concatenate([mesh.uv for mesh in meshes if mesh.uv is not None]) if textured else None,
    )


def transformed(mesh: Mesh, matrix: np.ndarray) -> Mesh:
    """Return the mesh moved by a (4, 4) matrix; a mirroring matrix turns the winding so that fronts stay fronts."""
    linear = matrix[:3, :3]
    positions = mesh.positions @ linear.T + matrix[:3, 3]
    faces = mesh.faces if np.linalg.det(linear) > 0 else mesh.faces[:, ::-1]
    normals = None
    if mesh.normals is not None:
        normals = mesh.normals @ np.linalg.inv(linear)
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return make_mesh(positions, faces, mesh.material, normals=normals, uv=mesh.uv)


def translation(x: float, y: float, z: float) -> np.ndarray:
    """Return the (4, 4) matrix that moves by (x, y, z)."""
    matrix = np.eye(4)
    matrix[:3, 3] = (x, y, z)
    return matrix


def scaling(x: float, y: float, z: float) -> np.ndarray:
    """Return the (4, 4) matrix that scales by (x, y, z)."""
    return np.diag([x, y, z, 1.0])


def rotation(axis: str, degrees: float) -> np.ndarray:
    """Return the (4, 4) right-handed rotation about "x", "y" or "z"."""
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    matrix = np.eye(4)
    matrix[first, first] = matrix[second, second] = cosine
    matrix[first, second], matrix[second, first] = -sine, sine
    return matrix


def _with_face_normals(mesh: Mesh) -> Mesh:
    """Return the mesh with its corners unshared and each carrying its triangle's normal."""
    corners = mesh.positions[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    uv = None if mesh.uv is None else mesh.uv[mesh.faces].reshape(-1, 2)
    faces = np.arange(3 * len(mesh.faces))
    return make_mesh(corners, faces, mesh.material, normals=np.repeat(normals, 3, axis=0), uv=uv)
