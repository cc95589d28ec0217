"""Many visitors who turn everything at random: no fault, memory flat, everyone still answered."""

from __future__ import annotations

import datetime
import json
import random
import threading
import time as clock
from pathlib import Path

import pytest

from luxel import runtime
from luxel.bench.machine import machine_name, machine_record
from luxel.viewer.app import App
from luxel.viewer.headless_client import HeadlessClient
from luxel.viewer.session import Session

from .conftest import start_session, wait_for

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
ROOM_MB = 120
"""Compiled kernels stay in memory, and the second round finds some settings that the first did not."""


def play(url: str, seed: int, seconds: float, found: list[str]) -> None:
    """Be a visitor for `seconds`; afterwards ask for one more picture. Leaves what went wrong in `found`."""
    chance = random.Random(seed)
    try:
        with HeadlessClient(url, window=(chance.randrange(200, 400), chance.randrange(160, 300))) as client:
            from luxel.scene.library import BUILT_IN

            home = BUILT_IN["cornell-box"]().cameras[0]
            client.look(home)
            client.listen(10.0, until_picture=True)
            end = clock.perf_counter() + seconds
            while clock.perf_counter() < end:
                client.fiddle(chance, home)
                client.listen(chance.uniform(0.02, 0.4))
            client.listen(1.0)
            client.look(home)
            if not client.listen(90.0, until_picture=True):
                found.append(f"visitor {seed} was not answered")
    except Exception as error:
        found.append(f"visitor {seed}: {type(error).__name__}: {error}")


def run_visitors(app: App, count: int, seconds: float) -> list[str]:
    """Let `count` visitors play at once; return what went wrong."""
    found: list[str] = []
    players = [threading.Thread(target=play, args=(app.url, seed, seconds, found)) for seed in range(count)]
    for player in players:
        player.start()
    for player in players:
        player.join()
    return found


def settled_memory(session: Session) -> float:
    """Return the memory in MiB of the session in its first state, with one visitor at rest."""
    visitor = session.join()

    def restore(world, visitor) -> None:  # noqa: ANN001
        world.switch_method("gibs")
        world.apply_preset(None)
        world.set_param("surfel_target", 4000)
        world.freeze(False)
        world.set_light_scale(1.0)

    session.ask(visitor, restore)
    after = visitor.frame_count
    wait_for(lambda: visitor.frame_count > after + 20 and visitor.is_sharp, 120.0, "rest")
    session.leave(visitor)
    clock.sleep(0.5)
    return runtime.memory_mb()


def soak(count: int, seconds: float) -> dict[str, float]:
    """Return memory before and after, and how many frames were made; fails on any fault."""
    session = start_session()
    app = App(session, port=0)
    try:
        run_visitors(app, count, seconds)  # the same seeds: what chance finds is compiled and kept before
        before = settled_memory(session)
        wrong = run_visitors(app, count, seconds)
        after = settled_memory(session)
        wait_for(lambda: not session.visitors(), 30.0, "everyone's leaving")
        assert not wrong, wrong
        assert not session.faults, session.faults[0]
        return {"memory_mb_before": before, "memory_mb_after": after, "recordings": session.stats.recordings}
    finally:
        app.stop()
        session.stop(20.0)


def test_three_visitors_for_a_while() -> None:
    found = soak(3, 8.0)
    assert found["memory_mb_after"] < found["memory_mb_before"] + ROOM_MB


@pytest.mark.soak
def test_eight_visitors_for_five_minutes() -> None:
    found = soak(8, 300.0)
    record = {
        "soak": "viewer",
        "visitors": 8,
        "seconds": 300,
        **found,
        "machine": machine_record(),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }
    with (RESULTS / f"{machine_name(record['machine'])}-soak.jsonl").open("a") as stream:
        stream.write(json.dumps(record) + "\n")
    assert found["memory_mb_after"] < found["memory_mb_before"] + ROOM_MB
