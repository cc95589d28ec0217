"""Lighting by wish: powers that were set are found again from the light that they bring."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.bake.core import Baked, bake_scene
from luxel.bake.lamps import scale_lights
from luxel.bake.solve import LightTarget, irradiance_by, solve_lights, texels_near
from luxel.errors import LuxelError

from .conftest import SMALL, two_lamps

WANTED = {"left": 2.5, "right": 0.4}


@pytest.fixture(scope="module")
def lamps() -> Baked:
    return bake_scene(two_lamps(), "lightmap", dict(SMALL), frames=12, samples=1)


def test_two_lamps_are_found_again(lamps: Baked) -> None:
    lit = bake_scene(scale_lights(two_lamps(), WANTED), "lightmap", dict(SMALL), frames=12, samples=1)
    texels = np.arange(0, len(lamps.layout.slot), 37)
    found = solve_lights(lamps, LightTarget(texels, lit.light.irradiance[texels]))
    assert found.factors == pytest.approx(WANTED, rel=0.01)
    assert found.error < 0.01


def test_a_colour_that_no_lamp_has_is_missed_by_as_little_as_can_be(lamps: Baked) -> None:
    texels = texels_near(lamps, np.array([[0.0, -1.0, 0.9], [0.9, -0.5, 0.0]]))
    red = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    columns = np.stack([irradiance_by(lamps, name)[texels].ravel() for name in WANTED], axis=1)
    # The blue lamp would have to take light away.
    assert np.linalg.lstsq(columns, red.ravel())[0][1] < 0.0
    found = solve_lights(lamps, LightTarget(texels, red))
    assert found.factors["right"] == 0.0 and found.factors["left"] > 0.0
    assert 0.1 < found.error < 1.0
    assert found.reached.ravel() == pytest.approx(columns @ list(found.factors.values()), rel=1e-4)
    for step in ((0.01, 0.0), (-0.01, 0.0), (0.0, 0.01)):
        powers = np.array(list(found.factors.values())) + step
        missed = np.linalg.norm(columns @ powers - red.ravel()) / np.linalg.norm(red)
        assert missed > found.error


def test_the_error_tells_how_much_of_the_wish_is_missed(lamps: Baked) -> None:
    texels = texels_near(lamps, np.array([[0.0, -1.0, 0.9], [0.9, -0.5, 0.0]]))
    now = lamps.light.irradiance[texels]
    # A wish for darkness, while a lamp that burns on is all there is: nothing of it comes true.
    dark = solve_lights(lamps, LightTarget(texels, np.zeros((2, 3))), lights=["left"])
    assert dark.factors == {"left": 0.0} and dark.reached.min() > 0.0
    assert dark.error == pytest.approx(1.0)
    assert solve_lights(lamps, LightTarget(texels, np.zeros((2, 3)))).error == 0.0
    # Texels without weight are free to miss.
    wish = now * np.array([[1.0], [50.0]])
    missed = solve_lights(lamps, LightTarget(texels, wish)).error
    forgiven = solve_lights(lamps, LightTarget(texels, wish, weight=np.array([1.0, 0.0]))).error
    assert missed > 0.01 and forgiven < 0.01


def test_bad_targets_are_refused(lamps: Baked) -> None:
    for target, words in (
        (LightTarget(np.array([10**6]), np.ones(1)), "list of whole numbers from 0"),
        (LightTarget(np.array([0.0]), np.ones(1)), "list of whole numbers from 0"),
        (LightTarget(np.array([True]), np.ones(1)), "list of whole numbers from 0"),
        (LightTarget(np.array([], int), np.ones(0)), "list of whole numbers from 0"),
        (LightTarget(np.array([0]), np.ones(1), weight=np.zeros(1)), "not all of them 0"),
        (LightTarget(np.array([0]), np.ones((2, 3))), "one or three numbers"),
        (LightTarget(np.array([0]), np.array([-1.0])), "not negative"),
    ):
        with pytest.raises(LuxelError, match=words):
            solve_lights(lamps, target)
    with pytest.raises(LuxelError, match="has no light 'middle'"):
        solve_lights(lamps, LightTarget(np.array([0]), np.ones(1)), lights=["middle"])
