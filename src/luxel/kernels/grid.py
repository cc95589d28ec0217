"""A uniform grid of discs, rebuilt each frame by count, prefix sum and fill (Ekberg 2022, section 4.2).

Every disc is listed in all cells that it touches, so a look-up reads one cell. A disc here is the flat ellipsoid in
which its weight is not zero: `radius` in its plane, `thickness` along its normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

CELL_LIMIT = 1 << 22
"""Cells at most; larger scenes get larger cells."""


@dataclass
class Lattice:
    """Where the cells are."""

    lower: mi.Point3f
    inverse_size: mi.Float
    nx: int
    ny: int
    nz: int

    @property
    def cell_count(self) -> int:
        """Number of cells."""
        return self.nx * self.ny * self.nz


@dataclass
class Grid:
    """Which discs touch each cell."""

    starts: mi.UInt32
    """(cells + 1): cell c owns items starts[c] .. starts[c + 1]."""
    items: mi.UInt32
    """Disc ids, in an order that may differ from run to run."""


def make_lattice(lower: np.ndarray, upper: np.ndarray, cell_size: float) -> Lattice:
    """Return a lattice over the box; cells grow beyond `cell_size` where there would be over `CELL_LIMIT` of them."""
    extent = np.maximum(np.asarray(upper, float) - lower, 1e-9)
    while True:
        dims = np.maximum(np.ceil(extent / cell_size).astype(int), 1)
        if int(np.prod(dims.astype(np.int64))) <= CELL_LIMIT:
            break
        cell_size *= 1.1
    slack = 0.5 * (dims * cell_size - extent)
    origin = [dr.opaque(mi.Float, float(value)) for value in np.asarray(lower, float) - slack]
    return Lattice(mi.Point3f(*origin), dr.opaque(mi.Float, 1.0 / cell_size), *(int(n) for n in dims))


def cell_of_point(lattice: Lattice, p: mi.Point3f) -> mi.UInt32:
    """Return the cell of each point; points outside belong to the nearest cell."""
    x, y, z = _coordinates(lattice, p)
    return mi.UInt32(x + lattice.nx * (y + lattice.ny * z))


def build_grid(
    lattice: Lattice,
    p: mi.Point3f,
    n: mi.Normal3f,
    radius: mi.Float,
    thickness: mi.Float,
    alive: mi.Bool,
    capacity: int,
) -> Grid:
    """Return the grid of the discs at `p` with unit normals `n`; items beyond `capacity` are left out."""
    counts = dr.zeros(mi.UInt32, lattice.cell_count + 1)
    _visit_cells(lattice, p, n, radius, thickness, alive, counts, None, capacity)
    starts = dr.prefix_reduce(dr.ReduceOp.Add, counts)
    cursor = mi.UInt32(starts)
    items = dr.empty(mi.UInt32, capacity)
    _visit_cells(lattice, p, n, radius, thickness, alive, cursor, items, capacity)
    return Grid(dr.minimum(starts, capacity), items)


@dr.syntax
def _visit_cells(
    lattice: Lattice,
    p: mi.Point3f,
    n: mi.Normal3f,
    radius: mi.Float,
    thickness: mi.Float,
    alive: mi.Bool,
    cursor: mi.UInt32,
    items: mi.UInt32 | None,
    capacity: int,
) -> None:
    """Count each disc in the cells it touches, or, given `items`, write its id there."""
    # The ellipsoid's box, in cells.
    squared = mi.Vector3f(n.x * n.x, n.y * n.y, n.z * n.z)
    extent = dr.sqrt(dr.fmax(radius * radius * (1.0 - squared) + thickness * thickness * squared, 0.0))
    x0, y0, z0 = _coordinates(lattice, p - extent)
    x1, y1, z1 = _coordinates(lattice, p + extent)
    across, up = x1 - x0 + 1, y1 - y0 + 1
    total = across * up * (z1 - z0 + 1)

    # Points of the slab around the disc's plane: what the box holds beyond it is skipped.
    local = (p - lattice.lower) * lattice.inverse_size
    reach = thickness * lattice.inverse_size + 0.5 * (dr.abs(n.x) + dr.abs(n.y) + dr.abs(n.z))
    last = mi.Int32(lattice.nx - 1), mi.Int32(lattice.ny - 1), mi.Int32(lattice.nz - 1)
    disc_id = dr.arange(mi.UInt32, dr.width(p))
    step = mi.Int32(0)
    while alive & (step < total):
        layer = step // across
        x, y, z = x0 + step - layer * across, y0 + layer % up, z0 + layer // up
        offset = mi.Vector3f(mi.Float(x) + 0.5 - local.x, mi.Float(y) + 0.5 - local.y, mi.Float(z) + 0.5 - local.z)
        # Border cells stand for everything beyond them, so the slab test does not apply there.
        border = (x == 0) | (y == 0) | (z == 0) | (x == last[0]) | (y == last[1]) | (z == last[2])
        touched = border | (dr.abs(dr.dot(offset, mi.Vector3f(n))) <= reach)
        cell = mi.UInt32(x + lattice.nx * (y + lattice.ny * z))
        if dr.hint(items is None, mode="scalar"):
            dr.scatter_reduce(dr.ReduceOp.Add, cursor, mi.UInt32(1), cell, touched)
        else:
            slot = dr.scatter_inc(cursor, cell, touched)
            dr.scatter(items, disc_id, slot, touched & (slot < capacity))
        step += 1


def _coordinates(lattice: Lattice, p: mi.Point3f) -> tuple[mi.Int32, mi.Int32, mi.Int32]:
    q = mi.Point3f((p - lattice.lower) * lattice.inverse_size)
    x = mi.Int32(dr.clip(dr.floor(q.x), 0.0, lattice.nx - 1.0))
    y = mi.Int32(dr.clip(dr.floor(q.y), 0.0, lattice.ny - 1.0))
    z = mi.Int32(dr.clip(dr.floor(q.z), 0.0, lattice.nz - 1.0))
    return x, y, z
