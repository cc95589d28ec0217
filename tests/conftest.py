"""Starts the device once, before any test module is imported, and finds the real scenes and a browser."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import pytest

from luxel import runtime
from luxel.errors import LuxelError

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Playwright

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


# ---------- A browser ----------

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
BROWSER_ARGUMENTS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""WebGL in software, which the viewer needs where there is no GPU."""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """A headless Chromium, the system's or Playwright's own.

    Where there is none its tests are skipped with the reason; under CI=true they fail.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        miss_browser("playwright is not installed: run `pip install playwright`")
    # One module long, because an event loop runs in this thread meanwhile and `asyncio.run` would refuse.
    with sync_playwright() as playwright:
        browser = launch_chromium(playwright)
        yield browser
        browser.close()


def launch_chromium(playwright: Playwright) -> Browser:
    """Start the first browser that starts; without one the test is skipped, or fails under CI=true."""
    from playwright.sync_api import Error

    found = [path for name in BROWSERS if (path := shutil.which(name))]
    reason = "no Chromium found: install it, or run `python -m playwright install chromium`"
    for path in [*found, None]:
        try:
            return playwright.chromium.launch(executable_path=path, args=list(BROWSER_ARGUMENTS))
        except Error as error:
            reason = f"{reason}; {path or 'playwright'}: {error.message.splitlines()[0]}"
    miss_browser(reason)


def miss_browser(reason: str) -> NoReturn:
    if os.environ.get("CI") == "true":
        pytest.fail(reason)
    pytest.skip(reason)
