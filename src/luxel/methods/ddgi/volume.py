"""From the world to a box's grid and back, on the device.

A box's nodes are numbered over an endless lattice; the box shows a window of it. A node is stored at its coordinates
modulo the window, so a window that moves by whole cells keeps every probe that stays inside where it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.methods.ddgi.boxes import ProbeBox


@dataclass
class Volume:
    """One box of probes."""

    to_grid_x: mi.Vector4f
    """Rows of the affine map from the world to lattice coordinates, in which nodes are whole numbers."""
    to_grid_y: mi.Vector4f
    to_grid_z: mi.Vector4f
    origin: mi.Point3f
    """World position of node (0, 0, 0)."""
    step_x: mi.Vector3f
    """World vectors of one cell."""
    step_y: mi.Vector3f
    step_z: mi.Vector3f
    low: mi.Vector3i
    """The window's lowest node."""
    side: mi.Float
    """Shortest cell side, metres."""
    reach: mi.Float
    """How far a point of a cage can be from a probe of it: the diagonal, enlarged by the largest offset."""
    nx: int
    ny: int
    nz: int
    first: int
    """Id of its first probe."""

    @property
    def probe_count(self) -> int:
        """Probes of this box."""
        return self.nx * self.ny * self.nz

    def owns(self, probe: mi.UInt32) -> mi.Bool:
        """Return whether probes belong to this box."""
        return (probe >= self.first) & (probe < self.first + self.probe_count)


def make_volume(box: ProbeBox, first: int, max_offset: float) -> Volume:
    """Return the device's form of `box`, whose probes start at id `first`."""
    axes, spacing = box.axes, box.spacing
    steps = axes * spacing[:, None]
    origin = np.asarray(box.middle) - 0.5 * (np.asarray(box.counts) - 1) @ steps
    rows = axes / spacing[:, None]
    shift = -rows @ origin
    diagonal = float(np.linalg.norm(spacing))
    return Volume(
        *(mi.Vector4f(*(_opaque(v) for v in (*row, t))) for row, t in zip(rows, shift, strict=True)),
        origin=mi.Point3f(*(_opaque(v) for v in origin)),
        step_x=mi.Vector3f(*(_opaque(v) for v in steps[0])),
        step_y=mi.Vector3f(*(_opaque(v) for v in steps[1])),
        step_z=mi.Vector3f(*(_opaque(v) for v in steps[2])),
        low=mi.Vector3i(*(dr.opaque(mi.Int32, 0) for _ in range(3))),
        side=_opaque(spacing.min()),
        reach=_opaque(diagonal * (1.0 + max_offset)),
        nx=box.counts[0],
        ny=box.counts[1],
        nz=box.counts[2],
        first=first,
    )


def grid_coordinates(volume: Volume, p: mi.Point3f) -> mi.Point3f:
    """Return lattice coordinates of world points."""
    q = mi.Vector4f(p.x, p.y, p.z, 1.0)
    return mi.Point3f(dr.dot(volume.to_grid_x, q), dr.dot(volume.to_grid_y, q), dr.dot(volume.to_grid_z, q))


def world_position(volume: Volume, g: mi.Point3f) -> mi.Point3f:
    """Return the world position of lattice coordinates."""
    return mi.Point3f(volume.origin + volume.step_x * g.x + volume.step_y * g.y + volume.step_z * g.z)


def cage_of(volume: Volume, g: mi.Point3f) -> tuple[mi.Vector3i, mi.Point3f]:
    """Return each point's lowest cage node and its place in the cage, 0..1; points outside belong to the nearest."""
    high = mi.Vector3i(volume.nx - 2, volume.ny - 2, volume.nz - 2)
    base = mi.Vector3i(dr.floor(g)) - volume.low
    base = dr.minimum(dr.maximum(base, mi.Vector3i(0)), high) + volume.low
    return base, mi.Point3f(dr.clip(g - mi.Point3f(base), 0.0, 1.0))


def inside_share(volume: Volume, g: mi.Point3f) -> mi.Float:
    """Return 1 well inside the box, falling to 0 at its border over the last cell."""
    span = mi.Point3f(volume.nx - 1.0, volume.ny - 1.0, volume.nz - 1.0)
    away = g - mi.Point3f(volume.low)
    edge = dr.clip(dr.minimum(away, span - away), 0.0, 1.0)
    return edge.x * edge.y * edge.z


def is_inside(volume: Volume, g: mi.Point3f) -> mi.Bool:
    """Return whether points lie in the box."""
    span = mi.Point3f(volume.nx - 1.0, volume.ny - 1.0, volume.nz - 1.0)
    away = g - mi.Point3f(volume.low)
    return dr.all((away >= 0.0) & (away <= span))


def probe_of_node(volume: Volume, node: mi.Vector3i) -> mi.UInt32:
    """Return the probe id of a lattice node inside the window."""
    s = mi.Vector3u(
        _wrap(node.x, volume.nx),
        _wrap(node.y, volume.ny),
        _wrap(node.z, volume.nz),
    )
    return volume.first + s.x + volume.nx * (s.y + volume.ny * s.z)


def cage_slots(volume: Volume, base: mi.Vector3i) -> tuple[mi.Vector3u, mi.Vector3u]:
    """Return where a cage's lower and upper nodes lie along each axis: the sum over the axes is the probe id.

    The eight probes of a cage share six of these numbers, so that a look-up wraps thrice and not 24 times.
    """
    counts = mi.Vector3u(volume.nx, volume.ny, volume.nz)
    low = mi.Vector3u(_wrap(base.x, volume.nx), _wrap(base.y, volume.ny), _wrap(base.z, volume.nz))
    high = dr.select(low + 1 == counts, 0, low + 1)

    def stride(slot: mi.Vector3u) -> mi.Vector3u:
        return mi.Vector3u(slot.x + volume.first, slot.y * volume.nx, slot.z * (volume.nx * volume.ny))

    return stride(low), stride(high)


def node_of_probe(volume: Volume, index: mi.UInt32, low: mi.Vector3i) -> mi.Vector3i:
    """Return the lattice node that slot `index` (0 .. probe_count - 1) holds while the window starts at `low`."""
    x = mi.Int32(index % volume.nx)
    y = mi.Int32((index // volume.nx) % volume.ny)
    z = mi.Int32(index // (volume.nx * volume.ny))
    return mi.Vector3i(
        low.x + mi.Int32(_wrap(x - low.x, volume.nx)),
        low.y + mi.Int32(_wrap(y - low.y, volume.ny)),
        low.z + mi.Int32(_wrap(z - low.z, volume.nz)),
    )


def _wrap(value: mi.Int32, size: int) -> mi.UInt32:
    """Return `value` modulo `size`, never negative."""
    rest = value - (value // size) * size
    rest = dr.select(rest < 0, rest + size, rest)
    return mi.UInt32(rest)


def _opaque(value: float) -> mi.Float:
    return dr.opaque(mi.Float, float(value))
