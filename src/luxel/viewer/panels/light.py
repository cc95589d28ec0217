"""The light: all of it, the sun by angles or by the hour, lamps, and what glows."""

from __future__ import annotations

from typing import Any

import numpy as np

from luxel.scene.edit import DEFAULT_SUN, WIDEST_SUN
from luxel.scene.model import Light
from luxel.scene.sun import sun_at_hour
from luxel.viewer.connection import Connection, put
from luxel.viewer.stats import Facts
from luxel.viewer.visitor import Visitor
from luxel.viewer.world import World

NO_LIGHT = "none yet"
DARKEST, BRIGHTEST = -6.0, 6.0
"""Stops of all light."""
NEW_LIGHT_SHARE = 0.35
"""A new lamp gives this much irradiance at the scene's size, over the irradiance of a facing default sun."""


class LightPanel:
    """Scale, sun, lights without a surface, emissive materials."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self._gizmo: Any = None
        self._index = 0

    def build(self) -> None:
        """Add the controls to the page."""
        gui, connection = self.connection.gui, self.connection
        with gui.add_folder("All light", order=0):
            self._scale = gui.add_slider(
                "Light",
                DARKEST,
                BRIGHTEST,
                0.1,
                0.0,
                hint="Stops: all lamps, sun and sky together, in the scene itself.",
            )
            connection.on_change(self._scale, lambda stops: self._ask("scale", "set_light_scale", 2.0 ** float(stops)))
        with gui.add_folder("Sun", order=1):
            self._azimuth = gui.add_slider("Azimuth °", 0.0, 360.0, 1.0, 0.0, hint="From +Z towards +X.")
            self._elevation = gui.add_slider("Elevation °", -10.0, 90.0, 0.5, 45.0, hint="Above the horizon.")
            self._strength = gui.add_number(
                "Strength W/m²", 0.0, min=0.0, step=0.5, hint="Irradiance on a facing plane, strongest channel."
            )
            self._diameter = gui.add_number(
                "Diameter °", 0.0, min=0.0, max=WIDEST_SUN, step=0.1, hint="0: sharp shadows; the real sun: 0.53."
            )
            for handle in (self._azimuth, self._elevation, self._strength, self._diameter):
                connection.on_change(handle, lambda _: self._set_sun())
            self._hour = gui.add_slider(
                "Time of day h",
                4.0,
                20.0,
                0.1,
                12.0,
                hint="A plain sun: rises in the east (+X) at 6, 60° high at noon.",
            )
            connection.on_change(self._hour, self._set_hour)
        with gui.add_folder("Lamps", order=2):
            self._which = connection.add_list("Lamp", (NO_LIGHT,), hint="Lights without a surface.")
            connection.on_change(self._which, lambda _: self._show_lamp(self.connection.facts))
            self._color = gui.add_rgb("Colour", (255, 255, 255))
            self._power = gui.add_number(
                "Intensity", 1.0, min=0.0, step=0.1, hint="W/sr; of a sun W/m². Strongest channel."
            )
            for handle in (self._color, self._power):
                connection.on_change(handle, lambda _: self._recolour())
            buttons = gui.add_button_group("Lamp", ("Add", "Remove", "Move"), hint="Move shows a gizmo in the picture.")
            connection.on_press(buttons, lambda: self._press(buttons.value))
        with gui.add_folder("Glowing surfaces", order=3) as folder:
            self._glow_folder = folder
            self._glow = connection.add_list("Material", (NO_LIGHT,), hint="Materials that shine.")
            connection.on_change(self._glow, lambda _: self._show_glow(self.connection.facts))
            self._glow_color = gui.add_rgb("Colour", (255, 255, 255))
            self._glow_power = gui.add_number("Radiance", 1.0, min=0.0, step=0.5, hint="W/(m² sr), strongest channel.")
            for handle in (self._glow_color, self._glow_power):
                connection.on_change(handle, lambda _: self._reglow())
        self.refresh(connection.facts)

    def tick(self) -> None:
        pass

    def refresh(self, facts: Facts) -> None:
        """Show `facts`, which may have changed elsewhere."""
        put(self._scale, float(np.clip(round(float(np.log2(max(facts.light_scale, 1e-6))), 1), DARKEST, BRIGHTEST)))
        if facts.sun is not None:
            azimuth, elevation, strength, diameter = facts.sun
            put(self._azimuth, float(round(azimuth)))
            put(self._elevation, float(np.clip(round(elevation * 2.0) / 2.0, -10.0, 90.0)))
            put(self._strength, float(round(strength, 3)))
            put(self._diameter, float(round(diameter, 3)))
        names = tuple(_name(number, light) for number, light in enumerate(facts.lights)) or (NO_LIGHT,)
        if tuple(self._which.options) != names:
            kept = self._which.value
            self._which.options = names
            put(self._which, kept if kept in names else names[-1])
        glowing = tuple(_glow_name(index, name) for index, name, _ in facts.glowing)
        self._glow_folder.visible = bool(glowing)
        if glowing and tuple(self._glow.options) != glowing:
            self._glow.options = glowing
        self._show_lamp(facts)
        self._show_glow(facts)

    # ------------------------------------------------------------------ all, sun

    def _ask(self, key: str, action: str, *values: Any, **changes: Any) -> None:
        self.connection.post(lambda world, _: getattr(world, action)(*values, **changes), f"light {key}")

    def _set_sun(self) -> None:
        strength = self._strength.value
        if self.connection.facts.sun is None and strength <= 0.0:
            strength = max(DEFAULT_SUN)
        angles = self._azimuth.value, self._elevation.value
        self._ask("sun", "set_sun", *angles, strength, self._diameter.value)

    def _set_hour(self, hour: float) -> None:
        self._ask("sun", "set_sun", *sun_at_hour(float(hour)))

    # ------------------------------------------------------------------ lamps

    def _lamp(self, facts: Facts) -> int | None:
        names = [_name(number, light) for number, light in enumerate(facts.lights)]
        return names.index(self._which.value) if self._which.value in names else None

    def _show_lamp(self, facts: Facts) -> None:
        index = self._lamp(facts)
        if index is None:
            self._remove_gizmo()
            return
        color, power = split_color(facts.lights[index].color)
        put(self._color, color)
        put(self._power, power)
        if self._gizmo is not None and index != self._index:
            self._add_gizmo(index)

    def _recolour(self) -> None:
        index = self._lamp(self.connection.facts)
        if index is not None:
            self._ask("lamp", "set_light", index, color=join_color(self._color.value, self._power.value))

    def _press(self, name: str) -> None:
        facts = self.connection.facts
        index = self._lamp(facts)
        if name == "Add":
            self.connection.post(lambda world, visitor: add_lamp(world, visitor))
        elif index is None:
            self.connection.notify("info", "There is no lamp yet: add one.")
        elif name == "Remove":
            self._remove_gizmo()
            self._ask("remove", "remove_light", index)
        elif self._gizmo is None:
            self._add_gizmo(index)
        else:
            self._remove_gizmo()

    def _add_gizmo(self, index: int) -> None:
        """Show a gizmo at the lamp; dragging it moves the lamp."""
        self._remove_gizmo()
        facts = self.connection.facts
        light, self._index = facts.lights[index], index
        if light.kind == "directional":
            self.connection.notify("info", "A sun has no place: turn it by azimuth and elevation.")
            return
        size = 0.12 * float(np.linalg.norm(facts.upper - facts.lower))
        gizmo = self.connection.client.scene.add_transform_controls(
            "/lamp",
            scale=size,
            disable_rotations=True,
            depth_test=False,
            position=tuple(np.asarray(light.position) - facts.origin),
        )

        @gizmo.on_update
        async def _(_: Any) -> None:
            x, y, z = (float(axis) for axis in np.asarray(gizmo.position, np.float64) + facts.origin)
            self._ask("lamp place", "set_light", index, position=(x, y, z))

        self._gizmo = gizmo

    def _remove_gizmo(self) -> None:
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None

    # ------------------------------------------------------------------ glowing surfaces

    def _show_glow(self, facts: Facts) -> None:
        for index, name, emission in facts.glowing:
            if _glow_name(index, name) == self._glow.value:
                color, power = split_color(emission)
                put(self._glow_color, color)
                put(self._glow_power, power)

    def _reglow(self) -> None:
        for index, name, _ in self.connection.facts.glowing:
            if _glow_name(index, name) == self._glow.value:
                # A glow of nothing would leave the list and could not be brought back.
                power = max(float(self._glow_power.value), 1e-6)
                self._ask("glow", "set_material", index, emission=join_color(self._glow_color.value, power))


def add_lamp(world: World, visitor: Visitor) -> None:
    """Add a point light in front of the visitor, as bright as the scene's size asks for."""
    origin = world.scene.host.origin
    lower, upper = world.scene.host.lower + origin, world.scene.host.upper + origin
    eye, target = np.asarray(visitor.camera.eye), np.asarray(visitor.camera.target)
    size = float(np.linalg.norm(upper - lower))
    ahead = (target - eye) / max(float(np.linalg.norm(target - eye)), 1e-9)
    margin = 0.05 * (upper - lower)
    x, y, z = np.clip(
        eye + min(0.4 * size, float(np.linalg.norm(target - eye))) * ahead, lower + margin, upper - margin
    )
    power = NEW_LIGHT_SHARE * max(DEFAULT_SUN) * (0.25 * size) ** 2
    name = f"lamp {1 + sum(light.kind == 'point' for light in world.lights)}"
    world.add_light(Light("point", (power, power, power), position=(float(x), float(y), float(z)), name=name))


def split_color(color: tuple[float, float, float]) -> tuple[tuple[int, int, int], float]:
    """Return a display colour of full brightness, 0..255, and the strongest channel."""
    power = max(max(color), 0.0)
    tint = np.asarray(color) / power if power > 0.0 else np.ones(3)
    red, green, blue = (int(round(255.0 * float(part) ** (1.0 / 2.2))) for part in np.clip(tint, 0.0, 1.0))
    return (red, green, blue), float(round(power, 4))


def join_color(display: tuple[int, int, int], power: float) -> tuple[float, float, float]:
    """Return the light of a display colour whose strongest channel is `power`."""
    linear = (np.asarray(display, np.float64) / 255.0) ** 2.2
    most = float(linear.max())
    red, green, blue = (float(power) * (float(part) / most if most > 0.0 else 1.0) for part in linear)
    return (red, green, blue)


def _name(number: int, light: Light) -> str:
    return f"{number + 1}  {light.name or light.kind}"


def _glow_name(index: int, name: str) -> str:
    """Return a material's line in the list: numbered, since files use a name twice and the list may not."""
    return f"{index + 1}  {name}"
