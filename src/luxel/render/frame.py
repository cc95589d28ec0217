"""The frame, top to bottom, as pure functions of what they are given.

    scene(t) -> update -> g-buffer -> shade -> direct light -> compose -> observe

`render_frame` is the whole of it; `render_view` is one camera's part. `shared.py` records and replays both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from numbers import Integral
from typing import Any

import drjit as dr
import mitsuba as mi

from luxel.errors import LuxelError
from luxel.image.layers import Layers
from luxel.kernels.camera import Pinhole
from luxel.kernels.direct import direct_irradiance
from luxel.kernels.film import Film
from luxel.kernels.gbuffer import GBuffer, trace_gbuffer
from luxel.kernels.history import frames_kept, running_mean
from luxel.kernels.pixel_filter import filter_offset
from luxel.kernels.records import PathLight
from luxel.kernels.reproject import LastView, find_taps, forget, remember
from luxel.methods.base import Frame, Light, Method
from luxel.scene.choice import check_filter
from luxel.scene.device import Scene, choose_layer
from luxel.stages import stage

SIZE_LIMIT = 16384

LEAST_ALBEDO = 1e-4
"""Albedo that radiance is divided by for its irradiance, at the least."""
LAYERS_WARM = 64
"""Frames of a still view after which each weighs the same in the mean of what it has seen."""
SEEN = ("albedo", "emission", "direct")
"""Parts of a picture that no cache has a say in."""
DRAWN = (*SEEN, "indirect", "glossy", "weight")
"""All parts that an image is made of."""


@dataclass
class ViewState:
    """One camera's part of a frame: where it looks, and the running mean of its noisy direct light."""

    camera: Pinhole
    before: Pinhole
    frame: Frame
    direct: mi.Color3f
    direct_count: mi.UInt32
    mean: Picture | None = None
    """What a still view has seen, averaged: with a pixel filter, and of blended surfaces' stochastic layers."""
    last: LastView | None = None
    """What its pixels saw one frame ago; None unless the method reprojects."""


@dataclass
class Picture:
    """The layers of a finished frame, in tile order."""

    albedo: mi.Color3f
    emission: mi.Color3f
    direct: mi.Color3f
    indirect: mi.Color3f
    glossy: mi.Color3f
    weight: mi.Float
    hit: mi.Bool
    depth: mi.Float
    """Distance from the eye, metres; infinite for a miss."""
    normal: mi.Normal3f
    """World unit shading normal, on the viewer's side."""
    throughput: mi.Color3f | None = None
    """What the specular chain lets through; None where none is followed. Albedo and glossy are weighed by it."""


def render_frame(
    method: Method, film: Film, scene: Scene, state: Any, screen: Any, view: ViewState
) -> tuple[Any, Any, ViewState, Picture]:
    """Advance everything by one frame. Returns the next state, screen and view, and the picture."""
    # Advance the world: the method's caches, without a camera.
    state = advance_world(method, scene, state, view.frame)
    return render_view(method, film, scene, state, screen, view)


def advance_world(method: Method, scene: Scene, state: Any, frame: Frame) -> Any:
    """Return the method's state after one frame of the world."""
    return method.update(choose_layer(scene, layer_seed(frame)), state, frame)


