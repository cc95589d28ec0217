"""A room under a roof whose timbers run through the ceiling and the walls: geometry that intersects on purpose."""

from __future__ import annotations

import math

import numpy as np

from luxel.scene.library.dials import require_range
from luxel.scene.library.shapes import box, make_mesh, merge, quad, rotation, transformed, translation
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData, Sky

HALF_WIDTH, HALF_LENGTH = 3.0, 4.0
KNEE, RIDGE, CEILING = 1.0, 3.7, 2.5
WINDOW = ((-0.6, 0.9), (0.6, 0.9), (0.6, 1.9), (-0.6, 1.9))
"""(x, y) of the window's corners in the gable at +Z."""
PLASTER, BOARDS, TIMBER, BRICK, LAMP = range(5)


def attic(*, beam: float = 0.18, beams: int = 6) -> SceneData:
    """A room under a pitched roof, with rafters sunk in the slopes and beams pushed through the ceiling.

    `beam` is the side of a timber in metres, `beams` how many pairs of rafters and tie beams there are. Sun and sky
    come in by a gable window, a small lamp lights the far end; the loft above the ceiling is dark.
    """
    require_range("beam", beam, 0.02, 0.5)
    require_range("beams", beams, 0, 20)
    materials = [
        Material("plaster", (0.80, 0.78, 0.73)),
        Material("boards", (0.45, 0.31, 0.19)),
        Material("timber", (0.34, 0.21, 0.12)),
        Material("brick", (0.58, 0.24, 0.16)),
        Material("lamp", (0.8, 0.8, 0.8), emission=(12.0, 9.0, 5.5)),
    ]
    lamp = quad((0.6, 2.1, -2.8), (1.1, 2.1, -2.8), (1.1, 2.1, -2.3), (0.6, 2.1, -2.3), LAMP)
    objects = [
        Object("shell", [_shell(), box((-3, 0, -4), (3, RIDGE, 4), BOARDS, inward=True, sides=("-y",))]),
        # The ceiling runs on through slopes and gables: what lies above it is a loft of its own.
        Object("ceiling", [box((-1.45, CEILING, -4.1), (1.45, CEILING + 0.06, 4.1), PLASTER)]),
        Object("chimney", [box((-1.9, -0.05, -2.6), (-1.2, 3.2, -1.9), BRICK)]),
        Object("trunk", [box((0.9, 0.0, -1.4), (1.9, 0.55, -0.8), BRICK)]),
        Object("lamp", [lamp]),
    ]
    if beams:
        objects.append(Object("timbers", [_timbers(beam, beams)]))
    sun = Light("directional", (24.0, 22.2, 19.2), direction=(-0.22, -0.36, -1.0), name="sun")
    view = Camera(eye=(-1.6, 1.5, 3.6), target=(0.4, 1.15, -2.0), fov=75.0)
    flight = [
        view,
        Camera((1.9, 1.3, 3.5), (-0.6, 1.3, -2.5), fov=90.0),
        Camera((0.0, 2.0, 0.6), (2.6, 0.6, -1.4), fov=110.0),
        Camera((0.0, 2.0, -0.6), (-2.6, 0.6, 1.4), fov=110.0),
        Camera((2.3, 0.9, 0.5), (-2.5, 1.2, -1.5), fov=100.0),
        Camera((2.2, 1.0, -3.6), (-1.0, 1.3, 1.0), fov=100.0),
        Camera((0.0, 1.1, -3.7), (0.0, 1.6, 2.0), fov=95.0),
        Camera((-2.4, 1.0, -3.6), (1.0, 1.2, 0.5), fov=100.0),
        Camera((-2.2, 0.9, 0.0), (2.4, 1.3, 1.0), fov=105.0),
        Camera((0.0, 0.5, 0.0), (0.0, 2.5, 0.3), fov=120.0),
        Camera((0.0, 2.9, 3.8), (0.0, 2.9, -3.0), fov=100.0),
        Camera((0.0, 2.9, -3.8), (0.0, 2.9, 3.0), fov=100.0),
    ]
    sky = Sky((1.6, 1.9, 2.3))
    return SceneData("attic", objects, materials, [sun], cameras=[view], sky=sky, flight=flight)


def _shell() -> Mesh:
    """Return knee walls, roof slopes and gables, facing inwards, with a window in the gable at +Z."""
    left, right, front, back = -HALF_WIDTH, HALF_WIDTH, HALF_LENGTH, -HALF_LENGTH
    section = [(left, 0.0), (right, 0.0), (right, KNEE), (0.0, RIDGE), (left, KNEE)]
    parts = []
    for (x0, y0), (x1, y1) in zip(section[1:], section[2:] + section[:1], strict=True):
        parts.append(quad((x0, y0, front), (x1, y1, front), (x1, y1, back), (x0, y0, back), PLASTER))
    gable = [(0, 1, 2), (0, 2, 4), (2, 3, 4)]
    parts.append(make_mesh([(x, y, back) for x, y in section], gable, PLASTER, uv=np.array(section)))
    # Counter-clockwise seen from outside, hence turned: 0 to 4 are the gable's corners, 5 to 8 the window's.
    ring = np.array([(0, 1, 6), (0, 6, 5), (1, 2, 6), (2, 7, 6), (2, 3, 7), (3, 8, 7), (3, 4, 8), (4, 5, 8), (4, 0, 5)])
    corners = section + list(WINDOW)
    parts.append(make_mesh([(x, y, front) for x, y in corners], ring[:, ::-1], PLASTER, uv=np.array(corners)))
    for (x0, y0), (x1, y1) in zip(WINDOW, WINDOW[1:] + WINDOW[:1], strict=True):
        out = front + 0.2
        parts.append(quad((x0, y0, out), (x1, y1, out), (x1, y1, front), (x0, y0, front), PLASTER))
    return merge(parts)


def _timbers(size: float, count: int) -> Mesh:
    """Return `count` pairs of rafters, sunk half into the slopes, and tie beams through ceiling and slopes."""
    rise, run = RIDGE - KNEE, HALF_WIDTH
    slope, length = math.degrees(math.atan2(rise, run)), math.hypot(rise, run)
    half = size / 2
    parts = []
    for z in np.linspace(-HALF_LENGTH + 0.6, HALF_LENGTH - 0.6, count) if count > 1 else [0.0]:
        rafter = box((-0.1, -half, -half), (length, half, half), TIMBER)
        left = translation(-HALF_WIDTH, KNEE, z) @ rotation("z", slope)
        parts += [transformed(rafter, left), transformed(rafter, rotation("y", 180.0) @ left)]
        tie = box((-1.9, CEILING - 0.6 * size, z - 0.8 * half), (1.9, CEILING + 0.4 * size, z + 0.8 * half), TIMBER)
        parts.append(tie)
    return merge(parts)
