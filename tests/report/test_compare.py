"""`compare`: what it writes and what it refuses."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from luxel.errors import LuxelError
from luxel.render.loading import load
from luxel.render.oracle import render_full
from luxel.report.collect import add_machine, average_seeds, make_header
from luxel.report.compare import compare
from luxel.report.jobs import MethodSetup
from luxel.scene.choice import scene_label
from luxel.scene.edit import default_camera

FIGURES = {
    "regional", "bias", "relmse", "rmse_tonemapped", "rmse_gi_tonemapped", "abs_error_mean", "abs_error_max",
    "block_error_max", "flip", "flicker", "flicker_absolute", "lag_frames", "leak", "truth_noise", "frame_ms", "stages",
    "floor_ms", "rays_per_frame", "seeds", "series",
}  # fmt: skip

BOX = "cornell-box"


def read_png(path: Path) -> np.ndarray:
    """Return (H, W, 3) int64."""
    with Image.open(path) as picture:
        return np.asarray(picture).astype(int)


@pytest.fixture(scope="module", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, short_rest: None) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LUXEL_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    out = tmp_path_factory.mktemp("compare") / "report"
    results = compare(
        ["furnace", "two-rooms"],
        ["path"],
        reference_spp=8,
        seeds=(0, 3),
        size=(32, 24),
        frames=4,
        command="luxel compare …",
        out=out,
    )
    return results, out


def test_results_hold_every_figure_of_every_method(report: tuple[dict[str, Any], Path]) -> None:
    results, out = report
    assert json.loads((out / "results.json").read_text())["scenes"].keys() == results["scenes"].keys()
    assert results["materials"] == "diffuse"
    assert list(results["scenes"]) == ["furnace", "two-rooms"]
    for scene in results["scenes"].values():
        assert list(scene["methods"]) == ["none", "ambient", "path"]
        assert scene["reference"]["kind"] == "diffuse"
        for figures in scene["methods"].values():
            assert figures.keys() >= FIGURES
            assert list(figures["seeds"]) == ["0", "3"]
            assert figures["series"]["frame"] == [1, 2, 4]
            assert len(figures["series"]["ms"]) == len(figures["series"]["regional"]) == 3


def test_the_trivial_methods_are_what_they_are(report: tuple[dict[str, Any], Path]) -> None:
    methods = report[0]["scenes"]["two-rooms"]["methods"]
    assert methods["none"]["bias"] == -1.0
    assert methods["none"]["leak"] is None
    assert methods["none"]["lag_frames"] is None
    # One irradiance everywhere: the right total, the wrong places, also behind the wall; it follows the lamps at once.
    assert methods["ambient"]["bias"] == pytest.approx(0.0, abs=1e-4)
    assert methods["ambient"]["regional"] > 0.1
    assert methods["ambient"]["leak"] == pytest.approx(1.0, rel=1e-3)
    assert methods["ambient"]["lag_frames"] == 1
    # A path tracer knows that a sealed room is dark.
    assert methods["path"]["leak"] == 0.0
    assert methods["path"]["regional"] < methods["ambient"]["regional"]
    assert report[0]["scenes"]["furnace"]["methods"]["path"]["leak"] is None


def test_the_mean_is_that_of_the_seeds(report: tuple[dict[str, Any], Path]) -> None:
    figures = report[0]["scenes"]["two-rooms"]["methods"]["path"]
    first, second = (figures["seeds"][seed]["regional"] for seed in ("0", "3"))
    assert first != second
    assert figures["regional"] == pytest.approx((first + second) / 2)


def test_images_are_there_and_have_the_size(report: tuple[dict[str, Any], Path]) -> None:
    import mitsuba as mi

    folder = report[1] / "furnace"
    images = {f"{name}{part}" for name in ("truth", "none", "ambient", "path") for part in ("", "_indirect")}
    flips = {f"{name}_flip.png" for name in ("none", "ambient", "path")}
    assert {file.name for file in folder.iterdir()} == {
        f"{name}.{end}" for name in images for end in ("exr", "png")
    } | flips
    assert read_png(folder / "path_flip.png").shape == (24, 32, 3)
    truth = np.array(mi.Bitmap(str(folder / "truth.exr")))
    assert truth.shape == (24, 32, 3)
    assert truth.mean() == pytest.approx(2.0, rel=0.05)
    indirect = np.array(mi.Bitmap(str(folder / "truth_indirect.exr")))
    assert 0.0 < indirect.mean() < truth.mean()


def test_the_head_says_what_ran(report: tuple[dict[str, Any], Path]) -> None:
    import luxel

    results = report[0]
    assert results["luxel"] == luxel.__version__
    assert results["command"] == "luxel compare …"
    assert results["machine"]["versions"]["mitsuba"] and "machines" not in results
    # `path` gets no peer, so there is none, and no denoiser.
    assert results["denoiser"]["used"] is None and "no peer" in results["denoiser"]["reason"]
    for name, scene in results["scenes"].items():
        assert scene["folder"] == name and scene["peers"] == [] and scene["path_series"] is None
    path = results["scenes"]["furnace"]["methods"]["path"]
    assert (path["method"], path["preset"], path["file"]) == ("path", None, "path")
    assert path["params"] == {"samples": 1, "history": 0}
    ambient = results["scenes"]["furnace"]["methods"]["ambient"]["params"]["irradiance"]
    assert ambient == results["scenes"]["furnace"]["reference"]["ambient_irradiance"]


def test_machines_that_differ_are_all_named() -> None:
    results = make_header(None, "diffuse")
    for cores in (2, 2, 16, 2):
        add_machine(results, {"cores": cores})
    assert results["machine"] == {"cores": 2} and results["machines"] == [{"cores": 2}, {"cores": 16}]


def test_the_spread_is_the_sample_deviation_of_the_seeds(report: tuple[dict[str, Any], Path]) -> None:
    figures = report[0]["scenes"]["two-rooms"]["methods"]["path"]
    first, second = (figures["seeds"][seed]["regional"] for seed in ("0", "3"))
    assert figures["spread"]["regional"] == pytest.approx(abs(first - second) / 2**0.5)
    assert report[0]["scenes"]["furnace"]["methods"]["path"]["spread"]["leak"] is None


def test_the_path_tracer_gets_the_time_of_a_method(tmp_path: Path) -> None:
    few = MethodSetup("few: surfels", "gibs", None, {"surfel_target": "400"})
    told: list[float] = []
    results = compare(
        [BOX],
        [few],
        reference_spp=16,
        size=(32, 32),
        frames=16,
        out=tmp_path,
        progress=lambda text, share: told.append(share),
    )
    assert told == sorted(told) and told[-1] == pytest.approx(1.0, abs=0.1) and max(told) <= 1.0 + 1e-9
    scene = json.loads((tmp_path / "results.json").read_text())["scenes"]["cornell-box"]
    assert scene["methods"]["few: surfels"]["params"]["surfel_target"] == 400
    took = scene["methods"]["few: surfels"]["series"]["ms"][-1]
    bare = scene["peers"][0]
    assert (bare["label"], bare["of"], bare["denoised"], bare["file"]) == (
        "path", "few: surfels", None, "path_at_few-surfels",
    )  # fmt: skip
    assert bare["of_ms"] == took
    assert bare["samples"] >= 1 and bare["ms"] > 0.0
    # What has no meaning for an image alone is null.
    assert bare["regional"] > 0.0 and bare["flicker"] is None and bare["spread"]["regional"] is None
    assert bare["seeds"]["0"]["regional"] == bare["regional"]
    assert scene["path_series"]["samples"][:1] == [1]
    assert results["denoiser"]["used"] == (scene["peers"][1]["denoised"] if len(scene["peers"]) > 1 else None)
    for peer in scene["peers"]:
        for end in (".exr", ".png", "_indirect.exr", "_indirect.png", "_flip.png"):
            assert (tmp_path / scene["folder"] / f"{peer['file']}{end}").exists()


def test_full_materials_are_reported_apart(tmp_path: Path) -> None:
    results = compare(["furnace"], ["path"], materials="full", reference_spp=32, size=(16, 16), frames=16, out=tmp_path)
    assert json.loads((tmp_path / "results.json").read_text())["materials"] == "full"
    scene = results["scenes"]["furnace"]
    assert scene["reference"]["kind"] == "full"
    path, none = scene["methods"]["path"], scene["methods"]["none"]
    assert path["regional"] is None and path["bias"] is None and path["series"]["regional"] == [None] * 5
    # The furnace has no gloss, so the path tracer agrees with its full materials.
    assert path["abs_error_mean"] < 0.1 < none["abs_error_mean"]


def test_full_materials_are_shown_by_who_shows_them_and_judged_by_mitsuba(tmp_path: Path) -> None:
    """`path` shows metal and glass; the picture that judges it has the light of `mi.render`."""
    data = load("glossy")
    results = compare([data], ["path"], materials="full", reference_spp=256, size=(32, 24), frames=80, out=tmp_path)
    (scene,) = results["scenes"].values()
    wanted = np.array(mi.Bitmap(str(tmp_path / scene["folder"] / "truth.exr")))
    theirs = render_full(data, default_camera(data, 32 / 24), size=(32, 24), spp=128)
    assert np.minimum(wanted, 2.0).mean() == pytest.approx(np.minimum(theirs, 2.0).mean(), rel=0.03)
    path, ambient = (scene["methods"][name]["abs_error_mean"] for name in ("path", "ambient"))
    assert path < 0.5 * ambient


def test_seeds_for_which_a_figure_does_not_apply_are_left_out() -> None:
    def run(lag: int | None, regional: float) -> dict[str, Any]:
        return {
            "lag_frames": lag,
            "regional": regional,
            "leak": None,
            "stages": {"gbuffer": regional},
            "rays_per_frame": {},
            "cache": {},
            "series": {"frame": [1], "ms": [1.0], "regional": [regional]},
        }

    mean = average_seeds({0: run(4, 0.5), 7: run(None, 0.25), 9: run(8, math.nan)})
    assert mean["lag_frames"] == 6.0
    assert mean["regional"] == mean["stages"]["gbuffer"] == mean["series"]["regional"][0] == 0.375
    assert mean["leak"] is None
    assert mean["seeds"]["7"]["lag_frames"] is None
    # 4 and 8 frames: the root of ((4 - 6)^2 + (8 - 6)^2) / (2 - 1).
    assert mean["spread"]["lag_frames"] == pytest.approx(8**0.5)
    assert mean["spread"]["leak"] is None


def test_names_in_the_report() -> None:
    assert scene_label("scenes/sponza/Sponza.gltf") == "Sponza"
    assert scene_label(Path("a.xml")) == "a"
    assert scene_label("two-rooms:wall=0.05") == "two-rooms:wall=0.05"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"methods": ["nothing"]}, "unknown method"),
        ({"methods": ["path:unheard"]}, "preset"),
        ({"materials": "other"}, "'other'.*diffuse or full"),
        ({"scenes": []}, "at least one scene"),
        ({"scenes": ["nowhere"]}, "nowhere"),
        ({"methods": [MethodSetup("truth", "path")]}, "another file"),
        ({"methods": [MethodSetup("a:b", "path"), MethodSetup("a-b", "path")]}, "another file"),
        ({"methods": [MethodSetup("p", "path", None, {"samples": "many"})]}, "whole number"),
    ],
)
def test_bad_input_is_one_sentence_before_any_rendering(tmp_path: Path, change: dict[str, Any], words: str) -> None:
    given: dict[str, Any] = {"scenes": ["furnace"], "methods": ["path"], "size": (8, 8), "frames": 1}
    with pytest.raises(LuxelError, match=words):
        compare(**{**given, **change}, out=tmp_path / "report")
    assert not (tmp_path / "report" / "results.json").exists()


def test_the_old_name_of_materials_is_read_and_said(tmp_path: Path) -> None:
    given: dict[str, Any] = {"scenes": ["furnace"], "methods": ["path"], "size": (8, 8), "frames": 1}
    with pytest.warns(FutureWarning, match="'materials'"), pytest.raises(LuxelError, match="'half'"):
        compare(**given, reference="half", out=tmp_path / "report")
