"""FLIP of displayed images."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.metrics.flip import flip, flip_map


def test_equal_images_do_not_differ() -> None:
    image = np.random.default_rng(1).random((24, 32, 3))
    assert flip(image, image) == pytest.approx(0.0, abs=1e-6)


def test_black_against_white_is_nearly_the_largest_error() -> None:
    black, white = np.zeros((24, 32, 3)), np.ones((24, 32, 3))
    assert flip(black, white) > 0.9
    assert 0.0 < flip(white * 0.5, white * 0.55) < 0.2


def test_the_map_is_dark_where_images_agree_and_bright_where_they_do_not() -> None:
    image = np.full((48, 96, 3), 0.5)
    other = image.copy()
    other[:, 64:] = 1.0
    shown = flip_map(other, image)
    assert shown.shape == image.shape
    assert shown.min() >= 0.0 and shown.max() <= 1.0
    assert shown[:, 80:].mean() > shown[:, :32].mean() + 0.2


def test_images_of_two_sizes_are_one_sentence() -> None:
    with pytest.raises(LuxelError, match="one shape"):
        flip(np.zeros((4, 4, 3)), np.zeros((4, 5, 3)))


def test_a_missing_evaluator_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    with pytest.raises(LuxelError, match="pip install flip-evaluator"):
        flip(np.zeros((4, 4, 3)), np.zeros((4, 4, 3)))