def render_view(
    method: Method, film: Film, scene: Scene, state: Any, screen: Any, view: ViewState, learn: bool = True
) -> tuple[Any, Any, ViewState, Picture]:
    """Look at the world as it is; of its state, only what the method learns from the view changes.

    Several cameras may look at one state in turn. `learn` False leaves the state alone. Returns as `render_frame`.
    """
    # A pixel filter sends each frame's rays through other points of the pixels, and of blended surfaces each frame
    # sees one layer: what stands still is the view, not the surface behind a pixel. So whatever a method would average
    # there waits for the mean of the pictures at the end.
    frame = view.frame
    scene = choose_layer(scene, layer_seed(frame))
    filtered, averaged = film.is_filtered, averages(film, scene)
    seen = frames_kept(frame.still, view.direct_count)
    if averaged:
        frame = replace(frame, still=mi.Bool(False))

    # See through the pixels: by their centres, or while all stands still by the points of the filter.
    with stage("gbuffer") as current:
        offset = film.spread * filter_offset(film.filter, seen) if filtered else None
        gbuffer = trace_gbuffer(scene, film, view.camera, view.before, offset)
        last = None
        if method.reprojects(state):
            before = forget(film) if view.last is None else view.last
            gbuffer = replace(gbuffer, taps=find_taps(scene, film, gbuffer, view.before, before))
            last = remember(gbuffer, offset)
        current.keep(*seen_fields(gbuffer), gbuffer.taps, last)
    surface = gbuffer.surface

    # Ask the method for the indirect light there.
    light, screen = method.shade(scene, state, screen, frame, gbuffer)
    if not isinstance(light, Light):
        raise LuxelError(
            f"method '{method.name}' answers with {type(light).__name__}; it must be a luxel.methods.Light "
            "of irradiance, radiance and weight"
        )

    # Light it directly; a still view averages the noise away over the frames.
    with stage("direct") as current:
        direct, count = mi.Color3f(0.0), mi.UInt32(0)
        if light.seen is None and "direct" not in method.holds:
            seed = frame.seed + frame.index * 0x2545F491
            turn = frame.index, frame.seed
            fresh = direct_irradiance(scene, surface, seed, gbuffer.lane, surface.active, turn)
            count = frames_kept(frame.still, view.direct_count)
            direct = running_mean(view.direct, fresh, count)
        current.keep(direct)

    # Compose the picture.
    with stage("compose") as current:
        picture = Picture(
            albedo=surface.albedo,
            emission=surface.emission + gbuffer.background,
            direct=direct,
            indirect=light.irradiance,
            glossy=light.radiance,
            weight=light.weight,
            hit=surface.active,
            depth=gbuffer.depth,
            normal=surface.n_shading,
        )
        if light.seen is not None:
            picture = replace(picture, **separate(light.seen))
        mean = view.mean
        if averaged:
            steady = DRAWN if filtered and method.progressive else SEEN if filtered else ()
            picture, mean = average_layers(mean, picture, view.frame.still, seen, steady)
            count = seen
        current.keep(picture)

    # Let the method learn from what this camera saw.
    if learn:
        state = method.observe(scene, state, frame, gbuffer, light)
    return state, screen, replace(view, direct=direct, direct_count=count + 1, mean=mean, last=last), picture


def average_layers(
    before: Picture | None, fresh: Picture, still: mi.Bool, count: mi.UInt32, steady: tuple[str, ...] = ()
) -> tuple[Picture, Picture]:
    """Return the picture of all that a still view has seen, and the means to go on with.

    `before` are the means over `count` frames, 0 where it does not stand still. Irradiances are averaged times albedo,
    as each surface reflects by its own: the image is the mean of the frames' images, and layers are what gives it.
    Until `LAYERS_WARM` frames are seen the recent ones weigh more, since a cache is still filling in the first; all
    frames weigh the same in the fields `steady`.
    """
    products = replace(fresh, direct=fresh.albedo * fresh.direct, indirect=fresh.albedo * fresh.indirect)
    before = products if before is None else before
    n = mi.Float(count)
    # Both forms give 1/17 at 64 frames; from there on it is a plain running mean.
    share = dr.select(n < LAYERS_WARM, 4.0 / (n + 4.0), 1.0 / dr.fmax(n - (0.75 * LAYERS_WARM - 1.0), 1.0))
    kept = frames_kept(still, count)
    first = kept == 0

    def average(name: str) -> Any:
        return running_mean(getattr(before, name), getattr(products, name), kept, None if name in steady else share)

    names = DRAWN if fresh.throughput is None else (*DRAWN, "throughput")
    means = {name: average(name) for name in names}
    mean = replace(products, **means, hit=fresh.hit | (still & before.hit))
    if steady:
        # Only the first of a filter's rays went through the pixel's centre; and beside a surface no method answers.
        centre = {name: dr.select(first, getattr(fresh, name), getattr(before, name)) for name in ("depth", "normal")}
        mean = replace(mean, **centre, weight=dr.select(first | fresh.hit, fresh.weight, before.weight))

    def demodulated(product: mi.Color3f, layer: mi.Color3f) -> mi.Color3f:
        return dr.select(mean.albedo > LEAST_ALBEDO, product / dr.fmax(mean.albedo, LEAST_ALBEDO), layer)

    picture = replace(
        mean, direct=demodulated(mean.direct, fresh.direct), indirect=demodulated(mean.indirect, fresh.indirect)
    )
    return picture, mean


