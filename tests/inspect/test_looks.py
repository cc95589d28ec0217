"""Every look of every method is drawn, and what it shows are the numbers that it says."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.image.tonemap import to_display
from luxel.inspect.looks import Shot, draw_look, list_looks, take_shot
from luxel.inspect.looks.cache import fit_tiles
from luxel.inspect.looks.frame import NEEDS_TRUTH, NOTHING
from luxel.inspect.looks.shot import surface_at_pixel
from luxel.inspect.ramps import colorize
from luxel.methods import METHODS, inspector_of
from luxel.render.renderer import Renderer

SIZE = 80
SETTINGS = {
    "gibs": {"surfel_target": 800},
    "ddgi": {"probe_target": 200, "extra_probes": 8, "num_samples_per_probe": 16},
    "ambient": {"irradiance": (0.3, 0.2, 0.1)},
    "lightmap": {"texel_target": 2048, "surfel_target": 512, "rays_per_texel": 128, "probe_target": 64},
}


@pytest.fixture(scope="module")
def shots() -> dict[str, Shot]:
    """A frame of each method, beside a truth that is half as bright."""
    made = {}
    for name in METHODS:
        renderer = Renderer("cornell-box", name, SETTINGS.get(name), size=(SIZE, SIZE), seed=1)
        renderer.run(12)
        layers = renderer.layers()
        half = replace(layers, direct=0.5 * layers.direct, indirect=0.5 * layers.indirect, emission=layers.emission)
        made[name] = take_shot(renderer, truth=half)
    return made


CASES = [(name, look.name) for name, method in METHODS.items() for look in list_looks(method)]


@pytest.mark.parametrize(("method", "name"), CASES)
def test_each_look_is_drawn(shots: dict[str, Shot], method: str, name: str) -> None:
    drawing = draw_look(name, shots[method])
    image = drawing.image
    assert image.shape == (SIZE, SIZE, 3) and image.dtype == np.float32
    assert np.isfinite(image).all() and image.min() >= 0.0 and image.max() <= 1.0
    assert drawing.look.doc and drawing.look.name == name
    whole = drawing.with_legend()
    assert whole.shape[1:] == (SIZE, 3) and (whole.shape[0] > SIZE) == (drawing.legend is not None)
    # Something is to be seen, but for what is one number everywhere.
    flat = method not in ("gibs", "ddgi") and name in ("weight", "irradiance") or name in ("weight", "certainty-atlas")
    flat |= method == "none" and name in ("indirect", "error")
    flat |= name in ("rays", "age")
    assert flat or np.unique(image.reshape(-1, 3), axis=0).shape[0] > 3


def test_names_are_unlike_and_said(shots: dict[str, Shot]) -> None:
    for method in METHODS.values():
        looks = list_looks(method)
        assert len({look.name for look in looks}) == len(looks) and all(look.doc for look in looks)
        assert {look.name for look in list_looks(method, truth=False)} == {look.name for look in looks} - NEEDS_TRUTH


def test_image_and_light_are_at_the_exposure(shots: dict[str, Shot]) -> None:
    shot = replace(shots["gibs"], exposure=3.0)
    layers = shot.layers
    np.testing.assert_allclose(draw_look("image", shot).image, to_display(layers.image(), 3.0), atol=1e-6)
    drawing = draw_look("irradiance", shot)
    shown = to_display(layers.indirect, 3.0 / np.pi)
    np.testing.assert_allclose(drawing.image[layers.hit], shown[layers.hit], atol=1e-5)
    assert drawing.legend is not None and drawing.legend.scale is not None
    # The scale's white end is the irradiance that is shown as white.
    assert drawing.legend.scale.high == pytest.approx(np.pi / 3.0) and drawing.legend.unit == "W/m²"
    # Direct and indirect light add up to the image.
    both = layers.indirect_radiance() + layers.emission + layers.albedo / np.pi * layers.direct
    np.testing.assert_allclose(both, layers.image(), rtol=1e-4, atol=1e-6)


def test_surfaces_are_what_they_are(shots: dict[str, Shot]) -> None:
    """The middle of the picture is the large box; high up beside it is the back wall, 4.9 m away."""
    shot = shots["none"]
    normals = draw_look("normals", shot).image
    np.testing.assert_allclose(normals[26, 60], (0.5, 0.5, 1.0), atol=0.01)
    drawing = draw_look("depth", shot, span=(0.0, 10.0))
    camera = shot.scene.host.data.cameras[0]
    column, row = (60 + 0.5) / SIZE * 2.0 - 1.0, 1.0 - (26 + 0.5) / SIZE * 2.0
    half = np.tan(np.deg2rad(camera.fov) / 2.0)
    distance = 4.9 * np.sqrt(1.0 + (half * column) ** 2 + (half * row) ** 2)
    np.testing.assert_allclose(drawing.image[26, 60], colorize(np.array(distance / 10.0)), atol=0.01)
    np.testing.assert_array_equal(drawing.image[0, 0], NOTHING)
    objects = draw_look("objects", shot).legend
    assert objects is not None and {name for name, _ in objects.entries} == {"room", "large-box", "small-box", "lamp"}


def test_too_bright_is_orange_and_too_dark_blue(shots: dict[str, Shot]) -> None:
    shot = shots["gibs"]
    assert shot.truth is not None
    lit = shot.layers.hit & (shot.layers.indirect_radiance().max(axis=2) > 0.02)
    over = draw_look("error", shot)
    assert (over.image[lit][:, 0] > over.image[lit][:, 2]).mean() > 0.99
    assert (
        over.legend is not None and over.legend.scale is not None and over.legend.scale.low == -over.legend.scale.high
    )
    under = draw_look("error", replace(shot, layers=shot.truth, truth=shot.layers)).image
    assert (under[lit][:, 2] > under[lit][:, 0]).mean() > 0.99
    none = draw_look("error", replace(shot, truth=shot.layers)).image
    np.testing.assert_allclose(none[lit], np.broadcast_to(none[lit][0], none[lit].shape), atol=0.01)
    assert draw_look("flip", replace(shot, truth=shot.layers)).image.max() < 0.25


def test_coverage_is_that_of_the_look_up(shots: dict[str, Shot]) -> None:
    """The picture shows what `query` answers now; the frame's own weight is one step older."""
    shot = shots["gibs"]
    drawing = draw_look("coverage", shot, span=(0.0, 8.0))
    answer = shot.method.query(shot.scene, shot.state, shot.gbuffer.surface)
    hit = shot.layers.hit
    expected = colorize(shot.film.to_image(answer.weight) / 8.0)
    np.testing.assert_allclose(drawing.image[hit], expected[hit], atol=1e-5)


