"""Every dial of DDGI. The names of the thesis's section 3.4 are kept; notes say where a default differs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from luxel.errors import LuxelError

MAJERCIK: dict[str, Any] = {
    "adaptive_hysteresis": False,
    "backface_offset": 0.2,
    "view_bias": 0.1,
    "backface_rule": "rohacek",
    "depth_model": "moments",
    "interpolation": "linear",
    "cascades": 1,
    "outside": "border",
    "far_depth": "keep",
    "detect_dead_probes": False,
    "offset_dead_probes": False,
    "corrected_weights": False,
    "extra_probes": 0,
    "sleep_after": 0,
    "sky_rays": 0,
}
"""The method as first published (Majercik et al. 2019), without the fixes."""

ROHACEK: dict[str, Any] = {
    "adaptive_hysteresis": False,
    "backface_rule": "rohacek",
    "bounces": "path",
    "depth_model": "moments",
    "interpolation": "linear",
    "cascades": 1,
    "outside": "border",
    "offset_pattern": "axes",
    "normal_bias": 0.0,
    "view_bias": 0.0,
    "extra_probes": 0,
    "sleep_after": 0,
    "sky_rays": 0,
}
"""The thesis's own setting: its fixes, without ours."""

BACKFACE_RULES = ("luxel", "rohacek")
OFFSET_PATTERNS = ("backface", "axes")
FAR_DEPTHS = ("reject", "clamp", "keep")
DEPTH_MODELS = ("planes", "moments")
FORMATS = ("float16", "float32")
RAY_BUDGETS = ("uniform", "variance")
BOUNCES = ("feedback", "path")
OUTSIDES = ("path", "border")
INTERPOLATIONS = ("root", "linear")
MAX_OFFSET = 0.45
"""Cells that a probe may move from its node along each axis: beyond, it would leave its cages."""


