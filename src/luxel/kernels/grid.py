"""A grid of discs over all of space, rebuilt each frame by count, prefix sum and fill (Ekberg 2022, section 4.2).

Every disc is listed in all cells that it touches, so a look-up reads one cell. A disc here is the flat ellipsoid in
which its weight is not zero: `radius` in its plane, `thickness` along its normal.

Cells have no box around them: a hash of a cell's coordinates is its slot in a table (Teschner et al. 2003, "Optimized
Spatial Hashing"). Where two cells share a slot they share a list, so readers must test the distance, as they do anyway.
A slot is one of a bucket: the hash of the block of cells around a cell is its bucket, and its coordinates are its place
there, by a rule that gives no two cells of one disc the same place. So no list holds a disc twice, and neighbours lie
together in memory.

Cells come in levels, each half as wide as the one before: a disc is listed in cells of its own level, so that discs of
all sizes have short lists. For each coarsest cell a word tells which levels have discs there (`levels_at`), and readers
look at those alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.sampling import mix
from luxel.scene.arrays import vectors_from_numpy

SLOTS_A_DISC = 4
"""Slots a disc at least. ListedDiscs that cover a surface once use about one cell each, so few cells share a slot."""
SLOT_BITS = 25
"""Bits of a slot's number at most: larger pools share slots more often."""
FARTHEST = float(1 << 30)
"""Cell coordinates at most, so that they fit an integer; what lies beyond belongs to the last cell."""
MASK_BITS_LESS = 3
"""By how many bits the table of the coarsest cells is smaller than that of all."""
SHIFTS = 64
"""Places that `find_shift` tries along each axis."""
ROUNDING = 2.0**-22
"""How far off cell coordinates may be, as a share of themselves: float32, rounded on both sides."""


@dataclass
class Lattice:
    """Where the cells are, and where in the table."""

    inverse_size: mi.Float
    shift: mi.Vector3f
    """(levels, 3), in cells of the level: the origin's cell begins at -shift. It only says where cells cut surfaces."""
    slot_bits: int
    """The table has 2^slot_bits slots."""
    block_bits: int
    """A block is 2^block_bits cells wide, which is at least a disc's width; a bucket has 2^(3 block_bits + 1) slots."""
    levels: int = 1
    """Sizes of cells; those of each level are half as wide as those of the level before."""

    @property
    def slot_count(self) -> int:
        """Number of slots in the table."""
        return 1 << self.slot_bits

    @property
    def mask_count(self) -> int:
        """Number of slots in the table of the levels that are present."""
        return 1 << (self.slot_bits - MASK_BITS_LESS)


@dataclass
class ListedDiscs:
    """What is listed."""

    p: mi.Point3f
    n: mi.Normal3f
    radius: mi.Float
    thickness: mi.Float
    alive: mi.Bool
    level: mi.UInt32 | None
    """Whose cells they are listed in; None: of the coarsest."""


@dataclass
class Scratch:
    """Items as threads find them."""

    pairs: mi.UInt32
    """(capacity, 2): disc ids and keys."""
    slots: mi.UInt32
    """The slot of each item's list."""
    cursor: mi.UInt32
    """Where each slot's next item goes."""
    keys: mi.UInt32 | None
    """Of each disc; None: ids serve."""


@dataclass
class Grid:
    """Which discs touch the cells of each slot."""

    starts: mi.UInt32
    """(slots + 1): slot s owns items starts[s] .. starts[s + 1]."""
    items: mi.UInt32
    """Disc ids, in each list by their keys: the same in every run."""
    left_out: mi.UInt32
    """Entries of lists for which there was no room."""
    masks: mi.UInt32 | None
    """For each slot of coarsest cells: bit k is set where discs of level k reach into them. None: there is one level.

    No plain zero: replays take that for another kind of array than the one they start with, and record anew.
    """


def make_lattice(radius: float, cell_size: float, disc_count: int, shift: np.ndarray | None = None) -> Lattice:
    """Return a lattice for up to `disc_count` discs of `radius` metres, with cells of `cell_size` radii.

    `shift` (3,), in cells, is such as `find_shift` returns; without it cells begin at the origin. A shift (L, 3) has a
    row for each level: discs of level k have a radius of at most `radius` / 2^k.
    """
    block_bits = (int(2.0 / cell_size) + 1).bit_length()
    slots = SLOTS_A_DISC * disc_count / min(cell_size, 1.0) ** 2
    slot_bits = min(max(int(slots - 1).bit_length(), 3 * block_bits + 4), SLOT_BITS)
    shifts = np.zeros((1, 3)) if shift is None else np.atleast_2d(shift)
    steps = vectors_from_numpy(mi.Vector3f, shifts)
    dr.make_opaque(steps)
    return Lattice(dr.opaque(mi.Float, 1.0 / (cell_size * radius)), steps, slot_bits, block_bits, len(shifts))


