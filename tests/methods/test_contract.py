"""The contract that every method answers to: each check runs over the methods that claim it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import drjit as dr
import numpy as np
import pytest

from luxel import runtime
from luxel.errors import LuxelError
from luxel.image.layers import Layers
from luxel.inspect.looks import take_shot
from luxel.methods import METHODS, inspector_of
from luxel.methods.base import CHECKS, describe_params
from luxel.metrics.error import regional
from luxel.metrics.leak import box_points, leak_ratio
from luxel.render.flight import fly_through
from luxel.render.renderer import WARM_UP_FRAMES, Renderer
from luxel.scene import load
from luxel.scene.edit import default_camera
from luxel.scene.library import BUILT_IN
from luxel.scene.model import Camera, Light, Material, Mesh, Object, SceneData, Sky
from luxel.stages import count_compilations

SIZE = (64, 64)
SMALL = {
    "gibs": {"surfel_target": 3000},
    "ddgi": {"probe_target": 600},
    "lightmap": {"texel_target": 4096, "surfel_target": 1024},
}
"""Settings that keep the checks quick."""
LINEAR = {"gibs": {"guide_share": 0.0}}
"""Settings with which no rounding decides where rays go."""
FORGETS_WITHIN = {"gibs": 300, "path": 1}
"""Frames until a light that was switched off is forgotten."""


def claiming(check: str) -> list[str]:
    assert check in CHECKS
    return [name for name, method in METHODS.items() if check in method.claims]


def make(name: str, scene: str | SceneData, **options: object) -> Renderer:
    data = load(scene) if isinstance(scene, str) else scene
    settings: dict = {"params": SMALL.get(name), "size": SIZE, "seed": 1, **options}
    return Renderer(data, name, **settings)


def indirect_mean(layers: Layers) -> float:
    return float(layers.indirect[layers.hit].mean(dtype=np.float64))


def difference(first: np.ndarray, second: np.ndarray) -> float:
    """Return the mean absolute difference over the second's mean."""
    return float(np.abs(first.astype(np.float64) - second).mean() / np.abs(second, dtype=np.float64).mean())


def points_in_cornell() -> tuple[np.ndarray, np.ndarray]:
    """Return points on the walls of the Cornell box, and their normals."""
    points, normals = box_points(np.array([-1.0, -1.0, -1.0]), np.array([1.0, 1.0, 1.0]), 6)
    on_walls = normals[:, 2] > -0.5  # the front is open
    return points[on_walls], normals[on_walls]


# ------------------------------------------------------------------------------------------------ building


@pytest.mark.parametrize("name", METHODS)
def test_the_method_is_what_its_class_says(name: str) -> None:
    method = METHODS[name]
    assert method.name == name and method.claims <= CHECKS and 0.0 <= method.max_leak < 1.0
    assert "indirect" in method.holds
    for key, _, doc in describe_params(method.Params):
        assert doc, f"{name}: parameter {key} has no doc"
    for preset in method.presets.values():
        assert set(preset) <= {key for key, _, _ in describe_params(method.Params)}


@pytest.mark.parametrize("name", METHODS)
def test_it_builds_and_answers(name: str) -> None:
    renderer = make(name, "cornell-box")
    renderer.run(2)
    layers = renderer.layers()
    assert layers.image().shape == (64, 64, 3)
    assert (layers.weight >= 0.0).all()
    assert all(isinstance(value, int | float) for value in renderer.cache().values())
    views = inspector_of(renderer.method).views(renderer.scene, renderer.state)
    assert all(view.kind in {"points", "image", "number", "spheres"} for view in views.values())
    check_what_lights_a_point(renderer)


