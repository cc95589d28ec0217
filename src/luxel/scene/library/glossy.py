"""A room for materials: metals, plastics and glass at six roughnesses, by a window and under one lamp."""

from __future__ import annotations

import numpy as np

from luxel.scene.library.dials import require_range
from luxel.scene.library.shapes import (
    box,
    cloth,
    framed_hole,
    merge,
    quad,
    rotation,
    sphere,
    transformed,
    translation,
)
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData, Sky, Texture

ROUGHNESSES = (0.0, 0.1, 0.2, 0.4, 0.6, 1.0)
LOW, HIGH = (-2.4, 0.0, -2.5), (2.4, 2.7, 2.5)
WALL = 0.25
"""Metres that the reveals of the window are deep."""
WINDOW = (0.75, 2.25, -1.9, -0.1)
"""Height from and to, z from and to, in the wall at -X."""
COLUMNS = tuple(-1.6 + 0.64 * index for index in range(len(ROUGHNESSES)))
"""x of the middle of what has the n-th roughness."""
RADIUS = 0.24

WALLS, FLOOR, PLINTH, CLAY, LAMP, CURTAIN, PANE, BALL, METAL = range(9)
DIELECTRIC = METAL + len(ROUGHNESSES)

METALS = (
    ("copper", (0.952, 0.620, 0.511), (0.201, 0.924, 1.102), (3.913, 2.453, 2.142)),
    ("silver", (0.975, 0.958, 0.906), (0.155, 0.117, 0.138), (4.828, 3.122, 2.147)),
)
"""Name, reflectance at normal incidence, eta and k: Mitsuba's "Cu" and "Ag", brought to linear Rec. 709."""
PLASTICS = (
    (0.62, 0.10, 0.07), (0.72, 0.38, 0.07), (0.66, 0.60, 0.16),
    (0.16, 0.44, 0.20), (0.10, 0.27, 0.58), (0.42, 0.18, 0.48),
)  # fmt: skip


def glossy(*, ior: float = 1.5, curtain: float = 0.6, lamp: float = 1.0) -> SceneData:
    """A room with metals, plastics and glass at six roughnesses, a pane and a curtain, lit by a window and a lamp.

    `ior` is the index of refraction of plastics and glass, `curtain` how much of the light its threads stop (the rest
    passes straight), `lamp` multiplies the lamp. Roughness rises from left to right: 0, 0.1, 0.2, 0.4, 0.6, 1.
    Materials are Mitsuba's (`interface` plastic, GGX, nothing between facets), so that both compare.
    """
    require_range("ior", ior, 1.01, 3.0)
    require_range("curtain", curtain, 0.0, 1.0)
    require_range("lamp", lamp, 0.0, 100.0)
    objects = [
        Object("room", _room()),
        Object("plinth", [box((-2.0, -0.02, -1.5), (2.0, 0.3, -0.9), PLINTH)]),
        Object("lamp", [_lamp()]),
        Object("curtain", [_curtain()]),
        Object("pane", _pane()),
        Object("glass-ball", [sphere((0.98, 0.32, 0.55), 0.32, BALL, rings=32, sectors=64)]),
    ]
    for index, (x, roughness) in enumerate(zip(COLUMNS, ROUGHNESSES, strict=True)):
        metal, dielectric = METAL + index, DIELECTRIC + index
        objects.append(Object(f"metal-sphere-{roughness:g}", [_ball((x, 0.3 + RADIUS, -1.2), metal)]))
        objects.append(Object(f"plastic-sphere-{roughness:g}", [_ball((x, RADIUS, -0.3), dielectric)]))
        objects.append(Object(f"metal-plank-{roughness:g}", [_plank(x - 0.16, metal)]))
        objects.append(Object(f"plastic-plank-{roughness:g}", [_plank(x + 0.16, dielectric)]))
    sun = Light("directional", (13.0, 11.4, 9.0), direction=(0.6, -0.62, 0.42), name="sun")
    view = Camera(eye=(0.25, 1.45, 2.4), target=(-0.12, 0.72, -1.0), fov=80.0)
    return SceneData(
        "glossy",
        objects,
        _materials(ior, curtain, lamp),
        [sun],
        cameras=[view],
        sky=Sky((1.5, 1.9, 2.5)),
        flight=[view, *_flight()],
    )


def _materials(ior: float, curtain: float, lamp: float) -> list[Material]:
    """Return all materials, in the order of their numbers."""
    weave = Texture(_weave(curtain), nearest=False)
    materials = [
        Material("walls", (0.74, 0.72, 0.68)),
        Material("floor", (1.0, 1.0, 1.0), base_color_texture=Texture(_tiles(), srgb=False)),
        Material("plinth", (0.52, 0.50, 0.47)),
        Material("clay", (0.55, 0.33, 0.24)),
        Material("lamp", (0.0, 0.0, 0.0), emission=(16.0 * lamp, 12.4 * lamp, 8.2 * lamp)),
        Material("curtain", (0.72, 0.55, 0.30), base_color_texture=weave, alpha_mode="blend"),
        Material("pane", (0.50, 0.78, 0.74), ior=ior, specular=1.0, transmission=1.0, thin=True, roughness=0.0),
        Material(
            "glass", (1.0, 1.0, 1.0), ior=ior, specular=1.0, transmission=1.0, roughness=0.0,
            attenuation_color=(0.55, 0.80, 0.72), attenuation_distance=0.6,
        ),
    ]  # fmt: skip
    for index, roughness in enumerate(ROUGHNESSES):
        name, colour, eta, k = METALS[index % 2]
        materials.append(Material(f"{name} {roughness:g}", colour, metallic=1.0, roughness=roughness, eta=eta, k=k))
    for colour, roughness in zip(PLASTICS, ROUGHNESSES, strict=True):
        materials.append(Material(f"plastic {roughness:g}", colour, roughness=roughness, ior=ior, specular=1.0))
    for material in materials[PANE:]:
        material.interface = "plastic"
    return materials


