"""Maps that say where in the unit square samples are worth most, learned from samples: many of them side by side.

A map is a density, constant in each of `SIDE` x `SIDE` cells: the uniform one, mixed with one in proportion to the root
mean square of what samples brought in each cell (the best choice while they scatter within the cells: Rath et al. 2020,
"Variance-Aware Path Guiding"). The more samples a map has learned from, the more it departs from the uniform one: a
map of a few samples adds noise. One continuous warp of the square follows the mixture, row first and then column, so
that a low-discrepancy sequence keeps its spread.

What was learned is kept in whole numbers, whose sum does not depend on the order of threads.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

SIDE = 8
CELLS = SIDE * SIDE
ROW_VECTORS = SIDE // 4
"""A row of cells, read in vectors of 4."""
MAP_VECTORS = ROW_VECTORS * (SIDE + 1)
"""Vectors of a map's densities: those of whole rows first, then those of each row's cells."""
STEPS = 64.0
"""Steps in which squares of samples are counted, where 1 is the square of the mean."""
BRIGHTEST = 4096.0
"""What squares count for at most. The sum of a cell stays below 2^32 for 16,384 of them."""
FIRST_SAMPLES, GROWTH = 128, 3
"""A map's densities are made anew after so many samples, plus so many times those that it had learned from before."""
LEAST_KEPT = 512
"""Samples that a map which forgets keeps, or up to half as many."""
MOST_SAMPLES = 32768
"""A map that has learned from more counts all of them a quarter."""
ONE_BELOW = 1.0 - 2.0**-24
"""The largest number below 1."""


@dataclass
class SquareMaps:
    """Maps over the unit square."""

    sums: mi.UInt32
    """(count, CELLS): sums of squares, in `STEPS`."""
    learned: mi.UInt32
    """(count): samples that the densities were made of."""
    fresh: mi.UInt32
    """(count): samples since, which are in the sums alone."""
    densities: mi.Float
    """(count, SIDE + 1, SIDE): the mean density of each row, then the density of each row's cells; 1 on average."""


def new_square_maps(count: int) -> SquareMaps:
    """Return `count` maps that know nothing."""
    return SquareMaps(
        dr.zeros(mi.UInt32, CELLS * count),
        dr.zeros(mi.UInt32, count),
        dr.zeros(mi.UInt32, count),
        dr.full(mi.Float, 1.0, 4 * MAP_VECTORS * count),
    )


# --- use -------------------------------------------------------------------------------------------------------------


def warp_by_map(maps: SquareMaps, index: mi.UInt32, sample: mi.Point2f, active: mi.Bool) -> tuple[mi.Point2f, mi.Float]:
    """Return points of the unit square that follow map `index`, from uniform ones, and their density."""
    rows = _read_row(maps, index, 0, active)
    row, down, _ = _walk(rows, sample.y)
    cells = _read_row(maps, index, row + 1, active)
    column, across, density = _walk(cells, sample.x)
    point = mi.Point2f((mi.Float(column) + across) * (1.0 / SIDE), (mi.Float(row) + down) * (1.0 / SIDE))
    return mi.Point2f(dr.fmin(point.x, ONE_BELOW), dr.fmin(point.y, ONE_BELOW)), density


def map_density(maps: SquareMaps, index: mi.UInt32, cell: mi.UInt32, active: mi.Bool) -> mi.Float:
    """Return the density that map `index` has in a cell."""
    return dr.gather(mi.Float, maps.densities, index * (4 * MAP_VECTORS) + SIDE + cell, active)


def cell_of_point(point: mi.Point2f) -> mi.UInt32:
    """Return the number of the cell that holds a point of the unit square, by rows."""
    column, row = (dr.minimum(mi.UInt32(dr.fmax(c, 0.0) * SIDE), SIDE - 1) for c in (point.x, point.y))
    return row * SIDE + column