def find_shift(corners: np.ndarray, cell: float, thickness: float) -> np.ndarray:
    """Return the shift (3,), in cells, at which discs of `thickness` on triangles touch the fewest layers of cells.

    `corners` (F, 3, 3) and lengths in metres. Walls and floors along the axes are what counts: where a border of cells
    runs beside one, all of its discs touch two layers instead of one, and lists are half as long again.
    """
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(face, axis=1)
    steps = (np.arange(SHIFTS) + 0.5) / SHIFTS
    found = np.full(3, 0.5)
    for axis in range(3):
        flat = np.abs(face[:, axis]) > 0.999 * np.maximum(area, 1e-30)
        place = np.mod(corners[flat, :, axis].mean(axis=1) / cell, 1.0)
        weights, _ = np.histogram(place, SHIFTS, (0.0, 1.0), weights=area[flat])
        # From each place to the nearest border, in cells, for each shift; beyond the thickness, more gains nothing.
        inside = np.mod(steps[:, None] + steps[None, :], 1.0)
        clear = np.minimum(np.minimum(inside, 1.0 - inside), thickness / cell + 0.5 / SHIFTS)
        if weights.any():
            found[axis] = steps[np.argmax(clear @ weights)]
    return found


def new_masks(lattice: Lattice) -> mi.UInt32 | None:
    """Return the masks of a grid that lists nothing."""
    return dr.zeros(mi.UInt32, lattice.mask_count) if lattice.levels > 1 else None


def slot_of_point(lattice: Lattice, p: mi.Point3f, level: mi.UInt32 | None = None) -> mi.UInt32:
    """Return the slot of each point's cell; of the coarsest where no level is given."""
    return _slot(lattice, *_coordinates(_in_cells(lattice, p, level)), level)


def levels_at(lattice: Lattice, grid: Grid, p: mi.Point3f, active: mi.Bool) -> mi.UInt32:
    """Return the levels that may have discs at each point: bit k is set for level k."""
    if grid.masks is None:
        return mi.UInt32(1)
    return dr.gather(mi.UInt32, grid.masks, _mask_slot(lattice, *_coordinates(_in_cells(lattice, p, None))), active)


def list_length(grid: Grid, slot: mi.UInt32, active: mi.Bool) -> mi.UInt32:
    """Return how many discs are listed in each slot."""
    return dr.gather(mi.UInt32, grid.starts, slot + 1, active) - dr.gather(mi.UInt32, grid.starts, slot, active)


def finest_level(levels: mi.UInt32) -> mi.UInt32:
    """Return the highest bit that is set; `levels` is not 0."""
    return 31 - dr.lzcnt(levels)


def build_grid(
    lattice: Lattice,
    p: mi.Point3f,
    n: mi.Normal3f,
    radius: mi.Float,
    thickness: mi.Float,
    alive: mi.Bool,
    capacity: int,
    keys: mi.UInt32 | None = None,
    longest: int = 0,
    level: mi.UInt32 | None = None,
) -> Grid:
    """Return the grid of the discs at `p` with unit normals `n`; lists that do not fit `capacity` items are left out.

    Lists are in the order of `keys` (of ids, where keys are alike or None), and hold the first `longest` of them (0:
    all). So a list is the same whichever thread came first, and as long as its discs stay, from frame to frame too.
    Each disc is listed in cells of its `level`; None: there is one.
    """
    discs = ListedDiscs(p, n, radius, thickness, alive, level)
    counts = dr.zeros(mi.UInt32, lattice.slot_count + 1)
    _visit_cells(lattice, discs, lambda x, y, z, touched: _count(counts, _slot(lattice, x, y, z, level), touched))
    starts = dr.prefix_reduce(dr.ReduceOp.Add, counts)
    # A list that ends beyond the room is left out whole: which of its discs would find room is chance.
    listed = dr.max(dr.select(starts <= capacity, starts, 0))
    left_out = dr.max(starts) - listed
    starts = dr.minimum(starts, listed)
    found = Scratch(dr.empty(mi.UInt32, 2 * capacity), dr.empty(mi.UInt32, capacity), mi.UInt32(starts), keys)
    _visit_cells(lattice, discs, lambda x, y, z, touched: _put(found, _slot(lattice, x, y, z, level), touched))
    kept = starts
    if longest:
        kept = dr.prefix_reduce(dr.ReduceOp.Add, dr.minimum(_lengths(starts), longest))
    masks = new_masks(lattice)
    if level is not None and masks is not None:
        bit = mi.UInt32(1) << level
        coarse = replace(discs, level=None)
        _visit_cells(lattice, coarse, lambda x, y, z, hit: _mark(masks, _mask_slot(lattice, x, y, z), bit, hit))
    return Grid(kept, _order_lists(starts, found, kept), left_out, masks)


