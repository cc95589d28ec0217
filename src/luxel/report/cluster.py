"""Jobs on many machines: an existing Dask cluster runs them, and this process collects.

A worker needs the same luxel, and a scene file at the same path; built-in scenes go by name. When a worker is lost,
Dask runs its jobs again elsewhere, the truth that others wait for included; each job has a key of its own and is
collected once, so nothing is counted twice. Dr.Jit keeps what is under way for each thread apart, so a worker runs all
jobs on one thread of ours, one after the other, however many threads it was started with.
"""

from __future__ import annotations

import functools
import importlib
import pickle
import re
import uuid
import weakref
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from luxel.errors import LuxelError
from luxel.report.jobs import Handle, Progress, RunJob, SceneCache, ViewJob, Work
from luxel.report.motion import FlightJob, MotionJob
from luxel.report.motion_peers import MotionPeerJob
from luxel.report.peers import PEER, PeerJob
from luxel.scene.choice import SceneChoice

CONNECT_SECONDS = 10.0
"""How long to wait for a scheduler, and then for its first worker."""


@contextmanager
def open_cluster(address: str) -> Iterator[ClusterRunner]:
    """Yield a runner on the cluster whose scheduler listens at `address`, such as tcp://10.0.0.5:8786.

    What has not been collected at the end is cancelled. Raises LuxelError where Dask is not installed, the scheduler
    does not answer, it has no workers, or a worker has another luxel.
    """
    distributed = _import_distributed()
    if not re.fullmatch(r"(\w+://)?.+:\d+", address.strip()):
        # Dask would try for long, and complain at length.
        raise LuxelError(f"--scheduler {address} is no address; write HOST:PORT, such as tcp://10.0.0.5:8786")
    try:
        client = distributed.Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise LuxelError(
            f"no Dask scheduler answers at '{address}' ({_line(error)}); start one with `dask scheduler`"
        ) from error
    runner = ClusterRunner(client)
    try:
        _check_workers(client, address)
        yield runner
    finally:
        runner.cancel()
        client.close()


class ClusterRunner:
    """Hands jobs to a cluster as soon as they are submitted."""

    def __init__(self, client: Any) -> None:
        self._client = client
        # Weakly: a result that nobody waits for any more leaves the cluster, and is not made again if it is lost there.
        self._futures: weakref.WeakSet[Any] = weakref.WeakSet()

    def submit(self, function: Work, job: Any, *inputs: Handle, report: Progress, urgent: int = 0) -> Handle:
        futures = [each.future for each in inputs if isinstance(each, _Remote)]
        future = self._client.submit(
            perform,
            _own_version(),
            function,
            _portable(job),
            *futures,
            key=f"luxel-{function.__name__}-{uuid.uuid4().hex}",
            pure=False,
            priority=urgent,
        )
        self._futures.add(future)
        return _Remote(future, describe_job(job), report)

    def cancel(self) -> None:
        """Take back what is not done yet and let the results go."""
        self._client.cancel(list(self._futures))
        self._futures.clear()


class _Remote:
    """A job on the cluster."""

    def __init__(self, future: Any, name: str, report: Progress) -> None:
        self.future = future
        self._name = name
        self._report = report

    def result(self) -> Any:
        distributed = _import_distributed()
        self._report(self._name, 0.0)
        try:
            result = self.future.result()
        except distributed.KilledWorker as error:
            raise LuxelError(
                f"{self._name}: {error.allowed_failures + 1} workers were lost while they ran it; look at their logs"
            ) from error
        except (OSError, distributed.CancelledError) as error:
            raise LuxelError(f"{self._name}: the connection to the scheduler was lost ({_line(error)})") from error
        self._report(self._name, 1.0)
        return result


def perform(version: str, function: Work, job: Any, *inputs: Any) -> Any:
    """Run `function(job, *inputs)` on this worker. Raises LuxelError where its luxel is not of `version`."""
    if _own_version() != version:
        raise LuxelError(f"a Dask worker has {_own_version()}, but here is {version}; install the same on all")

    def work() -> Any:
        scenes = _scenes()
        try:
            return function(job, *inputs, scenes=scenes, report=lambda text, share: None)
        except BaseException:
            scenes.clear()
            raise

    return _thread().submit(work).result()


def describe_job(job: ViewJob | RunJob | PeerJob | MotionJob | FlightJob | MotionPeerJob) -> str:
    """Return what people call a job."""
    if isinstance(job, ViewJob):
        return f"{job.label}: truth"
    if isinstance(job, RunJob):
        return f"{job.view.label}: {job.setup.label}, seed {job.seed}"
    if isinstance(job, PeerJob):
        return f"{job.view.label}: {PEER} at equal time, seed {job.seed}"
    return job.title


@functools.cache
def _thread() -> ThreadPoolExecutor:
    """The one thread of this worker that renders."""
    return ThreadPoolExecutor(1, "luxel")


@functools.cache
def _scenes() -> SceneCache:
    """This worker's scenes: jobs of one scene that follow each other share its upload."""
    return SceneCache()


def _portable(job: Any) -> Any:
    """Return the job with absolute paths. Raises LuxelError for a scene that cannot travel."""
    view: ViewJob = job if isinstance(job, ViewJob) else job.view
    if isinstance(view.scene, SceneChoice):
        moved = replace(view, scene=view.scene.anywhere())
    else:
        moved = view
        try:
            pickle.dumps(view.scene)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise LuxelError(
                f"scene '{view.label}' holds functions that cannot be sent to a cluster; name it or its file instead"
            ) from error
    return moved if job is view else replace(job, view=moved)


def _check_workers(client: Any, address: str) -> None:
    """Raise LuxelError unless there are workers and all have the same luxel, Mitsuba and Dr.Jit as this process."""
    try:
        client.wait_for_workers(1, timeout=CONNECT_SECONDS)
    except TimeoutError as error:
        raise LuxelError(
            f"the Dask scheduler at '{address}' has no workers; start one a machine or GPU with "
            f"`dask worker {address} --nthreads 1`"
        ) from error
    for worker, version in client.run(_ask_version()).items():
        if version != _own_version():
            has = version or "no such luxel"
            raise LuxelError(f"Dask worker {worker} has {has}, but here is {_own_version()}; install the same on all")


def _ask_version() -> Any:
    """Return a function that is sent whole, so that a worker without luxel can answer, too."""

    def ask() -> str | None:
        try:
            from luxel.report.cluster import _own_version
        except ImportError:
            return None
        return _own_version()

    return ask


@functools.cache
def _own_version() -> str:
    """Return what must be alike everywhere, for images and figures to be: luxel, Mitsuba, Dr.Jit."""
    from importlib import metadata

    from luxel import __version__

    return f"luxel {__version__}, mitsuba {metadata.version('mitsuba')}, drjit {metadata.version('drjit')}"


def _import_distributed() -> Any:
    try:
        return importlib.import_module("distributed")
    except ImportError as error:
        raise LuxelError("--scheduler needs an extra: run `pip install 'luxel[cluster]'`") from error


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
