"""Changes to a scene from the command line: cameras, sun, sky, environment map, and what a scene without them gets."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from luxel.errors import LuxelError
from luxel.scene.axes import camera_axes
from luxel.scene.bounds import triangle_bounds
from luxel.scene.model import Camera, Colour, Light, Material, SceneData, Sky
from luxel.scene.rules import BRIGHTEST
from luxel.scene.triangles import Box, Triangles, world_corners

DEFAULT_SKY: Colour = (0.7, 0.85, 1.0)
"""Radiance."""
DEFAULT_SUN: Colour = (10.0, 9.3, 8.2)
"""Irradiance on a facing plane, W/m^2."""
DEFAULT_SUN_DIRECTION = (0.2, -1.0, 0.15)
"""The way its light travels."""
FRONT_FOV = 45.0
"""Degrees, horizontal: of a camera in front of what the scene holds."""
FREE_FOV = 60.0
"""The same of a camera that is described without one."""
TOWARDS_VIEWER = (0.55, 0.35, 0.76)
"""From there to it."""
FRAME = 1.05
"""How much wider than the bounds its picture is."""
WIDEST_SUN = 90.0
"""Degrees across."""
FARTHEST_TURN = 1e6
"""Degrees of azimuth either way: farther off the angle within a turn is rounding."""
NO_LIGHT = "The scene has no light"
DEFAULT_LIGHT = ", so it gets the default sky and sun; `--sky none` takes both away."
DEFAULT_SKY_ALONE = ", so it gets the default sky; `--sky none` takes it away."


# --- light ---------------------------------------------------------------------------------------------------------


def has_own_light(data: SceneData) -> bool:
    """Return whether the scene brings a lamp or a sky that gives light; glowing surfaces do not count."""
    sky = data.sky
    shines = max(sky.color) > 0 and (sky.image is None or bool((sky.image > 0).any()))
    return shines or any(max(light.color) > 0 for light in data.lights)


def has_glow(data: SceneData) -> bool:
    """Return whether a surface of the scene emits light; under a black emission texture it does not."""
    used = {mesh.material for item in data.objects for mesh in item.meshes if len(mesh.faces)}
    return any(_glows(data.materials[index]) for index in used)


def _glows(material: Material) -> bool:
    if max(material.emission) <= 0 or material.emission_texture is None:
        return max(material.emission) > 0
    image = material.emission_texture.image
    return bool(((image[..., :3] if image.ndim == 3 else image) > 0).any())


def add_default_light(data: SceneData, why: str = NO_LIGHT) -> SceneData:
    """Give the scene the default sky and sun, with a warning that says so. Returns `data`.

    `why` is the first half of the warning.
    """
    sun = Light("directional", DEFAULT_SUN, direction=DEFAULT_SUN_DIRECTION, name="sun")
    data.lights, data.sky, data.default_sun = [*data.lights, sun], Sky(DEFAULT_SKY), sun
    # The file's own scene does not know of it.
    data.mitsuba_full = None
    data.warnings.append(why + DEFAULT_LIGHT)
    return data


def _forget_sky(data: SceneData) -> None:
    """Take away the suns of the sky, the default sun, and what was said of the default light: another sky comes."""
    data.lights = [light for light in data.lights if light != data.default_sun and not light.in_sky]
    data.default_sun = None
    data.warnings = [text for text in data.warnings if not text.endswith((DEFAULT_LIGHT, DEFAULT_SKY_ALONE))]


def apply_sun(data: SceneData, text: str) -> SceneData:
    """Replace the scene's directional lights by one sun: "AZIMUTH,ELEVATION[,STRENGTH[,DIAMETER]]". Returns `data`.

    Degrees, towards the sun: azimuth from +Z towards +X, elevation above the horizon. STRENGTH is the irradiance on a
    facing plane in W/m^2 of its strongest channel, 1e9 at most; the tint is the default sun's. DIAMETER, from 0
    (sharp shadows) to 90, is how wide its disc is. The sky stays, and so do suns that are part of it.
    """
    advice = "write --sun AZIMUTH,ELEVATION[,STRENGTH[,DIAMETER]], such as 120,40 or 120,40,8,0.53"
    numbers = _numbers(text, (2, 3, 4), f"'{text}' is not a sun", advice)
    azimuth, elevation = math.radians(numbers[0]), math.radians(numbers[1])
    strength = numbers[2] if len(numbers) > 2 else max(DEFAULT_SUN)
    diameter = numbers[3] if len(numbers) > 3 else 0.0
    if not abs(numbers[0]) <= FARTHEST_TURN:
        raise LuxelError(
            f"The sun's azimuth must lie between {-FARTHEST_TURN:g} and {FARTHEST_TURN:g} degrees, not {numbers[0]:g}."
        )
    if not -90 <= numbers[1] <= 90:
        raise LuxelError(f"The sun's elevation must lie between -90 and 90 degrees, not {numbers[1]:g}.")
    if not 0 <= strength <= BRIGHTEST:
        raise LuxelError(f"The sun's strength must lie between 0 and {BRIGHTEST:g} W/m^2, not {strength:g}.")
    if not 0 <= diameter <= WIDEST_SUN:
        raise LuxelError(f"The sun's diameter must lie between 0 and {WIDEST_SUN:g} degrees, not {diameter:g}.")
    to_sun = (
        math.cos(elevation) * math.sin(azimuth),
        math.sin(elevation),
        math.cos(elevation) * math.cos(azimuth),
    )
    red, green, blue = (strength * channel / max(DEFAULT_SUN) for channel in DEFAULT_SUN)
    travels = (-to_sun[0], -to_sun[1], -to_sun[2])
    others = [light for light in data.lights if light.kind != "directional" or light.in_sky]
    sun = Light("directional", (red, green, blue), direction=travels, angular_diameter=diameter, name="sun")
    data.lights = [*others, sun]
    data.default_sun = None
    data.warnings = [text.replace(DEFAULT_LIGHT, DEFAULT_SKY_ALONE) for text in data.warnings]
    return data


def apply_sky(data: SceneData, text: str) -> SceneData:
    """Replace the sky by a constant radiance, 1e9 at most: "none", one grey value, or "R,G,B". Returns `data`.

    A default sun goes with the default sky, and suns of a sky image with it; the scene's own sun stays.
    """
    if text.strip().lower() == "none":
        _forget_sky(data)
        data.sky = Sky()
        return data
    advice = "write --sky none, one radiance such as 0.8, or three such as 0.7,0.85,1"
    numbers = _numbers(text, (1, 3), f"'{text}' is not a sky", advice)
    if min(numbers) < 0 or max(numbers) > BRIGHTEST:
        raise LuxelError(f"The sky's radiance must lie between 0 and {BRIGHTEST:g}, not '{text}'.")
    _forget_sky(data)
    data.sky = Sky((numbers[0], numbers[len(numbers) // 2], numbers[-1]))
    return data


def apply_envmap(data: SceneData, file: str | Path) -> SceneData:
    """Replace the sky by a latitude-longitude image (EXR, HDR, PNG, JPEG; 8-bit ones are read as sRGB).

    Row 0 is the zenith, the centre looks along -Z. Pixels that are no finite number are mended, with a warning. Suns
    are cut out of it and become lights. A default sun goes with the default sky. Returns `data`. Raises `LuxelError`
    where it cannot be read or no pixel is finite or positive.
    """
    path = Path(file)
    if path.is_dir():
        raise LuxelError(f"'{path}' is a folder; name the environment map in it: an EXR, HDR, PNG or JPEG image.")
    if not path.is_file():
        raise LuxelError(f"There is no environment map '{path}'; give an EXR, HDR, PNG or JPEG image.")
    from luxel import runtime

    runtime.start("auto")
    import mitsuba as mi

    from luxel.scene.mitsuba.log import catch_warnings
    from luxel.scene.sky_image import repair_sky_image
    from luxel.scene.sky_suns import part_suns, sky_lights

    try:
        with catch_warnings() as heard:
            bitmap = mi.Bitmap(str(path))
            pixels = np.array(bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False))
    except Exception as error:
        raise LuxelError(f"'{path}' cannot be read as an image; give an EXR, HDR, PNG or JPEG file.") from error
    image, mended = repair_sky_image(pixels, f"Environment map '{path}'")
    _forget_sky(data)
    data.warnings += [*heard.sentences(), *mended]
    data.sky = part_suns(Sky((1.0, 1.0, 1.0), image=image))
    data.lights = [*data.lights, *sky_lights(data.sky)]
    return data


# --- cameras -------------------------------------------------------------------------------------------------------


def parse_camera(text: str, data: SceneData) -> Camera:
    """Return the camera called `text`, or the one that "EYE;TARGET[;FOV]" describes, such as "-9,2,0;5,2.5,0;65".

    A name in another letter case serves where it fits one camera only.
    """
    wanted = text.strip()
    for camera in data.cameras:
        if camera.name == wanted:
            return camera
    alike = [camera for camera in data.cameras if camera.name.casefold() == wanted.casefold()]
    if len(alike) == 1:
        return alike[0]
    if alike:
        names = ", ".join(f"'{camera.name}'" for camera in alike)
        raise LuxelError(
            f"Scene '{data.name}' has {len(alike)} cameras called '{wanted}' in other letter cases: {names}."
        )
    if ";" not in text:
        names = ", ".join(f"'{camera.name}'" for camera in data.cameras) or "none of its own"
        raise LuxelError(
            f"Scene '{data.name}' has no camera '{text}'; it has {names}, or write EYE;TARGET[;FOV] "
            "such as '-9,2,0;5,2.5,0;65'."
        )
    parts = text.split(";")
    what, advice = f"'{text}' is not a camera", "write EYE;TARGET[;FOV] such as '-9,2,0;5,2.5,0;65'"
    if len(parts) > 3:
        raise LuxelError(f"{what}; {advice}.")
    eye, target = (_numbers(part, (3,), what, advice) for part in parts[:2])
    return _free_camera(text, eye, target, _numbers(parts[2], (1,), what, advice)[0] if len(parts) == 3 else FREE_FOV)


def parse_flight_path(text: str) -> tuple[Camera, Camera]:
    """Return the first and the last view of a straight flight, "EYE;EYE;TARGET;TARGET[;FOV]".

    Raises LuxelError for anything else, and where one of the views looks nowhere.
    """
    parts = text.split(";")
    what = f"'{text}' is not a flight path"
    advice = "write EYE;EYE;TARGET;TARGET[;FOV] such as '-9,2,0;3,2.5,0;5,2.5,0;13,3,-3;65'"
    if len(parts) not in (4, 5):
        raise LuxelError(f"{what}; {advice}.")
    eyes, targets = ([_numbers(part, (3,), what, advice) for part in two] for two in (parts[:2], parts[2:4]))
    fov = _numbers(parts[4], (1,), what, advice)[0] if len(parts) == 5 else FREE_FOV
    first, last = (_free_camera(text, eye, target, fov) for eye, target in zip(eyes, targets, strict=True))
    return first, last


def _free_camera(text: str, eye: list[float], target: list[float], fov: float) -> Camera:
    """Return the camera that `text` describes. Raises LuxelError where there is none like it."""
    if not 1.0 <= fov <= 179.0:
        raise LuxelError(f"The camera's field of view must lie between 1 and 179 degrees, not {fov:g}.")
    if math.dist(eye, target) < 1e-9:
        raise LuxelError(f"The camera '{text}' looks nowhere: its eye and its target are the same point.")
    upright = math.hypot(eye[0] - target[0], eye[2] - target[2]) > 1e-6 * math.dist(eye, target)
    return Camera(_colour(eye), _colour(target), (0.0, 1.0, 0.0) if upright else (0.0, 0.0, -1.0), fov, name="custom")


def default_camera(data: SceneData, aspect: float = 1.0) -> Camera:
    """Return the scene's first camera, else one that fits its robust bounds: inside a room, in front of anything else.

    From in front, a picture of `aspect`, width over height, shows the bounds as a whole. Raises `LuxelError` where the
    scene has no triangle.
    """
    if data.cameras:
        return data.cameras[0]
    triangles = _triangles(data, 0.0)
    bounds = triangle_bounds(triangles)
    lo, hi = bounds.lower, bounds.upper
    centre, size = (lo + hi) / 2, hi - lo
    if _looks_like_a_room(triangles, lo, hi):
        along = 0 if size[0] >= size[2] else 2
        eye, target = centre.copy(), centre.copy()
        eye[1] = target[1] = lo[1] + 0.4 * size[1]
        # A building's bounds reach into its walls and beyond: as far back as the view from the middle is free.
        back = np.zeros(3)
        back[along] = -1.0
        free = min(_free_distance(triangles.corners, eye, back), 0.5 * size[along])
        eye[along], target[along] = centre[along] - 0.88 * free, hi[along]
        return Camera(_colour(eye), _colour(target), fov=75.0)
    towards = np.array(TOWARDS_VIEWER) / np.linalg.norm(TOWARDS_VIEWER)
    eye = centre + towards * max(_fitting_distance(size, towards, FRONT_FOV, aspect), 1e-3)
    return Camera(_colour(eye), _colour(centre), fov=FRONT_FOV)


def _fitting_distance(size: np.ndarray, towards: np.ndarray, fov: float, aspect: float) -> float:
    """Return how far along the unit `towards` (3,) from its middle all of a box of `size` (3,) is in the picture.

    `fov` is horizontal, in degrees; `aspect` is the picture's width over its height.
    """
    _, right, up, forward = camera_axes(Camera(_colour(towards), (0.0, 0.0, 0.0), fov=fov))
    corners = size * (np.indices((2, 2, 2)).reshape(3, 8).T - 0.5)
    half = math.tan(math.radians(fov / 2)) / FRAME
    beside, above = np.abs(corners @ right) / half, np.abs(corners @ up) / (half / aspect)
    return float((np.maximum(beside, above) - corners @ forward).max())


def _free_distance(corners: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> float:
    """Return the distance from `origin` (3,) along the unit `direction` (3,) to the nearest triangle, or infinity.

    Source: Möller and Trumbore 1997, "Fast, minimum storage ray-triangle intersection".
    """
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    h = np.cross(direction, b)
    volume = np.einsum("ij,ij->i", a, h)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / volume
        s = origin - corners[:, 0]
        u = np.einsum("ij,ij->i", s, h) * inverse
        q = np.cross(s, a)
        v = q @ direction * inverse
        t = np.einsum("ij,ij->i", b, q) * inverse
        hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 1e-6)
    return float(t[hit].min(initial=np.inf))


def _looks_like_a_room(triangles: Triangles, lo: np.ndarray, hi: np.ndarray) -> bool:
    """Return whether at least three sides of the bounds are lined by triangles that face inwards."""
    size = np.maximum(hi - lo, 1e-9)
    corners = triangles.corners[Box(lo - 1e-3 * size, hi + 1e-3 * size).touches(triangles.low, triangles.high)]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    place = (corners.mean(axis=1) - lo) / size
    face = np.array([size[1] * size[2], size[2] * size[0], size[0] * size[1]])
    lined = [
        (
            np.maximum(doubled[:, axis], 0)[place[:, axis] < 0.15].sum() / 2 > 0.3 * face[axis],
            np.maximum(-doubled[:, axis], 0)[place[:, axis] > 0.85].sum() / 2 > 0.3 * face[axis],
        )
        for axis in range(3)
    ]
    return int(np.sum(lined)) >= 3


def scene_bounds(data: SceneData, times: tuple[float, ...] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return (lo, hi), each (3,) float64: the box around all triangles at `times` (None: nine over the duration).

    Strays count in full, so no length is to be taken from it: `scene/bounds.py` has the robust bounds.
    Raises `LuxelError` where the scene has no triangle.
    """
    if times is None:
        moves = data.duration > 0
        times = tuple(np.linspace(0.0, data.duration, 9)) if moves else (0.0,)
    found = [_triangles(data, time) for time in times]
    lows = [triangles.low.min(axis=0) for triangles in found]
    highs = [triangles.high.max(axis=0) for triangles in found]
    return np.min(lows, axis=0), np.max(highs, axis=0)


def _triangles(data: SceneData, time: float) -> Triangles:
    """Return all triangles at `time` seconds, world space. Raises `LuxelError` where there is none."""
    corners = world_corners(data, time)
    if not len(corners):
        raise LuxelError(f"Scene '{data.name}' has no triangles; there is nothing to look at.")
    return Triangles(corners)


# --- text ----------------------------------------------------------------------------------------------------------


def _numbers(text: str, counts: tuple[int, ...], what: str, advice: str) -> list[float]:
    """Read comma-separated finite numbers. Raises `LuxelError` "what; advice." where they are not so many."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts or not all(math.isfinite(number) for number in numbers):
        raise LuxelError(f"{what}; {advice}.")
    return numbers


def _colour(values) -> Colour:
    return (float(values[0]), float(values[1]), float(values[2]))
