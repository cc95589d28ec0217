"""`luxel reproduce`: what it prints, writes and refuses."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from luxel.cli import main
from luxel.errors import LuxelError

DEVICE = os.environ.get("LUXEL_TEST_DEVICE", "cpu")


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LUXEL_CACHE", str(tmp_path_factory.mktemp("cache")))


def test_prints_tables_and_writes_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["reproduce", "rohacek", "--tables", "4.1,4.2", "--quick", "--device", DEVICE, "-o", str(tmp_path / "out")]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert "4.1: Atlas bytes a probe" in printed
    assert "bytes (published)" in printed
    assert "10,544" in printed
    assert "attic" in printed
    assert "machine" in printed
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"results.json", "runs.json", "tables.md"}
    read = json.loads((tmp_path / "out" / "results.json").read_text())
    assert [table["name"] for table in read["tables"]] == ["4.1", "4.2"]

    assert main(words) == 0
    again = capsys.readouterr()
    assert again.out == printed
    assert "runs are kept from" in again.err
    assert main([*words, "--seed", "1", "--tables", "4.1"]) == 0
    assert "measured anew" in capsys.readouterr().err
    assert main([*words, "--seed", "1", "--tables", "4.1", "--fresh"]) == 0
    assert capsys.readouterr().err == ""


def test_a_table_is_printed_when_it_is_there(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_: object, **__: object) -> None:
        raise LuxelError("stopped here")

    monkeypatch.setattr("luxel.bench.reproduce.runs.StudyView._run", stopped)
    assert main(["reproduce", "rohacek", "--tables", "4.1,4.6", "--quick", "--device", DEVICE]) == 2
    printed = capsys.readouterr()
    assert "4.1: Atlas bytes a probe" in printed.out
    assert "4.6" not in printed.out
    assert "stopped here" in printed.err


def test_json_is_one_object(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce", "rohacek", "--tables", "4.1", "--quick", "--json", "--device", DEVICE]) == 0
    read = json.loads(capsys.readouterr().out)
    assert read["machine"]["cores"] >= 1
    assert read["tables"][0]["columns"][-1] == "bytes (published)"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("nobody",), "there is no 'nobody' to reproduce"),
        (("ekberg",), "needs the file of Crytek Sponza"),
        (("rohacek", "Sponza.gltf"), "takes no scene file"),
        (("fast-object", "--tables", "4.1"), "choose from forth, back"),
        (("rohacek", "--tables", "5.5"), "there is no table '5.5'"),
        (("rohacek", "--bounces", "never"), "never"),
        (("ekberg", "missing.gltf", "--quick"), "missing.gltf"),
        (("rohacek", "--size", "0x0"), "no pixels"),
    ],
)
def test_bad_input_gets_one_sentence(words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce", *words, "--device", DEVICE]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert len(error.strip().splitlines()) == 1
