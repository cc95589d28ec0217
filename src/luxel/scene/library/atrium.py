"""A courtyard of two storeys of arcades with hanging cloths: a light stand-in for Sponza, 30 x 18 x 12 m."""

from __future__ import annotations

import numpy as np

from luxel.scene.library.shapes import arch, box, cloth, cylinder, merge, quad, sphere, transformed, translation
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData, Sky, Texture

LENGTH, DEPTH, EAVES, TOP = 15.0, 9.0, 10.6, 12.0
"""Half length (x) and half depth (z) of the walls, height of the roof and of the parapet."""
COURT = 4.0
"""Distance of the arcades' middle from the long axis."""
BAY, BAYS = 3.6, 8
GALLERY_LOW, GALLERY = 5.2, 5.5
"""Under side and floor of the upper storey."""
THICKNESS = 0.7

STONE, PLASTER, COLUMN, FLOOR, WOOD, RED, GREEN, BLUE, OCHRE = range(9)
COLUMN_X = tuple(BAY * (index - BAYS / 2) for index in range(BAYS + 1))


def atrium() -> SceneData:
    """A sunlit courtyard, two storeys of arcades with columns and coloured cloths: a light stand-in for Sponza."""
    materials = [
        Material("stone", (0.66, 0.56, 0.43)),
        Material("plaster", (0.78, 0.71, 0.60)),
        Material("column", (0.74, 0.69, 0.60)),
        Material("floor", (1.0, 1.0, 1.0), base_color_texture=Texture(_paving(), srgb=False)),
        Material("wood", (0.32, 0.20, 0.11)),
        Material("red cloth", (0.66, 0.06, 0.05)),
        Material("green cloth", (0.08, 0.40, 0.12)),
        Material("blue cloth", (0.07, 0.17, 0.55)),
        Material("ochre cloth", (0.76, 0.47, 0.08)),
    ]
    objects = [
        Object("walls", _walls()),
        Object("slabs", [merge([_slabs(GALLERY_LOW, GALLERY, -0.05), _slabs(EAVES - 0.3, EAVES, 0.1)]), _parapet()]),
        Object("arcades", [merge([_arcade(3.4, GALLERY_LOW), _arcade(8.2, EAVES - 0.3)])]),
        Object("columns", [merge([_columns(0.0, 3.4, 0.36), _columns(GALLERY, 8.2, 0.27)])]),
        Object("balustrade", [_balustrade()]),
        Object("fountain", [_fountain()]),
        Object("doors", _doors()),
        Object("banners", _banners()),
        Object("awnings", _awnings()),
    ]
    sun = Light("directional", (20.0, 18.4, 15.6), direction=(0.42, -1.0, 0.40), name="sun")
    view = Camera(eye=(-13.4, 2.6, -0.9), target=(0.0, 3.9, 0.5), fov=75.0)
    sky = Sky((0.75, 1.0, 1.35))
    return SceneData("atrium", objects, materials, [sun], cameras=[view], sky=sky, flight=[view, *_flight()])


def _walls() -> list[Mesh]:
    lo, hi = (-LENGTH, 0.0, -DEPTH), (LENGTH, EAVES, DEPTH)
    (x0, _, z0), (x1, _, z1) = lo, hi
    floor = quad((x0, 0, z1), (x1, 0, z1), (x1, 0, z0), (x0, 0, z0), FLOOR, uv_scale=(2 * LENGTH / 3, 2 * DEPTH / 3))
    return [box(lo, hi, PLASTER, inward=True, sides=("-x", "+x", "-z", "+z")), floor]


def _slabs(low: float, high: float, over: float) -> Mesh:
    """Return the floors (or roofs) of both aisles; they run on into the walls by `over` or stop short of them."""
    edge, wall = COURT - THICKNESS / 2 - 0.1, DEPTH + max(over, 0.0) + 0.05
    end = LENGTH + 0.05
    return merge([box((-end, low, edge), (end, high, wall), STONE), box((-end, low, -wall), (end, high, -edge), STONE)])


def _parapet() -> Mesh:
    edge, end = COURT - THICKNESS / 2 - 0.1, LENGTH + 0.05
    sides = [box((-end, EAVES - 0.05, z - 0.2), (end, EAVES + 0.7, z + 0.2), STONE) for z in (edge + 0.3, -edge - 0.3)]
    ends = [box((x - 0.2, EAVES - 0.05, -edge), (x + 0.2, TOP, edge), STONE) for x in (-end, end)]
    return merge(sides + ends)


