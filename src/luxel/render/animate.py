"""A sequence that starts warm: the cache is brought to where the first picture shows no more of its beginnings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from luxel.errors import LuxelError
from luxel.image.tonemap import to_display
from luxel.render.exposure import Exposure, resolve_exposure
from luxel.render.sequence import open_sequence

if TYPE_CHECKING:
    from luxel.render.renderer import Renderer

COVER_FRAMES = 256
"""Frames at most in which a view is waited for."""
COVER_STEP = 8
"""Frames between two looks at what is covered."""
COVERED = 0.99
"""Share of the pixels that must be answered in full."""


def cover_view(renderer: Renderer, time: float | None = None) -> float:
    """Render until 99 % of the pixels have weight 1 or more; return the share that has.

    Ends early where the share no longer grows, as under a method that answers in part only, and after `COVER_FRAMES`.
    `time` in seconds is where the scene stands meanwhile; None: where it is.
    """
    share = before = -1.0
    for _ in range(COVER_FRAMES // COVER_STEP):
        renderer.run(COVER_STEP, time_of=None if time is None else lambda _: time)
        layers = renderer.layers()
        share = float((layers.weight[layers.hit] >= 1.0).mean()) if layers.hit.any() else 1.0
        if share >= COVERED or share <= before:
            break
        before = share
    return share


def warm_up(renderer: Renderer, frames: int | None = None, start: float = 0.0, fps: float = 30.0) -> None:
    """Warm the cache for a sequence that begins at `start` seconds; its last frames lead up to there in motion.

    `frames` None: until the view is covered; a number: so many, 0 for a cold start.
    Raises LuxelError for a negative number.
    """
    from luxel.render.renderer import WARM_UP_FRAMES

    if frames is not None and frames < 0:
        raise LuxelError(f"a warm-up of {frames} frames cannot be: use 0 or more, or none for as many as it takes")
    if frames is None:
        cover_view(renderer, start)
        frames = WARM_UP_FRAMES
    renderer.run(frames, time_of=lambda index: start + (index - frames) / fps)


def render_sequence(
    renderer: Renderer,
    place: str | Path,
    frames: int,
    *,
    fps: float = 30.0,
    start: float = 0.0,
    exposure: Exposure | float | None = None,
    warm_up_frames: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> tuple[list[float], int]:
    """Render `frames` frames to `place`: a folder of numbered PNG, .gif or .mp4. Frame i shows `start` + i / fps s.

    The cache is warmed up first (`warm_up`). An automatic `exposure` (None, or stops) is one for all, by the first
    picture: one a frame would pump. Returns the frames' milliseconds, and the recordings after the warm-up.
    Raises LuxelError for a place that cannot be written and a negative `warm_up_frames`.
    """
    times: list[float] = []
    factor = 1.0
    with open_sequence(place, fps) as add:
        warm_up(renderer, warm_up_frames, start, fps)
        recordings = renderer.compilations
        for index in range(frames):
            now = start + index / fps
            times += renderer.run(1, time_of=lambda _, now=now: now)
            layers = renderer.layers()
            factor = resolve_exposure(exposure, layers) if index == 0 else factor
            add(to_display(layers.image(), factor))
            if progress is not None:
                progress(index + 1)
    return times, renderer.compilations - recordings
