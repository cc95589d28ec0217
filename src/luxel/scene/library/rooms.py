"""Closed rooms that light must not leak into or out of: two rooms with a thin wall, a box with a small hole."""

from __future__ import annotations

from luxel.scene.library.dials import require_range
from luxel.scene.library.shapes import box, framed_hole, merge, quad
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData

WIDTH, HEIGHT, DEPTH = 4.0, 2.6, 4.0


def two_rooms(*, wall: float = 0.05, lamp: float = 0.6) -> SceneData:
    """Two closed rooms that share a thin wall: one lit by a ceiling lamp, one sealed and dark.

    `wall` is the wall's thickness, `lamp` the side of the lamp, both in metres. Each room is a closed shell, the wall
    is the solid between their two faces. facts: `sealed_lo_x` .. `sealed_hi_z`, the inside of the dark room;
    camera "dark" stands in it. The flight stays in the lit room.
    """
    require_range("wall", wall, 0.001, 1.0)
    require_range("lamp", lamp, 0.05, 2.0)
    white, brick, blue, oak, glow = range(5)
    materials = [
        Material("white", (0.78, 0.77, 0.74)),
        Material("brick", (0.62, 0.20, 0.13)),
        Material("blue", (0.16, 0.28, 0.55)),
        Material("oak", (0.46, 0.30, 0.17)),
        Material("lamp", (0.78, 0.77, 0.74), emission=(14.0, 12.6, 10.4)),
    ]
    lit_lo, lit_hi = (-WIDTH, 0.0, -DEPTH / 2), (0.0, HEIGHT, DEPTH / 2)
    dark_lo, dark_hi = (wall, 0.0, -DEPTH / 2), (wall + WIDTH, HEIGHT, DEPTH / 2)
    lit_room = [
        box(lit_lo, lit_hi, white, inward=True, sides=("+y", "+x", "+z")),
        box(lit_lo, lit_hi, oak, inward=True, sides=("-y",)),
        box(lit_lo, lit_hi, brick, inward=True, sides=("-x",)),
        box(lit_lo, lit_hi, blue, inward=True, sides=("-z",)),
    ]
    x, y, half = -WIDTH / 2, HEIGHT - 0.02, lamp / 2
    panel = quad((x - half, y, -half), (x + half, y, -half), (x + half, y, half), (x - half, y, half), glow)
    objects = [
        Object("lit-room", lit_room),
        Object("lamp", [panel]),
        Object("table", [_table((-1.9, 0.0, -0.5), (1.2, 0.72, 0.8), oak)]),
        Object("crate", [box((-1.15, 0.0, -1.45), (-0.45, 0.9, -0.75), white)]),
        Object("dark-room", [box(dark_lo, dark_hi, white, inward=True)]),
    ]
    view = Camera(eye=(-3.7, 1.5, 1.8), target=(-0.9, 0.95, -1.0), fov=75.0)
    dark = Camera(eye=(wall + 3.7, 1.5, 1.8), target=(wall + 0.9, 0.95, -1.0), fov=75.0, name="dark")
    flight = [
        view,
        Camera((-3.7, 2.2, 1.7), (-1.5, 0.0, -0.6), fov=90.0),
        Camera((-3.6, 1.4, -1.7), (0.0, 1.0, 1.2), fov=95.0),
        Camera((-1.5, 1.7, -1.8), (-2.2, 0.0, 1.5), fov=100.0),
        Camera((-0.3, 1.5, -0.7), (-3.8, 0.9, 0.6), fov=95.0),
        Camera((-0.3, 1.7, 1.7), (-3.0, 0.8, -1.2), fov=95.0),
        Camera((-2.0, 0.25, 1.7), (-1.6, 1.0, -1.2), fov=100.0),
        Camera((-2.0, 0.2, 1.2), (-1.6, 2.6, -0.6), fov=100.0),
    ]
    facts = {f"sealed_lo_{axis}": value for axis, value in zip("xyz", dark_lo, strict=True)}
    facts |= {f"sealed_hi_{axis}": value for axis, value in zip("xyz", dark_hi, strict=True)}
    return SceneData("two-rooms", objects, materials, cameras=[view, dark], flight=flight, facts=facts)


