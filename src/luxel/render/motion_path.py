"""The flight that motion is judged on: where the camera is in each frame, at 30 frames a second.

    the scene's key views -> one smooth curve -> as fast as the limits of a walk let it -> a view a frame

Or a straight line between two views, in exactly as many frames, at whatever speed that takes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from luxel.errors import LuxelError
from luxel.scene.axes import camera_axes
from luxel.scene.edit import parse_flight_path
from luxel.scene.model import Camera

if TYPE_CHECKING:
    from luxel.scene.device import Scene

MOTION_FRAMES = 96
"""Frames flown unless told otherwise."""
FRAME_RATE = 30.0
"""Frames a second."""
STILL_FRAMES = 48
"""Frames of warm-up, the camera still, before the flight."""
JUDGED_EVERY = 6
"""Frames from one that is held against its truth to the next."""
CUT_FRAMES = (1, 4, 16)
"""Frames after the jump that are judged."""
SPEED_LIMIT, TURN_LIMIT = 2.0, 60.0
"""Metres and degrees a second, at most, along the curve."""
SAMPLES = 256
"""Places between two key views by which its length is told."""
SLACK = 1.001
"""Time that a step gets over what its length asks for: chords of few places are a little shorter than the curve."""
SETTLED_BITS = 30
"""Of a coordinate, at most: beyond them lies rounding."""
FAR_AWAY, FAR_SHARE = 64.0, 1e3
"""Flights are far away where their coordinates are so many times their extent, and of that no less than a share."""
NEAREST = 1e-6
"""Metres between eye and target below which a view looks nowhere."""


@dataclass(frozen=True)
class MotionPath:
    """Where the camera is in each frame of a flight; cameras are in the file's coordinates."""

    views: tuple[Camera, ...]
    """One a frame."""
    cut: Camera
    """Where it jumps to after the last."""

    @property
    def judged(self) -> tuple[int, ...]:
        """Return the numbers of the frames that are judged, counted from 1."""
        return judged_frames(len(self.views))


def judged_frames(frames: int) -> tuple[int, ...]:
    """Return which of `frames` flown frames are judged: every sixth, counted from 1."""
    return tuple(range(JUDGED_EVERY, frames + 1, JUDGED_EVERY))


def frame_time(frame: int) -> float:
    """Return the scene's time in seconds in flown frame `frame`; the first is 1, frames of warm-up have 0 and less.

    A moving scene runs on from the first frame of the warm-up to the last one after the cut.
    """
    return (STILL_FRAMES + frame - 1) / FRAME_RATE


def check_motion(frames: int, line: str | None) -> None:
    """Raise LuxelError where so many frames have none to judge, or `line` is no flight path."""
    if frames < JUDGED_EVERY:
        raise LuxelError(f"a flight of {frames} frames has none to judge: every {JUDGED_EVERY}th is, so fly more")
    if line is not None:
        line_views(*parse_flight_path(line), frames)


def find_motion(scene: Scene, frames: int = MOTION_FRAMES, line: str | None = None) -> MotionPath:
    """Return the flight of `scene`: along the text `line` (`parse_flight_path`), else through its key views.

    Raises LuxelError for a bad text, and where the scene has no two key views to fly between.
    """
    from luxel.render.flight import find_flight

    check_motion(frames, line)
    keys = find_flight(scene)
    if line is not None:
        views = line_views(*parse_flight_path(line), frames)
    else:
        keys = keys if scene.host.data.flight else _free_run(scene, keys)
        if len(_distinct(keys)) < 2:
            raise LuxelError(
                f"{scene.host.data.name}: it has only one key view, so there is nothing to fly through; give "
                "--flight-path EYE;EYE;TARGET;TARGET[;FOV]"
            )
        views = curve_views(keys, frames)
    # Who has arrived at the last view does not jump by going there.
    cut = next((key for key in (keys[-1], keys[0]) if _way(key, views[-1]) > 0.1), keys[0])
    return MotionPath(tuple(views), replace(views[0], eye=cut.eye, target=cut.target, up=cut.up, name="cut"))


def line_views(first: Camera, last: Camera, frames: int) -> list[Camera]:
    """Return `frames` views from `first` to `last`, eye and target on straight lines, evenly.

    Raises LuxelError where eye and target meet on the way.
    """
    shares = np.linspace(0.0, 1.0, frames)[:, None]
    eyes, targets = (
        _settle((1.0 - shares) * np.array(a) + shares * np.array(b), _size(np.array([a, b])))
        for a, b in ((first.eye, last.eye), (first.target, last.target))
    )
    if (np.linalg.norm(targets - eyes, axis=1) < NEAREST).any():
        raise LuxelError("on this flight path the eye meets its target: move one of them aside")
    return [
        replace(first, eye=_triple(eye), target=_triple(target), name="flight")
        for eye, target in zip(eyes, targets, strict=True)
    ]


# --- the curve -----------------------------------------------------------------------------------------------------


