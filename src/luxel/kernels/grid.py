"""A grid of discs over all of space, rebuilt each frame by count, prefix sum and fill (Ekberg 2022, section 4.2).

Every disc is listed in all cells that it touches, so a look-up reads one cell. A disc here is the flat ellipsoid in
which its weight is not zero: `radius` in its plane, `thickness` along its normal.

Cells have no box around them: a hash of a cell's coordinates is its slot in a table (Teschner et al. 2003, "Optimized
Spatial Hashing"). Where two cells share a slot they share a list, so readers must test the distance, as they do anyway.
A slot is one of a bucket: the hash of the block of cells around a cell is its bucket, and its coordinates are its place
there, by a rule that gives no two cells of one disc the same place. So no list holds a disc twice, and neighbours lie
together in memory.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.kernels.sampling import mix

SLOTS_A_DISC = 4
"""Slots a disc at least. Discs that cover a surface once use about one cell each, so few cells share a slot."""
SLOT_BITS = 25
"""Bits of a slot's number at most: larger pools share slots more often."""
FARTHEST = float(1 << 30)
"""Cell coordinates at most, so that they fit an integer; what lies beyond belongs to the last cell."""
SHIFTS = 64
"""Places that `find_shift` tries along each axis."""
ROUNDING = 2.0**-22
"""How far off cell coordinates may be, as a share of themselves: float32, rounded on both sides."""


@dataclass
class Lattice:
    """Where the cells are, and where in the table."""

    inverse_size: mi.Float
    shift: mi.Vector3f
    """In cells: the cell of the origin begins at -shift. It moves no light, only where cells cut surfaces."""
    slot_bits: int
    """The table has 2^slot_bits slots."""
    block_bits: int
    """A block is 2^block_bits cells wide, which is at least a disc's width; a bucket has 2^(3 block_bits + 1) slots."""

    @property
    def slot_count(self) -> int:
        """Number of slots in the table."""
        return 1 << self.slot_bits


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


def make_lattice(radius: float, cell_size: float, disc_count: int, shift: np.ndarray | None = None) -> Lattice:
    """Return a lattice for up to `disc_count` discs of `radius` metres, with cells of `cell_size` radii.

    `shift` (3,), in cells, is such as `find_shift` returns; without it cells begin at the origin.
    """
    block_bits = (int(2.0 / cell_size) + 1).bit_length()
    slots = SLOTS_A_DISC * disc_count / min(cell_size, 1.0) ** 2
    slot_bits = min(max(int(slots - 1).bit_length(), 3 * block_bits + 4), SLOT_BITS)
    steps = [dr.opaque(mi.Float, float(value)) for value in (np.zeros(3) if shift is None else shift)]
    return Lattice(dr.opaque(mi.Float, 1.0 / (cell_size * radius)), mi.Vector3f(*steps), slot_bits, block_bits)


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


