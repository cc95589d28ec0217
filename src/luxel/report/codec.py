"""Linear light in few bytes: 8x8 cosine transform of its logarithm, rounded to a step, deflated.

A browser shows 8 bits a channel, and so do its own image formats once they have reached a page. The report's exposure
slider and its difference maps need more: light from a thousandth of display white to a thousand times it, fine
enough to be subtracted. So pictures travel as log light, exact to a step that is a share of the value; the page
decodes them in `templates/codec.js`, which mirrors `decode`.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

BLOCK = 8
FLOOR = 2.0**-10
"""Added to light before its logarithm, in units of display white: what is darker is stored linearly."""
FINEST_STEP = 1.0 / 64.0
"""Step of a coefficient in stops: pixels are then off by 0.6 to 1.0 %, of noisy pictures by 1.3 % (root mean square,
measured on cornell-box and two-rooms)."""
COARSEST_STEP = 2.0
CHROMA = 2.0
"""Steps of the two colour differences over that of brightness."""
FINE_SCALE = 3.0
"""How much coarser the highest frequency is rounded than the mean, beyond 1: noise is dear there and shows least."""
WORD = 0xFFFF


@dataclass(frozen=True)
class EncodedPicture:
    """A coded picture."""

    width: int
    height: int
    step: float
    data: bytes


@dataclass(frozen=True)
class CosineCoefficients:
    """A picture as coefficients, ready to be rounded to any step."""

    width: int
    height: int
    coefficients: np.ndarray
    """(3, 64, blocks) float32: planes, coefficients from low to high frequency, blocks row by row."""


def transform(light: np.ndarray) -> CosineCoefficients:
    """Return the coefficients of (H, W, 3) linear light in units of display white.

    What is negative or not finite is taken as 0, what is beyond 65536 as that.
    """
    from scipy.fft import dctn

    height, width = light.shape[:2]
    clean = np.nan_to_num(light.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
    stops = np.log2(np.clip(clean, 0.0, 2.0**16) + np.float32(FLOOR))
    red, green, blue = stops[..., 0], stops[..., 1], stops[..., 2]
    # Brightness and two differences: on most surfaces the differences hardly change.
    planes = np.stack([(red + 2.0 * green + blue) / 4.0, red - green, blue - green])
    down, right = -height % BLOCK, -width % BLOCK
    planes = np.pad(planes, ((0, 0), (0, down), (0, right)), mode="edge")
    rows, columns = planes.shape[1] // BLOCK, planes.shape[2] // BLOCK
    blocks = planes.reshape(3, rows, BLOCK, columns, BLOCK).transpose(0, 1, 3, 2, 4)
    coefficients = np.asarray(dctn(blocks, axes=(3, 4), norm="ortho")).reshape(3, rows * columns, BLOCK * BLOCK)
    return CosineCoefficients(width, height, np.ascontiguousarray(coefficients[:, :, zigzag()].transpose(0, 2, 1)))


def encode(coefficients: CosineCoefficients, step: float) -> EncodedPicture:
    """Return the picture with its coefficients rounded to multiples of `step`, in stops."""
    rounded = np.rint(coefficients.coefficients / _steps(step)).astype(np.int32)
    # Neighbours have nearly the same mean: store what it changes by.
    rounded[:, 0, 1:] -= rounded[:, 0, :-1].copy()
    rounded = np.clip(rounded, -(WORD // 2), WORD // 2)
    # Small numbers of either sign become small codes; low bytes and high bytes apart, as the latter are nearly all 0.
    codes = ((rounded << 1) ^ (rounded >> 31)).astype(np.uint16).ravel()
    data = (codes & 0xFF).astype(np.uint8).tobytes() + (codes >> 8).astype(np.uint8).tobytes()
    # Runs of zeros and letter counts are all there is to find: on 512x512 pictures this is 6 to 8 % smaller than the
    # search for repeated strings, and ten times quicker.
    packer = zlib.compressobj(6, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    return EncodedPicture(coefficients.width, coefficients.height, step, packer.compress(data) + packer.flush())


def encode_within(coefficients: CosineCoefficients, limit: int) -> EncodedPicture:
    """Return the picture at the finest step whose data is at most `limit` bytes, or at the coarsest one."""
    step = FINEST_STEP
    coded = encode(coefficients, step)
    while len(coded.data) > limit and step < COARSEST_STEP:
        step = min(step * 2.0**0.5, COARSEST_STEP)
        coded = encode(coefficients, step)
    return coded


def decode(coded: EncodedPicture) -> np.ndarray:
    """Return (H, W, 3) float32 linear light in units of display white."""
    from scipy.fft import idctn

    rows, columns = -(-coded.height // BLOCK), -(-coded.width // BLOCK)
    data = np.frombuffer(zlib.decompress(coded.data), np.uint8).astype(np.int32)
    half = data.size // 2
    codes = data[:half] | (data[half:] << 8)
    numbers = ((codes >> 1) ^ -(codes & 1)).reshape(3, BLOCK * BLOCK, rows * columns)
    numbers[:, 0] = np.cumsum(numbers[:, 0], axis=1)
    coefficients = numbers * _steps(coded.step)
    ordered = np.empty((3, rows, columns, BLOCK * BLOCK))
    ordered[..., zigzag()] = coefficients.transpose(0, 2, 1).reshape(3, rows, columns, BLOCK * BLOCK)
    planes = np.asarray(idctn(ordered.reshape(3, rows, columns, BLOCK, BLOCK), axes=(3, 4), norm="ortho"))
    planes = planes.transpose(0, 1, 3, 2, 4).reshape(3, rows * BLOCK, columns * BLOCK)
    brightness, red_green, blue_green = planes[:, : coded.height, : coded.width]
    green = brightness - (red_green + blue_green) / 4.0
    stops = np.stack([green + red_green, green, green + blue_green], axis=-1)
    return np.maximum(np.exp2(stops) - FLOOR, 0.0).astype(np.float32)


def _steps(step: float) -> np.ndarray:
    """Return the step of each plane and coefficient, (3, 64, 1), where that of the brightness's mean is `step`."""
    places = zigzag()
    frequency = (places // BLOCK + places % BLOCK) / (2.0 * (BLOCK - 1.0))
    planes = np.array([step, CHROMA * step, CHROMA * step])
    return (planes[:, None] * (1.0 + FINE_SCALE * frequency)).astype(np.float32)[:, :, None]


def zigzag() -> np.ndarray:
    """Return the 64 places of a block, row * 8 + column, from low to high frequency."""
    return np.array(
        sorted(range(BLOCK * BLOCK), key=lambda place: (place // BLOCK + place % BLOCK, place // BLOCK)), np.intp
    )
