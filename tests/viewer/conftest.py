"""Sessions of small pictures, alone and served to browsers."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import luxel
from luxel.viewer.app import App
from luxel.viewer.session import Session
from luxel.viewer.world import Choice


def wait_for(condition: Callable[[], Any], seconds: float = 60.0, what: str = "what was asked for") -> Any:
    """Return what `condition` returns once it is true; fails the test after `seconds`."""
    end = clock.perf_counter() + seconds
    while clock.perf_counter() < end:
        if found := condition():
            return found
        clock.sleep(0.02)
    pytest.fail(f"{what} did not come within {seconds:g} s")


def start_session(scene: str = "cornell-box", method: str = "gibs", **settings: Any) -> Session:
    """Return a running session of small pictures."""
    data = luxel.load(scene)
    settings.setdefault("surfel_target", 4000) if method == "gibs" else None
    choice = Choice(method, settings=settings)
    return Session(data, choice, size=(240, 168), text=scene).start()


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