def check_what_lights_a_point(renderer: Renderer) -> None:
    """What `explain`, `discs` and `sources` say of a point on the floor goes together."""
    shot = take_shot(renderer, pixel=(32, 60))
    inspector, scene, state, point = inspector_of(renderer.method), renderer.scene, renderer.state, shot.chosen_point
    found = {entry.item: entry.weight for entry in inspector.explain(scene, state, point)}
    if any(weight > 0.0 for weight in found.values()):
        assert sum(found.values()) == pytest.approx(1.0, abs=1e-3)
    discs = inspector.discs(scene, state, point)
    if discs is not None:
        assert len(discs.item) == len(discs.p) == len(discs.n) == len(discs.radius) > 0
        assert all(found[item] > 0.0 for item in discs.item.tolist())
        np.testing.assert_allclose(np.linalg.norm(discs.n, axis=1), 1.0, atol=1e-4)
        assert np.isfinite(discs.p).all() and (discs.radius > 0.0).all()
    if any(look.kind == "source" for look in inspector.looks):
        told = inspector.sources(scene, state, point, shot.gbuffer.surface)
        answered = np.array(told.answered)
        assert told.words and told.heaviest and answered.any()
        share = np.array(told.share)[answered]
        assert (share > 0.0).all() and (share <= 1.0).all()
        assert {item for _, item in told.heaviest} <= set(found)
        assert set(np.array(told.item)[answered].tolist()) <= set(found)


@pytest.mark.parametrize("name", METHODS)
def test_unknown_parameters_are_refused(name: str) -> None:
    with pytest.raises(LuxelError, match="no parameter 'warp'"):
        make(name, "furnace", params={"warp": 9})


# ------------------------------------------------------------------------------------------------ radiometry


def unlit_cornell() -> SceneData:
    data = load("cornell-box")
    for material in data.materials:
        material.emission = (0.0, 0.0, 0.0)
    return data


@pytest.mark.parametrize("name", claiming("black"))
@pytest.mark.parametrize("switched_off", [False, True])
def test_black(name: str, switched_off: bool) -> None:
    """Exactly black, whether the scene has no light or its lights stand at zero."""
    renderer = make(name, load("cornell-box") if switched_off else unlit_cornell())
    if switched_off:
        renderer.set_light_scale(0.0)
    renderer.run(12)
    layers = renderer.layers()
    assert layers.hit.any() and layers.albedo.any()
    assert not layers.image().any() and not layers.indirect.any()


