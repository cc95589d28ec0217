"""Distance of an image from the truth, split so that indirect light is judged alone.

Every function takes the layers of the image under test and of the truth: the same camera, size and g-buffer.
Pixels without a hit are left out. A figure that the truth leaves undefined (a black truth, no surface in view)
is NaN. "Indirect light" means the radiance that indirect light adds to the image, albedo / pi * E plus the
glossy part; demodulated, it is divided by the albedo.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from luxel.image.layers import Layers
from luxel.image.tonemap import mean_exposure, to_display

ALBEDO_FLOOR = 0.02
"""Channels of pixels darker than this say too little about the light on them to be divided by."""
REGION = 16
"""Side of `regional`'s blocks, pixels."""
BLOCK = 64
"""Side of `block_error_max`'s blocks, pixels."""
RELMSE_FLOOR = 0.01
"""Added to the squared truth (in units of its squared mean), so that black pixels do not divide by zero."""


def regional(test: Layers, truth: Layers) -> float:
    """Return the RMSE over 16x16 blocks of demodulated indirect light, over the truth's mean: the main figure.

    A block's value is, for each channel apart, the sum of indirect radiance over the sum of albedo, over its
    pixels whose albedo in that channel is above 0.02; blocks at the right and lower edge may be smaller.
    Blocks (in a channel) without such a pixel are left out.
    """
    wanted, given = _demodulate_blocks(truth, truth), _demodulate_blocks(test, truth)
    return _ratio(_rms(given - wanted), _mean(wanted))


def truth_noise(truth: Layers, halves: Sequence[np.ndarray]) -> float:
    """Return half of `regional` between the truth's two halves: the noise that is left in their mean.

    `halves` are two independent estimates of the indirect irradiance, (H, W, 3) each.
    """
    first, second = (_demodulate_blocks(replace(truth, indirect=half), truth) for half in halves)
    return 0.5 * _ratio(_rms(first - second), _mean(0.5 * (first + second)))


def bias(test: Layers, truth: Layers) -> float:
    """Return the mean of indirect light over the truth's, minus one."""
    return _ratio(_mean(_indirect(test, truth)), _mean(_indirect(truth, truth))) - 1.0


def relmse(test: Layers, truth: Layers) -> float:
    """Return the mean of (test - truth)^2 / (truth^2 + 0.01 mean(truth)^2) of indirect light, linear."""
    wanted, given = _indirect(truth, truth), _indirect(test, truth)
    floor = RELMSE_FLOOR * _mean(wanted) ** 2
    return _mean((given - wanted) ** 2 / (wanted**2 + floor)) if floor > 0.0 else float("nan")


def rmse_tonemapped(test: Layers, truth: Layers) -> float:
    """Return the RMSE after c / (1 + max c) on indirect light, scaled so that the truth's mean is 1."""
    return _rmse_compressed(_indirect(test, truth), _indirect(truth, truth))


def rmse_gi_tonemapped(test: Layers, truth: Layers) -> float:
    """Return `rmse_tonemapped` of all reflected light over the albedo: direct and indirect, demodulated.

    Only pixels with an albedo above 0.02 in some channel take part; scaled like `rmse_tonemapped`.
    """
    lit = truth.hit & (truth.albedo.max(axis=-1) > ALBEDO_FLOOR)
    given, wanted = ((layers.direct + layers.indirect)[lit] / np.pi for layers in (test, truth))
    return _rmse_compressed(given.astype(np.float64), wanted.astype(np.float64))


