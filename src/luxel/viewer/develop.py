"""From a picture on the device to bytes for the browser: pick a layer, expose, encode, put the pixels in rows.

All of it is one small frozen kernel a film and look, so that only four bytes a pixel leave the device.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.film import Film
from luxel.render.frame import Picture
from luxel.render.replay import Replay
from luxel.render.tonemap import MIDDLE_GREY

REC709 = (0.2126, 0.7152, 0.0722)
LIT = ("image", "direct", "indirect", "irradiance")
"""Looks that are exposed like the image."""
FAST_LOOKS = (*LIT, "albedo", "normals")
"""Looks that are developed here; `deep` draws the others."""


class Darkroom:
    """Develops pictures of any film and look; keeps what it recorded."""

    def __init__(self) -> None:
        self._develop: dict[tuple[int, int, str], Replay] = {}
        self._lanes: dict[tuple[int, int], Any] = {}

    def develop(self, film: Film, picture: Picture, look: str, exposure: float) -> tuple[np.ndarray, float]:
        """Return the displayed picture (H, W, 3) uint8 and the mean luminance of the image; waits for the device."""
        key = (film.width, film.height, look)
        if key not in self._develop:
            if len(self._develop) > 64:
                self._develop.clear()
                self._lanes.clear()
            self._develop[key] = Replay(_develop_step(look))
        if key[:2] not in self._lanes:
            lanes = mi.UInt32(film.lanes_of_image().ravel().astype(np.uint32))
            dr.make_opaque(lanes)
            self._lanes[key[:2]] = lanes
        packed, light = self._develop[key](picture, self._lanes[key[:2]], dr.opaque(mi.Float, float(exposure)))
        pixels = np.array(packed).view(np.uint8).reshape(film.height, film.width, 4)
        return np.ascontiguousarray(pixels[..., :3]), float(np.array(light)[0])

    @property
    def recordings(self) -> int:
        """How often a development was recorded."""
        return sum(step.recordings for step in self._develop.values())


def exposure_for(mean_luminance: float) -> float:
    """Return the exposure that brings a mean luminance to middle grey, as `tonemap.auto_exposure` does."""
    return MIDDLE_GREY / mean_luminance if 0.0 < mean_luminance < float("inf") else 1.0


def _develop_step(look: str) -> Callable[..., Any]:
    def develop(picture: Picture, lanes: mi.UInt32, exposure: mi.Float) -> tuple[mi.UInt32, mi.Float]:
        color = _pick(look, picture)
        display = _encode(color * exposure) if look in LIT else dr.clip(color, 0.0, 1.0)
        # Adding a half and cutting off rounds; NaN becomes black, as a comparison with it is false.
        word = mi.UInt32(0)
        for place, channel in enumerate(display):
            word |= mi.UInt32(dr.select(channel > 0.0, channel, 0.0) * 255.0 + 0.5) << (8 * place)
        image = _image(picture)
        bright = sum(weight * channel for weight, channel in zip(REC709, image, strict=True))
        bright = dr.select(dr.isfinite(bright), bright, 0.0)
        dr.eval(word, bright)
        packed = dr.gather(mi.UInt32, word, lanes)
        light = dr.mean(dr.gather(mi.Float, bright, lanes))
        return packed, light

    return develop


def _image(picture: Picture) -> mi.Color3f:
    reflected = picture.albedo * dr.inv_pi * (picture.direct + picture.indirect)
    return picture.emission + reflected + picture.glossy


def _pick(look: str, picture: Picture) -> mi.Color3f:
    """Return the colour of each lane for `look`."""
    if look == "direct":
        return picture.emission + picture.albedo * dr.inv_pi * picture.direct
    if look == "indirect":
        return picture.albedo * dr.inv_pi * picture.indirect + picture.glossy
    if look == "irradiance":
        return picture.indirect * dr.inv_pi
    if look == "albedo":
        return _encode(picture.albedo)
    if look == "normals":
        tilt = mi.Color3f(*(0.5 + 0.5 * axis for axis in picture.normal))
        return dr.select(picture.hit, tilt, 0.0)
    return _image(picture)


def _encode(color: mi.Color3f) -> mi.Color3f:
    """Return linear light clipped and encoded by the sRGB curve."""
    light = dr.clip(color, 0.0, 1.0)
    return dr.select(light <= 0.0031308, 12.92 * light, 1.055 * dr.power(dr.fmax(light, 1e-8), 1.0 / 2.4) - 0.055)
