"""Starts the device once, before any test module is imported, and finds the real scenes."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from luxel import runtime
from luxel.errors import LuxelError

REPOSITORY = Path(__file__).resolve().parents[1]


def pytest_sessionstart() -> None:
    """Test modules import Mitsuba at their top, and Dr.Jit takes its LLVM at that moment."""
    try:
        runtime.start(os.environ.get("LUXEL_TEST_DEVICE", "cpu"))
    except LuxelError as error:
        pytest.exit(str(error), returncode=2)


@pytest.fixture(scope="session")
def scenes_folder() -> Path:
    """The folder of real scenes, `LUXEL_TEST_SCENES`; a test that asks for it is skipped where there is none."""
    folder = Path(os.environ.get("LUXEL_TEST_SCENES") or REPOSITORY.parent / "shared" / "scenes")
    if not folder.is_dir():
        pytest.skip(f"no real scenes at {folder}: name their folder in LUXEL_TEST_SCENES")
    return folder
