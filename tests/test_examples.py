"""Every example runs as a reader would run it, in a process of its own, and leaves what it promises."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
SMALL = "64"
PROMISES = {
    "00_first_image.py": ["first-image.png"],
    "01_compare_methods.py": ["none.png", "ambient.png", "path.png", "gibs.png", "truth.png"],
    "02_own_method.py": ["ambient.png", "voxels.png"],
    "03_moving_light.py": ["moving.gif"],
    "04_numpy_scene.py": ["hills.png", "hills.exr"],
    "05_irradiance_anywhere.py": ["floor.csv"],
}


def run_example(name: str, out: Path) -> str:
    """Run an example at a small size and return what it printed."""
    command = [sys.executable, str(EXAMPLES / name), str(out), SMALL]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=out.parent)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


def read_errors(text: str) -> dict[str, float]:
    """Return method -> regional error from lines such as `gibs: regional error 0.02`."""
    return {name: float(value) for name, value in re.findall(r"^(\w+):? .*?regional(?: error)? (\d\.\d+)", text, re.M)}


def test_every_example_is_tested() -> None:
    assert set(PROMISES) == {path.name for path in EXAMPLES.glob("*.py")}


@pytest.mark.parametrize("name", PROMISES)
def test_example_runs(name: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    printed = run_example(name, out)
    assert printed.strip()
    assert sorted(path.name for path in out.iterdir()) == sorted(PROMISES[name])
    for path in out.glob("*.png"):
        image = np.asarray(Image.open(path))
        assert image.ndim == 3 and image.std() > 5.0, f"{path.name} shows nothing"
    if name == "01_compare_methods.py":
        errors = read_errors(printed)
        assert errors["gibs"] < 0.5 * errors["ambient"] < errors["none"]
    if name == "02_own_method.py":
        errors = read_errors(printed)
        assert errors["voxels"] < 0.5 * errors["ambient"]
    if name == "03_moving_light.py":
        with Image.open(out / "moving.gif") as movie:
            assert getattr(movie, "n_frames", 1) == 40
    if name == "05_irradiance_anywhere.py":
        table = np.loadtxt(out / "floor.csv", delimiter=",", skiprows=1)
        assert table.shape == (9, 4) and (table[:, 1:] > 0.0).all()


def test_the_own_method_is_short() -> None:
    assert len((EXAMPLES / "02_own_method.py").read_text().splitlines()) < 80