@dataclass
class DdgiParams:
    """Dials of probe GI (Majercik et al. 2019; Roháček 2022, section 3.4)."""

    num_probes_x: int = 0
    """Probes along X; 0 takes as many as make near-cubic cells, `probe_target` in all. More: finer light, fewer leaks;
    time and memory grow in proportion."""
    num_probes_y: int = 0
    """Probes along Y, likewise."""
    num_probes_z: int = 0
    """Probes along Z, likewise."""
    probe_target: int = 2000
    """Probes in all where their numbers are left open. More: finer light and more rays; fewer: blurrier and faster."""
    probe_box_size: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Size of the box in metres, X,Y,Z; 0 fits it around the scene with a margin outside the geometry. Smaller: denser
    probes where they count; surfaces outside get light from the nearest ones."""
    world_offset: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Moves the box from the middle of the scene, metres X,Y,Z."""
    boxes: str = ""
    """Several boxes instead of one, split by ';': `x,y,z size x,y,z probes nx,ny,nz turn yaw` (middle, size, numbers,
    degrees about Y), such as `0,1,0 size 4,2,4 probes 5,4,5 turn 30`. The finest one that holds a point answers."""
    follow_camera: bool = False
    """The box follows the camera by whole cells; only the planes that enter start anew. For large scenes."""
    cascades: int = 0
    """Boxes around one another, each twice as large with as many probes. More: farther, at their full cost. 0: where a
    cell of the fitted box would be too coarse for the view, two finer boxes go where it looks; else there is one."""
    num_samples_per_probe: int = 64
    """Rays a probe and frame. More: calmer and quicker light; tracing time grows in proportion."""
    ray_budget: str = "uniform"
    """`uniform`: every probe casts as many rays. `variance`: the same total goes where light is noisy or changes."""
    sky_rays: int = 8
    """More rays a probe and frame, which look for the bright places of a sky image; none under a sky of one colour.
    More: calmer light from windows and glows; each costs less than one of the others, as it only asks what is free."""
    bounces: str = "feedback"
    """`feedback`: rays read the probes where they hit, one more bounce a frame. `path`: they go on as paths, as the
    thesis measured: no error is fed back, several times the rays."""
    outside: str = "path"
    """Rays that hit surroundings outside all boxes, such as a dome or a wide ground: with `path` they go on as paths,
    with `border` the probes at the border answer (both sources), whose light is that of the room."""
    hysteresis: float = 0.97
    """Share of the past that a frame keeps. Higher: calmer, slower. With `adaptive_hysteresis` it rules only depth, and
    where something moves."""
    adaptive_hysteresis: bool = True
    """Each texel blends by a multi-scale mean: calm at rest, quick in change. Off: `hysteresis` always."""
    depth_sharpness: int = 50
    """Exponent of the lobe by which a ray counts for a depth texel. Higher: sharper depth, more noise and artefacts."""
    far_depth: str = "reject"
    """Rays that go farther than a cage reaches: `reject` drops them from the depth (thesis, section 3.3.2), `clamp`
    shortens them, `keep` takes them whole, which leaks."""
    depth_model: str = "planes"
    """`planes`: each depth texel fits the plane that its rays hit: walls are sharp at any slant; twice the memory.
    `moments`: mean and deviation of the distance (both sources)."""
    irradiance_resolution: int = 8
    """Irradiance texels along a probe's side, gutter not counted. More: sharper, slower blending; 8 is enough."""
    depth_resolution: int = 16
    """Depth texels along a probe's side. More: fewer leaks; memory and blending grow with the square."""
    irradiance_format: str = "float16"
    """`float16` or `float32`: twice the memory for light beyond 3 digits."""
    depth_format: str = "float16"
    """`float16` or `float32`."""
    backface_offset: float = 0.0
    """Added to the weight of probes behind a surface (2019 paper: 0.2). Higher: smoother, more light from behind."""
    normal_bias: float = 0.1
    """Shift of the looked-up point along its normal, in shortest cell sides. Higher: less self-shadowing, blurrier
    corners; the thesis switches it off."""
    view_bias: float = 0.05
    """Shift towards the viewer, likewise. Too high: niches take on the light before them."""
    backface_rule: str = "luxel"
    """What back faces say. `rohacek` (thesis, 3.3.1): every back stops a ray, which brings no light and depth zero; a
    probe is dead when more than half of its rays meet backs. What is lit from behind is lost. `luxel`: only backs that
    do not reflect stop a ray; a probe is dead when a quarter of its rays meet such, or 65 % of its hits are any."""
    detect_dead_probes: bool = True
    """Probes that `backface_rule` finds inside something answer nothing. Off: they darken what is near."""
    offset_dead_probes: bool = True
    """Dead probes, and those too near to a surface, move away. Off: their places are lost."""
    offset_pattern: str = "backface"
    """`backface`: step through the closest back face, away from close front ones. `axes`: try the six axis directions,
    ever farther (the thesis's pattern, which knows nothing of the geometry)."""
    dead_probes_hysteresis: float = 0.8
    """Share that a frame keeps of the certainty of being inside something, or too near to it. Higher: passing objects
    push no probes around; lower: probes move sooner."""
    dead_probe_threshold: float = -1.0
    """Metres that a probe keeps from surfaces; -1 takes a tenth of the shortest cell side. 0: it may sit on them. Too
    high: no free place is found."""
    corrected_weights: bool = True
    """Trilinear weights peak where a moved probe is. Off: where its node is."""
    interpolation: str = "root"
    """How the say of several probes makes one answer. `root`: a linear fit of fourth roots over their places, to the
    fourth power: light falls off in a hollow curve, and the probes that see a point stand where it is lighter.
    `linear`: the plain mean (both sources): too bright."""
    extra_probes: int = 256
    """Probes held back for places that no probe of their cage sees. 0: such places get the mean of their cage."""
    sleep_after: int = 32
    """Frames without a look-up after which a probe casts no more rays; a look-up wakes it. 0: probes never sleep."""
    show_debug_layer: int = -1
    """Layer of the grid (along Y) that the atlas views show; -1 shows all."""


