"""The lightmap's file: the bake and the light of one frame, so that a saved transport relights without a new bake."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import drjit as dr
import numpy as np

from luxel.errors import LuxelError
from luxel.methods.lightmap.bake.fingerprint import fingerprint_scene
from luxel.methods.lightmap.bake.record import Bake, bake_arrays
from luxel.methods.lightmap.params import LightmapParams
from luxel.methods.lightmap.run.state import LightmapState
from luxel.methods.lightmap.run.upload import upload_bake
from luxel.methods.persistence import read_arrays, write_arrays
from luxel.scene.device import Scene

LIVE = ("light", "radiosity", "direct", "direct_count", "lights_seen", "seed")
"""Fields of the state that frames change, or that the bake does not hold."""


def save_lightmap(name: str, state: LightmapState, path: Path) -> None:
    """Write bake and light to `path` (.npz)."""
    arrays = {f"bake.{key}": value for key, value in bake_arrays(state.bake.bake).items()}  # type: ignore[attr-defined]
    arrays |= {f"state.{key}": np.array(getattr(state, key)) for key in LIVE}
    write_arrays(name, arrays, path)


def load_lightmap(name: str, scene: Scene, params: LightmapParams, path: Path) -> LightmapState:
    """Return the state in `path`. Raises LuxelError for another scene, other parameters, or a sky that it lacks."""
    held = read_arrays(name, path)
    bake = _read_bake(held, path)
    if bake.fingerprint != fingerprint_scene(scene, params):
        raise LuxelError(f"'{path}' is the bake of another scene or of other parameters; bake this one anew")
    if scene.lights.has_sky and not bake.sky_resolution:
        raise LuxelError(
            f"'{path}' was baked without a sky, so it holds no light from one; bake the scene with its sky"
        )
    state = upload_bake(scene, bake, 0)
    for key in LIVE:
        kind: Any = type(getattr(state, key))
        setattr(state, key, kind(held[f"state.{key}"]))
    dr.make_opaque(state.light, state.radiosity, state.direct, state.direct_count, state.lights_seen, state.seed)
    return state


def _read_bake(held: dict[str, np.ndarray], path: Path) -> Bake:
    values = {}
    for item in fields(Bake):
        key = f"bake.{item.name}"
        if key not in held:
            raise LuxelError(f"'{path}' holds a bake of another version: it lacks '{item.name}'")
        value = held[key]
        values[item.name] = value.item() if value.ndim == 0 else value
    return Bake(**values)