def test_probe_weights_are_those_of_the_explanation(shots: dict[str, Shot]) -> None:
    """At single pixels: the heaviest share, and the mix of colours by the shares."""
    from luxel.methods.ddgi.looks import color_of_probe

    shot = shots["ddgi"]
    surface = shot.gbuffer.surface
    top = shot.film.to_image(inspector_of(shot.method).read(shot.scene, shot.state, surface, "top-share").value)
    mix = shot.film.to_image(inspector_of(shot.method).read(shot.scene, shot.state, surface, "probe-shares").value)

    for x, y in ((40, 40), (20, 60), (60, 26), (64, 70), (12, 40)):
        found = inspector_of(shot.method).explain(shot.scene, shot.state, surface_at_pixel(shot, x, y)[0])
        assert sum(item.weight for item in found) == pytest.approx(1.0, abs=1e-3)
        assert top[y, x] == pytest.approx(max(item.weight for item in found), abs=2e-3)
        colors = np.array(color_of_probe(mi.UInt32([item.item for item in found]))).T
        expected = sum(item.weight * color for item, color in zip(found, colors, strict=True))
        np.testing.assert_allclose(mix[y, x], expected, atol=3e-3)


def test_drawing_changes_nothing(shots: dict[str, Shot]) -> None:
    """Two runs, one of which is looked at in every way after each frame, end alike and record nothing more."""
    ends = []
    for looking in (False, True):
        renderer = Renderer("cornell-box", "gibs", {"surfel_target": 300}, size=(32, 32), seed=1)
        renderer.run(10)
        recorded = renderer.compilations
        for _ in range(3):
            if looking:
                shot = take_shot(renderer)
                for look in list_looks(renderer.method, truth=False):
                    draw_look(look.name, shot)
            renderer.run(1)
        assert renderer.compilations == recorded
        ends.append(renderer.layers())
    # Threads add up in any order: equal but for the last bits.
    np.testing.assert_allclose(ends[0].indirect, ends[1].indirect, atol=0.02)


