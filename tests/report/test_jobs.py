"""Jobs: plain records, one upload and one truth a scene."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import pytest

from luxel.errors import LuxelError
from luxel.render.loading import load_choice
from luxel.report.compare import compare
from luxel.report.images import folder_names
from luxel.report.jobs import MethodSetup, RunJob, SceneCache, ViewJob, run_method, run_view
from luxel.scene.choice import SceneChoice

SIZE = (16, 16)


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LUXEL_CACHE", str(tmp_path / "cache"))


def quiet(text: str, share: float) -> None:
    pass


def make_view_job(source: str = "furnace", key: str = "a", **changes: str) -> ViewJob:
    return ViewJob(key, source, SceneChoice(source, **changes), "diffuse", 4, SIZE, "auto")


def test_a_job_travels_and_runs_by_itself() -> None:
    job = RunJob(make_view_job(), MethodSetup("path", "path"), seed=3, frames=2, flight=False, pictured=True)
    sent = pickle.loads(pickle.dumps(job))
    assert sent == job
    scenes = SceneCache()
    view = pickle.loads(pickle.dumps(run_view(sent.view, scenes=scenes, report=quiet)))
    outcome = pickle.loads(pickle.dumps(run_method(sent, view, scenes=scenes, report=quiet)))
    assert outcome.params == {"samples": 1, "history": 0} and outcome.machine["python"]
    assert outcome.pictures.image.shape == outcome.pictures.indirect.shape == (16, 16, 3)
    # All of the furnace's indirect light is in the image, and its truth is known.
    assert outcome.pictures.indirect.mean() == pytest.approx(view.truth.layers.indirect_radiance().mean(), rel=0.2)


def test_options_of_a_scene_travel_with_it() -> None:
    lit = SceneCache().scene(make_view_job("cornell-box", sky="0.5", sun="0,90,3"))
    assert lit.host.data.sky.color == (0.5, 0.5, 0.5)
    assert [light.kind for light in lit.host.data.lights].count("directional") == 1


def test_the_bench_keeps_one_scene() -> None:
    scenes = SceneCache()
    first = scenes.scene(make_view_job())
    assert scenes.scene(make_view_job()) is first
    other = scenes.scene(make_view_job(key="b"))
    assert other is not first
    assert scenes.scene(make_view_job(key="b")) is other
    scenes.clear()
    assert scenes.scene(make_view_job(key="b")) is not other


def test_a_scene_with_other_materials_is_uploaded_anew_but_not_read_again(monkeypatch: pytest.MonkeyPatch) -> None:
    job = make_view_job("glossy")
    scenes = SceneCache()
    diffuse = scenes.scene(job)
    monkeypatch.setattr("luxel.render.loading.load_choice", lambda choice: pytest.fail("read again"))
    full = scenes.scene(job, "full")
    assert scenes.scene(job, "full") is full
    assert (diffuse.features.gloss, full.features.gloss) == (False, True)


def test_one_upload_and_one_truth_a_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import luxel.render.truth as truth
    import luxel.scene.device as device

    calls: list[str] = []

    def counted(name: str, function: Any) -> Any:
        def call(*given: Any, **named: Any) -> Any:
            calls.append(name)
            return function(*given, **named)

        return call

    monkeypatch.setattr(device, "upload", counted("upload", device.upload))
    monkeypatch.setattr(truth, "render_truth", counted("truth", truth.render_truth))
    results = compare(
        ["furnace", "furnace"], ["path"], reference_spp=2, size=SIZE, frames=1, seeds=(0, 1), out=tmp_path
    )
    assert list(results["scenes"]) == ["furnace", "furnace-2"]
    assert calls == ["upload", "truth"] * 2


def test_results_are_there_after_each_scene(tmp_path: Path) -> None:
    def stop(text: str, share: float) -> None:
        if text.startswith("furnace-2: path"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        compare(["furnace", "furnace"], ["path"], reference_spp=2, size=SIZE, frames=1, out=tmp_path, progress=stop)
    kept = json.loads((tmp_path / "results.json").read_text())
    assert list(kept["scenes"]) == ["furnace"]
    assert kept["scenes"]["furnace"]["methods"]["path"]["flip"] is not None


def test_a_scene_as_text_says_where_it_lies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    moved = SceneChoice("a/b.gltf", envmap="sky.exr").anywhere()
    assert (moved.source, moved.envmap, moved.label) == (str(tmp_path / "a/b.gltf"), str(tmp_path / "sky.exr"), "b")
    assert SceneChoice("two-rooms:wall=0.05").anywhere().source == "two-rooms:wall=0.05"
    with pytest.raises(LuxelError, match="b.gltf"):
        load_choice(moved)


def test_folders_differ() -> None:
    assert folder_names(["a:b", "a b", "../x"]) == {"a:b": "a-b", "a b": "a-b-2", "../x": "-x"}
