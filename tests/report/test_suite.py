"""Suites: what a file asks for, what the flags change, and how it says what is wrong."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from luxel.cli import main
from luxel.errors import LuxelError
from luxel.render.loading import load_choice
from luxel.report.jobs import MethodSetup
from luxel.report.suite import read_suite
from luxel.scene.choice import SceneChoice

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "suite.toml"


def write(folder: Path, text: str) -> Path:
    path = folder / "some.toml"
    path.write_text(text)
    return path


def test_the_example_can_be_read() -> None:
    suite = read_suite(EXAMPLE)
    assert [scene.label for scene in suite["scenes"]] == ["cornell-box", "thin wall", "atrium, low sun"]
    assert suite["scenes"][2] == SceneChoice("atrium", sun="200,15,6", sky="0.3,0.4,0.6", name="atrium, low sun")
    assert suite["methods"] == [
        MethodSetup("gibs", "gibs"),
        MethodSetup("gibs:ekberg", "gibs", "ekberg"),
        MethodSetup("ddgi, 64 rays", "ddgi", None, {"num_samples_per_probe": "64"}),
    ]
    assert (suite["size"], suite["frames"], suite["seeds"]) == ((256, 256), 64, [0, 1, 2])
    # Every scene can be made as the file says.
    assert all(load_choice(scene).objects for scene in suite["scenes"])


def test_paths_count_from_the_file(tmp_path: Path) -> None:
    text = """
        scenes = ["a.gltf", "furnace", { scene = "sub/b.xml", envmap = "sky.exr", sky = "none" }]
        methods = ["path", { method = "gibs:ekberg", params = { rays_per_surfel = 8, low_discrepancy = true } }]
        size = [64, 32]
    """
    suite = read_suite(write(tmp_path, text))
    assert [scene.source for scene in suite["scenes"]] == [f"{tmp_path}/a.gltf", "furnace", f"{tmp_path}/sub/b.xml"]
    assert suite["scenes"][2].envmap == f"{tmp_path}/sky.exr"
    assert suite["methods"][1].label == "gibs:ekberg rays_per_surfel=8 low_discrepancy=true"
    params = suite["methods"][1].params()
    assert params.rays_per_surfel == 8 and params.low_discrepancy is True
    assert suite["size"] == (64, 32)
    assert suite.keys() == {"scenes", "methods", "size"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["some.toml", "scenes"]),
        ("scenes = [3\nframes", ["some.toml", "TOML", "line 2"]),
        ("scenes = []", ["scenes", "list"]),
        ('scenes = "furnace"', ["scenes", "list", "'furnace'"]),
        ("scenes = [3]", ["scenes[0]", "3"]),
        ('scenes = ["furnace"]\nframe = 3', ["some.toml", "'frame'", "frames"]),
        ('scenes = ["furnace"]\nframes = "3"', ["some.toml: frames", "whole number", "'3'"]),
        ('scenes = ["furnace"]\nframes = 0', ["frames", "whole number", "0"]),
        ('scenes = ["furnace"]\nframes = true', ["frames", "whole number", "true"]),
        ('scenes = ["furnace"]\nseeds = [0, -1]', ["seeds[1]", "-1"]),
        ('scenes = ["furnace"]\nsize = "big"', ["size", "640x360", "'big'"]),
        ('scenes = ["furnace"]\nsize = [64, "x"]', ["size", "'x'"]),
        ('scenes = ["furnace"]\nflight = 1', ["flight", "true or false"]),
        ('scenes = ["furnace"]\nmaterials = "half"', ["materials", "diffuse or full", "'half'"]),
        ('scenes = ["furnace"]\nreference = "half"', ["reference", "diffuse or full", "'half'"]),
        ('scenes = ["furnace"]\nreference = "full"\nmaterials = "full"', ["some.toml", "old name", "'materials'"]),
        ('scenes = [{ scene = "furnace", sum = "1,2" }]', ["scenes[0]", "'sum'", "sun"]),
        ('scenes = [{ scene = "furnace", sun = [1, "2"] }]', ["scenes[0].sun", "numbers"]),
        ('scenes = [{ sun = "1,2" }]', ["scenes[0]", "'scene'"]),
        ('scenes = ["furnace"]\nmethods = ["magic"]', ["methods[0]", "magic"]),
        ('scenes = ["furnace"]\nmethods = [{ preset = "ekberg" }]', ["methods[0]", "'method'"]),
        ('scenes = ["furnace"]\nmethods = [{ method = "gibs", preset = "x" }]', ["methods[0]", "preset 'x'"]),
        (
            'scenes = ["furnace"]\nmethods = [{ method = "path", params = { samples = 1.5 } }]',
            ["methods[0]", "samples"],
        ),
        ('scenes = ["furnace"]\nmethods = [{ method = "path", params = { sample = 1 } }]', ["methods[0]", "sample"]),
        ('scenes = ["furnace"]\nmethods = [{ method = "path", params = [1] }]', ["methods[0].params", "table"]),
        ('scenes = ["furnace"]\nmethods = [{ method = "path", label = "" }]', ["methods[0].label", "text"]),
    ],
)
def test_one_sentence_names_the_key_and_its_place(text: str, words: list[str], tmp_path: Path) -> None:
    with pytest.raises(LuxelError) as raised:
        read_suite(write(tmp_path, text))
    message = str(raised.value)
    assert "\n" not in message and all(word in message for word in words), message


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(LuxelError, match="no file"):
        read_suite(tmp_path / "missing.toml")
    with pytest.raises(LuxelError, match="cannot be read"):
        read_suite(tmp_path)
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(LuxelError, match="not TOML"):
        read_suite(tmp_path / "bytes.toml")


# ---------- On the command line ----------


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the command line asks `compare` for, without doing it."""
    found: dict[str, Any] = {}

    def catch(**given: Any) -> dict[str, Any]:
        found.update(given)
        return {"scenes": {}, "denoiser": {"used": None, "reason": ""}}

    monkeypatch.setattr(sys.modules["luxel.report.compare"], "compare", catch)
    return found


