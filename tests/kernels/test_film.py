"""Tile order: every pixel one lane, sub-tiles in aligned runs."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.film import TILE, Film

SIZES = [(1, 1), (16, 16), (64, 48), (17, 5), (33, 70)]


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_every_pixel_has_exactly_one_lane(width: int, height: int) -> None:
    film = Film(width, height)
    lane = dr.arange(mi.UInt32, film.lane_count)
    x, y, inside = (np.array(values) for values in film.pixel_of_lane(lane))
    assert film.lane_count % (TILE * TILE) == 0
    pixels = y[inside].astype(int) * width + x[inside]
    np.testing.assert_array_equal(np.sort(pixels), np.arange(width * height))
    assert (x[~inside] >= width).sum() + (y[~inside] >= height).sum() >= (~inside).sum()


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_lanes_of_image_is_the_inverse(width: int, height: int) -> None:
    film = Film(width, height)
    lanes = film.lanes_of_image()
    assert lanes.shape == (height, width)
    x, y, inside = (np.array(values) for values in film.pixel_of_lane(mi.UInt32(lanes.ravel().astype(np.uint32))))
    rows, columns = np.mgrid[:height, :width]
    assert inside.all()
    np.testing.assert_array_equal(x, columns.ravel())
    np.testing.assert_array_equal(y, rows.ravel())


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_lane_of_pixel_is_the_inverse_on_the_device(width: int, height: int) -> None:
    film = Film(width, height)
    lane = dr.arange(mi.UInt32, film.lane_count)
    x, y, inside = film.pixel_of_lane(lane)
    back, found = film.lane_of_pixel(mi.Int32(x), mi.Int32(y))
    mask = np.array(inside)
    np.testing.assert_array_equal(np.array(found), mask)
    np.testing.assert_array_equal(np.array(back)[mask], np.array(lane)[mask])
    rows, columns = np.mgrid[-2 : height + 2, -2 : width + 2].reshape(2, -1).astype(np.int32)
    lanes, found = (np.array(value) for value in film.lane_of_pixel(mi.Int32(columns), mi.Int32(rows)))
    within = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    np.testing.assert_array_equal(found, within)
    np.testing.assert_array_equal(lanes[within], film.lanes_of_image()[rows[within], columns[within]])
    assert (lanes < film.lane_count).all()


@pytest.mark.parametrize("side", [4, 8, 16])
def test_aligned_runs_are_square_sub_tiles(side: int) -> None:
    lanes = Film(64, 48).lanes_of_image()
    run = lanes // (side * side)
    blocks = run.reshape(48 // side, side, 64 // side, side)
    assert (blocks == blocks[:, :1, :, :1]).all()
    assert len(np.unique(run)) == (48 // side) * (64 // side)


@dr.syntax
def _sum_lanes(film: Film, times: mi.UInt32) -> mi.UInt32:
    total, step = mi.UInt32(0), mi.UInt32(0)
    while step < times:
        lane, _ = film.lane_of_pixel(mi.Int32(step), mi.Int32(0))
        total += lane
        step += 1
    return total


def test_a_loop_may_use_a_film() -> None:
    """Dr.Jit writes to what a loop reads, so a frozen record fails there; g-buffers carry films along."""
    film = Film(20, 3)
    assert int(np.array(_sum_lanes(film, dr.opaque(mi.UInt32, 18))).item()) == film.lanes_of_image()[0, :18].sum()