def _room() -> list[Mesh]:
    """Return the insides of walls, ceiling and floor; the shell's one border is the mouth of the window."""
    low, high, near, far = WINDOW
    x = LOW[0]
    # Both rings run counter-clockwise as seen from inside, looking along -X.
    corners = [(LOW[1], HIGH[2]), (LOW[1], LOW[2]), (HIGH[1], LOW[2]), (HIGH[1], HIGH[2])]
    around = [(low, far), (low, near), (high, near), (high, far)]
    inner = [(x, y, z) for y, z in around]
    mouth = [(x - WALL, y, z) for y, z in around]
    walls = [
        box(LOW, HIGH, WALLS, inward=True, sides=("+y", "-z", "+z")),
        framed_hole([(x, y, z) for y, z in corners], inner, WALLS),
        *(quad(inner[i], inner[(i + 1) % 4], mouth[(i + 1) % 4], mouth[i], WALLS) for i in range(4)),
    ]
    (x0, y, z0), (x1, _, z1) = LOW, HIGH
    floor = quad((x0, y, z1), (x1, y, z1), (x1, y, z0), (x0, y, z0), FLOOR, uv_scale=((x1 - x0) / 1.2, (z1 - z0) / 1.2))
    return [merge(walls), box(LOW, HIGH, CLAY, inward=True, sides=("+x",)), floor]


def _lamp() -> Mesh:
    """Return a panel below the ceiling, which shines down."""
    y = HIGH[1] - 0.05
    return quad((0.3, y, -0.7), (1.3, y, -0.7), (1.3, y, -0.2), (0.3, y, -0.2), LAMP)


def _ball(centre: tuple[float, float, float], material: int) -> Mesh:
    return sphere(centre, RADIUS, material, rings=20, sectors=40)


def _plank(x: float, material: int) -> Mesh:
    """Return a board that leans on the wall at -Z, its middle at `x`."""
    board = box((-0.14, 0.0, -0.02), (0.14, 1.5, 0.02), material)
    return transformed(board, translation(x, 0.02, -2.02) @ rotation("x", -16.0))


def _pane() -> list[Mesh]:
    """Return a sheet of glass in a foot, turned towards the window."""
    sheet = quad((-0.45, 0.03, 0.0), (0.45, 0.03, 0.0), (0.45, 1.0, 0.0), (-0.45, 1.0, 0.0), PANE)
    foot = box((-0.47, 0.0, -0.05), (0.47, 0.05, 0.05), PLINTH)
    turned = translation(-0.85, 0.0, 0.6) @ rotation("y", 24.0)
    return [transformed(sheet, turned), transformed(foot, turned)]


def _curtain() -> Mesh:
    """Return a cloth that hangs in folds before one half of the window."""
    low, high, near, far = WINDOW
    middle = 0.5 * (near + far)

    def surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        fold = (0.05 - 0.02 * v) * np.sin(2 * np.pi * 6 * u + 0.8 * np.sin(3 * v))
        return np.stack(
            [LOW[0] + 0.14 + fold, low - 0.35 + (high - low + 0.5) * v, middle + (near - 0.12 - middle) * u], 1
        )

    return cloth(surface, 60, 12, CURTAIN)


def _weave(opacity: float) -> np.ndarray:
    """Return (32, 32, 4) uint8: bands of denser and thinner cloth, whose mean alpha is `opacity`."""
    size = 32
    row, column = np.mgrid[0:size, 0:size]
    band = 0.15 * np.sign(np.sin(2 * np.pi * (column + 0.5) / 8.0)) * np.ones_like(row)
    image = np.full((size, size, 4), 255.0)
    image[..., 3] = 255.0 * np.clip(opacity + band * min(opacity, 1.0 - opacity) / 0.5, 0.0, 1.0)
    return np.round(image).astype(np.uint8)


def _tiles() -> np.ndarray:
    """Return (128, 128, 3) uint8 linear colours of 2 x 2 tiles, dark and light, with joints."""
    size = 128
    row, column = np.mgrid[0:size, 0:size]
    half = size // 2
    tones = np.array([[(0.50, 0.46, 0.40), (0.26, 0.24, 0.22)], [(0.26, 0.24, 0.22), (0.50, 0.46, 0.40)]])
    image = tones[row // half, column // half]
    image[(row % half < 2) | (column % half < 2)] = (0.16, 0.15, 0.14)
    return np.round(image * 255).astype(np.uint8)


def _flight() -> list[Camera]:
    """Key views: along the rows, behind the spheres, at the window, and back at the room."""
    return [
        Camera((-2.0, 1.4, 2.1), (0.6, 0.5, -1.2), fov=90.0),
        Camera((2.1, 1.3, 1.9), (-1.2, 0.6, -1.0), fov=90.0),
        Camera((2.2, 0.9, -0.7), (-2.2, 0.5, -0.9), fov=95.0),
        Camera((-2.1, 1.0, -1.7), (2.0, 0.6, -1.4), fov=95.0),
        Camera((0.0, 1.6, -1.5), (0.0, 0.3, 1.6), fov=110.0),
        Camera((2.1, 1.5, 0.2), (-2.4, 1.4, -1.0), fov=85.0),
        Camera((-1.8, 1.6, -0.4), (2.2, 1.0, 1.4), fov=105.0),
        Camera((0.2, 0.8, 1.2), (0.4, 2.7, -0.2), fov=110.0),
    ]
