"""Objects: choose one, grab it, move and turn it in the picture."""

from __future__ import annotations

from typing import Any

import numpy as np
from viser import Icon

from luxel.viewer import cameras
from luxel.viewer.desk import QUIET, Desk, put
from luxel.viewer.stats import Facts, describe_thing
from luxel.viewer.visitor import Visitor
from luxel.viewer.world import World

LIST_LIMIT = 200
"""Objects in the list; scenes of thousands are searched by a click instead."""


class ObjectsPanel:
    """Which object, and the grip on it."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk
        self._grip: Any = None

    def build(self) -> None:
        """Add the controls to the page."""
        gui, desk = self.desk.gui, self.desk
        with gui.add_folder("Objects"):
            self._which = gui.add_dropdown("Object", self._names(desk.facts), hint="What moves as one.")
            desk.on_change(self._which, lambda _: self._let_go())
            gui.add_markdown("*Grab it, then drag the arrows, squares and arcs in the picture.*")
            self._grab = gui.add_checkbox("Grab", False, hint="Holds it by a grip in its middle, until you let go.")
            desk.on_change(self._grab, self._toggle)
            back = gui.add_button("Put back", icon=Icon.ARROW_BACK_UP, color=QUIET, hint="Where it stood at first.")
            desk.on_press(back, self._put_back)
        self._home: dict[int, np.ndarray] = {}

    def tick(self) -> None:
        pass

    def refresh(self, facts: Facts) -> None:
        """Show `facts`, which may have changed elsewhere."""
        names = self._names(facts)
        if names != tuple(self._which.options):
            self._which.options = names
        # What was grabbed may be refused, as what deforms is.
        put(self._grab, self._grip is not None)

    def _names(self, facts: Facts) -> tuple[str, ...]:
        return tuple(f"{number + 1}  {thing.name}" for number, thing in enumerate(facts.things[:LIST_LIMIT])) or (
            "none",
        )

    def _index(self) -> int:
        return int(self._which.value.split()[0]) - 1

    def _toggle(self, holds: bool) -> None:
        if holds and self.desk.facts.things:
            self.grab(self._index())
        else:
            self._let_go()

    def _put_back(self) -> None:
        index = self._index() if self.desk.facts.things else -1
        if index in self._home:
            home = self._home[index]
            self._let_go()
            self.desk.post(lambda world, _: world.place(index, home), f"place {index}")

    def grab(self, index: int) -> None:
        """Take hold of object `index`: a grip in its middle moves and turns it."""
        self._drop()
        self.desk.post(lambda world, visitor: self._take(world, visitor, index))

    def _take(self, world: World, visitor: Visitor, index: int) -> None:
        """Show the grip where the object stands now; runs between two frames."""
        hold(world, visitor, index)
        facts, thing = self.desk.facts, describe_thing(world, index)
        self._home.setdefault(index, thing.matrix)
        start = np.eye(4)
        start[:3, 3] = thing.middle
        to_grip = np.linalg.inv(start) @ thing.matrix
        scale = max(0.45 * thing.size, 0.05 * float(np.linalg.norm(facts.upper - facts.lower)))
        grip = self.desk.client.scene.add_transform_controls(
            "/object", scale=scale, depth_test=False, position=tuple(thing.middle - facts.origin), opacity=0.9
        )

        @grip.on_update
        async def _(_: Any) -> None:
            # A slip of the hand must not send it where nobody finds it; what stands outside the bounds may stay there.
            middle = thing.middle - facts.origin
            least, most = np.minimum(facts.lower, middle), np.maximum(facts.upper, middle)
            place = np.clip(np.asarray(grip.position), least, most) + facts.origin
            turned = cameras.join_matrix(place, cameras.rotation_matrix(grip.wxyz), np.eye(3))
            self.desk.post(lambda world, _: world.place(index, turned @ to_grip), f"place {index}")

        self._grip = grip
        put(self._grab, True)

    def _let_go(self) -> None:
        self._drop()
        put(self._grab, False)

    def _drop(self) -> None:
        if self._grip is not None:
            self._grip.remove()
            self._grip = None


def hold(world: World, visitor: Visitor, index: int) -> None:
    """Make an object movable, and say so where that starts the caches anew."""
    if world.hold(index):
        name = world.data.objects[index].name
        visitor.notify("info", f"'{name}' was part of the still scene: it is taken out, and the cache starts anew.")