@pytest.mark.parametrize("name", claiming("furnace"))
def test_furnace(name: str) -> None:
    data = load("furnace")
    renderer = make(name, data)
    renderer.run(200)
    layers = renderer.layers()
    assert indirect_mean(layers) == pytest.approx(data.facts["indirect_irradiance"], rel=0.005)
    assert layers.image().mean() == pytest.approx(data.facts["radiance"], rel=0.005)
    # And no place of it is far off: 16 x 16 blocks. The corners of an emitting box are the noisiest places there are.
    blocks = layers.indirect.reshape(4, 16, 4, 16, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(blocks, data.facts["indirect_irradiance"], rtol=0.05)


@pytest.mark.parametrize("name", claiming("furnace"))
def test_integrating_sphere(name: str) -> None:
    data = load("sphere")
    renderer = make(name, data)
    renderer.run(256)
    layers = renderer.layers()
    assert indirect_mean(layers) == pytest.approx(data.facts["indirect_irradiance"], rel=0.02)
    assert layers.direct[layers.hit].mean() == pytest.approx(data.facts["direct_irradiance"], rel=0.02)


@pytest.mark.parametrize("name", claiming("linear"))
def test_linear(name: str) -> None:
    """Light times k gives image times k; the methods' floors must not show at any level of light."""
    images = {scale: light_at(scale, name, LINEAR.get(name)) for scale in (1.0, 2.0, 1e-3, 1e4)}
    assert images[1.0].mean() > 0.05
    for scale, image in images.items():
        assert difference(image, images[1.0]) < 2e-3, f"at {scale} times the light"


def test_guided_rays_are_linear_on_average() -> None:
    """Maps count in whole numbers: at powers of two all is as before, at others rounding sends some rays elsewhere."""
    images = {scale: light_at(scale, "gibs", None) for scale in (1.0, 2.0, 1e-3)}
    np.testing.assert_array_equal(images[2.0], images[1.0])
    assert images[1e-3].mean() == pytest.approx(images[1.0].mean(), rel=0.005)
    assert difference(images[1e-3], images[1.0]) < 0.06


def light_at(scale: float, name: str, settings: dict | None) -> np.ndarray:
    renderer = make(name, "cornell-box", params={**SMALL.get(name, {}), **(settings or {})})
    renderer.set_light_scale(scale)
    renderer.run(48)
    return renderer.layers().indirect / scale


# ------------------------------------------------------------------------------------------------ repeatability


@contextmanager
def one_thread() -> Iterator[None]:
    before = dr.thread_count()
    dr.set_thread_count(1)
    try:
        yield
    finally:
        dr.set_thread_count(before)


@pytest.mark.parametrize("name", claiming("seeded"))
def test_seeded(name: str) -> None:
    """The same to the bit on one thread, nearly so on more (sums run in another order); another seed differs."""
    with one_thread():
        first, again = (make(name, "cornell-box") for _ in range(2))
        for renderer in (first, again):
            renderer.run(24)
        reference = first.image()
        if first.device.name == "cpu":  # a GPU has no single thread to ask for
            np.testing.assert_array_equal(again.image(), reference)
        assert difference(again.image(), reference) < 1e-3
    threaded = make(name, "cornell-box")
    threaded.run(24)
    assert difference(threaded.image(), reference) < 1e-3
    other = make(name, "cornell-box", seed=2)
    other.run(24)
    assert difference(other.image(), reference) > 2e-3


@pytest.mark.parametrize("name", claiming("saves"))
def test_saves(name: str, tmp_path: Path) -> None:
    renderer = make(name, "cornell-box")
    renderer.run(72 if name == "ddgi" else 24)  # a frame of young probes differs from the next by its noise alone
    file = tmp_path / "state.npz"
    renderer.method.save(renderer.state, file)
    assert [path.name for path in tmp_path.iterdir()] == ["state.npz"]
    loaded = renderer.method.load(renderer.scene, renderer.params, file)
    second = make(name, "cornell-box", state=loaded)
    where = points_in_cornell()
    np.testing.assert_allclose(second.irradiance_at(*where), renderer.irradiance_at(*where), rtol=1e-5, atol=1e-7)
    if name != "path":  # its image is this frame's noise, which the state does not hold
        for each in (renderer, second):
            each.step()
        assert difference(second.layers().indirect + 1e-6, renderer.layers().indirect + 1e-6) < 0.02


@pytest.mark.parametrize("name", claiming("saves"))
def test_a_damaged_state_is_refused(name: str, tmp_path: Path) -> None:
    renderer = make(name, "cornell-box")
    file = tmp_path / "state.npz"
    file.write_bytes(b"not a state")
    with pytest.raises(LuxelError, match="damaged"):
        renderer.method.load(renderer.scene, renderer.params, file)
    other = make("none" if name != "none" else "ambient", "cornell-box")
    other.method.save(other.state, file)
    with pytest.raises(LuxelError, match="another method"):
        renderer.method.load(renderer.scene, renderer.params, file)


# ------------------------------------------------------------------------------------------------ change


@pytest.mark.parametrize("name", claiming("forgets"))
def test_forgets(name: str) -> None:
    renderer = make(name, "cornell-box")
    renderer.run(64)
    lit = indirect_mean(renderer.layers())
    renderer.set_light_scale(0.0)
    renderer.run(FORGETS_WITHIN.get(name, 300))
    dark = indirect_mean(renderer.layers())
    assert lit > 0.1 and dark < 0.01 * lit


@pytest.mark.parametrize("name", claiming("forgets"))
def test_light_comes_back(name: str) -> None:
    renderer = make(name, "cornell-box")
    renderer.set_light_scale(0.0)
    renderer.run(32)
    renderer.set_light_scale(1.0)
    renderer.run(200)
    steady = make(name, "cornell-box")
    steady.run(232)
    assert indirect_mean(renderer.layers()) == pytest.approx(indirect_mean(steady.layers()), rel=0.03)


def distance_to_moving(points: np.ndarray, time: float) -> dict[str, np.ndarray]:
    """Return the distance of world points (N, 3) to each object's surface of the scene `moving`, by their formulas."""
    data = load("moving")
    local = {}
    for item in data.objects:
        inverse = np.linalg.inv(item.to_world if item.motion is None else item.motion(time))
        local[item.name] = points @ inverse[:3, :3].T + inverse[:3, 3]

    def to_box(p: np.ndarray, lower: tuple, upper: tuple) -> np.ndarray:
        middle, half = (np.add(lower, upper)) / 2.0, (np.subtract(upper, lower)) / 2.0
        away = np.abs(p - middle) - half
        outside = np.linalg.norm(np.maximum(away, 0.0), axis=1)
        return np.abs(outside + np.minimum(away.max(axis=1), 0.0))

    lift = local["lift"]
    tube = np.stack([np.hypot(lift[:, 0], lift[:, 2]) - 0.55, np.abs(lift[:, 1] - 0.125) - 0.125], axis=1)
    to_lift = np.linalg.norm(np.maximum(tube, 0.0), axis=1) + np.minimum(tube.max(axis=1), 0.0)
    return {
        "room": to_box(local["room"], (-2.5, 0.0, -2.5), (2.5, 3.0, 2.5)),
        "slab": to_box(local["slab"], (-0.7, 0.0, -0.12), (0.7, 1.9, 0.12)),
        "ball": np.abs(np.linalg.norm(local["ball"], axis=1) - 0.45),
        "lift": np.abs(to_lift),
    }


def move(renderer: Renderer, frames: int, until: float) -> None:
    """Move the scene on to `until` seconds in `frames` steps."""
    start = renderer.time
    for index in range(frames):
        renderer.step(time=start + (until - start) * (index + 1) / frames)


@pytest.mark.parametrize("name", claiming("follows"))
def test_follows_with_its_items(name: str) -> None:
    """Cache items that lie on objects move with them: none is left in the air."""
    renderer = make(name, "moving")
    renderer.run(60)
    move(renderer, 30, 1.0)
    points = [
        view.data["p"]
        for view in inspector_of(renderer.method).views(renderer.scene, renderer.state).values()
        if view.kind == "points"
    ]
    if not points:
        pytest.skip(f"{name} keeps no items in the scene")
    distances = distance_to_moving(np.asarray(points[0], np.float64), 1.0)
    nearest = np.min(list(distances.values()), axis=0)
    # Items move at the start of a frame and are placed at its end; the facets of ball and lift are 3 mm off.
    assert np.quantile(nearest, 0.999) < 0.006 and nearest.max() < 0.05
    for item in ("slab", "ball", "lift"):
        assert ((distances[item] < 0.006) & (distances["room"] > 0.01)).sum() > 10, item


@pytest.mark.parametrize("name", claiming("follows"))
def test_follows_with_its_light(name: str) -> None:
    """Right after a movement the light is nearer to the truth there than the light of before is."""

    def still(time: float) -> Layers:
        truth = make("path", "moving", params={"samples": 4}, seed=99)
        truth.step(time=time)
        truth.run(80)
        return truth.layers()

    before, after = still(0.0), still(1.0)
    renderer = make(name, "moving")
    renderer.run(120)
    move(renderer, 60, 1.0)
    renderer.run(4 if name != "path" else 60)
    found = renderer.layers()
    np.testing.assert_allclose(found.albedo, after.albedo, atol=1e-5)
    ghost = regional(Layers(**{**vars(after), "indirect": before.indirect}), after)
    assert regional(found, after) < min(0.25, 0.6 * ghost)
    assert indirect_mean(found) == pytest.approx(indirect_mean(after), rel=0.08)


# ------------------------------------------------------------------------------------------------ robustness


def awkward() -> SceneData:
    """Return a scene with triangles without area, vertex normals of length zero, black and very bright materials."""
    flat = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [-2, -1, -2], [2, -1, -2], [2, -1, 2], [-2, -1, 2]], np.float32)
    one = np.array([[0, 1, 2]], np.uint32)
    faces = np.array([[0, 1, 2], [0, 0, 0], [3, 5, 4], [3, 6, 5]], np.uint32)
    floor = Mesh(flat, faces, 0, normals=np.zeros((7, 3), np.float32), uv=np.zeros((7, 2), np.float32))
    lamp = Mesh(np.array([[-0.1, 1, -0.1], [0.1, 1, -0.1], [0, 1, 0.1]], np.float32), one, 1)
    sliver = Mesh(np.array([[-1, 0.2, 0], [1, 0.2, 0], [0, 0.2, 1e-7]], np.float32), one, 2)
    materials = [Material(base_color=(1.0, 1.0, 1.0)), Material(emission=(1e6, 1e6, 1e6)), Material(metallic=1.0)]
    lights = [Light("point", (1.0, 1.0, 1.0), (0.0, -1.0, 0.0)), Light("spot", (2.0, 2.0, 2.0), cos_inner=0.7)]
    camera = Camera((0.0, 1.0, 3.0), (0.0, -0.5, 0.0), fov=80.0)
    sky = Sky((0.1, 0.1, 0.1))
    return SceneData("awkward", [Object("all", [floor, lamp, sliver])], materials, lights, [camera], sky)


