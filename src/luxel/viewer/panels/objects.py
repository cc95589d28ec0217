"""Objects: choose one, grab it, move and turn it in the picture."""

from __future__ import annotations

from typing import Any

import numpy as np
from viser import Icon

from luxel.viewer import cameras
from luxel.viewer.connection import QUIET, Connection, put
from luxel.viewer.stats import Facts, describe_object
from luxel.viewer.visitor import Visitor
from luxel.viewer.world import World

LIST_LIMIT = 200
"""Objects in the list; scenes of thousands are searched by a click instead."""


class ObjectsPanel:
    """Which object, and the gizmo on it."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self._gizmo: Any = None
        self._asked: object = None
        """The last wish for a gizmo, until it is let go: the world hears of wishes a frame later."""

    def build(self) -> None:
        """Add the controls to the page."""
        gui, connection = self.connection.gui, self.connection
        with gui.add_folder("Objects"):
            self._which = gui.add_dropdown("Object", self._names(connection.facts), hint="What moves as one.")
            connection.on_change(self._which, lambda _: self._let_go())
            gui.add_markdown("*Grab it, then drag the arrows, squares and arcs in the picture.*")
            self._grab = gui.add_checkbox("Grab", False, hint="Holds it by a gizmo in its middle, until you let go.")
            connection.on_change(self._grab, self._toggle)
            back = gui.add_button("Put back", icon=Icon.ARROW_BACK_UP, color=QUIET, hint="Where it stood at first.")
            connection.on_press(back, self._put_back)
        self._home: dict[int, np.ndarray] = {}

    def tick(self) -> None:
        pass

    def refresh(self, facts: Facts) -> None:
        """Show `facts`, which may have changed elsewhere."""
        names = self._names(facts)
        if names != tuple(self._which.options):
            self._which.options = names
        # What was grabbed may be refused, as what deforms is.
        put(self._grab, self._gizmo is not None)

    def _names(self, facts: Facts) -> tuple[str, ...]:
        return tuple(f"{number + 1}  {item.name}" for number, item in enumerate(facts.objects[:LIST_LIMIT])) or (
            "none",
        )

    def _index(self) -> int:
        return int(self._which.value.split()[0]) - 1

    def _toggle(self, holds: bool) -> None:
        if holds and self.connection.facts.objects:
            self.grab(self._index())
        else:
            self._let_go()

    def _put_back(self) -> None:
        index = self._index() if self.connection.facts.objects else -1
        if index in self._home:
            home = self._home[index]
            self._let_go()
            self.connection.post(lambda world, _: world.place(index, home), f"place {index}")

    def grab(self, index: int) -> None:
        """Take hold of object `index`: a gizmo in its middle moves and turns it."""
        self._drop()
        asked = self._asked = object()
        self.connection.post(lambda world, visitor: self._take(world, visitor, index, asked))

    def _take(self, world: World, visitor: Visitor, index: int, asked: object) -> None:
        """Show the gizmo where the object stands now; runs between two frames. Not where it has been let go since."""
        if self._asked is not asked:
            return
        hold(world, visitor, index)
        facts, item = self.connection.facts, describe_object(world, index)
        self._home.setdefault(index, item.matrix)
        start = np.eye(4)
        start[:3, 3] = item.middle
        to_gizmo = np.linalg.inv(start) @ item.matrix
        scale = max(0.45 * item.size, 0.05 * float(np.linalg.norm(facts.upper - facts.lower)))
        gizmo = self.connection.client.scene.add_transform_controls(
            "/object", scale=scale, depth_test=False, position=tuple(item.middle - facts.origin), opacity=0.9
        )

        @gizmo.on_update
        async def _(_: Any) -> None:
            # A slip of the hand must not send it where nobody finds it; what stands outside the bounds may stay there.
            middle = item.middle - facts.origin
            least, most = np.minimum(facts.lower, middle), np.maximum(facts.upper, middle)
            place = np.clip(np.asarray(gizmo.position), least, most) + facts.origin
            turned = cameras.join_matrix(place, cameras.rotation_matrix(gizmo.wxyz), np.eye(3))
            self.connection.post(lambda world, _: world.place(index, turned @ to_gizmo), f"place {index}")

        # Holding it may have taken a while: another may be wanted by now, or none.
        if self._asked is not asked:
            gizmo.remove()
            return
        self._gizmo = gizmo
        put(self._grab, True)

    def _let_go(self) -> None:
        self._drop()
        put(self._grab, False)

    def _drop(self) -> None:
        self._asked = None
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None


def hold(world: World, visitor: Visitor, index: int) -> None:
    """Make an object movable, and say so where that starts the caches anew."""
    if world.hold(index):
        name = world.data.objects[index].name
        visitor.notify("info", f"'{name}' was part of the still scene: it is taken out, and the cache starts anew.")
