"""What DDGI knows of a world: the probes, their texels, and the atlases that look-ups read."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from luxel.kernels.mean_estimator import Estimate, EstimatorDials
from luxel.methods.ddgi.volume import Volume

REQUEST_COUNT = 64
"""Probes held back that a frame places at most."""
UNUSED, DEAD, ASLEEP, AWAKE = range(4)
"""States of a probe. UNUSED: held back, not placed. DEAD: inside geometry. ASLEEP: nobody reads it."""
STATE_NAMES = ("held back", "dead", "asleep", "awake")


@dataclass
class Probes:
    """One entry a probe: those of the boxes first, then those held back."""

    p: mi.Point3f
    """World position, offset included."""
    offset: mi.Vector3f
    """From its node, in cells along the box's axes."""
    status: mi.UInt32
    dead: mi.Float
    """Certainty that it is inside geometry, 0..1: what makes it DEAD."""
    unfit: mi.Float
    """Certainty that it is inside geometry or too near to it, 0..1: what makes it move."""
    age: mi.UInt32
    """Frames since it was placed or moved; at 0 it knows nothing, whatever its texels hold."""
    unread: mi.UInt32
    """Frames since a look-up last read it."""
    tries: mi.UInt32
    """Places tried so far."""
    part: mi.UInt32
    """Of one held back: the eighth of a cell that it was placed for."""
    noise: mi.Float
    """How noisy or changing its light is: what the ray budget follows."""


@dataclass
class DepthMoments:
    """One entry a depth texel: weighted mean and variance of the distance to what is seen there, metres."""

    mean: mi.Float
    variance: mi.Float
    weight: mi.Float
    """Sum of the weights behind them; 0: nothing within reach was seen."""


@dataclass
class PlaneSums:
    """One entry a depth texel: weighted sums over its rays of w w^T, w / t and 1 / t^2, where t is the distance."""

    xx: mi.Float
    yy: mi.Float
    zz: mi.Float
    xy: mi.Float
    xz: mi.Float
    yz: mi.Float
    x: mi.Float
    y: mi.Float
    z: mi.Float
    square: mi.Float
    weight: mi.Float
    """Sum of the weights; 0: nothing within reach was seen."""


@dataclass
class ExtraProbes:
    """Probes held back for places that no probe of their cage sees: at most one an eighth of a cell."""

    of_part: mi.UInt32
    """Id of the extra probe of each eighth of a cell, 0 for none; one entry where there are none at all."""
    count: mi.UInt32
    """Extra probes placed."""


@dataclass
class PlacementRequests:
    """Places that no probe sees, as the views found them: a few a frame, one entry each."""

    p: mi.Point3f
    n: mi.Normal3f
    part: mi.UInt32
    """The eighth of a cell that it is in."""
    wanted: mi.Bool


@dataclass
class Rays:
    """Which rays belong to a probe."""

    first: mi.UInt32
    """Of each probe."""
    count: mi.UInt32
    sky: mi.UInt32
    """Rays of each probe that looked for the sky in the last frame; one entry."""


@dataclass
class SkyRays:
    """What the rays that look for the sky brought; a probe's rays side by side."""

    direction: mi.Float
    """(rays, 4): unit direction, and 0."""
    light: mi.Float
    """(rays, 4): what it adds to a sum over the probe's even rays, and 0."""
    count: int
    """Rays a probe."""


@dataclass
class ProbeRayResults:
    """What each ray brought; a probe's rays side by side."""

    direction_depth: mi.Float
    """(rays, 4): unit direction, and the distance: negative where a back stopped the ray, which then counts as depth
    zero; `trace.MISS` where nothing was hit. After the probes' rays come those of the placement requests."""
    radiance: mi.Float
    """(rays, 4): radiance along the ray, and 1 where it met the back of a triangle, whether that stopped it or not."""
    p: mi.Point3f
    """Hit, world."""
    hit: mi.Bool
    """Something was hit that may reflect, by a probe that is awake; in a box, where paths go on outside them."""
    sky: SkyRays | None = None
    """Rays of their own towards the sky; None where there are none."""


