"""A Mitsuba file measured from another point: its numbers moved in double precision, before Mitsuba rounds them.

The parser holds places and matrices as the file states them. Instantiating brings them to single precision, and meshes
to the world's space.
"""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

ENDLESS = ("directional", "constant", "envmap", "sunsky", "sky", "sun", "timed_sunsky")
"""Emitters that stand nowhere: their matrix turns them only."""
POINTS = {"sphere": ("center",), "cylinder": ("p0", "p1"), "point": ("position",)}
"""Places that a plugin takes besides its matrix, or in its stead."""
PICTURES = ("perspective", "thinlens", "orthographic")
"""Sensors that make a picture: others are not read, and some of them stand where their shape does."""
FILES = ("obj", "ply", "serialized")
CONTAINERS = ("shapegroup", "merge")


def measure_from(state: Any, origin: np.ndarray) -> float:
    """Move all that a parser's `state` places by -`origin` (3,), in place; groups of shapes move by their instances.

    Return the step, metres, of single precision that most of its mesh files must have, if they lie about the origin.
    """
    steps = [0.0]
    within = _find_grouped(state)
    for index, node in enumerate(state.nodes):
        kind = node.props.plugin_name()
        if index in within or kind in CONTAINERS or kind in ENDLESS:
            continue
        stands = node.type == mi.ObjectType.Shape or kind in PICTURES
        if stands or (node.type in (mi.ObjectType.Emitter, mi.ObjectType.Volume) and _is_placed(node.props, kind)):
            _move(node.props, POINTS.get(kind, ()), origin)
        if kind in FILES:
            steps.append(_step_of(node.props))
    return float(np.median(steps[1:] or steps))


def _step_of(props: Any) -> float:
    """Return the step of vertices that stand about (0, 0, 0) by a plugin's matrix."""
    matrix = np.array(props["to_world"].matrix, float).reshape(4, 4)
    if not abs(np.linalg.det(matrix[:3, :3])) > 0.0:
        return 0.0
    own = np.abs(np.linalg.solve(matrix[:3, :3], matrix[:3, 3])).max()
    return float(np.spacing(np.float32(own))) * float(np.linalg.norm(matrix[:3, :3], axis=0).max())


def _is_placed(props: Any, kind: str) -> bool:
    return any(name in props for name in ("to_world", *POINTS.get(kind, ())))


def _move(props: Any, names: tuple[str, ...], origin: np.ndarray) -> None:
    """Move a plugin by -`origin`: by its points where it has some, which then hold its matrix's place too."""
    matrix = np.array(props["to_world"].matrix, float).reshape(4, 4) if "to_world" in props else np.eye(4)
    linear, place = matrix[:3, :3], matrix[:3, 3] - origin
    # An end that is left to its default cannot be moved without the matrix.
    stated = bool(names) and all(name in props for name in names)
    if stated and abs(np.linalg.det(linear)) > 0.0:
        for name in names:
            moved = np.array(props[name], float).ravel() + np.linalg.solve(linear, place)
            props[name] = mi.ScalarPoint3d(moved.tolist())
        place = np.zeros(3)
    if "to_world" in props or not stated:
        matrix[:3, 3] = place
        props["to_world"] = mi.ScalarAffineTransform4d(matrix)


def _find_grouped(state: Any) -> set[int]:
    """Return the nodes below groups of shapes, which have a space of their own."""
    kind = mi.Properties.ResolvedReference
    found: set[int] = set()
    waiting = [index for index, node in enumerate(state.nodes) if node.props.plugin_name() == "shapegroup"]
    while waiting:
        props = state.nodes[waiting.pop()].props
        inner = [props[key].index() for key in list(props.keys()) if isinstance(props[key], kind)]
        fresh = [index for index in inner if index not in found]
        found.update(fresh)
        waiting += fresh
    return found
