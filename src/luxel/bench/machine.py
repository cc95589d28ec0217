"""The machine that a figure was measured on: processor, GPU, system, versions, commit."""

from __future__ import annotations

import os
import platform
import re
import subprocess
from pathlib import Path
from typing import Any

from luxel.runtime import describe


def machine_record() -> dict[str, Any]:
    """Return the machine record. What cannot be found out is None.

    Keys: cpu cores gpu driver os python device llvm versions (of luxel, mitsuba, drjit, numpy, scipy) commit.
    `commit` ends in `+` where the checkout has changes.
    """
    about = describe()
    gpu, driver = _find_gpu()
    return {
        "cpu": _find_cpu(),
        "cores": _count_cores(),
        "gpu": gpu,
        "driver": driver,
        "os": _find_os(),
        "python": platform.python_version(),
        "device": about["device"],
        "llvm": about["llvm_version"],
        "versions": about["versions"],
        "commit": find_commit(Path(__file__).parent),
    }


def machine_name(record: dict[str, Any]) -> str:
    """Return a file name for a machine, such as `amd-epyc-7763-2-cores` or, where the GPU computes, its name."""
    on_gpu = record["device"] == "cuda" and record["gpu"]
    text = record["gpu"] if on_gpu else f"{record['cpu'] or platform.machine()} {record['cores']} cores"
    text = re.sub(r"\((r|tm)\)|\bcpu\b|\bprocessor\b|@.*?ghz", " ", text.lower())
    return re.sub(r"[^a-z0-9]+", "-", text).strip("-")


def find_commit(folder: Path) -> str | None:
    """Return $LUXEL_COMMIT where it is set, for copies that do not know what they are copies of; else the commit of
    the luxel checkout that `folder` is in, None for an installed package."""
    if os.environ.get("LUXEL_COMMIT"):
        return os.environ["LUXEL_COMMIT"]
    top = _ask("git", "-C", str(folder), "rev-parse", "--show-toplevel")
    # A package inside the virtual environment of some other repository is not a checkout of luxel.
    if top is None or not (Path(top) / "src" / "luxel").is_dir():
        return None
    commit = _ask("git", "-C", top, "rev-parse", "HEAD")
    changes = _ask("git", "-C", top, "status", "--porcelain", "--untracked-files=no")
    return f"{commit}+" if commit and changes else commit


def _find_cpu() -> str | None:
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return _ask("sysctl", "-n", "machdep.cpu.brand_string") or platform.processor() or None
    found = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return found[1].strip() if found else platform.machine() or None


def _count_cores() -> int | None:
    """Return the cores that this process may use, which in a container can be fewer than the machine has."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count()


def _find_gpu() -> tuple[str | None, str | None]:
    """Return name and driver version of the first NVIDIA GPU."""
    answer = _ask("nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader", "--id=0")
    name, _, driver = (answer or "").partition(",")
    return name.strip() or None, driver.strip() or None


def _find_os() -> str:
    try:
        return platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        return platform.platform(terse=True)


def _ask(*command: str) -> str | None:
    """Return what a program prints, or None where it is missing or fails."""
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=20, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None
