"""The Cornell box as Mitsuba ships it (`mi.cornell_box()`): same geometry, light, colours and camera."""

from __future__ import annotations

from luxel.scene.library.shapes import box, quad, rotation, scaling, transformed, translation
from luxel.scene.model import Camera, Material, Object, SceneData

WHITE, RED, GREEN, LAMP = range(4)


def cornell_box() -> SceneData:
    """A 2 m room with a red and a green wall, two boxes and a ceiling lamp; open at the front."""
    white = (0.885809, 0.698859, 0.666422)
    materials = [
        Material("white", white, reflect_back=False),
        Material("red", (0.570068, 0.0430135, 0.0443706), reflect_back=False),
        Material("green", (0.105421, 0.37798, 0.076425), reflect_back=False),
        Material("lamp", white, emission=(18.387, 13.9873, 6.75357), reflect_back=False),
    ]
    lo, hi = (-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)
    room = [
        box(lo, hi, WHITE, inward=True, sides=("-y", "+y", "-z")),
        box(lo, hi, RED, inward=True, sides=("-x",)),
        box(lo, hi, GREEN, inward=True, sides=("+x",)),
    ]
    large = translation(-0.33, -0.4, -0.28) @ rotation("y", 18.25) @ scaling(0.3, 0.61, 0.3)
    small = translation(0.335, -0.7, 0.38) @ rotation("y", -17.0) @ scaling(0.3, 0.3, 0.3)
    lamp = quad((-0.23, 0.99, -0.18), (0.23, 0.99, -0.18), (0.23, 0.99, 0.2), (-0.23, 0.99, 0.2), LAMP)
    objects = [
        Object("room", room),
        Object("large-box", [transformed(box(lo, hi, WHITE), large)]),
        Object("small-box", [transformed(box(lo, hi, WHITE), small)]),
        Object("lamp", [lamp]),
    ]
    # The film is square, so Mitsuba's "smaller" fov axis is the horizontal one.
    view = Camera(eye=(0.0, 0.0, 3.9), target=(0.0, 0.0, 0.0), fov=39.3077)
    return SceneData("cornell-box", objects, materials, cameras=[view], flight=[view, *_look_behind_the_boxes()])


def _look_behind_the_boxes() -> list[Camera]:
    """Key views from within the room: each side of both boxes, every wall, the ceiling above the lamp."""
    return [
        Camera((0.0, 0.1, 1.6), (0.0, -0.3, 0.0), fov=75.0),
        Camera((-0.85, 0.6, 0.85), (0.3, -0.6, -0.1), fov=80.0),
        Camera((-0.9, 0.3, -0.9), (0.3, -0.4, 0.0), fov=90.0),
        Camera((0.1, 0.7, -0.9), (-0.1, -0.6, 0.2), fov=90.0),
        Camera((0.9, 0.5, -0.9), (-0.2, -0.6, 0.1), fov=90.0),
        Camera((0.9, 0.6, 0.9), (-0.1, -0.6, -0.1), fov=85.0),
        Camera((0.1, -0.8, 0.95), (0.0, 1.0, -0.1), fov=85.0),
    ]
