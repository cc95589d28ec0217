"""The looks that every method has: light taken apart, the surfaces in view, and the distance to the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import numpy as np

from luxel.image.layers import Layers
from luxel.image.tonemap import to_display
from luxel.inspect.looks.legend import Legend, Scale, ceil_nice, fit_scale
from luxel.inspect.looks.shot import Shot
from luxel.inspect.ramps import colorize, id_colors
from luxel.methods.inspect import Look
from luxel.scene.colours import luminance

Drawn = tuple[np.ndarray, Legend | None]
Span = tuple[float, float] | None

NOTHING = np.array((0.075, 0.082, 0.094), np.float32)
"""Displayed colour of pixels without a surface, where colours mean numbers: no ramp has it."""
RADIANCE, IRRADIANCE = "W/(m² sr)", "W/m²"
SHADE = 0.6
"""Brightness of surfaces seen edge-on in looks whose colours are names: enough to tell shapes by."""
BACKDROP = 0.2
"""Brightness that the image has behind discs and spheres whose colours are not light; and that its shapes add."""
NAMES_MOST = 16
"""Objects that a legend lists."""


@dataclass(frozen=True)
class FrameLook:
    """A look of every method, and how it is drawn."""

    look: Look
    draw: Callable[[Shot, Look, Span], Drawn]


# ---------- Light ----------


def draw_light(values: np.ndarray, shot: Shot, title: str, unit: str, factor: float = 1.0) -> tuple[np.ndarray, Legend]:
    """Return light (H, W, 3) times `factor` at the shot's exposure, with a scale in the light's own unit."""
    exposure = shot.exposure * factor
    legend = Legend(title, unit, Scale(0.0, 1.0 / exposure), "light")
    return to_display(values, exposure), legend


def _draw_image(shot: Shot, look: Look, span: Span) -> Drawn:
    return to_display(shot.image, shot.exposure), None


def _draw_direct(shot: Shot, look: Look, span: Span) -> Drawn:
    layers = shot.layers
    light = layers.emission + layers.albedo / np.pi * layers.direct
    return draw_light(light, shot, look.doc, RADIANCE)


def _draw_indirect(shot: Shot, look: Look, span: Span) -> Drawn:
    return draw_light(shot.layers.indirect_radiance(), shot, look.doc, RADIANCE)


def _draw_irradiance(shot: Shot, look: Look, span: Span) -> Drawn:
    image, legend = draw_light(shot.layers.indirect, shot, look.doc, IRRADIANCE, 1.0 / np.pi)
    return on_surfaces(image, shot.layers.hit), legend


# ---------- Surfaces ----------


def on_surfaces(image: np.ndarray, hit: np.ndarray) -> np.ndarray:
    """Return `image` (H, W, 3) where a surface is, and the colour of nothing elsewhere."""
    return np.where(hit[..., None], image, NOTHING).astype(np.float32)


def shaded(colors: np.ndarray, shot: Shot) -> np.ndarray:
    """Return displayed colours darkened where their surface turns away from the eye."""
    surface = shot.gbuffer.surface
    facing = shot.film.to_image(dr.abs(dr.dot(surface.n_shading, surface.wo)))
    return (colors * (SHADE + (1.0 - SHADE) * facing[..., None])).astype(np.float32)


def backdrop(shot: Shot) -> np.ndarray:
    """Return the image in dim greys, (H, W, 3) displayed: a ground on which colours stand out, in dark scenes too."""
    grey = luminance(to_display(shot.image, shot.exposure))[..., None]
    shape = shaded(np.ones((*grey.shape[:2], 3)), shot)
    return np.where(shot.layers.hit[..., None], BACKDROP * (grey + shape), NOTHING).astype(np.float32)


def _draw_albedo(shot: Shot, look: Look, span: Span) -> Drawn:
    return on_surfaces(to_display(shot.layers.albedo), shot.layers.hit), None


def _draw_normals(shot: Shot, look: Look, span: Span) -> Drawn:
    normals = shot.film.to_image(shot.gbuffer.surface.n_shading)
    axes = np.eye(3)
    entries = [
        (f"{sign}{name}", as_color(0.5 + 0.5 * way * axis))
        for name, axis in zip("XYZ", axes, strict=True)
        for sign, way in (("+", 1.0), ("-", -1.0))
    ]
    return on_surfaces(0.5 + 0.5 * normals, shot.layers.hit), Legend(look.doc, entries=tuple(entries))


def _draw_depth(shot: Shot, look: Look, span: Span) -> Drawn:
    hit = shot.layers.hit
    return draw_number(shot.film.to_image(shot.gbuffer.depth), hit, look, span)


def _draw_objects(shot: Shot, look: Look, span: Span) -> Drawn:
    ids = shot.film.to_image(shot.gbuffer.surface.object_id)
    seen, counts = np.unique(ids[shot.layers.hit], return_counts=True)
    host = shot.scene.host
    largest = seen[np.argsort(-counts)][:NAMES_MOST]
    entries = tuple((host.object_name(int(i)), as_color(id_colors(np.array(i)))) for i in largest)
    return on_surfaces(shaded(id_colors(ids), shot), shot.layers.hit), Legend(look.doc, entries=entries)


def as_color(values: np.ndarray) -> tuple[float, float, float]:
    """Return three numbers as a colour of a legend."""
    red, green, blue = (float(value) for value in values)
    return red, green, blue


# ---------- Numbers ----------


def draw_number(values: np.ndarray, shown: np.ndarray, look: Look, span: Span, ramp: str = "field") -> Drawn:
    """Return `values` (H, W) by the colours of a ramp where `shown`, and their scale."""
    scale = fit_scale(values[shown], look.span if span is None else span, look.logarithmic)
    image = on_surfaces(colorize(scale.place(np.where(shown, values, scale.low)), ramp), shown)
    return image, Legend(look.doc, look.unit, scale, ramp)


def _draw_weight(shot: Shot, look: Look, span: Span) -> Drawn:
    return draw_number(shot.layers.weight, shot.layers.hit, look, span)


# ---------- Distance to the truth ----------


def _draw_error(shot: Shot, look: Look, span: Span) -> Drawn:
    truth = _truth(shot)
    difference = luminance(shot.layers.indirect_radiance()) - luminance(truth.indirect_radiance())
    if span is None:
        most = float(np.quantile(np.abs(difference[truth.hit]), 0.99)) if truth.hit.any() else 0.0
        end = ceil_nice(most) if most > 0.0 else 1.0
        span = (-end, end)
    return draw_number(difference, truth.hit, look, span, "signed")


def _draw_flip(shot: Shot, look: Look, span: Span) -> Drawn:
    from luxel.metrics.error import display_pair
    from luxel.metrics.flip import flip_values

    values = flip_values(*display_pair(shot.image, _truth(shot).image()))
    return draw_number(values, np.ones_like(shot.layers.hit), look, span, "heat")


def _truth(shot: Shot) -> Layers:
    assert shot.truth is not None  # `draw_look` has asked for it
    return shot.truth


FRAME_LOOKS = (
    FrameLook(Look("image", "the image", "light", RADIANCE), _draw_image),
    FrameLook(Look("direct", "what lamps and the sun give, and what shines itself", "light", RADIANCE), _draw_direct),
    FrameLook(Look("indirect", "what indirect light adds to the image", "light", RADIANCE), _draw_indirect),
    FrameLook(Look("irradiance", "indirect light on white", "light", IRRADIANCE), _draw_irradiance),
    FrameLook(Look("albedo", "diffuse reflectance", "mix"), _draw_albedo),
    FrameLook(Look("normals", "shading normals", "mix"), _draw_normals),
    FrameLook(Look("depth", "distance from the eye", "number", "m"), _draw_depth),
    FrameLook(Look("objects", "objects by name", "item"), _draw_objects),
    FrameLook(Look("weight", "how surely the method answers; 0: no answer", "number", "", (0.0, 1.0)), _draw_weight),
    FrameLook(Look("error", "indirect light minus the truth's", "number", RADIANCE), _draw_error),
    FrameLook(Look("flip", "FLIP: how plainly a viewer sees the difference to the truth", "cost"), _draw_flip),
)  # fmt: skip
NEEDS_TRUTH = frozenset({"error", "flip"})