def _count(counts: mi.UInt32, slot: mi.UInt32, touched: mi.Bool) -> None:
    dr.scatter_reduce(dr.ReduceOp.Add, counts, mi.UInt32(1), slot, touched)


def _put(found: Scratch, slot: mi.UInt32, touched: mi.Bool) -> None:
    """Write each disc's id and key into the slot's list, as far as there is room."""
    disc_id = dr.arange(mi.UInt32, dr.width(touched))
    place = dr.scatter_inc(found.cursor, slot, touched)
    room = touched & (place < dr.width(found.slots))
    dr.scatter(found.pairs, mi.Vector2u(disc_id, disc_id if found.keys is None else found.keys), place, room)
    dr.scatter(found.slots, slot, place, room)


def _mark(masks: mi.UInt32, slot: mi.UInt32, bit: mi.UInt32, touched: mi.Bool) -> None:
    dr.scatter_reduce(dr.ReduceOp.Or, masks, bit, slot, touched)


def _lengths(starts: mi.UInt32) -> mi.UInt32:
    """Return the length of each list, and 0 at the end."""
    slot = dr.arange(mi.UInt32, dr.width(starts))
    inside = slot + 1 < dr.width(starts)
    return dr.select(inside, dr.gather(mi.UInt32, starts, slot + 1, inside) - starts, 0)


@dr.syntax
def _order_lists(starts: mi.UInt32, found: Scratch, kept: mi.UInt32) -> mi.UInt32:
    """Return the items with each list, now from `kept` on, in the order of keys and ids; what has no place is left out.

    Lists are short, so each item's rank is counted: a sort of all items goes over all the room there is.
    """
    capacity = dr.width(found.slots)
    ordered = dr.empty(mi.UInt32, capacity)
    item = dr.arange(mi.UInt32, capacity)
    listed = item < dr.gather(mi.UInt32, starts, dr.width(starts) - 1)
    mine, slot = dr.gather(mi.Vector2u, found.pairs, item, listed), dr.gather(mi.UInt32, found.slots, item, listed)
    other, end = dr.gather(mi.UInt32, starts, slot, listed), dr.gather(mi.UInt32, starts, slot + 1, listed)
    place = dr.gather(mi.UInt32, kept, slot, listed)
    after = dr.gather(mi.UInt32, kept, slot + 1, listed)
    disc, key = mi.UInt32(mine.x), mi.UInt32(mine.y)
    while other < end:
        rival = dr.gather(mi.Vector2u, found.pairs, other)
        before = (rival.y < key) | ((rival.y == key) & (rival.x < disc))
        place += dr.select(before, mi.UInt32(1), 0)
        other += 1
    dr.scatter(ordered, disc, place, listed & (place < after))
    return ordered