def slot_of_point(lattice: Lattice, p: mi.Point3f) -> mi.UInt32:
    """Return the slot of each point's cell."""
    return _slot(lattice, *_coordinates(_in_cells(lattice, p)))


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
) -> Grid:
    """Return the grid of the discs at `p` with unit normals `n`; lists that do not fit `capacity` items are left out.

    Lists are in the order of `keys` (of ids, where keys are alike or None), and hold the first `longest` of them (0:
    all). So a list is the same whichever thread came first, and as long as its discs stay, from frame to frame too.
    """
    counts = dr.zeros(mi.UInt32, lattice.slot_count + 1)
    _visit_cells(lattice, p, n, radius, thickness, alive, counts, None, capacity)
    starts = dr.prefix_reduce(dr.ReduceOp.Add, counts)
    # A list that ends beyond the room is left out whole: which of its discs would find room is chance.
    listed = dr.max(dr.select(starts <= capacity, starts, 0))
    left_out = dr.max(starts) - listed
    starts = dr.minimum(starts, listed)
    found = Scratch(dr.empty(mi.UInt32, 2 * capacity), dr.empty(mi.UInt32, capacity), mi.UInt32(starts), keys)
    _visit_cells(lattice, p, n, radius, thickness, alive, found.cursor, found, capacity)
    kept = starts
    if longest:
        kept = dr.prefix_reduce(dr.ReduceOp.Add, dr.minimum(_lengths(starts), longest))
    return Grid(kept, _order_lists(starts, found, kept), left_out)


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
    lattice: Lattice,
    p: mi.Point3f,
    n: mi.Normal3f,
    radius: mi.Float,
    thickness: mi.Float,
    alive: mi.Bool,
    cursor: mi.UInt32,
    found: Scratch | None,
    capacity: int,
) -> None:
    """Count each disc in the slots of the cells it touches, or, given `found`, write its id and key there."""
    # The ellipsoid's box, in cells; never wider than a block, so that each cell has a slot of its own.
    squared = mi.Vector3f(n.x * n.x, n.y * n.y, n.z * n.z)
    extent = dr.sqrt(dr.fmax(radius * radius * (1.0 - squared) + thickness * thickness * squared, 0.0))
    x0, y0, z0 = _coordinates(_in_cells(lattice, p - extent))
    x1, y1, z1 = _coordinates(_in_cells(lattice, p + extent))
    width = (1 << lattice.block_bits) - 1
    x1, y1, z1 = dr.minimum(x1, x0 + width), dr.minimum(y1, y0 + width), dr.minimum(z1, z0 + width)

    # Points of the slab around the disc's plane, within the radius: what the box holds beyond is skipped. Measured from
    # the disc's own cell, in whole cells and the rest, so that it is exact far from the origin too.
    local = _in_cells(lattice, p)
    xc, yc, zc = _coordinates(local)
    rest = local - dr.floor(local) - 0.5
    upright = dr.abs(mi.Vector3f(n))
    half = 0.5 + ROUNDING * dr.abs(mi.Vector3f(local))
    reach = thickness * lattice.inverse_size + dr.dot(upright, half)
    farthest = dr.square(radius * lattice.inverse_size)
    disc_id = dr.arange(mi.UInt32, dr.width(p))
    pair = mi.Vector2u(disc_id, disc_id if found is None or found.keys is None else found.keys)
    x, y, z = mi.Int32(x0), mi.Int32(y0), mi.Int32(z0)
    while alive & (z <= z1):
        offset = mi.Vector3f(mi.Float(x - xc) - rest.x, mi.Float(y - yc) - rest.y, mi.Float(z - zc) - rest.z)
        gap = dr.maximum(dr.abs(offset) - half, 0.0)
        touched = (dr.abs(dr.dot(offset, mi.Vector3f(n))) <= reach) & (dr.squared_norm(gap) <= farthest)
        slot = _slot(lattice, x, y, z)
        if dr.hint(found is None, mode="scalar"):
            dr.scatter_reduce(dr.ReduceOp.Add, cursor, mi.UInt32(1), slot, touched)
        else:
            assert found is not None
            place = dr.scatter_inc(cursor, slot, touched)
            room = touched & (place < capacity)
            dr.scatter(found.pairs, pair, place, room)
            dr.scatter(found.slots, slot, place, room)
        # Go on along x, from its end to the next row, from the last row to the next layer: divisions would be slower.
        x += 1
        at_end = x > x1
        x, y = dr.select(at_end, x0, x), dr.select(at_end, y + 1, y)
        at_end = y > y1
        y, z = dr.select(at_end, y0, y), dr.select(at_end, z + 1, z)


def _in_cells(lattice: Lattice, p: mi.Point3f) -> mi.Point3f:
    """Return points in units of cells."""
    return mi.Point3f(dr.fma(p, lattice.inverse_size, lattice.shift))


def _coordinates(local: mi.Point3f) -> tuple[mi.Int32, mi.Int32, mi.Int32]:
    """Return the whole coordinates of the cells that hold points given in cells."""
    x, y, z = (mi.Int32(dr.clip(dr.floor(value), -FARTHEST, FARTHEST)) for value in local)
    return x, y, z


def _slot(lattice: Lattice, x: mi.Int32, y: mi.Int32, z: mi.Int32) -> mi.UInt32:
    """Return the slot of a cell: its block's hash says which bucket, its coordinates which place there.

    This is the one function that knows how cells become slots: for cells of several sizes, mix their level in here.
    """
    bits, width = lattice.block_bits, 1 << lattice.block_bits
    # With w for the width, x + (w + 1) y + (w^2 + w - 1) z differs for any two cells less than w apart along each axis,
    # by less than 2 w^3, so also modulo 2 w^3. The factors are odd: the cells of any plane use all places evenly.
    place = mi.UInt32(x + (width + 1) * y + (width * width + width - 1) * z) & (2 * width**3 - 1)
    a, b, c = mi.UInt32(x >> bits), mi.UInt32(y >> bits), mi.UInt32(z >> bits)
    block = mix(a * 0xD1B54A33 + b * 0xABC98389 + c * 0x8CB92BA7)
    return ((block << (3 * bits + 1)) | place) & (lattice.slot_count - 1)
