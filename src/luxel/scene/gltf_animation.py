"""glTF animation: key-framed tracks, sampled at any time (glTF 2.0, section 3.11 and appendix C)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pygltflib import Animation, AnimationChannel

from luxel.scene.gltf_accessors import AccessorReader
from luxel.scene.gltf_document import Document

Interpolation = Literal["LINEAR", "STEP", "CUBICSPLINE"]

# Element types of the output accessor for each animated property.
OUTPUT_TYPES: dict[str, tuple[str, ...]] = {
    "translation": ("VEC3",),
    "rotation": ("VEC4",),
    "scale": ("VEC3",),
    "weights": ("SCALAR",),
}
# Above this cosine between two quaternions the arc is so short that slerp divides by almost zero.
NEARLY_PARALLEL = 0.9995


@dataclass
class Track:
    """One property over time. `times` is (K,) seconds, not decreasing.

    `values` is (K, C); for CUBICSPLINE (K, 3, C) with in-tangent, value and out-tangent of each key.
    """

    times: np.ndarray
    values: np.ndarray
    interpolation: Interpolation
    is_rotation: bool = False

    def sample(self, time: float) -> np.ndarray:
        """(C,) float64 at `time` seconds; before the first and after the last key the end value holds."""
        last = len(self.times) - 1
        key = int(np.searchsorted(self.times, time, side="right")) - 1
        if key < 0 or key >= last:
            return self._finish(self._key_value(0 if key < 0 else last))
        if self.interpolation == "STEP":
            return self._finish(self._key_value(key))
        span = self.times[key + 1] - self.times[key]
        s = (time - self.times[key]) / span
        if self.interpolation == "CUBICSPLINE":
            return self._finish(hermite(self.values[key], self.values[key + 1], s, span))
        start, end = self.values[key], self.values[key + 1]
        return slerp(start, end, s) if self.is_rotation else (1.0 - s) * start + s * end

    def _key_value(self, key: int) -> np.ndarray:
        return self.values[key, 1] if self.interpolation == "CUBICSPLINE" else self.values[key]

    def _finish(self, value: np.ndarray) -> np.ndarray:
        return value / max(float(np.linalg.norm(value)), 1e-12) if self.is_rotation else value.copy()


def hermite(start: np.ndarray, end: np.ndarray, s: float, span: float) -> np.ndarray:
    """Cubic Hermite curve between two (3, C) keys; tangents are per second, so `span` scales them."""
    s2, s3 = s * s, s * s * s
    out_tangent, in_tangent = span * start[2], span * end[0]
    return (
        (2.0 * s3 - 3.0 * s2 + 1.0) * start[1]
        + (s3 - 2.0 * s2 + s) * out_tangent
        + (3.0 * s2 - 2.0 * s3) * end[1]
        + (s3 - s2) * in_tangent
    )


def slerp(start: np.ndarray, end: np.ndarray, s: float) -> np.ndarray:
    """The unit quaternion a fraction `s` along the shorter arc from `start` to `end`, both (4,)."""
    cosine = float(start @ end)
    if cosine < 0.0:
        end, cosine = -end, -cosine
    if cosine > NEARLY_PARALLEL:
        mixed = (1.0 - s) * start + s * end
        return mixed / np.linalg.norm(mixed)
    angle = np.arccos(cosine)
    return (np.sin((1.0 - s) * angle) * start + np.sin(s * angle) * end) / np.sin(angle)


def read_tracks(document: Document, reader: AccessorReader) -> tuple[dict[tuple[int, str], Track], float]:
    """Tracks of the file's first animation by (node, property), and its last key's time in seconds.

    Further animations are named in a warning. Raises `LuxelError` for broken keys.
    """
    animations = document.gltf.animations or []
    if not animations:
        return {}, 0.0
    names = [animation.name or f"animation {i}" for i, animation in enumerate(animations)]
    if len(animations) > 1:
        document.warn(f"Only the first animation ({names[0]}) is played; not played: {', '.join(names[1:])}.")
    tracks: dict[tuple[int, str], Track] = {}
    for channel in animations[0].channels or []:
        target = channel.target
        if target is None or target.node is None:
            continue
        if target.path not in OUTPUT_TYPES:
            document.warn(f"Animation of {target.path} is not supported and is ignored.")
            continue
        node = document.item(document.gltf.nodes, target.node, "animated node")
        if target.path == "weights" and node.mesh is None:
            document.warn(f"Animated morph weights of node {target.node} are ignored: it has no mesh.")
            continue
        tracks[target.node, target.path] = _read_track(document, reader, animations[0], channel, names[0])
    return tracks, max((float(track.times[-1]) for track in tracks.values()), default=0.0)


def _read_track(
    document: Document, reader: AccessorReader, animation: Animation, channel: AnimationChannel, name: str
) -> Track:
    sampler = document.item(animation.samplers, channel.sampler, f"sampler of {name}")
    path = channel.target.path
    times = reader.read_floats(sampler.input, ("SCALAR",)).astype(np.float64)
    values = reader.read_floats(sampler.output, OUTPUT_TYPES[path], unit=True).astype(np.float64)
    if not len(times) or not np.isfinite(times).all() or (np.diff(times) < 0.0).any():
        document.fail(f"the key times of {name} for the {path} of node {channel.target.node} do not increase")
    if not np.isfinite(values).all():
        document.fail(f"the {path} keys of {name} for node {channel.target.node} hold NaN or infinity")
    interpolation: Interpolation = "LINEAR"
    if sampler.interpolation == "STEP":
        interpolation = "STEP"
    elif sampler.interpolation == "CUBICSPLINE":
        interpolation = "CUBICSPLINE"
    elif sampler.interpolation not in ("LINEAR", None):
        document.warn(f"The interpolation {sampler.interpolation} is unknown and is taken as LINEAR.")
    parts = 3 if interpolation == "CUBICSPLINE" else 1
    # Weights are stored flat, one scalar per morph target; the other properties one vector per key.
    width = values.size // (len(times) * parts)
    expected = values.shape[1] if values.ndim == 2 else width
    if width != expected or width == 0 or values.size != width * len(times) * parts:
        document.fail(f"the {path} keys of {name} for node {channel.target.node} do not match its key times")
    values = values.reshape((len(times), 3, width) if parts == 3 else (len(times), width))
    is_rotation = path == "rotation"
    if is_rotation and parts == 1:
        values = values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)
    return Track(times, values, interpolation, is_rotation)