@dr.syntax
def _visit_cells(
    lattice: Lattice, discs: ListedDiscs, visit: Callable[[mi.Int32, mi.Int32, mi.Int32, mi.Bool], None]
) -> None:
    """Call `visit` for the cells that each disc touches, with their coordinates and whether they are touched."""
    p, n, radius, thickness, level = discs.p, discs.n, discs.radius, discs.thickness, discs.level
    # The ellipsoid's box, in cells; never wider than a block, so that each cell has a slot of its own.
    squared = mi.Vector3f(n.x * n.x, n.y * n.y, n.z * n.z)
    extent = dr.sqrt(dr.fmax(radius * radius * (1.0 - squared) + thickness * thickness * squared, 0.0))
    x0, y0, z0 = _coordinates(_in_cells(lattice, p - extent, level))
    x1, y1, z1 = _coordinates(_in_cells(lattice, p + extent, level))
    width = (1 << lattice.block_bits) - 1
    x1, y1, z1 = dr.minimum(x1, x0 + width), dr.minimum(y1, y0 + width), dr.minimum(z1, z0 + width)

    # Points of the slab around the disc's plane, within the radius: what the box holds beyond is skipped. Measured from
    # the disc's own cell, in whole cells and the rest, so that it is exact far from the origin too.
    local = _in_cells(lattice, p, level)
    xc, yc, zc = _coordinates(local)
    rest = local - dr.floor(local) - 0.5
    upright = dr.abs(mi.Vector3f(n))
    half = 0.5 + ROUNDING * dr.abs(mi.Vector3f(local))
    inverse_size = _inverse_size(lattice, level)
    reach = thickness * inverse_size + dr.dot(upright, half)
    farthest = dr.square(radius * inverse_size)
    x, y, z = mi.Int32(x0), mi.Int32(y0), mi.Int32(z0)
    alive = mi.Bool(discs.alive)
    while alive & (z <= z1):
        offset = mi.Vector3f(mi.Float(x - xc) - rest.x, mi.Float(y - yc) - rest.y, mi.Float(z - zc) - rest.z)
        gap = dr.maximum(dr.abs(offset) - half, 0.0)
        touched = (dr.abs(dr.dot(offset, mi.Vector3f(n))) <= reach) & (dr.squared_norm(gap) <= farthest)
        visit(x, y, z, touched)
        # Go on along x, from its end to the next row, from the last row to the next layer: divisions would be slower.
        x += 1
        at_end = x > x1
        x, y = dr.select(at_end, x0, x), dr.select(at_end, y + 1, y)
        at_end = y > y1
        y, z = dr.select(at_end, y0, y), dr.select(at_end, z + 1, z)


def _inverse_size(lattice: Lattice, level: mi.UInt32 | None) -> mi.Float:
    """Return one over the width of a level's cells."""
    return lattice.inverse_size if level is None else lattice.inverse_size * power_of_two(level)


def power_of_two(exponent: mi.UInt32) -> mi.Float:
    """Return 2^exponent, exactly, for exponents up to 127."""
    return dr.reinterpret_array(mi.Float, (exponent + 127) << 23)


def _in_cells(lattice: Lattice, p: mi.Point3f, level: mi.UInt32 | None) -> mi.Point3f:
    """Return points in units of a level's cells."""
    shift = dr.gather(mi.Vector3f, lattice.shift, mi.UInt32(0) if level is None else level)
    return mi.Point3f(dr.fma(p, _inverse_size(lattice, level), shift))


def _coordinates(local: mi.Point3f) -> tuple[mi.Int32, mi.Int32, mi.Int32]:
    """Return the whole coordinates of the cells that hold points given in cells."""
    x, y, z = (mi.Int32(dr.clip(dr.floor(value), -FARTHEST, FARTHEST)) for value in local)
    return x, y, z


def _mask_slot(lattice: Lattice, x: mi.Int32, y: mi.Int32, z: mi.Int32) -> mi.UInt32:
    """Return the slot of a coarsest cell in the table of the levels that are present."""
    return mix(mi.UInt32(x) * 0xD1B54A33 + mi.UInt32(y) * 0xABC98389 + mi.UInt32(z) * 0x8CB92BA7) & (
        lattice.mask_count - 1
    )


def _slot(lattice: Lattice, x: mi.Int32, y: mi.Int32, z: mi.Int32, level: mi.UInt32 | None) -> mi.UInt32:
    """Return the slot of a level's cell: a hash of level and block says which bucket, coordinates which place there."""
    bits, width = lattice.block_bits, 1 << lattice.block_bits
    # With w for the width, x + (w + 1) y + (w^2 + w - 1) z differs for any two cells less than w apart along each axis,
    # by less than 2 w^3, so also modulo 2 w^3. The factors are odd: the cells of any plane use all places evenly.
    place = mi.UInt32(x + (width + 1) * y + (width * width + width - 1) * z) & (2 * width**3 - 1)
    a, b, c = mi.UInt32(x >> bits), mi.UInt32(y >> bits), mi.UInt32(z >> bits)
    words = a * 0xD1B54A33 + b * 0xABC98389 + c * 0x8CB92BA7
    block = mix(words if level is None else words + level * 0x9E3779B1)
    return ((block << (3 * bits + 1)) | place) & (lattice.slot_count - 1)
