"""States of any shape come back as they were saved; what cannot be kept is refused before anything is written."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.methods.persistence import load_state, save_state


@dataclass
class Ring:
    light: mi.Float
    rays: int = 4


@dataclass
class Opaque:
    rings: Any = None


@dataclass
class State:
    rings: list[Ring]
    levels: list[list[mi.Float]]
    pair: tuple[mi.UInt32, dict[str, Any]]
    host: np.ndarray
    named: dict[Any, Any]
    history: mi.Color3f | None = None
    recent: list[mi.Color3f] = field(default_factory=list)
    label: str = "made"


class Plain:
    def __init__(self) -> None:
        self.light = mi.Float(1.0, 2.0)


def make(value: float) -> State:
    count = int(value)
    return State(
        rings=[Ring(mi.Float(value, value + 1), rays=count), Ring(mi.Float(value + 2, value + 3))],
        levels=[[mi.Float(value)], [mi.Float(value + 4, 5), mi.Float(value + 5, 6, 7)]],
        pair=(mi.UInt32(count, 2), {"deep": [{"a/b": mi.Bool(count > 0, False)}, None], "n": count}),
        host=np.full((2, 3), value, np.float16),
        named={7: mi.Point3f([value, 1], [2, 3], [4, 5])},
        label=f"state {count}",
    )


def flatten(node: Any) -> list[Any]:
    """Return all arrays and whatever else stands in a node, in order, by means of its own."""
    if isinstance(node, dr.ArrayBase | np.ndarray):
        return [np.array(node).tolist()]
    if isinstance(node, list | tuple):
        return [type(node).__name__, *(leaf for item in node for leaf in flatten(item))]
    if isinstance(node, dict):
        return [leaf for key, item in node.items() for leaf in (key, *flatten(item))]
    if hasattr(node, "__dataclass_fields__"):
        return [leaf for name in node.__dataclass_fields__ for leaf in (name, *flatten(getattr(node, name)))]
    return [node]


def test_a_nested_state_comes_back(tmp_path: Path) -> None:
    saved, file = make(9.0), tmp_path / "state.npz"
    save_state("mine", saved, file)
    loaded = load_state("mine", make(0.0), file)
    # Numbers and text are settings: those of the state that was built.
    assert loaded.rings[0].rays == 0 and loaded.label == "state 0" and loaded.pair[1]["n"] == 0
    loaded.rings[0].rays, loaded.label, loaded.pair[1]["n"] = 9, "state 9", 9
    assert flatten(loaded) == flatten(saved)
    assert isinstance(loaded.rings[0].light, mi.Float) and isinstance(loaded.named[7], mi.Point3f)
    assert loaded.host.dtype == np.float16


def test_what_has_grown_or_gone_comes_back(tmp_path: Path) -> None:
    saved, file = make(9.0), tmp_path / "state.npz"
    saved.recent = [mi.Color3f([1, 2], [3, 4], [5, 6]), mi.Color3f([7], [8], [9])]
    saved.history = mi.Color3f([1], [2], [3])
    saved.levels.append([mi.Float(11, 12)])
    saved.rings.pop()
    save_state("mine", saved, file)
    loaded = load_state("mine", make(9.0), file)
    assert flatten(loaded) == flatten(saved)
    assert isinstance(loaded.recent[1], mi.Color3f)
    saved.recent, saved.history = [], None
    save_state("mine", saved, file)
    grown = make(9.0)
    grown.recent, grown.history = [mi.Color3f(1.0)], mi.Color3f(2.0)
    loaded = load_state("mine", grown, file)
    assert loaded.recent == [] and loaded.history is None


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    saved, file = make(9.0), tmp_path / "state.npz"
    save_state("mine", saved, file)
    for change in ("shape", "kind", "missing"):
        blank = make(9.0)
        if change == "shape":
            blank.levels[1][0] = mi.Float(1, 2, 3, 4)
        elif change == "kind":
            blank.levels = (mi.Float(1.0),)  # pyright: ignore[reportAttributeAccessIssue]
        else:
            blank.rings = []
        with pytest.raises(LuxelError, match="other parameters"):
            load_state("mine", blank, file)


@pytest.mark.parametrize("kind", ["deque", "keys", "object"])
def test_arrays_that_cannot_be_kept_are_refused(kind: str, tmp_path: Path) -> None:
    light = mi.Float(1.0, 2.0)
    hidden = {"deque": deque([light]), "keys": {(1, 2): light}, "object": Plain()}[kind]
    with pytest.raises(LuxelError, match="'rings' is a .* cannot be saved"):
        save_state("mine", Opaque(hidden), tmp_path / "state.npz")
    assert not list(tmp_path.iterdir())


def test_settings_of_any_kind_are_let_be(tmp_path: Path) -> None:
    for setting in (deque([1, 2]), {"a", "b"}, {(1, 2): "x"}, [1, 2, 3], len, "text", range(3), Path("x")):
        save_state("mine", Opaque(setting), tmp_path / "state.npz")
        assert load_state("mine", Opaque(setting), tmp_path / "state.npz").rings is setting