def _read_row(maps: SquareMaps, index: mi.UInt32, row: mi.UInt32 | int, active: mi.Bool) -> list[mi.Float]:
    first = index * MAP_VECTORS + row * ROW_VECTORS
    vectors = [dr.gather(mi.Vector4f, maps.densities, first + number, active) for number in range(ROW_VECTORS)]
    return [value for vector in vectors for value in vector]


def _walk(values: list[mi.Float], sample: mi.Float) -> tuple[mi.UInt32, mi.Float, mi.Float]:
    """Return which of the values a uniform number falls to, in proportion, its place in there, and the value."""
    left = sample * _total(values)
    chosen, value = mi.UInt32(0), mi.Float(values[0])
    for number in range(1, len(values)):
        beyond = (chosen == number - 1) & (left >= value)
        left = dr.select(beyond, left - value, left)
        chosen = dr.select(beyond, number, chosen)
        value = dr.select(beyond, values[number], value)
    return chosen, dr.clip(left / dr.fmax(value, 1e-20), 0.0, ONE_BELOW), value


def _total(values: list[mi.Float]) -> mi.Float:
    total = mi.Float(0.0)
    for value in values:
        total += value
    return total


# --- learning --------------------------------------------------------------------------------------------------------


def learn_samples(
    maps: SquareMaps, index: mi.UInt32, cell: mi.UInt32, square: mi.Float, active: mi.Bool
) -> SquareMaps:  # fmt: skip
    """Return the maps with samples added: what each brought, squared and over its density, in map `index` and a cell.

    Values are meant in units in which the mean of what samples bring is about 1.
    """
    sums, fresh = mi.UInt32(maps.sums), mi.UInt32(maps.fresh)
    steps = mi.UInt32(dr.round(dr.clip(square, 0.0, BRIGHTEST) * STEPS))
    dr.scatter_add(sums, steps, index * CELLS + cell, active & (steps > 0))
    dr.scatter_add(fresh, mi.UInt32(1), index, active)
    return SquareMaps(sums, maps.learned, fresh, maps.densities)


def refresh_maps(maps: SquareMaps, share: mi.Float, doubt: float, forget: mi.Bool) -> SquareMaps:
    """Return the maps with new densities where they have learned much since the last ones.

    In between these stay, or they would tear the sequences that they warp. Of a map's samples, `share` n / (n +
    `doubt`) follow what it has learned from n, the others are uniform. With `forget` all maps forget half of what
    they know, down to `LEAST_KEPT` samples: what is left gives way to the new ones.
    """
    count = dr.width(maps.fresh)
    index = dr.arange(mi.UInt32, count)
    changes = maps.fresh >= FIRST_SAMPLES + GROWTH * maps.learned
    known = maps.learned + maps.fresh
    less = dr.select(changes & (known > MOST_SAMPLES), mi.UInt32(2), 0)
    less = dr.select(forget & (known > LEAST_KEPT), mi.UInt32(1), less)
    known = known >> less
    sums, densities = mi.UInt32(maps.sums), mi.Float(maps.densities)
    vectors = []
    for number in range(CELLS // 4):
        place = index * (CELLS // 4) + number
        kept = dr.gather(mi.Vector4u, maps.sums, place, changes | (less > 0)) >> less
        dr.scatter(sums, kept, place, less > 0)
        vectors.append(dr.sqrt(mi.Vector4f(kept)))
    roots = [value for vector in vectors for value in vector]
    whole = _total(roots)
    guided = dr.select(whole > 0.0, share * mi.Float(known) / (mi.Float(known) + doubt), 0.0)
    scale = guided * CELLS / dr.fmax(whole, 1.0)
    cells = [dr.fma(root, scale, 1.0 - guided) for root in roots]
    rows = [_total(cells[row * SIDE : (row + 1) * SIDE]) * (1.0 / SIDE) for row in range(SIDE)]
    values = rows + cells
    for number in range(MAP_VECTORS):
        vector = mi.Vector4f(*values[4 * number : 4 * number + 4])
        dr.scatter(densities, vector, index * MAP_VECTORS + number, changes)
    learned = dr.select(changes, known, maps.learned >> less)
    return SquareMaps(sums, learned, known - learned, densities)
