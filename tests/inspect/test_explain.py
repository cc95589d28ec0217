"""Why a pixel is black or lit: each verdict on a small scene that is made to deserve it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.inspect.diagnosis import VERDICTS, diagnose
from luxel.inspect.explain import explain_pixel
from luxel.inspect.explanation import Explanation, Paths
from luxel.inspect.looks import take_shot
from luxel.methods.inspect import Contribution
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.library.shapes import box
from luxel.scene.model import Camera, Light, Material, Object, SceneData, Sky

SIZE = 32


def run(
    scene: SceneData, method: str = "gibs", frames: int = 12, camera: Camera | None = None, **settings: Any
) -> Renderer:
    renderer = Renderer(scene, method, settings or None, size=(SIZE, SIZE), seed=1, camera=camera)
    renderer.run(frames)
    return renderer


def room(*, albedo: float = 0.7, sky: float = 0.0) -> SceneData:
    """A room of 6 m whose only lamp, a narrow spot, lights the middle of the floor; a closed crate in a corner."""
    shell = box((-3, 0, -3), (3, 4, 3), 0, inward=True)
    crate = box((-2.9, 0.1, -2.9), (-1.1, 1.9, -1.1), 1)
    lamp = Light("spot", (60.0, 60.0, 60.0), (0.0, 3.5, 0.0), (0.0, -1.0, 0.0), cos_inner=0.94, cos_outer=0.87)
    view = Camera((0.0, 1.0, 2.5), (0.0, 3.9, -1.0), fov=60.0)
    materials = [Material("paint", (albedo, albedo, albedo)), Material("wood", (0.6, 0.6, 0.6))]
    return SceneData(
        "room", [Object("shell", [shell]), Object("crate", [crate])], materials, [lamp], [view], Sky((sky, sky, sky))
    )


def middle(renderer: Renderer, exposure: float | None = 1.0) -> Explanation:
    found = explain_pixel(take_shot(renderer, exposure=exposure), SIZE // 2, SIZE // 2)
    assert found.verdict in VERDICTS and found.words and all(word.endswith(".") for word in found.words)
    return found


def says(found: Explanation, *parts: str) -> bool:
    return all(part in " ".join(found.words) for part in parts)


# ------------------------------------------------------------------------------------------------ no fault of a method


def test_nothing_is_there() -> None:
    away = Camera((0.0, 0.0, 9.0), (0.0, 0.0, 20.0))
    found = middle(run(load("cornell-box"), "none", 1, away))
    assert (found.verdict, found.hit, found.position) == ("background", False, None)
    assert says(found, "black", "nothing is there")
    outside = Camera((0.0, 9.0, 0.0), (0.0, 20.0, 1.0))
    found = middle(run(room(sky=0.8), "none", 1, outside))
    assert found.verdict == "background" and says(found, "shows the sky", "0.8")


def test_the_surface_is_black() -> None:
    found = middle(run(room(albedo=0.0)))
    assert found.verdict == "black-surface" and says(found, "black because its surface is black", "0.0%")
    assert found.material_name == "paint" and found.object_name == "shell"
    metal = room(albedo=0.5)
    metal.materials = [replace(one, metallic=1.0) for one in metal.materials]
    found = middle(run(metal))
    assert found.verdict == "black-surface" and says(found, "black because its surface is metal", "--method path")


def test_the_back_of_a_one_sided_surface() -> None:
    found = middle(run(load("cornell-box"), camera=Camera((0.0, 0.0, -4.0), (0.0, 0.0, 0.0))))
    assert found.verdict == "back-side" and not found.front and says(found, "the back of a surface")


def test_no_light_reaches_a_sealed_room() -> None:
    scene = load("two-rooms")
    dark = next(camera for camera in scene.cameras if camera.name == "dark")
    for method in ("gibs", "ddgi"):
        found = middle(run(scene, method, 8, dark), exposure=1e-3)
        assert found.verdict == "no-light" and says(found, "no light reaches it", "1,024 paths")
        assert found.paths is not None and max(found.paths.direct) == max(found.paths.indirect) == 0.0


def test_the_eye_is_inside_a_crate() -> None:
    found = middle(run(room(), camera=Camera((-2.0, 1.0, -2.0), (-2.0, 1.2, -3.0))))
    assert found.verdict == "inside" and not found.front and found.object_name == "crate"
    assert found.paths is not None and found.paths.backs == 1.0 and says(found, "inside geometry", "100%")


def test_light_that_the_exposure_does_not_show() -> None:
    renderer = run(load("cornell-box"), frames=20)
    found = middle(renderer, exposure=1e-3)
    assert found.verdict == "exposure" and says(found, "times the exposure would make it middle grey")
    assert middle(renderer, exposure=None).verdict == "lit"
    # The factor in the words is true.
    factor = float(next(w for w in found.words if "times" in w).split(": ")[1].split(" times")[0])
    radiance = float(np.array(found.radiance) @ (0.2126, 0.7152, 0.0722))
    assert radiance * 1e-3 * factor == pytest.approx(0.18, rel=0.01)


# ------------------------------------------------------------------------------------------------ faults of a method


def test_a_method_without_indirect_light() -> None:
    found = middle(run(room(), "none", 1))
    assert found.verdict == "unanswered" and says(found, "method 'none' brings no indirect light")
    assert found.contributions == () and max(found.indirect) == 0.0


def test_no_surfel_is_there_yet() -> None:
    """A pool of 64 surfels does not reach over the room: what is bare there is black, or borrows its light."""
    for borrows, verdict in ((False, "unseen"), (True, "lit")):
        renderer = run(room(), capacity=64, surfel_target=4000, fill_bare=borrows)
        weight = renderer.layers().weight
        rows, columns = np.nonzero(weight == 0.0)
        found = explain_pixel(take_shot(renderer, exposure=1.0), int(columns[0]), int(rows[0]))
        assert found.verdict == verdict and says(found, "surfel") and found.weight == 0.0


def test_outside_the_box_of_probes() -> None:
    """All probes stand in the closed crate, where it is dark, and the room takes the nearest of them."""
    box_in_crate = "-2,1,-2 size 1,1,1 probes 3,3,3"
    found = middle(run(room(), "ddgi", boxes=box_in_crate, extra_probes=0, detect_dead_probes=False))
    assert found.verdict == "outside" and says(found, "outside the box")
    assert any(item.why == "outside" for item in found.contributions)


QUICK = {"extra_probes": 0, "offset_dead_probes": False, "num_samples_per_probe": 16}


def test_all_probes_around_are_dead() -> None:
    """In the middle of a hollow block no probe counts as alive, nor does one of the neighbouring cages."""
    shell = box((-6, -6, -6), (6, 6, 6), 0, inward=True)
    block, pebble = box((-2.5, -2.5, -2.5), (2.5, 2.5, 2.5), 0), box((-0.2, -0.2, -0.2), (0.2, 0.2, 0.2), 0)
    lamp = Light("spot", (60.0, 60.0, 60.0), (0.0, 2.0, 0.0), (0.0, -1.0, 0.0), cos_inner=0.7, cos_outer=0.5)
    objects = [Object("shell", [shell]), Object("block", [block]), Object("pebble", [pebble])]
    below = Camera((0.0, -1.5, 0.3), (0.0, 0.0, 0.0), fov=20.0)
    scene = SceneData("hollow", objects, [Material("paint", (0.7, 0.7, 0.7))], [lamp], [below])
    found = middle(run(scene, "ddgi", 20, boxes="0,0,0 size 11,11,11 probes 12,12,12", **QUICK))
    assert found.object_name == "pebble" and found.verdict == "inside" and says(found, "all probes around it are dead")
    assert found.weight == 0.0 and {item.why for item in found.contributions} == {"dead"}


def test_neighbours_that_stand_in_are_listed() -> None:
    """A cage within the crate, all dead, has living neighbours above: they are listed, and their mean is the answer."""
    scene, camera = room(), Camera((-2.0, 0.8, -2.0), (-2.0, 1.9, -2.2), fov=50.0)
    # The bias takes the asking point into the cage below the lid, whose probes are all in the crate.
    places = {"boxes": "0,1.5,0 size 5.6,3,5.6 probes 11,6,11", "view_bias": 0.1}
    renderer = run(scene, "ddgi", 30, camera, **places, **QUICK)
    found = middle(renderer)
    borrowed = [item for item in found.contributions if item.why == "borrowed"]
    assert len(borrowed) > 4 and all(item.why == "dead" for item in found.contributions if item not in borrowed)
    assert sum(item.weight for item in borrowed) == pytest.approx(1.0, abs=1e-3)
    mean = sum(item.weight * np.array(item.irradiance) for item in borrowed)
    assert found.position is not None and found.normal is not None
    answer = renderer.irradiance_at(np.array([found.position]), np.array([found.normal]))[0]
    np.testing.assert_allclose(mean, answer, rtol=0.02)
    assert says(found, "standing in from neighbouring cages")


# ------------------------------------------------------------------------------------------------ lit


@pytest.mark.parametrize(("method", "item"), [("gibs", "surfel"), ("ddgi", "probe"), ("path", "")])
def test_a_lit_pixel(method: str, item: str) -> None:
    renderer = run(load("cornell-box"), method, 40)
    found = middle(renderer, exposure=None)
    layers = renderer.layers()
    assert found.verdict == "lit" and found.hit and found.front and found.item == item
    np.testing.assert_allclose(found.radiance, layers.image()[16, 16], rtol=1e-6)
    np.testing.assert_allclose(found.indirect, layers.indirect[16, 16], rtol=1e-6)
    assert (found.object_name, found.material_name) == ("large-box", "white")
    # The large box's front, turned by 18.25 degrees about Y.
    angle = np.deg2rad(18.25)
    np.testing.assert_allclose(found.normal or (), (np.sin(angle), 0.0, np.cos(angle)), atol=0.01)
    offset = np.array(found.position) - renderer.camera.eye
    assert found.distance == pytest.approx(float(np.linalg.norm(offset)), rel=1e-4)
    assert found.paths is not None and 0.0 < found.paths.noise < 0.1 * max(found.paths.indirect)
    assert says(found, "It is lit by", "W/m^2 of direct", "indirect light", "1,024 paths")
    if item:
        weights = [entry.weight for entry in found.contributions]
        assert sum(weights) == pytest.approx(1.0, abs=1e-3) and weights == sorted(weights, reverse=True)
        assert says(found, f"{item}s asked", "of the say")
        for entry in found.contributions:
            assert entry.p is not None and np.linalg.norm(np.array(entry.p) - found.position) < 1.0


def test_paths_are_a_truth() -> None:
    """Against the analytic furnace: E direct = E indirect = pi at every point."""
    found = middle(run(load("furnace"), "none", 1))
    assert found.paths is not None and found.paths.misses == 0.0 and found.paths.backs == 0.0
    np.testing.assert_allclose(found.paths.direct, np.pi, rtol=0.05)
    np.testing.assert_allclose(found.paths.indirect, np.pi, rtol=0.08)


def test_a_lamp_shines_itself() -> None:
    renderer = run(load("cornell-box"), camera=Camera((0.0, 0.0, 0.0), (0.0, 0.99, 0.01), fov=10.0))
    found = middle(renderer, exposure=None)
    assert found.verdict == "lit" and found.object_name == "lamp" and says(found, "shines itself")


def test_everything_is_plain_values() -> None:
    from luxel.files import to_json

    found = middle(run(load("cornell-box")), exposure=None)
    plain = found.to_dict()
    assert plain["contributions"][0]["p"] == found.contributions[0].p and plain["paths"]["count"] == 1024
    assert '"verdict": "lit"' in to_json(plain)


def test_pixels_outside_are_refused() -> None:
    renderer = run(load("cornell-box"), "none", 1)
    for x, y in ((SIZE, 0), (0, SIZE), (-1, 0)):
        with pytest.raises(LuxelError, match="outside the image"):
            explain_pixel(renderer, x, y)
    with pytest.raises(LuxelError, match="nothing has been rendered"):
        explain_pixel(Renderer(load("cornell-box"), "none", size=(8, 8)), 0, 0)


# ------------------------------------------------------------------------------------------------ words alone


def made(**changes: Any) -> Explanation:
    """A black pixel of 'ddgi' where paths find light that would show."""
    grey = (0.5, 0.5, 0.5)
    paths = Paths(1024, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0.01, 0.0, 0.0)
    start = Explanation(
        (1, 2), "ddgi", "probe", "", (), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, True, albedo=grey, paths=paths
    )
    return replace(start, **changes)


def item(weight: float, why: str = "") -> Contribution:
    return Contribution(7, weight, (0.1, 0.1, 0.1), why, (0.0, 0.0, 0.0), why)


def test_no_probe_sees_it() -> None:
    asked = (item(0.5, "depth"), item(0.5, "depth"), item(0.0, "normal"), item(0.0, "dead"))
    verdict, words = diagnose(made(contributions=asked, weight=0.001))
    assert verdict == "unseen" and words[0] == "It is black because no probe sees it."
    assert "guess" in " ".join(words)


def test_the_light_is_missed() -> None:
    verdict, words = diagnose(made(contributions=(item(1.0),), weight=1.0, indirect=(0.001, 0.001, 0.001)))
    assert verdict == "missed" and "know too little" in words[0] and "0.001 times" in words[-1]


def test_reasons_are_counted() -> None:
    silent = (*(item(0.0, "depth") for _ in range(3)), item(0.0, "dead"))
    lit = made(shown=(0.5, 0.5, 0.5), contributions=(item(0.7), item(0.3), *silent), weight=1.0)
    _, words = diagnose(lit)
    assert words[1].startswith("Of 6 probes asked, 2 answer; 3 without sight of the point, 1 dead, inside geometry.")
    assert "probe 7, has 70%" in words[1]
    _, words = diagnose(replace(lit, contributions=(item(1.0),)))
    assert words[1].startswith("Of 1 probe asked, 1 answers.")
    _, words = diagnose(replace(lit, contributions=()))
    assert "none is near" in words[1]


def test_too_little_light_for_any_exposure_is_no_fault_of_the_method() -> None:
    """What paths find would not show either: the method is not blamed."""
    faint = Paths(1024, (0.0, 0.0, 0.0), (1e-4, 1e-4, 1e-4), 1e-6, 0.0, 0.0)
    verdict, words = diagnose(made(paths=faint, contributions=(item(1.0),), weight=1.0))
    assert verdict == "exposure" and "shows none" in words[0]