@pytest.mark.parametrize("name", claiming("finite"))
@pytest.mark.parametrize("scene", ["awkward", *(name for name in BUILT_IN if name != "atrium")])
def test_finite(name: str, scene: str) -> None:
    renderer = make(name, awkward() if scene == "awkward" else scene)
    for frame in range(10):
        renderer.step(time=0.1 * frame)
    layers = renderer.layers()
    for layer in (layer for layer in vars(layers).values() if layer is not None):
        assert np.isfinite(layer).all()
    assert layers.image().min() >= 0.0


@pytest.mark.parametrize("name", claiming("sealed"))
@pytest.mark.parametrize("wall", [0.01, 0.05, 0.2])
def test_sealed(name: str, wall: float) -> None:
    """After a flight through the lit room, the dark one is as dark as the method says."""
    data = load("two-rooms", wall=wall)
    renderer = make(name, data, params=None)
    fly_through(renderer)
    renderer.run(32)
    layers = renderer.layers()
    lower, upper = (np.array([data.facts[f"sealed_{end}_{axis}"] for axis in "xyz"]) for end in ("lo", "hi"))
    # Points 16 mm off the edges: what leaks comes along the walls, ceiling and floor that the rooms share.
    ratio = leak_ratio(renderer.irradiance_at(*box_points(lower, upper, 128)), layers.indirect[layers.hit])
    print(f"leak of {name} through {wall} m: {ratio:.6f}")
    assert indirect_mean(layers) > 0.1
    assert 0.0 <= ratio <= METHODS[name].max_leak