@dataclass
class DdgiDials:
    """Parameters that may change while it runs, as opaque values."""

    hysteresis: mi.Float
    backface_offset: mi.Float
    normal_bias: mi.Float
    view_bias: mi.Float
    dead_hysteresis: mi.Float
    dead_threshold: mi.Float
    """Metres; below 0: a tenth of the shortest cell side."""
    estimator: EstimatorDials


@dataclass
class Guide:
    """What guides the cascades that go where the view looks."""

    side: mi.Float
    """Cell side of the finest one, metres."""
    distance: mi.Float
    """Running mean of the logarithm to base 2 of the distances, metres, of what the view shows."""
    frame: mi.UInt32
    """The last frame in which a view guided them."""
    lower: mi.Point3f
    """Box around all that there is, strays included: what boxes that move stay within."""
    upper: mi.Point3f


@dataclass
class DdgiSettings:
    """Parameters that shape the kernels: constants of a state."""

    probe_count: int
    extra_count: int
    rays_per_probe: int
    irradiance_resolution: int
    depth_resolution: int
    half_irradiance: bool
    half_depth: bool
    planes: bool
    """Depth is kept as planes; else as moments."""
    depth_sharpness: int
    far_depth: int
    """Index into `FAR_DEPTHS`."""
    adaptive: bool
    detect_dead: bool
    offset_dead: bool
    thesis_backs: bool
    """Every back stops a ray and half of a probe's rays make it dead; else luxel's rule holds."""
    step_through: bool
    """Offsets go through the closest back face; else along the axes."""
    corrected_weights: bool
    roots: bool
    """Answers are means of fourth roots; else plain means."""
    variance_budget: bool
    feedback: bool
    paths_outside: bool
    """Rays that hit something outside all boxes go on as paths; else the nearest box answers."""
    sky_rays: int
    """Rays a probe that look for the sky where it has bright places."""
    follow_camera: bool
    guided: int
    """Boxes, from the first on, that go where the view looks."""
    sleep_after: int
    debug_layer: int
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where places are measured from in the file's coordinates (`SceneData.origin`): for who writes them."""

    @property
    def total(self) -> int:
        """Probes of the boxes and those held back."""
        return self.probe_count + self.extra_count

    @property
    def request_count(self) -> int:
        """Places that may ask for a probe in one frame."""
        return REQUEST_COUNT if self.extra_count > 0 else 0


@dataclass
class DdgiState:
    """Everything that DDGI knows of a world."""

    volumes: tuple[Volume, ...]
    probes: Probes
    rows: mi.Float
    """(total, 4): position and 1 where a look-up may use it: what a look-up reads first."""
    irradiance: Estimate
    """(total * resolution^2): the texels' running means, W/m^2."""
    depth: DepthMoments | PlaneSums
    irradiance_atlas: mi.Float | mi.Float16
    """(total, resolution + 2, resolution + 2, 4): irradiance over `scale`, and 1; with the gutter."""
    depth_atlas: mi.Float | mi.Float16
    """(total, resolution + 2, resolution + 2, 2): mean and standard deviation of the distance, metres; or, by planes,
    (…, 4): the plane (1/m) and the relative deviation from it."""
    extras: ExtraProbes
    wishes: PlacementRequests
    read: mi.UInt32
    """1 for each eighth of a cell in which somebody has asked since the last update."""
    rays: Rays
    guide: Guide
    scale: mi.Float
    """Unit of `irradiance_atlas`: the running mean luminance, so that half floats hold any level of light."""
    drift: mi.Float
    """The texels' common alarm: by which share their short and long means differ, beyond chance."""
    outside: mi.Float
    """Running share of the rays' hits that lie in no box."""
    backs: mi.Float
    """Running share of the rays' hits that are on the back of a triangle."""
    seed: mi.UInt32
    dials: DdgiDials
    settings: DdgiSettings

    def rays_of(self, probe: mi.UInt32) -> mi.UInt32:
        """Return how many even rays each probe casts in this frame."""
        if not self.settings.variance_budget:
            return mi.UInt32(self.settings.rays_per_probe)
        return dr.gather(mi.UInt32, self.rays.count, probe)
