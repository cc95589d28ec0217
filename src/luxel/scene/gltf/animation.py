"""glTF animation: key-framed tracks, sampled at any time (glTF 2.0, section 3.11 and appendix C)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np

from luxel.scene.gltf.accessors import AccessorReader
from luxel.scene.gltf.document import Document
from luxel.scene.gltf.schema import Animation, AnimationChannel, AnimationTarget

Interpolation = Literal["LINEAR", "STEP", "CUBICSPLINE"]

# Element types of the output accessor for each animated property.
OUTPUT_TYPES: dict[str, tuple[str, ...]] = {
    "translation": ("VEC3",),
    "rotation": ("VEC4",),
    "scale": ("VEC3",),
    "weights": ("SCALAR",),
}
POINTER = "KHR_animation_pointer"
# Pointers to what ordinary channels move too.
NODE_POINTER = re.compile(r"/nodes/(\d+)/(translation|rotation|scale|weights)")
ALL = "all"
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


def read_tracks(
    document: Document, reader: AccessorReader, chosen: str | int | None = None
) -> tuple[dict[tuple[int, str], Track], float]:
    """Tracks of the chosen animation by (node, property), and its last key's time in seconds.

    `chosen` is a name, a number from 0, "all" (every animation at once; where two move the same thing, the first does)
    or None: the first. Those not played are named in a warning. Raises `LuxelError` for an unknown one or broken keys.
    """
    animations = document.gltf.animations
    names = [animation.name or f"animation {i}" for i, animation in enumerate(animations)]
    picked = _pick(document, names, chosen)
    left = [name for i, name in enumerate(names) if i not in picked]
    if left:
        which = "the first animation" if chosen is None else "the chosen animation"
        document.warn(f"Only {which} ({names[picked[0]]}) is played; not played: {', '.join(left)}.")
    tracks: dict[tuple[int, str], Track] = {}
    for index in picked:
        for channel in animations[index].channels:
            key = _target(document, channel.target)
            if key is None:
                continue
            if key in tracks and len(picked) > 1:
                document.warn("Where two animations move the same thing, these are left out: {names}.", names[index])
                continue
            tracks[key] = _read_track(document, reader, animations[index], channel, key, names[index])
    return tracks, max((float(track.times[-1]) for track in tracks.values()), default=0.0)


def _pick(document: Document, names: list[str], chosen: str | int | None) -> list[int]:
    """The numbers of the animations that `chosen` names."""
    if chosen is None:
        return [0] if names else []
    text = str(chosen).strip()
    listed = ", ".join(f"{i} '{name}'" for i, name in enumerate(names))
    if not names:
        document.fail(f"animation '{text}' is asked for but the file has none")
    if text in names and not isinstance(chosen, int):
        return [names.index(text)]
    if text.lower() == ALL:
        return list(range(len(names)))
    if text.isdecimal() and int(text) < len(names):
        return [int(text)]
    alike = [i for i, name in enumerate(names) if name.casefold() == text.casefold()]
    if len(alike) != 1:
        document.fail(f"it has no animation '{text}'; it has {listed}, or write {ALL}")
    return alike


def _target(document: Document, target: AnimationTarget | None) -> tuple[int, str] | None:
    """The (node, property) that a channel moves; None, with a warning, for what luxel does not move."""
    if target is None:
        return None
    node, path = target.node, target.path
    if POINTER in target.extensions:
        pointer = str(target.extensions[POINTER].get("pointer"))
        found = NODE_POINTER.fullmatch(pointer)
        if found is None:
            what = "visibility" if pointer.endswith("/KHR_node_visibility/visible") else "these properties"
            document.warn(f"Animation of {what} is not supported, they stay as they start: {{names}}.", pointer)
            return None
        node, path = int(found[1]), found[2]
    if node is None:
        return None
    if path not in OUTPUT_TYPES:
        document.warn(f"Animation of {path} is not supported and is ignored.")
        return None
    if document.item(document.gltf.nodes, node, "animated node").mesh is None and path == "weights":
        document.warn(f"Animated morph weights of node {node} are ignored: it has no mesh.")
        return None
    return node, path


def _read_track(
    document: Document,
    reader: AccessorReader,
    animation: Animation,
    channel: AnimationChannel,
    key: tuple[int, str],
    name: str,
) -> Track:
    sampler = document.item(animation.samplers, channel.sampler, f"sampler of {name}")
    node, path = key
    times = reader.read_floats(sampler.input, ("SCALAR",)).astype(np.float64)
    values = reader.read_floats(sampler.output, OUTPUT_TYPES[path], unit=True).astype(np.float64)
    if not len(times) or not np.isfinite(times).all() or (np.diff(times) < 0.0).any():
        document.fail(f"the key times of {name} for the {path} of node {node} do not increase")
    if not np.isfinite(values).all():
        document.fail(f"the {path} keys of {name} for node {node} hold NaN or infinity")
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
        document.fail(f"the {path} keys of {name} for node {node} do not match its key times")
    values = values.reshape((len(times), 3, width) if parts == 3 else (len(times), width))
    is_rotation = path == "rotation"
    if is_rotation and parts == 1:
        values = values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)
    return Track(times, values, interpolation, is_rotation)