@pytest.mark.parametrize("name", claiming("compiled"))
def test_nothing_is_compiled_after_the_warm_up(name: str) -> None:
    """Neither by more frames nor by what may change at run time: camera, time, level of light, more cache items."""
    data = load("moving")
    # A frozen function is recorded anew for other Dr.Jit flags, so this one stands from the start.
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        renderer = make(name, data)
        for frame in range(WARM_UP_FRAMES):
            renderer.step(time=0.01 * frame, camera=data.flight[frame % 2])
        recordings = renderer.compilations
        assert 1 <= recordings <= 3
        dr.sync_thread()
        dr.kernel_history_clear()
        for frame in range(40):
            renderer.set_light_scale(1.0 + 0.1 * (frame % 3))
            renderer.step(time=0.05 * frame, camera=data.flight[frame % len(data.flight)])
        renderer.run(4)
        dr.sync_thread()
        history = dr.kernel_history()
        dr.kernel_history_clear()
    assert renderer.compilations == recordings
    assert len(history) >= 40
    assert count_compilations(history) == 0


@pytest.mark.parametrize("name", claiming("flat"))
def test_memory_is_flat(name: str) -> None:
    renderer = make(name, "cornell-box")
    renderer.run(60)
    series = []
    for _ in range(7):
        renderer.run(20)
        series.append(runtime.memory_mb())
    slope = np.median([b - a for a, b in zip(series[:-1], series[1:], strict=True)]) / 20.0
    assert slope < 0.02, f"{slope:.3f} MiB a frame: {series}"
    assert series[-1] - series[0] < 16.0


def test_cameras_of_the_checks_see_the_scenes() -> None:
    for name in BUILT_IN:
        assert default_camera(load(name)) is not None
