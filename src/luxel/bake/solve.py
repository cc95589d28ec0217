"""Lighting by wish: which powers of a scene's lights bring the wanted irradiance to chosen texels.

Light is linear: the irradiance of a texel is a sum over the lights of power times what that light brings at power one.
Each column of that map is one relighting with a single light, and non-negative least squares turns it round (Lawson
and Hanson 1974, through SciPy).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import nnls

from luxel.bake.core import Baked, finish_bake
from luxel.bake.lamps import list_lights, name_lights, only_light
from luxel.errors import LuxelError
from luxel.methods.lightmap.run.state import LightmapState, bake_of
from luxel.methods.lightmap.run.upload import upload_bake
from luxel.scene.device import upload

REACH = 4.0
"""Texels from a wished point to the texel that stands for it, at most."""


@dataclass
class LightTarget:
    """What is wanted: n texels of the bake, and their irradiance."""

    texels: np.ndarray
    """(n,) indices of texels; `texels_near` finds them by place."""
    irradiance: np.ndarray
    """(n, 3) or (n,), W/m^2; one number a texel asks for the mean of its channels."""
    weight: np.ndarray | None = None
    """(n,) how much each texel matters; None: all alike."""


@dataclass
class LightSolution:
    """The powers found."""

    factors: dict[str, float]
    """Light's name -> factor of its power in the scene; `scale_lights` applies them."""
    reached: np.ndarray
    """Irradiance that they bring to the texels, of the target's shape."""
    error: float
    """Root of the mean squared difference from the target, over the target's root mean square, both by weight.

    Where the target is black, over that of `reached`: 1 where any light is left, 0 where none is."""


def solve_lights(
    bake: Baked,
    target: LightTarget,
    *,
    lights: list[str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> LightSolution:
    """Return the non-negative light powers that best reach `target`; `lights` None lets all of them change.

    Lights that are not named keep their power. Raises LuxelError for a target that does not fit the bake, an unknown
    light, a scene without one, or a method whose bake cannot be relit.
    """
    wanted, weight = _check_target(bake, target)
    if not isinstance(bake.state, LightmapState):
        raise LuxelError(f"a bake by '{bake.method.name}' cannot be relit; bake with method 'lightmap'")
    known = name_lights(bake.data)
    names = known if lights is None else lights
    unknown = [name for name in names if name not in known]
    if unknown or not names:
        what = f"no light '{unknown[0]}'" if unknown else "no light to solve for"
        raise LuxelError(f"{bake.data.name} has {what}; its lights: {list_lights(known)}")
    columns = []
    fixed = np.zeros_like(wanted)
    for number, name in enumerate(known):
        brought = irradiance_by(bake, name)[target.texels]
        brought = brought if wanted.ndim == 2 else brought.mean(axis=1)
        if name in names:
            columns.append(brought)
        else:
            fixed = fixed + brought
        if progress is not None:
            progress((number + 1) / len(known))
    matrix = np.stack([column.ravel() for column in columns], axis=1)
    scale = np.sqrt(weight / weight.mean() if wanted.ndim == 1 else np.repeat(weight / weight.mean(), 3))
    ordered = [name for name in known if name in names]
    factors, _ = nnls(matrix * scale[:, None], (wanted - fixed).ravel() * scale)
    reached = (matrix @ factors).reshape(wanted.shape) + fixed
    size = _rms(wanted, scale) or _rms(reached, scale)
    error = _rms(reached - wanted, scale) / size if size > 0.0 else 0.0
    return LightSolution(dict(zip(ordered, (float(f) for f in factors), strict=True)), reached, error)


def irradiance_by(bake: Baked, light: str) -> np.ndarray:
    """Return what one light alone brings to the texels, (M, 3) W/m^2, at its power in the scene."""
    data = only_light(bake.data, light)
    scene = upload(data)
    state: Any = upload_bake(scene, bake_of(bake.state), bake.seed)
    alone = finish_bake(
        data, scene, bake.method, bake.params, state, bake.layout,
        frames=bake.frames, samples=bake.samples, seed=bake.seed, indirect_only=bake.indirect_only,
    )  # fmt: skip
    return alone.light.irradiance


def texels_near(bake: Baked, points: np.ndarray) -> np.ndarray:
    """Return the texel nearest to each point (n, 3) of the file's coordinates, of those that lie in the open, (n,).

    Raises LuxelError for a point farther from any than `REACH` texels.
    """
    from scipy.spatial import KDTree

    layout = bake.layout
    held = np.flatnonzero(np.diff(layout.starts) > 0)
    first = layout.starts[held]
    place = (bake.corners[layout.face[first]] * layout.weights[first][..., None]).sum(axis=1)
    wanted = np.atleast_2d(np.asarray(points, float))
    distance, index = KDTree(place).query(wanted - bake.scene.host.origin)
    far = int(np.argmax(distance))
    if distance[far] > REACH * layout.texel_size:
        x, y, z = wanted[far]
        raise LuxelError(f"the point {x:g}, {y:g}, {z:g} lies {distance[far]:.3g} m from the nearest texel")
    return held[index]


def _rms(values: np.ndarray, scale: np.ndarray) -> float:
    """Return the root mean square of `values`, each times its `scale`."""
    return float(np.sqrt(((values.ravel() * scale) ** 2).mean()))


def _check_target(bake: Baked, target: LightTarget) -> tuple[np.ndarray, np.ndarray]:
    texels, wanted = np.asarray(target.texels), np.asarray(target.irradiance, float)
    count = len(bake.layout.slot)
    whole = texels.ndim == 1 and len(texels) and np.issubdtype(texels.dtype, np.integer)
    if not whole or texels.min() < 0 or texels.max() >= count:
        raise LuxelError(f"the target's texels must be a list of whole numbers from 0 to {count - 1}")
    if wanted.shape not in ((len(texels),), (len(texels), 3)):
        raise LuxelError(f"the target asks for irradiance of shape {wanted.shape}; give one or three numbers a texel")
    if not np.isfinite(wanted).all() or (wanted < 0.0).any():
        raise LuxelError("the target's irradiance must be finite and not negative")
    weight = np.ones(len(texels)) if target.weight is None else np.asarray(target.weight, float)
    if weight.shape != texels.shape or not (np.isfinite(weight).all() and (weight >= 0.0).all() and weight.any()):
        raise LuxelError("the target's weights must be one number from 0 for each texel, not all of them 0")
    return wanted, weight