def separate(light: PathLight) -> dict[str, mi.Color3f]:
    """Return the layers of a picture whose light paths have followed whole: irradiances come from radiance by albedo.

    Where next to no albedo is, what would be divided by it goes to the glossy layer: the composed picture is right.
    """
    has = light.albedo > LEAST_ALBEDO
    irradiance = dr.select(has, dr.pi / dr.fmax(light.albedo, LEAST_ALBEDO), 0.0)
    rest = dr.select(has, 0.0, light.direct + light.indirect)
    return {
        "albedo": light.albedo,
        "emission": light.emission,
        "direct": light.direct * irradiance,
        "indirect": light.indirect * irradiance,
        "glossy": light.glossy + rest,
        "throughput": light.throughput,
    }


def averages(film: Film, scene: Scene) -> bool:
    """Return whether what a still view shows is the mean of its frames' images."""
    return film.is_filtered or scene.features.blended


def blank_picture(film: Film, scene: Scene, method: Method) -> Picture:
    """Return a black picture of what `method` shows of `scene`: the mean of no frames."""
    lanes = film.lane_count
    picture = Picture(
        *(dr.zeros(mi.Color3f, lanes) for _ in range(5)),
        weight=dr.zeros(mi.Float, lanes),
        hit=dr.zeros(mi.Bool, lanes),
        depth=dr.zeros(mi.Float, lanes),
        normal=dr.zeros(mi.Normal3f, lanes),
        throughput=dr.zeros(mi.Color3f, lanes) if scene.features.gloss and method.shows_gloss else None,
    )
    dr.make_opaque(picture)
    return picture


def layer_seed(frame: Frame) -> mi.UInt32:
    """Return the number of the layer of blended surfaces that a frame sees."""
    return frame.seed + frame.index * 0x68E31DA4


def seen_fields(gbuffer: GBuffer) -> list[Any]:
    """Return what every frame needs of the g-buffer; the rest is computed only where a method asks for it."""
    surface = gbuffer.surface
    shape = [surface.p, surface.n_geometric, surface.n_shading, surface.prim_id, surface.barycentric, surface.front]
    return [*shape, surface.albedo, surface.emission, surface.active, gbuffer.background, gbuffer.depth]


def take_apart(picture: Picture, film: Film) -> Layers:
    """Return a picture's layers as arrays of `film`'s size; waits for it."""
    plane = film.to_image
    return Layers(
        albedo=plane(picture.albedo),
        emission=plane(picture.emission),
        direct=plane(picture.direct),
        indirect=plane(picture.indirect),
        glossy=plane(picture.glossy),
        weight=plane(picture.weight),
        hit=plane(picture.hit).astype(bool),
        throughput=None if picture.throughput is None else plane(picture.throughput),
    )


def make_film(size: tuple[int, int], filter: str = "none", spread: float = 1.0) -> Film:
    """Return the film of (width, height), `filter` and `spread` as `Film` has them.

    Raises LuxelError for a size that cannot be rendered, and for an unknown filter.
    """
    check_filter(filter)
    pair = isinstance(size, tuple | list) and len(size) == 2
    if not (pair and all(isinstance(side, Integral) and not isinstance(side, bool) for side in size)):
        raise LuxelError(f"size {size!r} is no size: give two whole numbers (width, height), such as (128, 128)")
    width, height = size
    if not (1 <= width <= SIZE_LIMIT and 1 <= height <= SIZE_LIMIT):
        raise LuxelError(f"size {width}x{height} cannot be rendered: width and height go from 1 to {SIZE_LIMIT}")
    return Film(int(width), int(height), filter, spread)
