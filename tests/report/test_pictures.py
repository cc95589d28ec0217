"""The report's pictures: true to a known step, small enough for one page, honest about what is missing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxel.report import codec
from luxel.report.pictures import complain, read_all_pictures, share_out
from luxel.report.results import read_results

FINEST = codec.FINEST_STEP


def make_light(width: int, height: int, noise: float = 0.0) -> np.ndarray:
    """Return a picture with a gradient over twelve stops, a hard edge and, if wanted, noise."""
    ramp = np.exp2(np.linspace(-10.0, 2.0, width, dtype=np.float32))[None, :, None]
    light = ramp * np.array([1.0, 0.7, 0.3], np.float32) * np.ones((height, 1, 1), np.float32)
    light[height // 2 :] *= 0.25
    spread = np.random.default_rng(3).lognormal(0.0, noise, (height, width, 1)) if noise else 1.0
    return (light * spread).astype(np.float32)


def relative_error(given: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    return (given - wanted) / (wanted + codec.FLOOR)


@pytest.mark.parametrize(("width", "height"), [(64, 64), (61, 35), (1, 1), (8, 9)])
@pytest.mark.parametrize("noise", [0.0, 0.7])
def test_decoding_gives_the_light_back_to_a_percent(width: int, height: int, noise: float) -> None:
    light = make_light(width, height, noise)
    again = codec.decode(codec.encode(codec.transform(light), FINEST))
    assert again.shape == light.shape
    error = relative_error(again, light)
    assert float(np.sqrt((error**2).mean())) < 0.015
    assert float(np.abs(error).max()) < 0.08


def test_a_coarser_step_is_smaller_and_worse() -> None:
    light = make_light(96, 96, 0.3)
    coefficients = codec.transform(light)
    fine, coarse = codec.encode(coefficients, FINEST), codec.encode(coefficients, 8.0 * FINEST)
    assert len(coarse.data) < 0.7 * len(fine.data)
    errors = [float((relative_error(codec.decode(one), light) ** 2).mean()) for one in (fine, coarse)]
    assert errors[1] > 4.0 * errors[0] > 0.0


def test_black_stays_black_and_costs_nothing() -> None:
    coded = codec.encode(codec.transform(np.zeros((128, 128, 3), np.float32)), FINEST)
    assert len(coded.data) < 400
    assert float(np.abs(codec.decode(coded)).max()) < 1e-5


def test_what_no_screen_shows_does_no_harm() -> None:
    light = make_light(16, 16)
    light[3, 4] = [np.nan, np.inf, -1.0]
    light[9, 9] = 1e30
    again = codec.decode(codec.encode(codec.transform(light), FINEST))
    assert np.isfinite(again).all() and (again >= 0.0).all()
    assert again[9, 9].max() == pytest.approx(2.0**16, rel=0.1)


def test_a_limit_is_kept_by_coarser_steps() -> None:
    coefficients = codec.transform(make_light(128, 128, 0.5))
    free = codec.encode_within(coefficients, 10_000_000)
    assert free.step == FINEST
    limit = len(free.data) // 3
    tight = codec.encode_within(coefficients, limit)
    assert len(tight.data) <= limit and FINEST < tight.step < codec.COARSEST_STEP


@pytest.mark.parametrize(
    ("sizes", "budget", "largest"),
    [
        ([10, 20, 30], 100, 30),  # all fit as they are
        ([10, 20, 30], 60, 30),
        ([10, 50, 90], 100, 45),  # the small one leaves its share to the others
        ([10, 10], 0, 0),
        ([], 100, 0),
    ],
)
def test_the_budget_is_shared_out(sizes: list[int], budget: int, largest: int) -> None:
    assert share_out(sizes, budget) == largest
    if largest:
        assert sum(min(size, largest) for size in sizes) <= budget


def test_galleries_hold_every_picture_at_the_truths_exposure(comparison: Any) -> None:
    folder = comparison()
    results = read_results(folder)
    all_pictures = read_all_pictures(folder, results)
    assert complain(all_pictures) == ""
    # The truth, two baselines, two methods, three peers; each as image and as indirect light.
    assert len(all_pictures[0].coded) == 16 and len(all_pictures[0].flips) == 7 and len(all_pictures[0].thumbs) == 8
    truth = codec.decode(all_pictures[0].coded["0-image"])
    assert truth.shape == (24, 40, 3)
    assert truth[:, -1, 0].mean() == pytest.approx(4.0 * 0.5, rel=0.02)


def test_many_noisy_pictures_stay_within_the_budget(comparison: Any) -> None:
    folder = comparison()
    results = read_results(folder)
    for path in folder.rglob("*.exr"):
        if "path_at" in path.name:
            overwrite(path, make_light(40, 24, 0.9))
    free = read_all_pictures(folder, results)
    sizes = [len(coded.data) for scene_pictures in free for coded in scene_pictures.coded.values()]
    extras = sum(len(text) * 3 // 4 for one in free for text in (*one.flips.values(), *one.thumbs.values()))
    budget = extras + sum(sizes) * 2 // 3
    tight = read_all_pictures(folder, results, budget=budget)
    assert (
        extras + sum(len(coded.data) for scene_pictures in tight for coded in scene_pictures.coded.values()) <= budget
    )
    # The smooth ones paid nothing.
    assert tight[0].coded["0-image"].step == FINEST
    assert max(coded.step for coded in tight[0].coded.values()) > FINEST


def test_a_great_many_pixels_are_halved_alike(comparison: Any) -> None:
    folder = comparison()
    results = read_results(folder)
    sizes = {
        (one.width, one.height)
        for scene_pictures in read_all_pictures(folder, results)
        for one in scene_pictures.coded.values()
    }
    assert sizes == {(40, 24)}
    small = read_all_pictures(folder, results, budget=4000)
    # 26 pictures at a quarter of a byte a pixel: 615 pixels each.
    assert {(one.width, one.height) for scene_pictures in small for one in scene_pictures.coded.values()} == {(20, 12)}


def test_missing_and_damaged_pictures_are_left_out_and_named(comparison: Any) -> None:
    folder: Path = comparison()
    (folder / "box" / "gibs.exr").unlink()
    (folder / "box" / "ddgi_indirect.exr").write_bytes(b"not an image")
    (folder / "box" / "none_flip.png").write_bytes(b"")
    overwrite(folder / "box" / "ambient.exr", make_light(8, 8))
    all_pictures = read_all_pictures(folder, read_results(folder))
    assert set(all_pictures[0].missing) == {
        f"box/{name}" for name in ("gibs.exr", "ddgi_indirect.exr", "none_flip.png", "ambient.exr")
    }
    said = complain(all_pictures)
    assert said.startswith("4 pictures are missing or damaged and left out: ") and "and 1 more" in said


def overwrite(path: Path, light: np.ndarray) -> None:
    import OpenEXR

    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": light}).write(str(path))
