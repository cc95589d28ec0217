"""`luxel compare --motion` on the command line: what it asks for, prints and refuses."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from luxel.cli import main
from luxel.cli.compare import _print_scene

PATH = "-9,2,0;3,2.5,0;5,2.5,0;13,3,-3;65"


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the command line asks `compare` for, without doing it."""
    found: dict[str, Any] = {}

    def catch(**given: Any) -> dict[str, Any]:
        found.update(given)
        return {"scenes": {}, "denoiser": {"used": None, "reason": ""}}

    monkeypatch.setattr(sys.modules["luxel.report.compare"], "compare", catch)
    return found


def test_flags_say_what_is_flown(asked: dict[str, Any], tmp_path: Path) -> None:
    words = ["compare", "atrium", "two-rooms", "-o", str(tmp_path)]
    assert main(words) == 0
    assert (asked["motion"], asked["motion_spp"]) == (False, None)
    flags = ["--motion", "--motion-frames", "12", "--motion-spp", "64", f"--flight-path={PATH}"]
    assert main([*words, *flags]) == 0
    assert (asked["motion"], asked["motion_frames"], asked["motion_spp"]) == (True, 12, 64)
    assert [scene.flight_path for scene in asked["scenes"]] == [PATH, PATH]
    assert "--motion" in asked["command"] and PATH in asked["command"]


def test_a_suite_may_fly(asked: dict[str, Any], tmp_path: Path) -> None:
    suite = tmp_path / "suite.toml"
    suite.write_text(
        f'motion = true\nmotion_frames = 24\nmotion_spp = 32\nscenes = ["two-rooms", {{ scene = "atrium", '
        f'flight_path = "{PATH}" }}]\n'
    )
    assert main(["compare", str(suite), "-o", str(tmp_path)]) == 0
    assert (asked["motion"], asked["motion_frames"], asked["motion_spp"]) == (True, 24, 32)
    assert [scene.flight_path for scene in asked["scenes"]] == [None, PATH]
    assert main(["compare", str(suite), "-o", str(tmp_path), "--motion-frames", "6"]) == 0
    assert asked["motion_frames"] == 6


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--motion", "--flight-path=1,2,3;4,5,6"], "not a flight path"),
        (["--motion", "--flight-path=0,0,0;2,0,0;2,0,0;0,0,0", "--motion-frames", "7"], "meets its target"),
        ([f"--flight-path={PATH}"], "add --motion"),
        (["--motion-frames", "12"], "add --motion"),
        (["--motion-spp", "12"], "add --motion"),
        (["--motion", "--motion-frames", "5"], "--motion-frames"),
        (["--motion", "--motion-spp", "0"], "--motion-spp"),
    ],
)
def test_a_flight_that_cannot_be_is_refused_with_exit_code_2(
    flags: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", "furnace", "--size", "16x16", "-o", str(tmp_path / "out"), *flags]) == 2
    said = capsys.readouterr().err
    assert words in said and "Traceback" not in said
    assert not (tmp_path / "out" / "results.json").exists()


def test_rest_and_motion_are_printed_one_below_the_other(capsys: pytest.CaptureFixture[str]) -> None:
    names = ("regional", "bias", "flip", "flicker", "lag_frames", "leak", "frame_ms", "floor_ms", "truth_noise")
    flown = ("motion_regional", "motion_regional_worst", "motion_bias", "motion_flip", "motion_flicker", "cut_regional")
    figures = dict.fromkeys(names, 0.5) | {name: 0.001 * number for number, name in enumerate(flown, 1)}
    peer = {**figures, "of": "gibs", "denoised": None, "samples": 7, "ms": 20.0, "of_ms": 25.0, "history": None}
    scene = {
        "methods": {"gibs": {**figures, "motion_ms": 25.0}},
        "reference": {"spp": 8, "kind": "diffuse", "motion": {"frames": 12, "path": PATH, "spp": 512, "noise": 0.002}},
        "peers": [
            {**peer, "run": "rest", "label": "path"},
            {**peer, "run": "motion", "label": "path:reproject", "history": 9, "time_ratio": 0.8, "motion_ms": 20.0},
        ],
    }
    _print_scene("atrium", scene)
    lines = capsys.readouterr().out.splitlines()
    title = next(number for number, line in enumerate(lines) if "in motion" in line)
    assert PATH in lines[title] and "512 samples" in lines[title]
    assert lines[title + 1].split() == ["method", "regional", "worst", "bias", "flip", "flicker", "cut", "ms"]
    assert lines[title + 2].split() == ["gibs", "0.001", "0.002", "0.003", "0.004", "0.005", "0.006", "25"]
    assert lines[title + 3].split()[-2:] == ["ms", "time_ratio"]
    assert lines[title + 4].split() == ["gibs,", "reproject", "0.001", "0.003", "0.004", "0.005", "7", "9", "20", "0.8"]