def check_params(params: DdgiParams) -> None:
    """Raise LuxelError for a value that DDGI cannot run with."""
    finite = float("inf")
    rules = (
        *(
            (
                f"num_probes_{axis}",
                getattr(params, f"num_probes_{axis}") in (0, *range(2, 1025)),
                "0, or from 2 to 1024",
            )
            for axis in "xyz"
        ),
        ("probe_target", 8 <= params.probe_target <= 16_000_000, "from 8 to 16000000"),
        (
            "probe_box_size",
            _triple(params.probe_box_size) and min(params.probe_box_size) >= 0.0,
            "three sizes, 0 or more",
        ),
        ("world_offset", _triple(params.world_offset), "three numbers"),
        ("cascades", 0 <= params.cascades <= 8, "from 0 to 8"),
        ("num_samples_per_probe", 4 <= params.num_samples_per_probe <= 4096, "from 4 to 4096"),
        ("sky_rays", 0 <= params.sky_rays <= 4096, "from 0 to 4096"),
        ("ray_budget", params.ray_budget in RAY_BUDGETS, " or ".join(RAY_BUDGETS)),
        ("bounces", params.bounces in BOUNCES, " or ".join(BOUNCES)),
        ("outside", params.outside in OUTSIDES, " or ".join(OUTSIDES)),
        ("hysteresis", 0.0 <= params.hysteresis < 1.0, "from 0 to below 1"),
        ("depth_sharpness", 1 <= params.depth_sharpness <= 1000, "from 1 to 1000"),
        ("far_depth", params.far_depth in FAR_DEPTHS, ", ".join(FAR_DEPTHS)),
        ("depth_model", params.depth_model in DEPTH_MODELS, " or ".join(DEPTH_MODELS)),
        ("irradiance_resolution", 2 <= params.irradiance_resolution <= 64, "from 2 to 64"),
        ("depth_resolution", 2 <= params.depth_resolution <= 64, "from 2 to 64"),
        ("irradiance_format", params.irradiance_format in FORMATS, " or ".join(FORMATS)),
        ("depth_format", params.depth_format in FORMATS, " or ".join(FORMATS)),
        ("backface_offset", 0.0 <= params.backface_offset <= 1.0, "from 0 to 1"),
        ("interpolation", params.interpolation in INTERPOLATIONS, " or ".join(INTERPOLATIONS)),
        ("backface_rule", params.backface_rule in BACKFACE_RULES, " or ".join(BACKFACE_RULES)),
        ("normal_bias", 0.0 <= params.normal_bias <= 1.0, "from 0 to 1"),
        ("view_bias", 0.0 <= params.view_bias <= 1.0, "from 0 to 1"),
        ("offset_pattern", params.offset_pattern in OFFSET_PATTERNS, " or ".join(OFFSET_PATTERNS)),
        ("dead_probes_hysteresis", 0.0 <= params.dead_probes_hysteresis < 1.0, "from 0 to below 1"),
        ("dead_probe_threshold", -1.0 <= params.dead_probe_threshold < finite, "-1, or 0 and more"),
        ("extra_probes", 0 <= params.extra_probes <= 65536, "from 0 to 65536"),
        ("show_debug_layer", params.show_debug_layer >= -1, "-1, or the number of a layer"),
        ("sleep_after", 0 <= params.sleep_after <= 1_000_000, "from 0 to 1000000"),
    )
    for name, fine, allowed in rules:
        if not fine:
            raise LuxelError(f"ddgi: parameter '{name}' is {getattr(params, name)}, but must be {allowed}")


def _triple(values: object) -> bool:
    if not isinstance(values, tuple | list) or len(values) != 3:
        return False
    return all(isinstance(v, int | float) and abs(v) < 1e9 for v in values)
