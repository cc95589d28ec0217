"""`luxel render` with caches that are kept, taken up again and given to other programs."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from luxel.cli import main

DEVICE = os.environ.get("LUXEL_TEST_DEVICE", "cpu")
PROBES = ["--method", "ddgi", "--set", "probe_target=120", "--set", "extra_probes=4"]


def words(output: Path, *more: str, frames: int = 1) -> list[str]:
    start = ["render", "cornell-box", "--size", "32x32", "--device", DEVICE, "--exposure", "1"]
    return [*start, "--frames", str(frames), "-o", str(output), *more]


def read_png(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture).astype(int)


def test_a_cache_is_taken_up_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One frame from the saved cache shows the light of the long run, which a first frame of its own does not."""
    kept, images = tmp_path / "new" / "probes.npz", [tmp_path / f"{name}.exr" for name in ("long", "on", "first")]
    assert main(words(images[0], *PROBES, "--save-cache", str(kept), "--json", frames=60)) == 0
    assert json.loads(capsys.readouterr().out)["cache_file"] == str(kept)
    assert [path.name for path in kept.parent.iterdir()] == ["probes.npz"]
    assert main(words(images[1], *PROBES, "--load-cache", str(kept))) == 0
    assert "cache file" not in capsys.readouterr().out
    assert main(words(images[2], *PROBES)) == 0

    import mitsuba as mi

    long, on, first = (float(np.array(mi.Bitmap(str(path)))[..., :3].mean()) for path in images)
    assert abs(on - long) < 0.3 * abs(first - long)


def test_any_method_keeps_its_cache(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = tmp_path / "surfels.npz"
    gibs = ["--method", "gibs", "--set", "surfel_target=500"]
    assert main(words(tmp_path / "a.png", *gibs, "--save-cache", str(kept), frames=8)) == 0
    assert str(kept) in capsys.readouterr().out
    assert main(words(tmp_path / "b.png", *gibs, "--load-cache", str(kept))) == 0


def test_the_atlases_are_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "deep" / "atlases"
    assert main(words(tmp_path / "a.png", *PROBES, "--atlases", str(folder), "--json", frames=4)) == 0
    written = [Path(path) for path in json.loads(capsys.readouterr().out)["atlases"]]
    assert sorted(written) == sorted(folder.iterdir())
    assert {path.name for path in written} == {"irradiance_atlas.exr", "depth_atlas.exr", "probes.json"}
    header = json.loads((folder / "probes.json").read_text())
    assert len(header["probes"]["p"]) == header["probes"]["total"]


def test_what_will_be_allocated_is_said_before(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(words(tmp_path / "a.png", *PROBES)) == 0
    shown = capsys.readouterr()
    (line,) = (line for line in shown.err.splitlines() if "held back" in line)
    assert line.startswith("luxel: ddgi: ") and "MiB" in line and "held back" not in shown.out
    assert main(words(tmp_path / "a.png", *PROBES, "--json")) == 0
    shown = capsys.readouterr()
    assert "held back" not in shown.err and "held back" not in json.dumps(json.loads(shown.out)["warnings"])

    # It comes first: where the building fails, it has been said.
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("no building")

    monkeypatch.setattr("luxel.render.renderer.Renderer.__init__", fail)
    assert main(words(tmp_path / "a.png", *PROBES)) == 1
    assert "held back" in capsys.readouterr().err
    # Most methods have nothing to say of it.
    assert main(words(tmp_path / "a.png", "--method", "none")) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize(
    ("more", "hint"),
    [
        (["--method", "gibs", "--atlases", "atlases"], "'ddgi'"),
        (["--method", "none", "--save-cache", "cache.txt"], ".npz"),
        (["--method", "none", "--load-cache", "missing.npz"], "no such file"),
        (["--method", "none", "--save-cache", "file/cache.npz"], "cannot write"),
        (["--method", "ddgi", "--atlases", "file"], "cannot write"),
        (["--method", "none", "--load-cache", "file"], "damaged"),
    ],
)
def test_bad_files_are_refused_before_the_work(
    more: list[str], hint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise AssertionError("nothing may be rendered")

    monkeypatch.setattr("luxel.render.renderer.Renderer.step", fail)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("old")
    assert main(words(tmp_path / "a.png", *more)) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith("luxel: ") and hint in line
    assert [path.name for path in tmp_path.iterdir()] == ["file"] and (tmp_path / "file").read_text() == "old"


def test_the_cache_of_other_parameters_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = tmp_path / "probes.npz"
    assert main(words(tmp_path / "a.png", *PROBES, "--save-cache", str(kept))) == 0
    capsys.readouterr()
    other = [*PROBES, "--set", "irradiance_resolution=6", "--load-cache", str(kept)]
    assert main(words(tmp_path / "b.png", *other)) == 2
    assert "other parameters" in capsys.readouterr().err
    assert main(words(tmp_path / "b.png", "--method", "none", "--load-cache", str(kept))) == 2
    assert "another method" in capsys.readouterr().err
    assert not (tmp_path / "b.png").exists()
