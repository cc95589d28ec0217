"""What the method has to say after the run is printed, once, and only where it is so."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from luxel.cli import main

WORDS = ["--method", "gibs", "--size", "48x32", "--frames", "12"]
FULL = "The pool is full"


@pytest.mark.parametrize(("setting", "full"), [("capacity=64", True), ("surfel_target=2000", False)])
def test_a_full_pool_is_said(setting: str, full: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By the figures of the cache: the sentence is there where count and capacity are one."""
    words = ["render", "cornell-box", *WORDS, "--set", setting, "-o", str(tmp_path / "image.png")]
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["cache"]["surfel_count"] == found["cache"]["surfel_capacity"]) is full
    assert sum(FULL in text for text in found["warnings"]) == full
    assert main(words) == 0
    shown = capsys.readouterr()
    lines = [line for line in shown.err.splitlines() if FULL in line]
    assert len(lines) == full and FULL not in shown.out
    assert all(line.startswith("luxel: warning: ") and "--set capacity=128)" in line for line in lines)


def test_explain_says_it_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "cornell-box", "--pixel", "24,16", *WORDS, "--set", "capacity=64"]) == 0
    assert capsys.readouterr().err.count(FULL) == 1


def test_bench_says_it_too(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["bench", "gibs", "--size", "48x32", "--frames", "4", "--set", "capacity=64"]
    assert main([*words, "--json"]) == 0
    shown = capsys.readouterr()
    assert [FULL in text for text in json.loads(shown.out)["warnings"]] == [True] and FULL not in shown.err
    assert main(words) == 0
    shown = capsys.readouterr()
    assert shown.err.count(FULL) == 1 and FULL not in shown.out


def test_compare_says_it_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Once for all seeds, with the method's label, and of nothing else than what it is true of."""
    suite = tmp_path / "some.toml"
    small = '{ method = "gibs", label = "small", params = { capacity = 16 } }'
    suite.write_text(f'scenes = ["cornell-box"]\nmethods = [{small}]\nseeds = [0, 1]')
    words = ["compare", str(suite), "--size", "24x16", "--frames", "8", "--reference-spp", "4", "--no-peers"]
    assert main([*words, "-o", str(tmp_path / "report")]) == 0
    shown = capsys.readouterr()
    said = [line for line in shown.err.splitlines() if FULL in line]
    assert len(said) == 1 and said[0].startswith("luxel: warning: cornell-box, small: ") and FULL not in shown.out
    methods = json.loads((tmp_path / "report" / "results.json").read_text())["scenes"]["cornell-box"]["methods"]
    assert [name for name, method in methods.items() if method["warnings"]] == ["small"]
    assert (tmp_path / "report" / "report.html").read_text().count(FULL) == 1
