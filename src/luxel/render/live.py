"""Edits of a scene while it is rendered: what `Renderer` and the viewer's world offer alike.

An edit that the caches follow by themselves is done at once; histories of the screen start anew with the next frame.
One that needs the scene uploaded anew starts the caches anew. One that cannot be raises LuxelError and changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from luxel.errors import LuxelError
from luxel.render.shared import Cache
from luxel.scene import live
from luxel.scene.device import Scene
from luxel.scene.host import Looks
from luxel.scene.model import Light, SceneData, Sky
from luxel.scene.sun import with_sun


class LiveScene:
    """A scene with the caches that light it."""

    scene: Scene

    def _caches(self) -> Iterable[Cache]:
        """Return all caches of the scene."""
        raise NotImplementedError

    def _note_edit(self, structure: bool = True) -> None:
        """Hear of an edit that is done; `structure`: of more than a place."""

    @property
    def data(self) -> SceneData:
        """The scene as edited so far; held, so that it is changed by calls only."""
        return self.scene.host.data

    @property
    def light_scale(self) -> float:
        """What all light is multiplied by."""
        return self.scene.host.light_scale

    # ------------------------------------------------------------------ light

    def set_light_scale(self, factor: float) -> None:
        """Multiply every light, emission and sky by `factor`, 0 or more; compiles nothing."""
        live.set_light_scale(self.scene, factor)
        self._note_edit()

    def set_light(self, which: int | str, **fields: Any) -> None:
        """Change fields of a light (`luxel.Light`), by index or name: `set_light("lamp", color=(9, 9, 9))`."""
        live.set_light(self.scene, which, **fields)
        self._note_edit()

    def add_light(self, light: Light) -> int:
        """Add a light without a surface; return its index. Its number is part of the kernels: compiles once."""
        index = live.add_light(self.scene, light)
        self._note_edit()
        return index

    def remove_light(self, which: int | str) -> None:
        """Remove a light, by index or name; those behind it move up. Compiles once, as `add_light`."""
        live.remove_light(self.scene, which)
        self._note_edit()

    def set_sun(
        self, azimuth: float, elevation: float, strength: float | None = None, diameter: float | None = None
    ) -> None:
        """Replace the directional lights by one sun, of the tint that they had; suns of the sky's image stay.

        Degrees, towards the sun: `azimuth` from +Z towards +X, `elevation` above the horizon. `strength` is the
        irradiance on a facing plane in W/m^2 of its strongest channel, `diameter` how many degrees wide its disc is,
        0 (sharp shadows) to 90; None keeps what it was.
        """
        live.set_lights(self.scene, with_sun(self.data, azimuth, elevation, strength, diameter))
        self._note_edit()

    def set_sky(self, sky: Sky | None = None, **fields: Any) -> None:
        """Replace the sky by a `luxel.Sky`, or change fields of it: `set_sky(color=(1, 1, 1))`.

        Suns of an image (`Light.in_sky`) shine as lights; they are turned and coloured with it, and go with it.
        """
        if sky is not None and not isinstance(sky, Sky):
            raise LuxelError(f"a sky is a luxel.Sky, not {sky!r}; a plain one is set by set_sky(color=(r, g, b))")
        if sky is None and not fields:
            raise LuxelError("set_sky() changes nothing: give a luxel.Sky or fields of one; luxel.Sky() is no sky")
        before = self.data.sky
        if "image" in fields:
            fields = {"suns": None, **fields}
        changed = live.change(before if sky is None else sky, fields)
        appears = max(changed.color) > 0.0 and not self.scene.lights.has_sky
        if appears or changed.image is not before.image or changed.rotation != before.rotation:
            self._check("sky", "another sky")
        live.set_sky(self.scene, changed)
        self._note_edit()

    # ------------------------------------------------------------------ materials, objects

    def set_material(self, which: int | str, **fields: Any) -> None:
        """Change fields of a material (`luxel.Material`), by index or name.

        Where something opaque becomes see-through, the scene is uploaded anew and the caches start anew.
        """
        index = live.find_index(self.data.materials, which, "material")
        before = self.data.materials[index]
        material = live.change(before, fields)
        if live.BAKED & fields.keys() and live.is_baked(self.data, index):
            self._check("reflectance", f"changing what material '{before.name or index}' makes of light")
        if live.needs_upload(self.scene, index, material):
            materials = [*self.data.materials[:index], material, *self.data.materials[index + 1 :]]
            self._upload(replace(self.data, materials=materials), f"letting light through material '{before.name}'")
        else:
            live.set_material(self.scene, index, material)
        self._note_edit()

    def move_object(self, which: int | str, to_world: Any) -> None:
        """Place an object, by index or name, at the (4, 4) matrix `to_world`, and keep it there at any time.

        The first move of an object that stood still takes it out of the still scene: the scene is uploaded anew and
        the caches start anew. From then on a move costs next to nothing and is followed.
        """
        index = live.find_index(self.data.objects, which, "object")
        matrix = live.check_placement(self.scene, index, to_world)
        taken_out = self.hold(index)
        live.place_object(self.scene, index, matrix)
        self._note_edit(structure=taken_out)

    def hold(self, which: int | str) -> bool:
        """Make an object one that can be placed, where it is; return whether that started the caches anew."""
        index = live.find_index(self.data.objects, which, "object")
        if live.is_movable(self.scene, index):
            return False
        item = self.data.objects[index]
        matrix = live.check_placement(self.scene, index, item.to_world)
        self._upload(live.with_held(self.data, index, matrix), f"moving object '{item.name}'")
        self._note_edit()
        return True

    # ------------------------------------------------------------------ what both need

    def _check(self, part: str, words: str) -> None:
        # Other renderers of the scene have caches of their own.
        for cache in self.scene.host.caches:
            cache.check_edit(part, words)

    def _upload(self, data: SceneData, words: str, looks: Looks | None = None) -> None:
        """Upload `data` in place of the scene, and start all caches anew: all of it, or nothing where it fails.

        `looks` None keeps what it shows of materials.
        """
        self._check("geometry", words)
        fresh = live.upload_like(self.scene, data, looks)
        built = [(cache, cache.method.build(fresh, cache.params, cache.seed)) for cache in self._caches()]
        live.take_over(self.scene, fresh)
        for cache, state in built:
            cache.restart(self.scene, cache.params, state)
