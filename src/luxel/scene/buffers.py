"""The scene on the device: what every kernel takes.

`builder.py` makes it and `device.py` moves it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import mitsuba as mi

from luxel.scene.accel import Group, OneAccel
from luxel.scene.host import Host
from luxel.scene.lights import LightTables
from luxel.scene.textures import MaterialTables


@dataclass
class Geometry:
    """The shared buffers. Rows of four floats let the kernels read one packet instead of four words."""

    vertices: mi.Float
    """(V, 4): object-space position, u."""
    normals: mi.Float
    """(V, 4): object-space vertex normal (zero: use the triangle's), v."""
    triangles: mi.UInt32
    """(F, 4): three vertices, material | object id << 16."""
    colors: mi.Float
    """(V, 4) vertex colours, or one row where the scene has none."""
    uv2: mi.Float
    """(V, 2) light map coordinates, or one row."""
    to_world: mi.Float
    """(objects + 1, 12): rows of the object-to-world matrices; row 0 is the identity."""
    to_object: mi.Float
    """(objects + 1, 12): their inverses."""
    to_world_before: mi.Float
    """(objects + 1, 12): `to_world` one frame earlier, for motion vectors."""
    vertices_before: mi.Float
    """Deforming scenes: `vertices` one frame earlier; else one row."""


@dataclass
class Features:
    """What the scene has, as constants: kernels are compiled without what it lacks."""

    moving: bool
    deforming: bool
    colors: bool
    uv2: bool
    cutout: bool
    """Some surfaces do not stop every ray."""
    blended: bool
    """Some surfaces let rays by by chance: a frame sees one stochastic layer of them."""
    gloss: bool
    """Some materials reflect or refract, and are to be seen so: `MaterialTables.gloss` has a row for each."""
    transmission: bool
    """Some of them are glass."""
    hide_emitters: bool
    """Camera rays pass through surfaces that emit, and see no sky."""
    surrounded: bool
    """Some triangles lie beyond the robust bounds: a dome, a wide ground, a stray."""


@dataclass
class Scene:
    """What every kernel takes. A Dr.Jit pytree: frozen functions read it as an input."""

    groups: list[Group]
    one: OneAccel | None
    """All groups in one structure, as OptiX needs it; else each group has its own."""
    geometry: Geometry
    materials: MaterialTables
    lights: LightTables
    features: Features
    lower: mi.Point3f
    """Robust bounds over the animation (`scene/bounds.py`), world space, measured from the origin (`local.py`)."""
    upper: mi.Point3f
    coordinate: mi.Float
    """Median over the triangles of their largest |coordinate|, metres: how coarsely places are rounded here."""
    layer_seed: mi.UInt32
    """Chooses the stochastic layer of blended surfaces; whoever averages layers changes it (`choose_layer`)."""
    host: Host = field(repr=False)
