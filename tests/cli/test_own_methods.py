"""A method of one's own at every command that takes one: the example of the docs, run from the shell."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from luxel.cli import main
from luxel.methods import METHODS
from luxel.methods.own import SOURCES
from luxel.report.suite import read_suite

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "02_own_method.py"
VOXELS = f"{EXAMPLE}:Voxels"
SMALL = ["--size", "32x32", "--frames", "3"]


@pytest.fixture(autouse=True)
def forgotten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LUXEL_CACHE", str(tmp_path / "cache"))
    yield
    METHODS.pop("voxels", None)
    SOURCES.clear()


def answered(words: list[str], capsys: pytest.CaptureFixture[str]) -> dict:
    assert main(words) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


def test_render_takes_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["render", "cornell-box", "--method", VOXELS, *SMALL, "--set", "keep=0.5", "--truth", "4"]
    result = answered([*words, "--save-cache", "voxels.npz", "--json"], capsys)
    assert result["method"] == "voxels" and result["rays_per_frame"] is None
    assert result["error"]["regional"] >= 0.0 and Path(result["image"]).is_file()
    again = answered(
        ["render", "cornell-box", "--method", VOXELS, *SMALL, "--load-cache", "voxels.npz", "--json"], capsys
    )
    assert again["method"] == "voxels"
    assert main(["render", "cornell-box", "--method", VOXELS, *SMALL, "--set", "hold=0.5"]) == 2
    assert "method 'voxels' has no parameter 'hold' (it has: keep)" in capsys.readouterr().err
    assert main(["render", "cornell-box", "--method", f"{VOXELS}:fast", *SMALL]) == 2
    assert "method 'voxels' has no preset 'fast'" in capsys.readouterr().err
    assert main(["render", "cornell-box", "--method", f"{VOXELS}:fast", "--preset", "slow", *SMALL]) == 2
    assert "'fast', and --preset another one, 'slow'" in capsys.readouterr().err


def test_bench_and_explain_take_it(capsys: pytest.CaptureFixture[str]) -> None:
    result = answered(["bench", VOXELS, *SMALL, "--json"], capsys)
    assert result["method"] == "voxels" and result["floor_ms"] is None and result["frame_ms"]["median"] > 0.0
    found = answered(["explain", "cornell-box", "--method", VOXELS, "--pixel", "16,28", *SMALL, "--json"], capsys)
    assert found["method"] == "voxels" and not found["inspected"]


def test_compare_takes_it_by_flag_and_by_suite(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["compare", "cornell-box", "--reference-spp", "4", "--no-peers", *SMALL, "-o", "out", "--json"]
    result = answered([*words, "--methods", f"{VOXELS},gibs:ekberg"], capsys)
    assert list(result["scenes"]["cornell-box"]["methods"]) == ["none", "ambient", "voxels", "gibs:ekberg"]
    entry = result["scenes"]["cornell-box"]["methods"]["voxels"]
    assert entry["method"] == "voxels" and entry["floor_ms"] is None and entry["baseline"] is False
    assert "voxels" in (tmp_path / "out" / "report.html").read_text()

    (tmp_path / "mine.py").write_text(EXAMPLE.read_text())
    del METHODS["voxels"]
    SOURCES.clear()
    suite = tmp_path / "deep" / "suite.toml"
    suite.parent.mkdir()
    suite.write_text(
        'scenes = ["cornell-box"]\n'
        'methods = ["gibs", { method = "../mine.py:Voxels", label = "slow", params = { keep = 0.99 } }]\n'
    )
    setup = read_suite(suite)["methods"][1]
    assert (setup.label, setup.method, setup.settings) == ("slow", "voxels", {"keep": "0.99"})
    assert setup.origin.path == str(tmp_path / "mine.py") and setup.params().keep == 0.99
    suite.write_text('scenes = ["cornell-box"]\nmethods = ["gibs", "../other.py:Voxels"]\n')
    assert main(["compare", str(suite), "-o", "out"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("luxel: suite.toml: methods[1]: there is no file") and len(said.splitlines()) == 1


def test_what_cannot_be_baked_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bake", "cornell-box", "--method", VOXELS, "-o", "box.glb"]) == 2
    assert "'voxels' cannot bake" in capsys.readouterr().err


def test_the_viewer_tells_the_file_in_its_command(capsys: pytest.CaptureFixture[str]) -> None:
    from luxel.methods import load_method
    from luxel.viewer.share import _method_text
    from luxel.viewer.world import list_methods

    load_method(VOXELS)
    assert "voxels" in list_methods() and _method_text("voxels") == VOXELS and _method_text("gibs") == "gibs"


def test_one_option_takes_a_preset_of_any_method(capsys: pytest.CaptureFixture[str]) -> None:
    result = answered(["render", "cornell-box", "--method", "gibs:ekberg", *SMALL, "--json"], capsys)
    assert result["method"] == "gibs"
    assert main(["render", "cornell-box", "--method", "gibs:nobody", *SMALL]) == 2
    assert "method 'gibs' has no preset 'nobody'" in capsys.readouterr().err
