"""A session served to browsers, and a browser without a screen."""

from __future__ import annotations

import os
import shutil
import time as clock
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import luxel
from luxel.viewer.app import App
from luxel.viewer.session import Session
from luxel.viewer.world import Choice

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


def wait_for(condition: Callable[[], Any], seconds: float = 60.0, what: str = "what was asked for") -> Any:
    """Return what `condition` returns once it is true; fails the test after `seconds`."""
    end = clock.perf_counter() + seconds
    while clock.perf_counter() < end:
        if found := condition():
            return found
        clock.sleep(0.02)
    pytest.fail(f"{what} did not come within {seconds:g} s")


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """The system's browser, headless, with WebGL in software. Skips where there is none; under CI=true that fails."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return lack("playwright is not installed: pip install playwright")
    found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if found is None:
        return lack("there is no browser: install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=list(ARGUMENTS))
        yield browser
        browser.close()


def lack(reason: str) -> None:
    """Skip for `reason`; where CI=true says that all must run, fail."""
    if os.environ.get("CI") == "true":
        pytest.fail(reason)
    pytest.skip(reason)


def start_session(scene: str = "cornell-box", method: str = "gibs", **settings: Any) -> Session:
    """Return a running session of small pictures."""
    data = luxel.load(scene)
    settings.setdefault("surfel_target", 4000) if method == "gibs" else None
    choice = Choice(method, settings=settings)
    return Session(data, choice, size=(240, 168), device="cpu", text=scene).start()


@pytest.fixture
def session() -> Iterator[Session]:
    running = start_session()
    yield running
    running.stop(20.0)


@pytest.fixture
def app(session: Session) -> Iterator[App]:
    served = App(session, port=0)
    yield served
    served.stop()
