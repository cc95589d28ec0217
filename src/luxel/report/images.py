"""The images that a comparison leaves beside its figures: EXR, PNG at the truth's exposure, FLIP maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from luxel.image.tonemap import to_display
from luxel.image.write import write_exr, write_png
from luxel.metrics.flip import flip_map
from luxel.report.jobs import Pictures, ReferenceView, safe_name


def write_truth(folder: Path, view: ReferenceView) -> None:
    """Write the truth's image and its indirect part (radiance)."""
    _write_image(folder, "truth", view.wanted, view.exposure)
    _write_image(folder, "truth_indirect", view.truth.layers.indirect_radiance(), view.exposure)


def write_pictures(folder: Path, name: str, pictures: Pictures, view: ReferenceView) -> None:
    """Write a run's image, its indirect part and its FLIP map against the truth's image."""
    _write_image(folder, name, pictures.image, view.exposure)
    _write_image(folder, f"{name}_indirect", pictures.indirect, view.exposure)
    shown, wanted = (to_display(image, view.exposure) for image in (pictures.image, view.wanted))
    write_png(folder / f"{name}_flip.png", flip_map(shown, wanted))


def folder_names(labels: list[str]) -> dict[str, str]:
    """Return a folder name for each scene: its label without what file systems dislike, and no two alike."""
    names: dict[str, str] = {}
    for label in labels:
        plain = name = safe_name(label)
        number = 2
        while name in names.values():
            name, number = f"{plain}-{number}", number + 1
        names[label] = name
    return names


def _write_image(folder: Path, name: str, image: np.ndarray, exposure: float) -> None:
    """Write a linear image as NAME.exr and, at the truth's exposure, as NAME.png."""
    write_exr(folder / f"{name}.exr", image)
    write_png(folder / f"{name}.png", to_display(image, exposure))
