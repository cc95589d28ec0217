"""Scenes whose light is known without rendering: the furnace and the integrating sphere."""

from __future__ import annotations

import math

import numpy as np

from luxel.scene.library.dials import require_range
from luxel.scene.library.shapes import box, sphere_zone
from luxel.scene.model import Camera, Material, Mesh, Object, SceneData

SECTORS = 72
RINGS = 48
CAP_RADIANCE = 10.0


def furnace() -> SceneData:
    """A closed box of albedo 0.5 whose every surface emits 1: the radiance is 2 everywhere.

    L = emission / (1 - albedo) = 2, E direct = pi * emission = pi, E indirect = pi * L - E direct = pi.
    """
    glow = Material("glow", (0.5, 0.5, 0.5), emission=(1.0, 1.0, 1.0))
    walls = box((-1, -1, -1), (1, 1, 1), 0, inward=True)
    # Off the axis, or the picture's diagonals would run exactly along the box's edges, where nothing has one normal.
    front = Camera(eye=(0.03, 0.05, 0.9), target=(0.0, 0.0, 0.0), fov=75.0)
    turns = [
        Camera((0.0, 0.0, 0.6), (0.0, 0.0, -1.0), fov=100.0),
        Camera((-0.6, 0.0, 0.0), (1.0, 0.0, 0.0), fov=100.0),
        Camera((0.0, 0.0, -0.6), (0.0, 0.0, 1.0), fov=100.0),
        Camera((0.6, 0.0, 0.0), (-1.0, 0.0, 0.0), fov=100.0),
        Camera((0.0, -0.6, 0.0), (0.0, 1.0, 0.01), fov=100.0),
        Camera((0.0, 0.6, 0.0), (0.0, -1.0, 0.01), fov=100.0),
    ]
    facts = {"radiance": 2.0, "direct_irradiance": math.pi, "indirect_irradiance": math.pi}
    return SceneData("furnace", [Object("box", [walls])], [glow], cameras=[front], flight=[front, *turns], facts=facts)


def sphere(*, cap: float = 20.0, albedo: float = 0.6) -> SceneData:
    """An integrating sphere of radius 1 with an emitting cap: the irradiance is known and the same everywhere.

    `cap` is the cap's half angle in degrees, `albedo` that of the whole inside, cap included.

    In a sphere the form factor between any two patches is dA / A, whatever their places, so light of radiosity B
    on an area A_B gives E = B * A_B / A at every point. The cap (radiance L, radiosity pi * L) gives
    E_direct = pi * L * A_cap / A. What is reflected is albedo * (E_direct + E_indirect) on all of A, so
    E_indirect = albedo * (E_direct + E_indirect), that is E_indirect = E_direct * albedo / (1 - albedo).
    The areas are those of the triangles: for a closed convex polyhedron these are the exact means over its surface
    of E_direct, and of E_indirect up to the second order in the facets' size.
    """
    require_range("cap", cap, 2.0, 90.0)
    require_range("albedo", albedo, 0.0, 0.95)
    edge = math.radians(cap)
    cap_rings = max(3, round(RINGS * cap / 180.0))
    lamp = sphere_zone((0, 0, 0), 1.0, 0, np.linspace(0.0, edge, cap_rings + 1), SECTORS, inward=True)
    wall_polar = np.linspace(edge, math.pi, RINGS - min(cap_rings, RINGS // 2) + 1)
    wall = sphere_zone((0, 0, 0), 1.0, 1, wall_polar, SECTORS, inward=True)
    grey = (albedo, albedo, albedo)
    glow = (CAP_RADIANCE, CAP_RADIANCE, CAP_RADIANCE)
    materials = [Material("cap", grey, emission=glow), Material("wall", grey)]
    cap_share = _area(lamp) / (_area(lamp) + _area(wall))
    direct = math.pi * CAP_RADIANCE * cap_share
    facts = {"direct_irradiance": direct, "indirect_irradiance": direct * albedo / (1.0 - albedo)}
    view = Camera(eye=(0.0, -0.1, 0.6), target=(0.0, 0.1, -1.0), fov=90.0)
    turns = [
        Camera((-0.5, 0.0, 0.0), (1.0, 0.0, 0.0), fov=110.0),
        Camera((0.0, 0.0, -0.5), (0.0, 0.0, 1.0), fov=110.0),
        Camera((0.5, 0.0, 0.0), (-1.0, 0.0, 0.0), fov=110.0),
        Camera((0.0, -0.5, 0.0), (0.0, 1.0, 0.01), fov=110.0),
        Camera((0.0, 0.5, 0.0), (0.0, -1.0, 0.01), fov=110.0),
    ]
    return SceneData(
        "sphere", [Object("sphere", [lamp, wall])], materials, cameras=[view], flight=[view, *turns], facts=facts
    )


def _area(mesh: Mesh) -> float:
    corners = mesh.positions[mesh.faces].astype(float)
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(doubled, axis=1).sum() / 2)