def _table(at: tuple[float, float, float], size: tuple[float, float, float], material: int) -> Mesh:
    """Return a table of four legs and a top as one mesh; `at` is the middle of its footprint."""
    (x, y, z), (width, height, depth), leg, top = at, size, 0.07, 0.05
    parts = [
        box((x - width / 2, y + height - top, z - depth / 2), (x + width / 2, y + height, z + depth / 2), material)
    ]
    for side_x in (x - width / 2, x + width / 2 - leg):
        for side_z in (z - depth / 2, z + depth / 2 - leg):
            parts.append(box((side_x, y, side_z), (side_x + leg, y + height - top, side_z + leg), material))
    return merge(parts)


def opening(*, hole: float = 0.5, wall: float = 0.2) -> SceneData:
    """A closed box lit only by the sun through one small hole: all but a patch is bounced light.

    `hole` is the side of the square hole, `wall` the thickness of the wall it goes through, both in metres.
    Only insides are modelled: the shell's one border is the mouth of the hole.
    """
    require_range("hole", hole, 0.02, 1.5)
    require_range("wall", wall, 0.01, 1.0)
    white, clay, green = range(3)
    materials = [
        Material("white", (0.80, 0.79, 0.76)),
        Material("clay", (0.66, 0.36, 0.22)),
        Material("green", (0.24, 0.48, 0.22)),
    ]
    lo, hi = (-2.0, 0.0, -2.0), (2.0, 3.0, 2.0)
    low, high, (x, _, _) = 1.9 - hole / 2, 1.9 + hole / 2, hi
    # Both rings run counter-clockwise as seen from inside, looking along +X.
    around_hole = [(low, -hole / 2), (low, hole / 2), (high, hole / 2), (high, -hole / 2)]
    inner = [(x, y, z) for y, z in around_hole]
    mouth = [(x + wall, y, z) for y, z in around_hole]
    sides = [(lo[1], lo[2]), (lo[1], hi[2]), (hi[1], hi[2]), (hi[1], lo[2])]
    shell = [
        box(lo, hi, white, inward=True, sides=("+y", "-y", "+z")),
        framed_hole([(x, y, z) for y, z in sides], inner, white),
        *(quad(inner[i], inner[(i + 1) % 4], mouth[(i + 1) % 4], mouth[i], white) for i in range(4)),
    ]
    coloured = [
        box(lo, hi, clay, inward=True, sides=("-x",)),
        box(lo, hi, green, inward=True, sides=("-z",)),
    ]
    objects = [
        Object("shell", [merge(shell), *coloured]),
        Object("block", [box((-1.4, 0.0, -1.3), (-0.7, 1.0, -0.6), white)]),
    ]
    sun = Light("directional", (100.0, 93.0, 82.0), direction=(-1.0, -0.85, -0.12), name="sun")
    view = Camera(eye=(1.4, 1.5, 1.8), target=(-0.7, 0.8, -0.8), fov=80.0)
    flight = [
        view,
        Camera((-1.7, 1.6, 1.7), (0.6, 0.9, -1.0), fov=95.0),
        Camera((-1.8, 1.5, -1.8), (0.6, 0.8, 0.8), fov=100.0),
        Camera((1.6, 2.2, -1.7), (-1.2, 0.3, 0.2), fov=100.0),
        Camera((-1.2, 1.8, 0.2), (2.2, 1.9, 0.0), fov=70.0),
        Camera((0.4, 0.5, 0.6), (-0.4, 3.0, -0.5), fov=110.0),
    ]
    return SceneData("opening", objects, materials, [sun], cameras=[view], flight=flight)