def test_flags_go_before_the_suite(asked: dict[str, Any], tmp_path: Path) -> None:
    assert main(["compare", str(EXAMPLE), "-o", str(tmp_path)]) == 0
    assert (asked["size"], asked["frames"], asked["seeds"], asked["peers"]) == ((256, 256), 64, [0, 1, 2], True)
    assert [one.label for one in asked["methods"]] == ["gibs", "gibs:ekberg", "ddgi, 64 rays"]
    words = ["--size", "64x48", "--seeds", "5", "--no-peers", "--methods", "path", "--sun", "10,20", "--flight"]
    assert main(["compare", str(EXAMPLE), "-o", str(tmp_path), *words]) == 0
    assert (asked["size"], asked["seeds"], asked["peers"], asked["flight"]) == ((64, 48), [5], False, True)
    assert asked["frames"] == 64 and asked["methods"] == ["path"]
    assert [scene.sun for scene in asked["scenes"]] == ["10,20"] * 3
    assert asked["scenes"][2].sky == "0.3,0.4,0.6"


def test_materials_are_one_word_and_the_old_one_is_still_read(
    asked: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def ask(text: str, *words: str) -> tuple[str, str, list[str]]:
        assert main(["compare", str(write(tmp_path, f'scenes = ["furnace"]\n{text}')), "-o", "out", *words]) == 0
        return asked["materials"], asked["command"], capsys.readouterr().err.strip().splitlines()

    assert ask("")[::2] == ("diffuse", [])
    assert ask('materials = "full"')[::2] == ("full", [])
    for text, words, wanted in (
        ('reference = "full"', [], "full"),
        ('reference = "full"', ["--materials", "diffuse"], "diffuse"),
        ('materials = "diffuse"', ["--reference", "full"], "full"),
    ):
        materials, command, (line,) = ask(text, *words)
        assert materials == wanted and "reference" not in command
        assert "old name" in line and "materials'" in line
        assert not words or command.endswith(f"--materials {wanted}")
    assert main(["compare", "furnace", "-o", "out", "--reference", "full", "--materials", "full"]) == 2
    assert "leave it out" in capsys.readouterr().err
    with pytest.warns(FutureWarning, match="'materials'"):
        assert read_suite(write(tmp_path, 'scenes = ["furnace"]\nreference = "full"'))["materials"] == "full"


def test_what_neither_names_is_the_default(asked: dict[str, Any], tmp_path: Path) -> None:
    assert main(["compare", str(write(tmp_path, 'scenes = ["furnace"]')), "-o", str(tmp_path)]) == 0
    assert (asked["size"], asked["frames"], asked["methods"], asked["seeds"]) == ((512, 512), 64, ["gibs"], [0])


def test_the_command_can_be_repeated(asked: dict[str, Any], tmp_path: Path) -> None:
    words = ["compare", "furnace", "two-rooms", "-o", "my report", "--no-peers", "--frames", "3", "--camera", "a;b"]
    assert main(words) == 0
    expected = "luxel compare furnace two-rooms --output 'my report' --frames 3 --no-peers --camera 'a;b'"
    assert asked["command"] == expected
    assert asked["scenes"] == [SceneChoice(name, camera="a;b") for name in ("furnace", "two-rooms")]


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["suite.toml", "furnace"], "stands alone"),
        (["missing.toml"], "missing.toml"),
        (["large.toml"], "too large"),
    ],
)
def test_bad_suites_exit_with_2(
    words: list[str], hint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "large.toml").write_text('scenes = ["furnace"]\nsize = "90000x90000"')
    assert main(["compare", *words, "-o", "out"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("luxel: ") and hint in line
    assert not (tmp_path / "out").exists()


def test_a_suite_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("LUXEL_CACHE", str(tmp_path / "cache"))
    text = """
        scenes = ["furnace", { scene = "furnace", sky = 0.5, name = "dim" }]
        methods = [{ method = "path", params = { samples = 2 }, label = "two paths" }]
        seeds = [0, 1]
        size = "8x8"
        frames = 2
        reference_spp = 4
    """
    assert main(["compare", str(write(tmp_path, text)), "-o", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert "two paths" in shown and "dim" in shown
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert list(results["scenes"]) == ["furnace", "dim"]
    record = results["scenes"]["dim"]["methods"]["two paths"]
    assert record["params"] == {"samples": 2, "history": 0} and list(record["seeds"]) == ["0", "1"]
    assert record["spread"]["bias"] > 0.0
    assert (tmp_path / "out" / "dim" / f"{record['file']}.png").exists()
