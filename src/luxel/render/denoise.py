"""Denoise indirect light: by OptiX on a GPU that can, else by Open Image Denoise on the CPU, else not at all.

What is denoised is the demodulated indirect irradiance, (H, W, 3), not the picture: the light that methods differ in.
Emission and albedo hold no noise, and the sharp shadows of the direct light are only blurred. The guides are the
shading normal and, since the albedo has been divided out, an albedo of one on every surface; both come from the
g-buffer and hold no noise, and Open Image Denoise is told so.

Measured with Open Image Denoise 2.5.1 at 128x128. `flip` of the picture at 32 paths a pixel, with indirect light
alone, direct and indirect apart, both in one: `atrium` 0.048, 0.056, 0.053; `cornell-box` 0.036, 0.037, 0.039. At one
path the noise of area lights shows, and denoising them as well helps a little: `cornell-box` 0.087, 0.085, 0.084.
With the real albedo as guide `regional` at 32 paths was 0.082 on `atrium` and 0.025 on `cornell-box`, with an albedo
of one 0.039 and 0.023.
"""

from __future__ import annotations

import importlib
import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.camera import camera_axes, make_pinhole
from luxel.kernels.film import Film
from luxel.kernels.gbuffer import trace_gbuffer
from luxel.scene.arrays import from_numpy
from luxel.scene.device import Scene
from luxel.scene.model import Camera

OPTIX_WEIGHTS = Path("/usr/share/nvidia/nvoptix.bin")
"""Without this file of the driver the OptiX denoiser does not fail but aborts the process."""
TRIAL_SIDE = 16
"""Pixels of the side of the image that is denoised to see whether it works."""


@dataclass(frozen=True)
class Guides:
    """What a denoiser may know of the view, float32."""

    albedo: np.ndarray
    """(H, W, 3): one on surfaces, zero where nothing was hit; that of demodulated light."""
    normal: np.ndarray
    """(H, W, 3): unit shading normals in the camera's frame, x right, y up, z towards the viewer; zero for a miss."""


@dataclass(frozen=True)
class Denoiser:
    """A denoiser that works here."""

    used: str
    """`optix` or `oidn`."""
    reason: str
    """One sentence: what it is, and why this one."""
    apply: Callable[[np.ndarray, Guides], tuple[np.ndarray, float]]
    """Takes a noisy irradiance (H, W, 3) and guides of its size; returns (H, W, 3) float32 and the milliseconds that
    the denoiser worked. Copies between NumPy and the GPU are not counted: a renderer would not make them."""


def find_denoiser(device: str) -> tuple[Denoiser | None, str]:
    """Return the denoiser for `device` (`cuda` or `cpu`), or None, and one sentence that says why."""
    obstacle = _optix_obstacle(device)
    if obstacle is None:
        reason = "The OptiX denoiser of the NVIDIA driver, on the GPU."
        return Denoiser("optix", reason, _Optix().apply), reason
    try:
        oidn = _Oidn(importlib.import_module("pyoidn"))
        # Whether it runs here, such as on this processor, shows only at the first use.
        black = np.zeros((TRIAL_SIDE, TRIAL_SIDE, 3), np.float32)
        oidn.apply(black, Guides(black, black))
    except ImportError:
        reason = f"None: {obstacle}, and Open Image Denoise is not installed (`pip install 'luxel[denoise]'`)."
        return None, reason
    except (OSError, RuntimeError) as error:
        line = " ".join(str(error).split())
        return None, f"None: {obstacle}, and Open Image Denoise does not run here ({line})."
    reason = f"Open Image Denoise on the CPU, as {obstacle}."
    return Denoiser("oidn", reason, oidn.apply), reason


def trace_guides(scene: Scene, camera: Camera, size: tuple[int, int], time: float = 0.0) -> Guides:
    """Return the guides of `camera`'s view of (width, height) `size` at `time` seconds."""
    film, pinhole = Film(*size), make_pinhole(camera, *size, time, origin=scene.host.origin)
    surface = trace_gbuffer(scene, film, pinhole, pinhole).surface
    hit = film.to_image(surface.active).astype(bool)[..., None]
    world = film.to_image(mi.Color3f(mi.Vector3f(surface.n_shading)))
    _, right, up, forward = camera_axes(camera, time)
    normal = np.where(hit, world @ np.stack([right, up, -forward], axis=1), 0.0)
    albedo = np.broadcast_to(hit, normal.shape)
    return Guides(np.ascontiguousarray(albedo, np.float32), np.ascontiguousarray(normal, np.float32))


def _optix_obstacle(device: str) -> str | None:
    if device != "cuda":
        return "the OptiX denoiser needs the device cuda"
    if not OPTIX_WEIGHTS.is_file():
        return f"the OptiX denoiser needs the driver's file {OPTIX_WEIGHTS}, which is missing"
    return None


class _Optix:
    """Keeps the denoiser of the last image size: making one takes longer than using it."""

    def __init__(self) -> None:
        self._made: tuple[tuple[int, int], Any] | None = None

    def apply(self, noisy: np.ndarray, guides: Guides) -> tuple[np.ndarray, float]:
        """Return the denoised (H, W, 3) and the milliseconds that it took."""
        size = (noisy.shape[1], noisy.shape[0])
        if self._made is None or self._made[0] != size:
            self._made = size, mi.OptixDenoiser(mi.ScalarVector2u(*size), albedo=True, normals=True)
        # Mitsuba's sensors have x to the left and z forward.
        normals = guides.normal * np.array([-1.0, 1.0, -1.0], np.float32)
        color, albedo, normal = (from_numpy(mi.TensorXf, a) for a in (noisy, guides.albedo, normals))
        dr.eval(color, albedo, normal)
        dr.sync_thread()
        start = clock.perf_counter()
        clean = self._made[1](color, albedo=albedo, normals=normal)
        dr.eval(clean)
        dr.sync_thread()
        spent = 1e3 * (clock.perf_counter() - start)
        return np.array(clean).astype(np.float32), spent


class _Oidn:
    """Open Image Denoise through `pyoidn`, which keeps its device and filter between calls."""

    def __init__(self, module: Any) -> None:
        self._module = module

    def apply(self, noisy: np.ndarray, guides: Guides) -> tuple[np.ndarray, float]:
        color = np.ascontiguousarray(noisy, np.float32)
        start = clock.perf_counter()
        clean = self._module.denoise(color, albedo=guides.albedo, normal=guides.normal, hdr=True, clean_aux=True)
        return clean, 1e3 * (clock.perf_counter() - start)
