"""Frames in which light bounces on: as many as were asked for, or until it has settled."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.bake.layout import Layout
from luxel.methods.base import Frame, Method, Progress
from luxel.render.renderer import Renderer
from luxel.scene.device import Scene

SETTLED = 1e-3
"""Mean change of the light over its mean, from one look to the next, below which it has settled."""
FRAMES_A_LOOK = 8
FRAMES_AT_MOST = 512
"""Where no number is asked for."""
POINTS_LOOKED_AT = 4096
"""About so many, where a method answers at points and not in texels."""


def bounce_light(
    scene: Scene,
    method: Method,
    params: Any,
    state: Any,
    layout: Layout,
    *,
    frames: int | None,
    seed: int,
    say: Progress,
) -> tuple[Any, int, bool]:
    """Return the state after `frames` frames, how many those were, and False where its light has not settled.

    `frames` None runs until it has; asked for a number, nobody looks. A progressive method keeps no light
    and needs no frame.
    """
    if method.progressive:
        return state, 0, True
    if method.texels(state) is not None:
        runner: Relighting | Rendering = Relighting(scene, method, state, layout, seed)
    else:
        runner = Rendering(scene, method, params, state, layout, seed)
    done, share, before = 0, 0.0, np.zeros(1)
    limit = FRAMES_AT_MOST if frames is None else frames
    while done < limit:
        runner.run(done, min(done + FRAMES_A_LOOK, limit))
        done = min(done + FRAMES_A_LOOK, limit)
        share = max(share, done / limit)
        if frames is None:
            light = runner.look()
            change = float(np.abs(light - before).mean()) / max(float(light.mean()), 1e-30)
            if change < SETTLED:
                say("bouncing light", 1.0)
                return runner.state, done, True
            # Changes shrink by about the same factor from look to look.
            share, before = max(share, math.log(change) / math.log(SETTLED)), light
        say("bouncing light", share)
    return runner.state, done, frames is not None


class Relighting:
    """Frames of a method that keeps texels, without a camera."""

    def __init__(self, scene: Scene, method: Method, state: Any, layout: Layout, seed: int) -> None:
        self.scene, self.method, self.state, self.layout = scene, method, state, layout
        self.seed = dr.opaque(mi.UInt32, (seed * 0x9E3779B1 + 1) & 0xFFFFFFFF)

    def run(self, first: int, last: int) -> None:
        """Run the frames first .. last."""
        still = dr.opaque(mi.Bool, True)
        for index in range(first, last):
            self.state = self.method.update(
                self.scene, self.state, Frame(dr.opaque(mi.UInt32, index), self.seed, still)
            )
            dr.eval(self.state)

    def look(self) -> np.ndarray:
        """Return the texels' indirect light, (M, 3)."""
        texels = self.method.texels(self.state)
        assert texels is not None
        return texels[self.layout.slot]


class Rendering:
    """Frames of a method whose cache is fed by the whole frame; the picture is thrown away."""

    def __init__(self, scene: Scene, method: Method, params: Any, state: Any, layout: Layout, seed: int) -> None:
        self.renderer = Renderer(scene, method.name, params, size=(8, 8), seed=seed, state=state)
        stride = max(1, len(layout.face) // POINTS_LOOKED_AT)
        few = replace(layout, face=layout.face[::stride], weights=layout.weights[::stride])
        self.places = few.points(0, len(few.face), scene)

    @property
    def state(self) -> Any:
        """The method's state after the last frame."""
        return self.renderer.state

    def run(self, first: int, last: int) -> None:
        """Run as many frames as from `first` to `last`."""
        self.renderer.run(last - first)

    def look(self) -> np.ndarray:
        """Return the indirect light at some of the texels' points, (n, 3)."""
        return np.array(self.renderer.method.query(self.renderer.scene, self.state, self.places).irradiance).T
