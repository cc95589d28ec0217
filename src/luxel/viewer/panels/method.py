"""How the light is found: method, preset, every parameter, and the cache's life."""

from __future__ import annotations

from typing import Any

from viser import Icon

from luxel.methods.params import find_method
from luxel.viewer.connection import QUIET, Connection, put
from luxel.viewer.dials import Dial, list_dials
from luxel.viewer.stats import Facts
from luxel.viewer.visitor import Visitor
from luxel.viewer.world import World, list_methods

DEFAULTS = "defaults"
FIRST_DIALS = 6
"""Parameters that are shown at once; the others wait in a folder. `Params` names the weightier ones first."""


class MethodPanel:
    """Method, preset, dials, reset and freeze."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self._dials: dict[str, tuple[Dial, Any]] = {}
        self._folders: list[Any] = []
        self._shown = ""

    def build(self) -> None:
        """Add the controls to the page."""
        gui, connection, facts = self.connection.gui, self.connection, self.connection.facts
        with gui.add_folder("Method", order=0):
            self._method = gui.add_dropdown(
                "Method",
                tuple(list_methods()),
                initial_value=facts.choice.method,
                hint="How indirect light is found. All visitors of this session share it.",
            )
            connection.on_change(
                self._method, lambda name: connection.post(lambda world, _: world.switch_method(name), "method")
            )
            self._preset = connection.add_list("Preset", (DEFAULTS,), hint="A named set of parameters.")
            connection.on_change(self._preset, self._choose_preset)
            reset = gui.add_button("Start cache anew", icon=Icon.REFRESH, hint="Forget all cached light.", color=QUIET)
            connection.on_press(reset, lambda: connection.post(lambda world, _: world.reset(), "reset"))
            self._freeze = gui.add_checkbox(
                "Freeze cache", facts.frozen, hint="Nothing is traced, placed or forgotten; the view still moves."
            )
            connection.on_change(
                self._freeze, lambda value: connection.post(lambda world, _: world.freeze(value), "freeze")
            )
        self._parameters = gui.add_folder("Parameters", order=1)
        self._more = gui.add_folder("More parameters", order=2, expand_by_default=False)
        self.refresh(facts)

    def tick(self) -> None:
        pass

    def refresh(self, facts: Facts) -> None:
        """Show `facts`, which may have changed elsewhere."""
        choice = facts.choice
        put(self._method, choice.method)
        put(self._freeze, facts.frozen)
        if self._shown != choice.method:
            self._shown = choice.method
            self._preset.options = (DEFAULTS, *find_method(choice.method).presets)
            self._rebuild(choice.method)
        put(self._preset, choice.preset or DEFAULTS)
        for key, (dial, handle) in self._dials.items():
            value = dial.to_control(getattr(facts.params, key))
            if dial.kind == "slider":
                # A preset or a command line may go beyond what a hand usually wants.
                handle.max, handle.min = max(handle.max, value), min(handle.min, value)
            put(handle, value)

    def _rebuild(self, method: str) -> None:
        for _, handle in self._dials.values():
            handle.remove()
        dials = list_dials(method)
        with self._parameters:
            self._dials = {dial.key: (dial, self._add(dial)) for dial in dials[:FIRST_DIALS]}
        with self._more:
            self._dials |= {dial.key: (dial, self._add(dial)) for dial in dials[FIRST_DIALS:]}
        self._parameters.visible = bool(dials)
        self._more.visible = len(dials) > FIRST_DIALS

    def _add(self, dial: Dial) -> Any:
        handle = add_dial(self.connection.gui, dial)

        def change(value: Any) -> None:
            wanted = dial.from_control(value)

            def apply(world: World, visitor: Visitor) -> None:
                if dial.key not in {each.key for each in list_dials(world.main)}:
                    return  # another visitor has switched the method meanwhile
                if not world.set_param(dial.key, wanted):
                    visitor.notify("info", f"{dial.label}: the cache starts anew with this value.")

            self.connection.post(apply, f"param {dial.key}")

        self.connection.on_change(handle, change)
        return handle

    def _choose_preset(self, name: str) -> None:
        preset = None if name == DEFAULTS else name
        self.connection.post(lambda world, _: world.apply_preset(preset), "preset")


def add_dial(gui: Any, dial: Dial) -> Any:
    """Add the control of a parameter, at its default."""
    start = dial.to_control(dial.default)
    if dial.kind == "check":
        return gui.add_checkbox(dial.label, start, hint=dial.doc)
    if dial.kind == "choice":
        return gui.add_dropdown(dial.label, tuple(map(str, dial.options)), initial_value=start, hint=dial.doc)
    if dial.kind == "slider":
        return gui.add_slider(dial.label, dial.low, dial.high, dial.step, start, hint=dial.doc)
    if dial.kind == "number":
        return gui.add_number(dial.label, start, step=dial.step, hint=dial.doc)
    if dial.kind == "vector":
        return gui.add_vector3(dial.label, start, step=0.01, hint=dial.doc)
    return gui.add_text(dial.label, start, hint=dial.doc)
