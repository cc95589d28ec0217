"""The truth of a flight: rendered once, kept in halves, found again; and sums that can be committed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxel.metrics.motion import judge_by_sums, judge_frame
from luxel.render import motion_truth
from luxel.render.loading import load
from luxel.render.motion_path import MotionPath, find_motion
from luxel.render.motion_truth import (
    find_sums,
    from_half,
    motion_key,
    read_sums,
    render_motion_truth,
    to_half,
    write_sums,
)
from luxel.scene import is_built_in
from luxel.scene.device import Scene, upload

SIZE = (32, 24)


@pytest.fixture(autouse=True)
def own_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LUXEL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("LUXEL_REFERENCES", str(tmp_path / "references"))
    (tmp_path / "references" / "motion").mkdir(parents=True)


@pytest.fixture
def renders(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[float]]:
    """The times of the frames that are path traced."""
    times: list[float] = []
    real = motion_truth.render_truth

    def count(*given: Any, **named: Any) -> Any:
        times.append(named["time"])
        return real(*given, **named)

    monkeypatch.setattr(motion_truth, "render_truth", count)
    yield times


def fly(name: str, frames: int = 12) -> tuple[Scene, MotionPath]:
    scene = upload(load(name))
    return scene, find_motion(scene, frames)


def test_every_judged_frame_of_a_furnace_has_its_radiance(renders: list[float]) -> None:
    scene, path = fly("furnace")
    truth = render_motion_truth(scene, path, SIZE, 64)
    assert [frame.frame for frame in truth.frames] == [6, 12] and [cut.frame for cut in truth.cuts] == [13, 16, 28]
    # Emission 1 under albedo 0.5 in a closed box: 1 + 0.5 + 0.25 + ... = 2.
    for frame in [*truth.frames, *truth.cuts]:
        assert frame.layers is not None
        assert frame.layers.image().mean() == pytest.approx(2.0, rel=0.03)
    assert truth.exposure == pytest.approx(0.18 / 2.0, rel=0.03)
    assert truth.spp == 64 and 0.0 < truth.noise < 0.1 and truth.device in ("cpu", "cuda")
    # Two of the flight, and one of three that look the same after the jump.
    assert len(renders) == 3


def test_a_moving_scene_runs_on(renders: list[float]) -> None:
    scene, path = fly("moving")
    truth = render_motion_truth(scene, path, SIZE, 2)
    # 48 frames of warm-up at 30 a second, then the flight, whose first frame has number 1.
    wanted = [(48 + frame - 1) / 30 for frame in (6, 12, 13, 16, 28)]
    assert renders == pytest.approx(wanted)
    first, last = (cut.layers for cut in (truth.cuts[0], truth.cuts[2]))
    assert first is not None and last is not None
    assert not np.array_equal(first.albedo, last.albedo)
    assert scene.host.time == 0.0


@pytest.mark.parametrize(("name", "hashed"), [("two-rooms", 1), ("moving", 5)])
def test_what_stands_still_is_hashed_once(name: str, hashed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    times: list[float] = []
    real = motion_truth.view_key
    monkeypatch.setattr(motion_truth, "view_key", lambda *given: times.append(given[3]) or real(*given))
    scene, path = fly(name)
    render_motion_truth(scene, path, SIZE, 2)
    assert len(times) == hashed


def test_what_was_rendered_is_found_again_and_not_for_another_question(renders: list[float], tmp_path: Path) -> None:
    scene, path = fly("two-rooms")
    first = render_motion_truth(scene, path, SIZE, 4)
    count = len(renders)
    again = render_motion_truth(scene, path, SIZE, 4)
    assert len(renders) == count and again.noise == first.noise
    for one, other in zip(first.frames, again.frames, strict=True):
        assert one.layers is not None and other.layers is not None
        np.testing.assert_array_equal(one.layers.indirect, other.layers.indirect)
        np.testing.assert_array_equal(one.layers.image(), other.layers.image())
    render_motion_truth(scene, path, SIZE, 6)
    render_motion_truth(scene, path, SIZE, 4, seed=1)
    render_motion_truth(scene, path, (30, 24), 4)
    assert len(renders) == 4 * count
    # A damaged file is made again.
    files = sorted((tmp_path / "cache").rglob("motion-*.npz"))
    assert len(files) == 4 * count
    for file in files:
        file.write_bytes(file.read_bytes()[:100])
    render_motion_truth(scene, path, SIZE, 4)
    assert len(renders) == 5 * count


@pytest.mark.parametrize("damage", ["array", "no layer", "cut off"])
def test_a_file_that_holds_something_else_is_made_again(damage: str, renders: list[float], tmp_path: Path) -> None:
    scene, path = fly("furnace", 6)
    first = render_motion_truth(scene, path, SIZE, 2)
    count = len(renders)
    for file in (tmp_path / "cache").rglob("motion-*.npz"):
        held = dict(np.load(file))
        if damage == "array":
            with file.open("wb") as stream:
                np.save(stream, np.zeros(3))
            continue
        if damage == "no layer":
            del held["layer_direct"]
        else:
            held["layer_indirect"] = held["layer_indirect"][:5]
        np.savez(file, **held)
    again = render_motion_truth(scene, path, SIZE, 2)
    assert len(renders) == 2 * count
    np.testing.assert_array_equal(again.frames[0].layers.image(), first.frames[0].layers.image())  # type: ignore[union-attr]


@pytest.mark.parametrize("peak", [1e9, 1.0, 1e-9])
def test_halves_keep_light_of_any_level(peak: float) -> None:
    values = (peak * np.geomspace(1e-7, 1.0, 60)).astype(np.float32).reshape(5, 4, 3)
    np.testing.assert_allclose(from_half(*to_half(values)), values, rtol=2.0**-11)
    assert (from_half(*to_half(np.zeros((2, 2, 3)))) == 0.0).all()


@pytest.mark.parametrize("looks", ["diffuse", "full"])
def test_full_materials_keep_every_layer(looks: Any, renders: list[float]) -> None:
    scene = upload(load("glossy"), materials=looks)
    path = find_motion(scene, 6)
    first = render_motion_truth(scene, path, SIZE, 4).frames[0].layers
    again = render_motion_truth(scene, path, SIZE, 4).frames[0].layers
    assert first is not None and again is not None and len(renders) == 2
    for name, values in vars(first).items():
        if values is not None:
            np.testing.assert_array_equal(values, getattr(again, name))
    assert first.glossy.any() == (looks == "full")


@pytest.mark.skipif("cuda" in os.environ.get("LUXEL_TEST_DEVICE", "cpu"), reason="a GPU renders the truth instead")
def test_committed_sums_take_the_place_of_an_hour(renders: list[float], tmp_path: Path) -> None:
    scene, path = fly("two-rooms")
    truth = render_motion_truth(scene, path, SIZE, 4)
    count, key = len(renders), motion_key(scene, path, SIZE)
    file = tmp_path / "references" / "motion" / f"two-rooms-{key}.npz"
    write_sums(file, truth, {"scene": "two-rooms"})
    assert find_sums(key, 4) is not None and find_sums(key, 5) is None and find_sums("0" * 16, 1) is None
    kept = read_sums(file)
    assert kept is not None and (kept.spp, kept.noise, kept.exposure) == (4, truth.noise, truth.exposure)
    assert [cut.frame for cut in kept.cuts] == [13, 16, 28] and kept.cut == path.cut
    assert kept.irradiance == pytest.approx(truth.irradiance, rel=1e-3)
    # A frame is judged by the sums as by the layers that they are of.
    layers = truth.frames[1].layers
    assert layers is not None and kept.frames[1].layers is None
    layers.indirect[:] *= np.linspace(0.5, 1.4, SIZE[0], dtype=np.float32)[None, :, None]
    by_sums, by_layers = judge_by_sums(layers, kept.frames[1].sums), judge_by_sums(layers, truth.frames[1].sums)
    assert by_sums == pytest.approx(by_layers, abs=1e-3)
    assert judge_frame(layers, layers)["regional"] == 0.0
    # They have fewer paths than asked for unless told otherwise, so nothing takes them for it.
    assert len(renders) == count
    write_sums(file, truth.__class__(**{**vars(truth), "spp": 512}))
    assert render_motion_truth(scene, path, SIZE).frames[0].layers is None
    # A number asks for a truth of its own.
    assert render_motion_truth(scene, path, SIZE, 4).frames[0].layers is not None


def test_damaged_sums_are_none(tmp_path: Path) -> None:
    file = tmp_path / "broken.npz"
    file.write_bytes(b"PK")
    assert read_sums(file) is None and read_sums(tmp_path / "missing.npz") is None


def test_another_flight_has_another_key() -> None:
    scene, path = fly("two-rooms")
    other = find_motion(scene, 18)
    assert len({motion_key(scene, path, SIZE), motion_key(scene, other, SIZE), motion_key(scene, path, (8, 8))}) == 3


COMMITTED = sorted((Path(__file__).parents[2] / "benchmarks" / "references" / "motion").glob("*.npz"))


@pytest.mark.parametrize("file", COMMITTED, ids=lambda file: file.stem)
def test_committed_sums_belong_to_a_flight(file: Path) -> None:
    """No file lies about that nothing finds; those of scenes that are files are looked for where the files are."""
    with np.load(file) as kept:
        about = json.loads(str(kept["about"]))
    truth = read_sums(file)
    assert truth is not None and truth.spp >= motion_truth.MOTION_SPP and 0.0 < truth.noise < 0.1
    if not is_built_in(about["scene"]):
        pytest.skip(f"{about['scene']} is no built-in scene")
    scene = upload(load(about["scene"]))
    path = find_motion(scene, about["flown"], about["path"])
    assert file.stem.endswith(f"-{motion_key(scene, path, tuple(about['size']))}")