def test_what_cannot_be_drawn_is_refused(shots: dict[str, Shot]) -> None:
    shot = shots["none"]
    with pytest.raises(LuxelError, match="'none' has no look 'surfels'.*image, direct"):
        draw_look("surfels", shot)
    with pytest.raises(LuxelError, match="'error' compares with the truth"):
        draw_look("error", replace(shot, truth=None))
    for span in ((1.0, 1.0), (0.0, float("nan")), (2.0, 1.0)):
        with pytest.raises(LuxelError, match="cannot be drawn"):
            draw_look("depth", shot, span=span)
    with pytest.raises(LuxelError, match="nothing has been rendered"):
        take_shot(Renderer("cornell-box", "none", size=(16, 16)))
    other = Renderer("cornell-box", "none", size=(16, 16))
    other.run(1)
    with pytest.raises(LuxelError, match="80x80.*16x16"):
        take_shot(other, truth=shot.layers)


def test_a_view_of_nothing_is_drawn() -> None:
    """Looking away from everything: no quantile of no pixel, no legend without an end."""
    from luxel.scene.model import Camera

    renderer = Renderer(
        "cornell-box", "gibs", {"surfel_target": 300}, size=(32, 32), camera=Camera((0, 0, 9), (0, 0, 20))
    )
    renderer.run(2)
    shot = take_shot(renderer, truth=renderer.layers())
    assert not shot.layers.hit.any()
    for look in list_looks(renderer.method):
        assert np.isfinite(draw_look(look.name, shot).with_legend()).all()


@pytest.mark.parametrize(
    ("count", "shape", "size"), [(5, (4, 6), (64, 64)), (9, (80, 100), (40, 64)), (1, (300, 2), (32, 32))]
)
def test_sheets_fit_their_picture(count: int, shape: tuple[int, int], size: tuple[int, int]) -> None:
    """Every tile is there, all of one size, none over another."""
    tiles = [np.full((*shape, 3), (index + 1) / 10.0, np.float32) for index in range(count)]
    picture = fit_tiles(tiles, *size)
    assert picture.shape == (*size, 3)
    found = [np.abs(picture - (index + 1) / 10.0).max(axis=2) < 1e-4 for index in range(count)]
    areas = [int(mask.sum()) for mask in found]
    assert min(areas) > 0 and len(set(areas)) == 1
    if count == 5:  # two across and three down, each texel 5 x 5 pixels: 62 of 64 pixels across, all 64 down
        assert areas[0] == 4 * 6 * 25


def test_the_chosen_point_is_ringed_and_what_lights_it_coloured(shots: dict[str, Shot]) -> None:
    """Seen from the floor: walls have colours, the floor itself is grey; another point, another picture."""
    shot = shots["lightmap"]
    floor = replace(shot, point=surface_at_pixel(shot, 40, 74)[0])
    drawing = draw_look("clusters", floor)
    image = drawing.image
    assert drawing.legend is not None and drawing.legend.entries and "light one texel" in drawing.legend.title
    white = np.argwhere(image.min(axis=2) > 0.95)
    np.testing.assert_allclose(white.mean(axis=0), (74, 40), atol=1.5)
    told = inspector_of(floor.method).sources(floor.scene, floor.state, floor.chosen_point, floor.gbuffer.surface)
    answered = floor.film.to_image(told.answered).astype(bool) & floor.layers.hit
    upward = floor.film.to_image(floor.gbuffer.surface.n_geometric)[..., 1] > 0.9
    beside = np.hypot(*(np.mgrid[:SIZE, :SIZE] - np.array([74, 40])[:, None, None])) > 10.0
    spread = image.max(axis=2) - image.min(axis=2)
    low = upward & (floor.film.to_image(floor.gbuffer.surface.p)[..., 1] < -0.9)
    assert answered[~low].mean() > 0.05 and not answered[low].any()
    assert spread[answered & beside].mean() > 0.1 and spread[low & beside].max() < 0.02
    other = draw_look("clusters", replace(shot, point=surface_at_pixel(shot, 8, 40)[0])).image
    assert np.abs(other - image).mean() > 0.02


def test_a_point_that_has_no_surface_is_told_so(shots: dict[str, Shot]) -> None:
    shot = shots["lightmap"]
    drawing = draw_look("clusters", replace(shot, point=surface_at_pixel(shot, 0, 0)[0]))
    assert drawing.legend is not None and "No surface" in drawing.legend.title
    assert (drawing.image.max(axis=2) - drawing.image.min(axis=2)).max() < 0.03
    with pytest.raises(LuxelError, match="outside the image"):
        take_shot(make_small_frame(), pixel=(16, 0))


def make_small_frame() -> Renderer:
    renderer = Renderer("cornell-box", "none", size=(16, 16))
    renderer.run(1)
    return renderer
