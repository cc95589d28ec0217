"""From a picture on the device to bytes for the browser: pick a layer, expose, encode, put the pixels in rows.

All of it is one small frozen kernel a film and look, so that only four bytes a pixel leave the device.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.direct import luminance
from luxel.kernels.film import Film
from luxel.render.exposure import CELLS, KINDS, Meter, cells_of
from luxel.render.frame import Picture
from luxel.render.replay import Replay
from luxel.scene.arrays import from_numpy

LIT = ("image", "direct", "indirect", "irradiance")
"""Looks that are exposed like the image."""
FAST_LOOKS = (*LIT, "albedo", "normals")
"""Looks that are encoded here; `host_looks` draws the others."""


class DisplayEncoder:
    """Develops pictures of any film and look; keeps what it recorded."""

    def __init__(self) -> None:
        self._steps: dict[tuple[int, int, str], Replay] = {}
        self._lanes: dict[tuple[int, int], tuple[mi.UInt32, mi.UInt32]] = {}

    def encode(self, film: Film, picture: Picture, look: str, exposure: float) -> tuple[np.ndarray, Meter]:
        """Return the displayed picture (H, W, 3) uint8 and the light of the image by cell; waits for the device."""
        key = (film.width, film.height, look)
        if key not in self._steps:
            if len(self._steps) > 64:
                self._steps.clear()
                self._lanes.clear()
            self._steps[key] = Replay(_encode_step(look))
        if key[:2] not in self._lanes:
            order = film.lanes_of_image().ravel(), cells_of(film.width, film.height).ravel()
            lanes, cells = (from_numpy(mi.UInt32, each) for each in order)
            dr.make_opaque(lanes, cells)
            self._lanes[key[:2]] = lanes, cells
        packed, sums = self._steps[key](picture, *self._lanes[key[:2]], dr.opaque(mi.Float, float(exposure)))
        pixels = np.array(packed).view(np.uint8).reshape(film.height, film.width, 4)
        light, count = np.array(sums, np.float64).reshape(2, KINDS, CELLS * CELLS)
        return np.ascontiguousarray(pixels[..., :3]), Meter(light, count)

    @property
    def recordings(self) -> int:
        """How often a development was recorded."""
        return sum(step.recordings for step in self._steps.values())


def _encode_step(look: str) -> Callable[..., Any]:
    def encode(picture: Picture, lanes: mi.UInt32, cells: mi.UInt32, exposure: mi.Float) -> tuple[mi.UInt32, mi.Float]:
        color = _pick(look, picture)
        display = _encode_srgb(color * exposure) if look in LIT else dr.clip(color, 0.0, 1.0)
        # Adding a half and cutting off rounds; NaN becomes black, as a comparison with it is false.
        word = mi.UInt32(0)
        for place, channel in enumerate(display):
            word |= mi.UInt32(dr.select(channel > 0.0, channel, 0.0) * 255.0 + 0.5) << (8 * place)
        counted = _count(picture)
        dr.eval(word, counted)
        packed = dr.gather(mi.UInt32, word, lanes)
        return packed, _sum_by_cell(counted, lanes, cells)

    return encode


def _count(picture: Picture) -> list[tuple[mi.Float, mi.Bool]]:
    """Return luminance and whether it counts for each kind of `exposure.Meter`."""
    # Not the image without its emission: beside a bright lamp single precision would leave nothing of it.
    image, reflected = _image(picture), _reflected(picture)
    surface = picture.hit & ((luminance(picture.albedo) > 0.0) | (luminance(picture.glossy) > 0.0))
    kinds = (luminance(reflected), surface), (luminance(image), picture.hit), (luminance(image), mi.Bool(True))
    return [(light, mask & dr.isfinite(light)) for light, mask in kinds]


def _sum_by_cell(counted: list[tuple[mi.Float, mi.Bool]], lanes: mi.UInt32, cells: mi.UInt32) -> mi.Float:
    """Return the sums of light, kind by kind and cell by cell, then the counts."""
    sums = dr.zeros(mi.Float, 2 * KINDS * CELLS * CELLS)
    for kind, (light, mask) in enumerate(counted):
        used = dr.gather(mi.Bool, mask, lanes)
        value = dr.fmax(dr.gather(mi.Float, light, lanes), 0.0)
        dr.scatter_add(sums, value, kind * CELLS * CELLS + cells, used)
        dr.scatter_add(sums, mi.Float(1.0), (KINDS + kind) * CELLS * CELLS + cells, used)
    return sums


def _reflected(picture: Picture) -> mi.Color3f:
    return picture.albedo * dr.inv_pi * (picture.direct + picture.indirect) + picture.glossy


def _image(picture: Picture) -> mi.Color3f:
    return picture.emission + _reflected(picture)


def _pick(look: str, picture: Picture) -> mi.Color3f:
    """Return the colour of each lane for `look`."""
    if look == "direct":
        return picture.emission + picture.albedo * dr.inv_pi * picture.direct
    if look == "indirect":
        return picture.albedo * dr.inv_pi * picture.indirect + picture.glossy
    if look == "irradiance":
        return picture.indirect * dr.inv_pi
    if look == "albedo":
        return _encode_srgb(picture.albedo)
    if look == "normals":
        tilt = mi.Color3f(*(0.5 + 0.5 * axis for axis in picture.normal))
        return dr.select(picture.hit, tilt, 0.0)
    return _image(picture)


def _encode_srgb(color: mi.Color3f) -> mi.Color3f:
    """Return linear light clipped and encoded by the sRGB curve."""
    light = dr.clip(color, 0.0, 1.0)
    return dr.select(light <= 0.0031308, 12.92 * light, 1.055 * dr.power(dr.fmax(light, 1e-8), 1.0 / 2.4) - 0.055)