def _arcade(spring: float, height: float) -> Mesh:
    """Return one storey's arches on both sides of the court, standing on the columns' heads."""
    bay = arch(BAY, height + 0.02, spring, 1.32, THICKNESS, STONE, segments=16)
    middles = [(left + right) / 2 for left, right in zip(COLUMN_X[:-1], COLUMN_X[1:], strict=True)]
    panels = [transformed(bay, translation(x, 0.0, z)) for x in middles for z in (-COURT, COURT)]
    # The last half bays, between the outer columns and the end walls, are solid.
    reach = (COLUMN_X[-1], LENGTH + 0.05)
    for x0, x1 in (reach, (-reach[1], -reach[0])):
        for z in (-COURT, COURT):
            corner = (x0, spring, z - THICKNESS / 2), (x1, height + 0.02, z + THICKNESS / 2)
            panels.append(box(*corner, STONE, sides=("-y", "-z", "+z")))
    return merge(panels)


def _columns(foot: float, head: float, radius: float) -> Mesh:
    """Return one storey's columns: plinth, slightly tapered shaft, capital."""
    parts = []
    for x in COLUMN_X:
        for z in (-COURT, COURT):
            wide = radius * 1.35
            parts.append(box((x - wide, foot, z - wide), (x + wide, foot + 0.22, z + wide), COLUMN))
            parts.append(cylinder((x, foot + 0.22, z), radius * 1.2, 0.1, COLUMN, top_radius=radius, sides=20))
            parts.append(
                cylinder((x, foot + 0.32, z), radius, head - foot - 0.9, COLUMN, top_radius=radius * 0.86, sides=20)
            )
            parts.append(cylinder((x, head - 0.58, z), radius * 0.86, 0.4, COLUMN, top_radius=radius * 1.32, sides=20))
            parts.append(box((x - 0.46, head - 0.18, z - 0.42), (x + 0.46, head + 0.02, z + 0.42), COLUMN))
    return merge(parts)


def _balustrade() -> Mesh:
    parts = []
    for z in (-COURT, COURT):
        parts.append(box((-LENGTH, GALLERY + 0.82, z - 0.12), (LENGTH, GALLERY + 0.94, z + 0.12), COLUMN))
        for left in COLUMN_X[:-1]:
            for step in np.linspace(0.55, BAY - 0.55, 6):
                x = left + float(step)
                parts.append(cylinder((x, GALLERY, z), 0.05, 0.34, COLUMN, top_radius=0.10, sides=8))
                parts.append(cylinder((x, GALLERY + 0.34, z), 0.10, 0.49, COLUMN, top_radius=0.05, sides=8))
    return merge(parts)


def _fountain() -> Mesh:
    return merge(
        [
            cylinder((2.5, 0.0, 0.0), 1.5, 0.18, COLUMN, sides=32, capped=True),
            cylinder((2.5, 0.18, 0.0), 1.2, 0.42, COLUMN, top_radius=1.3, sides=32, capped=True),
            cylinder((2.5, 0.6, 0.0), 0.3, 0.9, COLUMN, top_radius=0.16, sides=20),
            cylinder((2.5, 1.5, 0.0), 0.16, 0.3, COLUMN, top_radius=0.7, sides=28, capped=True),
            sphere((2.5, 2.1, 0.0), 0.36, COLUMN, rings=14, sectors=28),
        ]
    )


def _doors() -> list[Mesh]:
    """Return wooden doors in the end walls and along the aisles, and the stone frames around them."""
    doors, frames = [], []
    for x, sign in ((-LENGTH, 1.0), (LENGTH, -1.0)):
        near, far = sorted((x - sign * 0.05, x + sign * 0.12))
        doors.append(box((near, -0.05, -1.1), (far, 3.2, 1.1), WOOD))
        near, far = sorted((x - sign * 0.05, x + sign * 0.2))
        frames += [box((near, -0.05, z - 0.2), (far, 3.2, z + 0.2), STONE) for z in (-1.3, 1.3)]
        frames.append(box((near, 3.2, -1.5), (far, 3.55, 1.5), STONE))
    for x in COLUMN_X[1:-1:2]:
        for z, sign in ((-DEPTH, 1.0), (DEPTH, -1.0)):
            for floor in (0.0, GALLERY):
                near, far = sorted((z - sign * 0.05, z + sign * 0.1))
                doors.append(box((x - 0.65, floor - 0.05, near), (x + 0.65, floor + 2.4, far), WOOD))
    return [merge(doors), merge(frames)]


