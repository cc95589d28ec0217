"""A Dask cluster of two processes on this machine: the same results, also when one of them is killed on the way."""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from luxel.errors import LuxelError
from luxel.methods import METHODS
from luxel.methods.own import SOURCES
from luxel.report import cluster
from luxel.report.compare import compare
from luxel.report.jobs import MethodSetup, make_setup
from luxel.scene.model import SceneData

distributed: Any = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")

# Dask closes its sockets and loops in threads of its own, some of them after the test.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
SMALL: dict[str, Any] = {"reference_spp": 16, "size": (24, 16), "frames": 2, "peers": False}
SAME = ("regional", "bias", "flip", "leak")
"""Figures that do not depend on the clock."""


@pytest.fixture(scope="module", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LUXEL_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def workers(own_cache: None) -> Iterator[Any]:
    """Two worker processes; with two threads each, of which luxel must use one."""
    with distributed.LocalCluster(n_workers=2, threads_per_worker=2, processes=True, dashboard_address=":0") as running:
        yield running


def test_a_lost_worker_changes_nothing(workers: Any, tmp_path: Path) -> None:
    methods = [MethodSetup("few", "gibs", None, {"surfel_target": "200"}), "path"]
    asked: dict[str, Any] = {**SMALL, "seeds": (0, 1), "peers": True}
    killed: list[int] = []

    def kill_one(text: str, share: float) -> None:
        """Once the first run has been collected, take the worker that holds the most results."""
        if not killed and share > 0.1:
            fullest = max(workers.scheduler.workers.values(), key=lambda worker: len(worker.has_what))
            (nanny,) = (one for one in workers.workers.values() if one.worker_address == fullest.address)
            assert fullest.has_what or fullest.processing
            killed.append(nanny.pid)
            os.kill(nanny.pid, signal.SIGKILL)

    far = compare(
        ["furnace"],
        methods,
        **asked,
        scheduler=workers.scheduler_address,
        out=tmp_path / "far",
        progress=kill_one,
    )
    assert len(killed) == 1
    near = compare(["furnace"], methods, **asked, out=tmp_path / "near")
    assert far.keys() == near.keys() and list(far["scenes"]) == list(near["scenes"])
    for name, scene in near["scenes"].items():
        other = far["scenes"][name]
        assert scene.keys() == other.keys() and list(scene["methods"]) == list(other["methods"])
        for label, figures in scene["methods"].items():
            assert list(other["methods"][label]["seeds"]) == ["0", "1"]
            if label == "few":  # its surfels lie where the threads put them, so no two runs are quite alike
                continue
            for figure in SAME:
                wanted = figures[figure]
                assert other["methods"][label][figure] == (wanted and pytest.approx(wanted, rel=1e-3, abs=1e-5))
        kinds = [(peer["of"], peer["denoised"], list(peer["seeds"])) for peer in scene["peers"]]
        assert kinds and kinds == [(peer["of"], peer["denoised"], list(peer["seeds"])) for peer in other["peers"]]

    def files(folder: str) -> list[str]:
        return sorted(str(path.relative_to(tmp_path / folder)) for path in (tmp_path / folder).rglob("*.*"))

    assert files("far") == files("near")
    assert not workers.scheduler.tasks


def test_a_worker_runs_one_job_at_a_time(workers: Any) -> None:
    with distributed.Client(workers.scheduler_address, set_as_default=False) as client:
        version = cluster._own_version()
        futures = [client.submit(cluster.perform, version, note_thread, number, pure=False) for number in range(6)]
        notes = client.gather(futures)
    for process in {note[0] for note in notes}:
        spans = sorted(note[2:] for note in notes if note[0] == process)
        assert len({note[1] for note in notes if note[0] == process}) == 1
        assert all(first[1] <= second[0] for first, second in zip(spans, spans[1:], strict=False))


def note_thread(job: int, *, scenes: Any, report: Any) -> tuple[int, int, float, float]:
    """Return process, thread, begin and end of a short nap."""
    begin = time.monotonic()
    time.sleep(0.05)
    return os.getpid(), threading.get_ident(), begin, time.monotonic()


OWN = """
from dataclasses import dataclass
import drjit as dr
import mitsuba as mi
from luxel.methods import Light, Method


@dataclass
class State:
    level: mi.Float


class Level(Method):
    @dataclass
    class Params:
        level: float = 0.0

    name = "level-on-workers"
    presets = {"bright": {"level": 4.0}}

    def build(self, scene, params, seed, *, workdir=None, progress=None):
        return State(dr.opaque(mi.Float, params.level))

    def query(self, scene, state, surface):
        return Light(mi.Color3f(state.level), mi.Color3f(0.0), dr.select(surface.active, mi.Float(1.0), 0.0))
"""


@pytest.fixture
def own_method(tmp_path: Path) -> Iterator[Path]:
    """A method in a file whose folder has a colon and a comma in its name."""
    folder = tmp_path / "mine: a,b"
    folder.mkdir()
    (folder / "level.py").write_text(OWN)
    yield folder / "level.py"
    METHODS.pop("level-on-workers", None)
    SOURCES.clear()


def test_workers_load_the_file_of_a_method(workers: Any, tmp_path: Path, own_method: Path) -> None:
    results = compare(
        ["furnace"], [f"{own_method}:Level", f"{own_method}:Level:bright"], **SMALL,
        scheduler=workers.scheduler_address, out=tmp_path / "out",
    )  # fmt: skip
    found = results["scenes"]["furnace"]["methods"]
    assert list(found) == ["none", "ambient", "level-on-workers", "level-on-workers:bright"]
    # 0 everywhere is what `none` says; the other one is far too bright.
    assert found["level-on-workers"]["bias"] == pytest.approx(found["none"]["bias"], abs=1e-6)
    assert found["level-on-workers:bright"]["params"] == {"level": 4.0}
    assert found["level-on-workers:bright"]["bias"] > found["level-on-workers"]["bias"]
    assert found["level-on-workers"]["method"] == "level-on-workers"


def test_workers_show_full_materials_where_they_can(workers: Any, tmp_path: Path) -> None:
    asked: dict[str, Any] = {**SMALL, "materials": "full"}
    far = compare(["glossy"], ["path"], **asked, scheduler=workers.scheduler_address, out=tmp_path / "far")
    near = compare(["glossy"], ["path"], **asked, out=tmp_path / "near")
    for label, shown in (("path", "full"), ("ambient", "diffuse")):
        one, other = (results["scenes"]["glossy"]["methods"][label] for results in (far, near))
        assert one["materials"] == other["materials"] == shown
        assert one["flip"] == pytest.approx(other["flip"], rel=1e-2)


def test_a_worker_with_another_file_says_so(workers: Any, tmp_path: Path, own_method: Path) -> None:
    sent = make_setup(f"{own_method}:Level")
    own_method.write_text(OWN.replace("0.0", "1.0", 1))
    with pytest.raises(LuxelError, match="differs from the file that was asked for"):
        compare(["furnace"], [sent], **SMALL, scheduler=workers.scheduler_address, out=tmp_path / "out")
    assert not workers.scheduler.tasks


def test_bad_input_comes_back_as_one_sentence(workers: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(LuxelError, match=f"no file '{tmp_path / 'missing.gltf'}'"):
        compare(["missing.gltf"], ["path"], **SMALL, scheduler=workers.scheduler_address, out=tmp_path / "out")
    moving = SceneData("own", [], [], mitsuba_full=lambda: None)
    with pytest.raises(LuxelError, match="'own' holds functions"):
        compare([moving], ["path"], **SMALL, scheduler=workers.scheduler_address, out=tmp_path / "out")
    assert not workers.scheduler.tasks


def test_another_version_is_refused(workers: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = cluster._own_version()
    monkeypatch.setattr(cluster, "_own_version", lambda: "luxel 9.9.9")
    with pytest.raises(LuxelError, match=f"{own}, but here is luxel 9.9.9"):
        compare(["furnace"], ["path"], **SMALL, scheduler=workers.scheduler_address, out=tmp_path)
    # Also a worker that comes later says so.
    with pytest.raises(LuxelError, match="luxel 1.1.1"):
        cluster.perform("luxel 1.1.1", note_thread, 0)


def test_the_question_for_the_version_is_sent_whole() -> None:
    """By name it could not be asked of a worker that lacks luxel."""
    cloudpickle = pytest.importorskip("cloudpickle")
    with pytest.raises((AttributeError, pickle.PicklingError)):
        pickle.dumps(cluster._ask_version())
    assert b"_own_version" in cloudpickle.dumps(cluster._ask_version())


def test_nobody_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "CONNECT_SECONDS", 0.5)
    for address in ("tcp://127.0.0.1:9", "nonsense://x", "no address"):
        with pytest.raises(LuxelError, match="no Dask scheduler answers|is no address"):
            compare(["furnace"], ["path"], **SMALL, scheduler=address, out=tmp_path)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=":0") as empty,
        pytest.raises(LuxelError, match="has no workers"),
    ):
        compare(["furnace"], ["path"], **SMALL, scheduler=empty.scheduler_address, out=tmp_path)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (distributed.KilledWorker("key", None, 3), "furnace: truth: 4 workers were lost"),
        (distributed.CancelledError("key"), "furnace: truth: the connection to the scheduler was lost"),
    ],
)
def test_what_dask_cannot_mend_is_one_sentence(error: Exception, words: str) -> None:
    def fail() -> None:
        raise error

    handle = cluster._Remote(SimpleNamespace(result=fail), "furnace: truth", lambda text, share: None)
    with pytest.raises(LuxelError, match=words):
        handle.result()


def test_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(LuxelError, match="luxel\\[cluster\\]"):
        compare(["furnace"], ["path"], **SMALL, scheduler="tcp://127.0.0.1:9", out=tmp_path)


def test_what_is_no_address_is_said_at_once(tmp_path: Path) -> None:
    with pytest.raises(LuxelError, match="is no address; write HOST:PORT"):
        compare(["furnace"], ["path"], **SMALL, scheduler="nonsense", out=tmp_path)
