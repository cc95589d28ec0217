"""What DDGI shows of its probes agrees with its state and with the scene."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.kernels.trace import trace_closest
from luxel.methods.ddgi.atlas import texel_direction
from luxel.methods.ddgi.params import MAX_OFFSET
from luxel.methods.ddgi.state import ASLEEP, AWAKE, DEAD, UNUSED, DdgiState
from luxel.methods.ddgi.views import STATE_COLORS, YELLOW, probe_views, relative_depth
from luxel.render.renderer import Renderer
from luxel.scene.model import Camera

SMALL = {"probe_target": 300, "extra_probes": 8, "num_samples_per_probe": 32}


def make(frames: int = 30, **params: object) -> Renderer:
    renderer = Renderer("cornell-box", "ddgi", {**SMALL, **params}, size=(48, 48), seed=1)
    renderer.run(frames)
    return renderer


@pytest.fixture(scope="module")
def cornell() -> Renderer:
    return make()


def with_layer(state: DdgiState, layer: int) -> DdgiState:
    return replace(state, settings=replace(state.settings, debug_layer=layer))


def test_spheres_are_the_probes_that_are_placed(cornell: Renderer) -> None:
    state = cornell.state
    placed = np.array(state.probes.status) != UNUSED
    for name in ("irradiance", "depth", "state"):
        view = probe_views(state)[name]
        assert view.kind == "spheres"
        count = placed.sum()
        resolution = view.data["atlas"].shape[1]
        assert view.data["p"].shape == view.data["color"].shape == (count, 3)
        assert view.data["atlas"].shape == (count, resolution, resolution, 3)
        np.testing.assert_allclose(view.data["p"], np.array(state.probes.p).T[placed])


def test_probes_held_back_are_not_shown(cornell: Renderer) -> None:
    state = cornell.state
    status = np.array(state.probes.status)
    status[state.settings.probe_count :] = UNUSED
    views = probe_views(replace(state, probes=replace(state.probes, status=mi.UInt32(status))))
    for name in ("irradiance", "depth", "state"):
        assert len(views[name].data["p"]) == state.settings.probe_count < state.settings.total


def test_irradiance_is_that_of_the_texels(cornell: Renderer) -> None:
    state = cornell.state
    status = np.array(state.probes.status)
    texels = np.array(state.irradiance.mean).T.reshape(state.settings.total, 8, 8, 3)
    shown = probe_views(state)["irradiance"].data["atlas"]
    np.testing.assert_allclose(shown, texels[status != UNUSED], rtol=2e-3, atol=1e-4)
    assert shown.max() > 0.1


@pytest.mark.parametrize("model", ["planes", "moments"])
def test_depth_is_the_distance_in_the_scene(model: str) -> None:
    """Most texels of awake probes tell the distance that a ray along their own direction goes."""
    renderer = make(60, depth_model=model, sleep_after=0)
    state, resolution = renderer.state, renderer.state.settings.depth_resolution
    texels = resolution**2
    lane = dr.arange(mi.UInt32, state.settings.total * texels)
    p = dr.gather(mi.Point3f, state.probes.p, lane // texels)
    hit = trace_closest(renderer.scene, p, texel_direction(lane % texels, resolution), mi.Bool(True))
    reach = float(np.array(state.volumes[0].reach)[0])
    truth = np.minimum(np.array(hit.t).reshape(-1, resolution, resolution) / reach, 1.0)
    found = relative_depth(state)
    awake = np.array(state.probes.status) == AWAKE
    near = awake[:, None, None] & (truth < 0.6)
    assert near.sum() > 1000
    assert np.median(np.abs(found - truth)[near] / truth[near]) < (0.02 if model == "planes" else 0.05)
    view = probe_views(state)["depth"].data["atlas"]
    np.testing.assert_array_equal(view[..., 0], found[np.array(state.probes.status) != UNUSED])
    assert view.min() >= 0.0 and view.max() <= 1.0


def test_colours_tell_the_states(cornell: Renderer) -> None:
    state = cornell.state
    total = state.settings.total
    status = np.resize([DEAD, ASLEEP, AWAKE, AWAKE, DEAD, UNUSED], total).astype(np.uint32)
    age = np.resize([100, 100, 100, 3, 3, 3], total).astype(np.uint32)
    probes = replace(state.probes, status=mi.UInt32(status), age=mi.UInt32(age))
    colors = probe_views(replace(state, probes=probes))["state"].data["color"]
    wanted = [STATE_COLORS[DEAD], STATE_COLORS[ASLEEP], STATE_COLORS[AWAKE], YELLOW, STATE_COLORS[DEAD]]
    np.testing.assert_allclose(colors[:5], np.array(wanted, np.float32), rtol=1e-6)
    assert len(colors) == (status != UNUSED).sum()
    assert len({tuple(color) for color in wanted}) == 4


def test_a_sheet_shows_layers_side_by_side() -> None:
    """Also where the box has followed the camera, so that probes are stored in another order than they stand."""
    renderer = make(10, follow_camera=True, extra_probes=0)
    eye = np.array(renderer.camera.eye) + (1.0, 0.8, -1.3)
    for _ in range(10):
        renderer.step(camera=Camera(tuple(eye), (0.0, 0.0, 0.0)))
    state = renderer.state
    volume, low = state.volumes[0], np.array(state.volumes[0].low).ravel()
    assert low.any()
    sheet = probe_views(state)["irradiance_atlas"].data["image"]
    assert sheet.shape == (8 * volume.nz, 8 * volume.nx * volume.ny, 3)
    p = np.array(state.probes.p).T
    steps = np.stack([np.array(v).ravel() for v in (volume.step_x, volume.step_y, volume.step_z)])
    blocks = probe_views(state)["irradiance"].data["atlas"]
    for x, y, z in ((0, 0, 0), (1, 2, 1), (volume.nx - 1, volume.ny - 1, volume.nz - 1)):
        # With every probe at its node, the one of this node is the one that stands there.
        place = np.array(volume.origin).ravel() + (low + (x, y, z)) @ steps
        distance = np.linalg.norm(p - np.array(state.probes.offset).T @ steps - place, axis=1)
        assert distance.min() < 1e-4
        column = 8 * (x + volume.nx * y)
        np.testing.assert_array_equal(sheet[8 * z : 8 * z + 8, column : column + 8], blocks[distance.argmin()])


@pytest.mark.parametrize("name", ["irradiance_atlas", "depth_atlas", "certainty"])
def test_one_layer_is_a_part_of_all(cornell: Renderer, name: str) -> None:
    volume = cornell.state.volumes[0]
    whole = probe_views(with_layer(cornell.state, -1))[name].data["image"]
    one = probe_views(with_layer(cornell.state, 1))[name].data["image"]
    height, width = one.shape[:2]
    assert volume.ny * width == whole.shape[1] and one.std() > 0.0
    np.testing.assert_array_equal(one, whole[:height, width : 2 * width])


def test_a_layer_that_is_not_there_is_refused(cornell: Renderer) -> None:
    with pytest.raises(LuxelError, match=f"from 0 to {cornell.state.volumes[0].ny - 1}"):
        probe_views(with_layer(cornell.state, cornell.state.volumes[0].ny))


def test_certainty_is_shown_by_blocks(cornell: Renderer) -> None:
    state, volume = cornell.state, cornell.state.volumes[0]
    image = probe_views(state)["certainty"].data["image"][: 8 * volume.nz, :, 0]
    unfit = np.array(state.probes.unfit)[: volume.probe_count].reshape(volume.nz, volume.ny * volume.nx)
    np.testing.assert_array_equal(image[::8, ::8][:, : unfit.shape[1]], unfit)
    assert unfit.max() > 0.5 > unfit.min()


def test_offsets_lead_from_the_nodes_to_the_probes() -> None:
    state = make(30, offset_pattern="axes").state
    volume, views = state.volumes[0], probe_views(state)
    data = views["offsets"].data
    # The box stands still, so its nodes are in the order of the probes.
    p = np.array(state.probes.p).T[: volume.probe_count]
    np.testing.assert_allclose(data["p"] + data["offset"], p, atol=1e-5)
    lengths = np.linalg.norm(data["offset"], axis=1)
    steps = [float(np.linalg.norm(np.array(v))) for v in (volume.step_x, volume.step_y, volume.step_z)]
    assert (np.abs(data["offset"]) <= MAX_OFFSET * np.array(steps) + 1e-5).all()
    assert (lengths > 0.0).sum() > 5
    assert views["mean_offset"].data["value"] == pytest.approx(lengths[lengths > 0.0].mean(), rel=1e-5)
    still = np.ptp(data["color"][lengths == 0.0], axis=0)
    assert not still.any() and np.ptp(data["color"], axis=0).any()


def test_numbers_count_the_dead_and_the_moved(cornell: Renderer) -> None:
    status = np.array(cornell.state.probes.status)
    share = probe_views(cornell.state)["dead_share"].data["value"]
    assert share == pytest.approx((status == DEAD).sum() / (status != UNUSED).sum()) and 0.0 < share < 1.0
    fixed = make(30, offset_dead_probes=False)
    assert probe_views(fixed.state)["mean_offset"].data["value"] == 0.0
    undetected = make(4, detect_dead_probes=False)
    assert probe_views(undetected.state)["dead_share"].data["value"] == 0.0