def display_pair(test: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two linear images as displayed, (H, W, 3) in 0..1.

    Both at the exposure that brings the mean luminance of the truth to 0.18.
    """
    exposure = mean_exposure(truth)
    return to_display(test, exposure), to_display(truth, exposure)


def absolute_error(test: np.ndarray, truth: np.ndarray, hit: np.ndarray) -> np.ndarray:
    """Return the summed absolute channel difference of two displayed images, (H, W) in 0..3, 0 without a hit."""
    return np.where(hit, np.abs(test.astype(np.float64) - truth).sum(axis=-1), 0.0)


def abs_error_mean(test: Layers, truth: Layers) -> float:
    """Return the mean of `absolute_error` over the pixels that hit something."""
    return _mean(absolute_error(*display_pair(test.image(), truth.image()), truth.hit)[truth.hit])


def abs_error_max(test: Layers, truth: Layers) -> float:
    """Return the largest `absolute_error` of a pixel."""
    return _max(absolute_error(*display_pair(test.image(), truth.image()), truth.hit)[truth.hit])


def block_error_max(test: Layers, truth: Layers) -> float:
    """Return the largest mean of `absolute_error` over a 64x64 block (smaller at the right and lower edge)."""
    return _largest_block(absolute_error(*display_pair(test.image(), truth.image()), truth.hit), truth.hit)


def ambient_irradiance(truth: Layers) -> tuple[float, float, float]:
    """Return the one irradiance (W/m^2, per channel) that gives the truth's total indirect light.

    It is pi times the sum of indirect radiance over the sum of albedo; 0 in a channel without albedo.
    """
    light = _indirect(truth, truth).sum(axis=0)
    albedo = truth.albedo[truth.hit].astype(np.float64).sum(axis=0)
    red, green, blue = (float(np.pi * a / b) if b > 0.0 else 0.0 for a, b in zip(light, albedo, strict=True))
    return red, green, blue


def all_errors(test: Layers, truth: Layers, truth_halves: Sequence[np.ndarray]) -> dict[str, float]:
    """Return every figure of one image against the truth, by name; NaN where one is undefined.

    `truth_halves` are two independent estimates of the truth's indirect irradiance, (H, W, 3) each.
    """
    return {
        "regional": regional(test, truth),
        "bias": bias(test, truth),
        "relmse": relmse(test, truth),
        "rmse_tonemapped": rmse_tonemapped(test, truth),
        "rmse_gi_tonemapped": rmse_gi_tonemapped(test, truth),
        **image_errors(test.image(), truth.image(), truth.hit),
        "truth_noise": truth_noise(truth, truth_halves),
    }


def image_errors(test: np.ndarray, truth: np.ndarray, hit: np.ndarray) -> dict[str, float]:
    """Return the figures of displayed images alone: `abs_error_mean`, `abs_error_max`, `block_error_max`, `flip`.

    `test` and `truth` are linear (H, W, 3) images, `hit` (H, W) bool tells where a surface is. Both are displayed at
    the exposure that brings the mean luminance of the truth to 0.18.
    """
    from luxel.metrics.flip import flip

    shown, wanted = display_pair(test, truth)
    errors = absolute_error(shown, wanted, hit)
    return {
        "abs_error_mean": _mean(errors[hit]),
        "abs_error_max": _max(errors[hit]),
        "block_error_max": _largest_block(errors, hit),
        "flip": flip(shown, wanted),
    }


def image_noise(halves: Sequence[np.ndarray]) -> float:
    """Return the `flip` of one half of a truth against the whole: the noise that is left in their mean.

    `halves` are two independent estimates of one linear image, (H, W, 3). A half is as far from their mean as that is
    from an image of endless paths. FLIP is no straight measure of small differences, so the halves' own is not halved.
    """
    from luxel.metrics.flip import flip

    return flip(*display_pair(halves[0], 0.5 * (halves[0] + halves[1])))


# ---------- The pieces ----------


def _indirect(layers: Layers, truth: Layers) -> np.ndarray:
    """Return the indirect radiance of the pixels that hit something, (N, 3) float64."""
    return layers.indirect_radiance()[truth.hit].astype(np.float64)


def _demodulate_blocks(layers: Layers, truth: Layers) -> np.ndarray:
    """Return indirect radiance over albedo by block and channel, those that have any, (M,) float64."""
    counted = truth.hit[..., None] & (truth.albedo > ALBEDO_FLOOR)
    light = block_sums(np.where(counted, layers.indirect_radiance(), 0.0), REGION)
    albedo = block_sums(np.where(counted, truth.albedo, 0.0), REGION)
    filled = albedo > 0.0
    return light[filled] / albedo[filled]


def block_sums(values: np.ndarray, side: int) -> np.ndarray:
    """Sum over side x side blocks of the first two axes, float64; blocks at the far edges may be smaller."""
    rows = np.add.reduceat(values.astype(np.float64), np.arange(0, values.shape[0], side), axis=0)
    return np.add.reduceat(rows, np.arange(0, values.shape[1], side), axis=1)


def _largest_block(errors: np.ndarray, hit: np.ndarray) -> float:
    """Return the largest block mean; the background counts as pixels without error."""
    if not hit.any():
        return float("nan")
    return float((block_sums(errors, BLOCK) / block_sums(np.ones_like(errors), BLOCK)).max())


def _rmse_compressed(given: np.ndarray, wanted: np.ndarray) -> float:
    mean = _mean(wanted)
    if not mean > 0.0:
        return float("nan")
    return _rms(_compress(given / mean) - _compress(wanted / mean))


def _compress(colors: np.ndarray) -> np.ndarray:
    """Map c to c / (1 + max c), (N, 3)."""
    return colors / (1.0 + colors.max(axis=-1, keepdims=True))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def _mean(values: np.ndarray) -> float:
    return float(np.mean(values)) if values.size else float("nan")


def _max(values: np.ndarray) -> float:
    return float(np.max(values)) if values.size else float("nan")


def _ratio(value: float, scale: float) -> float:
    return value / scale if scale > 0.0 else float("nan")