def curve_views(keys: list[Camera], frames: int) -> list[Camera]:
    """Return the first `frames` views of a smooth curve through `keys` (two or more that differ).

    It goes as fast as 2 m/s and 60 degrees/s let it, whichever is reached first; a curve that would end before the last
    frame is flown slower, so that it ends there. Field of view and projection stay the first key's.
    """
    curve = _Curve(_distinct(keys))
    places = np.linspace(0.0, curve.knots[-1], SAMPLES * (len(curve.knots) - 1) + 1)
    # Seconds from place to place, by the limit that is reached first.
    eyes, turns = curve.at(places)
    metres = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
    degrees = np.rad2deg((turns[1:] * turns[:-1].inv()).magnitude())
    spent = np.concatenate([[0.0], np.cumsum(SLACK * np.maximum(metres / SPEED_LIMIT, degrees / TURN_LIMIT))])
    times = np.arange(frames) / FRAME_RATE
    if frames > 1 and times[-1] > spent[-1]:
        times *= spent[-1] / times[-1]
    eyes, turns = curve.at(np.interp(times, spent, places))
    size = _size(np.array([camera_axes(key)[0] for key in keys]))
    eyes, axes = _settle(eyes, size), _settle(turns.as_matrix(), 1.0)
    lens = replace(keys[0], motion=None, name="flight")
    return [
        replace(lens, eye=_triple(eye), target=_triple(_settle(eye - axis[:, 2], size)), up=_triple(axis[:, 1]))
        for eye, axis in zip(eyes, axes, strict=True)
    ]


def _settle(values: np.ndarray, size: float) -> np.ndarray:
    """Return `values` on a grid of a billionth of `size`, metres.

    Truths are found by a hash of where the camera is, and the last bits of the curve differ between machines.
    """
    step = 2.0 ** (np.ceil(np.log2(max(size, 1e-12))) - SETTLED_BITS)
    return np.round(values / step) * step + 0.0  # no negative zero


def _size(places: np.ndarray) -> float:
    """Return the size by which places (N, 3) of a flight are settled: their coordinates', or, far away, its own.

    A step of a billionth of five thousand kilometres, where maps put things, would shake the view by some pixels.
    """
    far, extent = float(np.abs(places).max()), float(np.ptp(places, axis=0).max())
    return min(far, max(FAR_AWAY * extent, far / FAR_SHARE))


class _Curve:
    """Key views joined by cubic pieces whose slopes meet, each between its two views on every axis.

    A curve that swings beyond its views goes through the walls that they stand before, so eyes are interpolated
    monotonically: Fritsch and Butland 1984, "A method for constructing local monotone piecewise cubic interpolants", as
    SciPy's PCHIP has it. Directions are unit quaternions, so that a turn goes round and never through zero. Knots are
    as far apart as the way between their views takes at the limits.
    """

    def __init__(self, keys: list[Camera]) -> None:
        from scipy.interpolate import PchipInterpolator

        self.knots = np.concatenate([[0.0], np.cumsum([_way(a, b) for a, b in zip(keys, keys[1:], strict=False)])])
        eyes = np.array([camera_axes(key)[0] for key in keys])
        quaternions = np.array([_turn_of(key).as_quat() for key in keys])
        for index in range(1, len(keys)):
            # A quaternion and its opposite are one direction: take the one that is nearer.
            if quaternions[index] @ quaternions[index - 1] < 0.0:
                quaternions[index] *= -1.0
        self._eyes = PchipInterpolator(self.knots, eyes)
        self._quaternions = PchipInterpolator(self.knots, quaternions)

    def at(self, places: np.ndarray) -> tuple[np.ndarray, Any]:
        """Return eyes (N, 3) and directions (a Rotation of N) at `places` (N,) between the first knot and the last."""
        from scipy.spatial.transform import Rotation

        return self._eyes(places), Rotation.from_quat(self._quaternions(places))


def _distinct(keys: list[Camera]) -> list[Camera]:
    """Return `keys` without those that are the view before them."""
    return [key for index, key in enumerate(keys) if index == 0 or _way(keys[index - 1], key) > 1e-6]


def _way(first: Camera, second: Camera) -> float:
    """Return the seconds from one view to another at the limits."""
    metres = float(np.linalg.norm(camera_axes(second)[0] - camera_axes(first)[0]))
    degrees = float(np.rad2deg((_turn_of(second) * _turn_of(first).inv()).magnitude()))
    return max(metres / SPEED_LIMIT, degrees / TURN_LIMIT)


def _turn_of(camera: Camera) -> Any:
    """Return the direction of a camera at rest as scipy's Rotation: its columns are right, up and backward."""
    from scipy.spatial.transform import Rotation

    _, right, up, forward = camera_axes(camera)
    return Rotation.from_matrix(np.stack([right, up, -forward], axis=1))


def _free_run(scene: Scene, keys: list[Camera]) -> list[Camera]:
    """Return the first and longest run of key views between which nothing stands: found ways may lead through walls."""
    from luxel.render.flight_plan import free_ways

    runs = [[keys[0]]]
    for key, free in zip(keys[1:], free_ways(scene, keys).tolist(), strict=True):
        if free:
            runs[-1].append(key)
        else:
            runs.append([key])
    return max(runs, key=len)


def _triple(vector: np.ndarray) -> tuple[float, float, float]:
    return float(vector[0]), float(vector[1]), float(vector[2])
