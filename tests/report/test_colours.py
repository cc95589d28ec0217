"""The methods' colours can be told apart, also by eyes that lack a kind of cone, and read on their background."""

from __future__ import annotations

import itertools
import re
from importlib import resources

import numpy as np
import pytest

STYLE = (resources.files("luxel.report") / "templates" / "report.css").read_text()
METHODS = ("gibs", "ddgi", "path", "lightmap", "surfel-path")
# Machado, Oliveira and Fernandes, "A Physiologically-based Model for Simulation of Color Vision Deficiency", 2009:
# severity 1, on linear light.
EYES = {
    "all cones": np.eye(3),
    "no red": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "no green": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "no blue": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
LEAST_DIFFERENCE = 10.0
"""CIELAB distance; about 2 is just seen side by side."""
LEAST_CONTRAST = 3.0
"""WCAG 2.2, success criterion 1.4.11: graphics against their background."""


def read_colours(scheme: str) -> dict[str, np.ndarray]:
    """Return the style sheet's colours as linear light by their name."""
    light, dark = re.findall(r":root \{(.*?)\n {0,2}\}", STYLE, re.DOTALL)[:2]
    text = light if scheme == "light" else dark
    found = dict(re.findall(r"--(?:c-)?([\w-]+): #([0-9a-f]{6})", text))
    display = {name: np.array([int(value[at : at + 2], 16) for at in (0, 2, 4)]) / 255 for name, value in found.items()}
    return {
        name: np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
        for name, value in display.items()
    }


def to_lab(linear: np.ndarray) -> np.ndarray:
    matrix = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    x, y, z = np.cbrt(np.clip(matrix @ linear, 1e-4, None) / np.array([0.9505, 1.0, 1.089]))
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("eyes", EYES)
def test_no_two_methods_look_alike(scheme: str, eyes: str) -> None:
    colours = read_colours(scheme)
    seen = {name: to_lab(np.clip(EYES[eyes] @ colours[name], 0.0, 1.0)) for name in METHODS}
    distances = {
        (first, second): float(np.linalg.norm(seen[first] - seen[second]))
        for first, second in itertools.combinations(METHODS, 2)
    }
    assert not {pair: distance for pair, distance in distances.items() if distance < LEAST_DIFFERENCE}


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_colour_stands_out_from_the_page(scheme: str) -> None:
    colours = read_colours(scheme)
    weights = np.array([0.2126, 0.7152, 0.0722])
    paper = float(weights @ colours["card"])
    for name in (*METHODS, "none", "ambient", "truth", "spare-0", "spare-1", "spare-2", "spare-3", "soft", "accent"):
        ink = float(weights @ colours[name])
        contrast = (max(ink, paper) + 0.05) / (min(ink, paper) + 0.05)
        assert contrast >= LEAST_CONTRAST, (name, contrast)