def _banners() -> list[Mesh]:
    """Return cloths that hang from the gallery's edge into the court, folded along their length."""
    colours = (RED, GREEN, BLUE, OCHRE)
    hung: dict[int, list[Mesh]] = {colour: [] for colour in colours}
    for index in range(1, BAYS - 1):
        middle = (COLUMN_X[index] + COLUMN_X[index + 1]) / 2
        for side, z in ((0, -COURT), (1, COURT)):
            if (index + side) % 2 == 0:
                colour = colours[(index // 2 + 2 * side) % 4]
                hung[colour].append(_banner(middle, z, float(index), colour))
    return [merge(meshes) for meshes in hung.values() if meshes]


def _banner(x: float, z: float, phase: float, colour: int) -> Mesh:
    width, length, towards = 1.9, 3.3, -np.sign(z)
    edge = z + towards * (THICKNESS / 2 + 0.2)

    def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        drop = 1 - v
        fold = (0.03 + 0.09 * drop) * np.sin(2 * np.pi * (3 * u + 0.13 * phase) + 0.9 * np.sin(2.2 * drop + phase))
        narrow = 1 - 0.12 * np.sin(np.pi * np.clip(drop, 0, 1))
        away = 0.10 * drop * np.sin(1.7 * phase)
        along = x + (u - 0.5) * width * narrow + 0.05 * drop * np.sin(phase)
        return np.stack([along, GALLERY_LOW + 0.25 - length * drop, edge + towards * (0.14 + away) + fold], axis=1)

    return cloth(surface, 28, 18, colour)


def _awnings() -> list[Mesh]:
    """Return three wide cloths slung across the court between the upper arcades."""
    return [_awning(x, level, colour) for x, level, colour in ((-5.4, 9.3, OCHRE), (1.8, 9.6, RED), (9.0, 9.2, BLUE))]


def _awning(x: float, level: float, colour: int) -> Mesh:
    width, span = 2.6, 2 * (COURT - THICKNESS / 2)

    def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        across = (v - 0.5) * span
        sag = 1.5 * (1 - (2 * v - 1) ** 2) + 0.12 * np.sin(2 * np.pi * u * 2 + 3 * v)
        tight = 1 - 0.25 * (1 - (2 * v - 1) ** 2)
        return np.stack([x + (u - 0.5) * width * tight, level - sag, across], axis=1)

    return cloth(surface, 16, 28, colour)


def _paving() -> np.ndarray:
    """Return (256, 256, 3) uint8 linear colours of 2 x 2 slabs with dark joints, each slab a little different."""
    size, joint = 256, 3
    tones = np.array([[(0.60, 0.52, 0.41), (0.46, 0.36, 0.27)], [(0.43, 0.34, 0.26), (0.57, 0.50, 0.40)]])
    row, column = np.mgrid[0:size, 0:size]
    half = size // 2
    image = tones[row // half, column // half]
    grain = 0.03 * np.sin(row * 0.37 + 2 * np.sin(column * 0.11)) * np.sin(column * 0.23 + np.sin(row * 0.17))
    image = image * (1 + grain[..., None])
    in_joint = (row % half < joint) | (column % half < joint)
    image[in_joint] = (0.20, 0.17, 0.14)
    return np.round(np.clip(image, 0, 0.9) * 255).astype(np.uint8)


def _flight() -> list[Camera]:
    """Key views: along the court, through each aisle of both storeys, once over the roofs."""
    views = [
        Camera((-5.0, 1.8, 0.4), (4.0, 4.0, -1.0), fov=90.0),
        Camera((4.5, 6.0, 0.0), (-6.0, 5.0, 0.5), fov=95.0),
        Camera((13.5, 2.2, 0.6), (0.0, 4.5, -0.4), fov=85.0),
    ]
    for height in (1.9, GALLERY + 1.7):
        for z in (6.5, -6.5):
            sign = 1.0 if z > 0 else -1.0
            views.append(Camera((sign * 14.2, height, z), (0.0, height, z), fov=95.0))
            views.append(Camera((0.0, height, z * 1.25), (0.0, height + 0.4, 0.0), fov=110.0))
            views.append(Camera((-sign * 14.2, height, z), (0.0, height, z), fov=95.0))
    views += [
        Camera((-13.0, 17.0, -10.0), (0.0, 8.0, 0.0), fov=80.0),
        Camera((13.0, 17.0, 10.0), (0.0, 8.0, 0.0), fov=80.0),
    ]
    return views
