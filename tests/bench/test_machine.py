"""What a benchmark says about the machine."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxel.bench.machine import find_commit, machine_name, machine_record
from luxel.bench.rays import bumpy_sphere, ray_benchmark


def test_the_record_names_what_a_reader_needs() -> None:
    record = machine_record()
    assert record.keys() == {
        "cpu", "cores", "gpu", "driver", "os", "python", "device", "llvm", "versions", "commit",
    }  # fmt: skip
    assert record["cores"] >= 1
    assert record["versions"]["mitsuba"] and record["versions"]["drjit"]


@pytest.mark.parametrize(
    ("record", "name"),
    [
        ({"cpu": "AMD EPYC 7763 64-Core Processor", "cores": 2}, "amd-epyc-7763-64-core-2-cores"),
        ({"cpu": "Intel(R) Xeon(R) CPU @ 2.20GHz", "cores": 4}, "intel-xeon-4-cores"),
        ({"cpu": "x", "cores": 4, "device": "cuda", "gpu": "NVIDIA H100 80GB HBM3"}, "nvidia-h100-80gb-hbm3"),
        ({"cpu": "x", "cores": 4, "gpu": "NVIDIA H100 80GB HBM3"}, "x-4-cores"),
    ],
)
def test_file_names_of_machines(record: dict[str, Any], name: str) -> None:
    assert machine_name({"device": "cpu", "gpu": None, **record}) == name


def test_the_commit_is_that_of_a_luxel_checkout_only(tmp_path: Path) -> None:
    def git(*words: str) -> str:
        identity = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
        ran = subprocess.run(
            ["git", "-C", str(tmp_path), *identity, *words], capture_output=True, text=True, check=True
        )
        return ran.stdout.strip()

    package = tmp_path / "src" / "luxel"
    package.mkdir(parents=True)
    assert find_commit(package) is None
    git("init", "-q")
    (package / "a.py").write_text("")
    git("add", ".")
    git("commit", "-q", "-m", "first")
    assert find_commit(package) == git("rev-parse", "HEAD")
    (package / "a.py").write_text("changed")
    assert find_commit(package) == git("rev-parse", "HEAD") + "+"
    other = tmp_path / "other"
    (other / ".venv").mkdir(parents=True)
    subprocess.run(["git", "-C", str(other), "init", "-q"], check=True)
    assert find_commit(other / ".venv") is None


def test_the_ball_is_closed_and_looks_outwards() -> None:
    positions, faces = bumpy_sphere(24)
    assert faces.shape == (2 * 24 * 24, 3)
    corners = positions[faces].astype(np.float64)
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
    assert volume == pytest.approx(4.0 / 3.0 * np.pi, rel=0.05)


def test_rays_are_counted() -> None:
    figures = ray_benchmark(0.05)
    assert figures["batches"] >= 1
    assert figures["rays_per_second"] > 1e3
