"""The automatic exposure: what counts, against arithmetic on pictures that are made by hand."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import luxel
from luxel.cli import options
from luxel.errors import LuxelError
from luxel.image.layers import Layers
from luxel.render.exposure import Exposure, auto_exposure, resolve_exposure
from luxel.render.frame import Picture, make_film
from luxel.viewer.display import DisplayEncoder

SIZE = 64


def wall(luminance: float = 0.4) -> Layers:
    """Return a white wall that fills the picture and reflects `luminance`."""
    black, shape = np.zeros((SIZE, SIZE, 3), np.float32), (SIZE, SIZE, 3)
    return Layers(
        albedo=np.ones(shape, np.float32),
        emission=black.copy(),
        direct=np.full(shape, np.pi * luminance, np.float32),
        indirect=black.copy(),
        glossy=black.copy(),
        weight=np.ones(shape[:2], np.float32),
        hit=np.ones(shape[:2], bool),
    )


def brighten(layers: Layers, rows: int, factor: float) -> Layers:
    layers.direct[:rows] *= factor
    return layers


def test_an_even_wall_is_middle_grey() -> None:
    assert auto_exposure(wall(0.4)) == pytest.approx(0.18 / 0.4)
    for scale in (1e-6, 1e6):
        assert auto_exposure(wall(0.4 * scale)) == pytest.approx(0.45 / scale)


@pytest.mark.parametrize("sky", [0.0, 1e-3, 40.0, np.inf])
def test_the_background_does_not_count(sky: float) -> None:
    layers = wall()
    layers.hit[:40], layers.albedo[:40], layers.emission[:40] = False, 0.0, sky
    assert auto_exposure(layers) == pytest.approx(0.45)


@pytest.mark.parametrize("albedo", [0.0, 1.0])
def test_a_lamp_counts_by_what_it_reflects(albedo: float) -> None:
    layers = wall()
    layers.emission[10:30], layers.albedo[10:30] = 500.0, albedo
    assert auto_exposure(layers) == pytest.approx(0.45)


@pytest.mark.parametrize("factor", [20.0, 1e4])
def test_a_patch_of_sun_leaves_the_room_as_it_is(factor: float) -> None:
    assert auto_exposure(brighten(wall(), 5, factor)) == pytest.approx(0.45)


@pytest.mark.parametrize("factor", [0.0, 1e-3])
def test_a_room_seen_from_a_dark_outside_is_shown_as_from_within(factor: float) -> None:
    assert auto_exposure(brighten(wall(), 48, factor)) == pytest.approx(0.45, rel=0.02)


def test_a_sunlit_window_that_grows_brighter_darkens_the_room_bit_by_bit() -> None:
    """A sixth of the picture, 30 to 120 times as bright as the room: no step at any brightness."""
    found = np.array([auto_exposure(brighten(wall(), 11, factor)) for factor in np.arange(30.0, 120.0)])
    steps = found[:-1] / found[1:]
    assert steps.min() >= 1.0 and steps.max() < 1.1


def test_two_lit_halves_share_the_exposure() -> None:
    # 0.4 and 0.1: the brightest tenth lies within the first half.
    assert auto_exposure(brighten(wall(), 32, 0.25)) == pytest.approx(0.18 / 0.25)


def test_noise_of_single_pixels_has_no_say() -> None:
    """A path tracer's first sample: one pixel in ten brings ten times the light, the others none."""
    rng, layers = np.random.default_rng(1), wall()
    layers.direct = np.full((512, 512, 3), np.pi * 0.4) * 10.0 * (rng.random((512, 512, 1)) < 0.1)
    layers.albedo, layers.hit = np.ones((512, 512, 3)), np.ones((512, 512), bool)
    layers.emission = layers.indirect = layers.glossy = np.zeros((512, 512, 3))
    assert auto_exposure(layers) == pytest.approx(0.45, rel=0.03)


def test_what_only_shines_is_shown_by_its_shine() -> None:
    layers = wall()
    layers.emission, layers.albedo = layers.albedo * 0.4, layers.albedo * 0.0
    layers.hit[:20], layers.emission[:20] = False, 90.0
    assert auto_exposure(layers) == pytest.approx(0.45)
    layers.hit[:], layers.emission[:] = False, 0.2
    assert auto_exposure(layers) == pytest.approx(0.9)


def test_black_and_broken_pictures_have_an_exposure() -> None:
    assert auto_exposure(wall(0.0)) == 1.0
    layers = wall()
    layers.direct[:7] = np.nan
    assert auto_exposure(layers) == pytest.approx(0.45)
    assert auto_exposure(np.full((300, 3), 0.4)) == pytest.approx(0.45)
    assert auto_exposure(np.zeros((0, 3))) == 1.0


def test_stops_are_counted_from_the_automatic_exposure() -> None:
    assert resolve_exposure(Exposure(stops=1.5), wall()) == pytest.approx(0.45 * 2.0**1.5)
    assert resolve_exposure(None, wall()) == pytest.approx(0.45)
    assert resolve_exposure(3.0, wall()) == 3.0
    assert options.parse_exposure("+1.5ev") == Exposure(stops=1.5)
    assert options.parse_exposure(" -2 EV ") == Exposure(stops=-2.0)
    for text in ("ev", "nanev", "infev", "+1e9ev", "1.5stops", "-2", "0", ""):
        with pytest.raises(LuxelError, match="--exposure"):
            options.parse_exposure(text)


@pytest.mark.parametrize("size", [(64, 48), (33, 65), (20, 12)])
def test_the_viewer_meters_as_the_image_does(size: tuple[int, int]) -> None:
    """Sums on the device against NumPy's, on a picture with background, lamp and surfaces."""
    renderer = luxel.Renderer("cornell-box", "none", size=size)
    renderer.run(2)
    picture = renderer._view.picture  # pyright: ignore[reportPrivateUsage]
    assert picture is not None
    _, meter = DisplayEncoder().encode(renderer.film, picture, "albedo", 1.0)
    layers = renderer.layers()
    assert meter.exposure() == pytest.approx(auto_exposure(layers), rel=1e-4)
    assert meter.count[1].sum() == layers.hit.sum() and meter.count[2].sum() == size[0] * size[1]


def test_the_viewer_meters_what_a_very_bright_lamp_reflects() -> None:
    """Lamps of radiance 3e7 that reflect 0.4 fill the picture: in single precision their sum holds nothing of it."""
    film = make_film((32, 32))
    lanes = film.lane_count

    def color(value: float) -> mi.Color3f:
        return mi.Color3f(*(dr.full(mi.Float, value, lanes) for _ in range(3)))

    picture = Picture(
        albedo=color(1.0), emission=color(3e7), direct=color(np.pi * 0.4), indirect=color(0.0), glossy=color(0.0),
        weight=dr.full(mi.Float, 1.0, lanes), hit=dr.full(mi.Bool, True, lanes), depth=dr.full(mi.Float, 1.0, lanes),
        normal=mi.Normal3f(0.0, 1.0, 0.0),
    )  # fmt: skip
    _, meter = DisplayEncoder().encode(film, picture, "albedo", 1.0)
    assert meter.exposure() == pytest.approx(0.45, rel=1e-4)
