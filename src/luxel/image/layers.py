"""One frame taken apart, as NumPy arrays: what metrics, reports and files work on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass
class Layers:
    """The parts of an image; float32, row 0 at the top, linear Rec. 709.

    With full materials, albedo and glossy are as the eye sees them: weighed by what the specular chain lets through.
    """

    albedo: np.ndarray
    """(H, W, 3) diffuse reflectance; 0 where nothing was hit."""
    emission: np.ndarray
    """(H, W, 3) emitted radiance; the sky's radiance where nothing was hit."""
    direct: np.ndarray
    """(H, W, 3) direct irradiance, W/m^2."""
    indirect: np.ndarray
    """(H, W, 3) indirect irradiance, W/m^2."""
    glossy: np.ndarray
    """(H, W, 3) glossy radiance."""
    weight: np.ndarray
    """(H, W) coverage that the method answered with."""
    hit: np.ndarray
    """(H, W) bool: a surface was hit."""
    throughput: np.ndarray | None = None
    """(H, W, 3) what mirrors and smooth glass let through of what is seen behind them; None where none is followed."""

    def image(self) -> np.ndarray:
        """Return emission + albedo / pi * (direct E + indirect E) + glossy, (H, W, 3) radiance."""
        reflected = self.albedo / np.pi * (self.direct + self.indirect)
        return (self.emission + reflected + self.glossy).astype(np.float32)

    def indirect_radiance(self) -> np.ndarray:
        """Return the indirect part of the image, (H, W, 3) radiance."""
        return (self.albedo / np.pi * self.indirect + self.glossy).astype(np.float32)
