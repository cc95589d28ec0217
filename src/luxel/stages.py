"""Named, nested stages: what each step of a frame costs.

A stage's name is one string: timer row, profiler range and JSON key. `Stage.keep` evaluates the stage's results, with
a recorder and without, so that a stage is the same kernels in both; fusing stages was slower on CPU and GPU.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

_recorder: ContextVar[Recorder | None] = ContextVar("luxel_stage_recorder", default=None)


@dataclass
class Row:
    """One run of one stage."""

    ms: float
    """Time that its kernels ran on the device, milliseconds."""
    launches: int
    """Kernels launched."""


@dataclass
class Recorder:
    """Collects rows while it is installed by `recording`."""

    rows: dict[str, list[Row]] = field(default_factory=lambda: defaultdict(list))

    def medians(self) -> dict[str, float]:
        """Return stage name -> median milliseconds."""
        import statistics

        return {name: statistics.median(row.ms for row in rows) for name, rows in self.rows.items()}

    def launches(self) -> dict[str, int]:
        """Return stage name -> kernels launched in its last run."""
        return {name: rows[-1].launches for name, rows in self.rows.items()}


class Stage:
    """A running stage; `keep` names what must be computed before it ends."""

    def keep(self, *results: Any) -> None:
        """Evaluate `results` (Dr.Jit pytrees)."""
        import drjit as dr

        dr.eval(*results)


@contextmanager
def stage(name: str) -> Iterator[Stage]:
    """Open the stage `name`, such as "gibs/trace"."""
    recorder = _recorder.get()
    if recorder is None:
        yield Stage()
        return
    import drjit as dr

    with dr.profile_range(name):
        yield Stage()
        dr.sync_thread()
    history = dr.kernel_history()
    recorder.rows[name].append(Row(sum(entry["execution_time"] for entry in history), len(history)))


@contextmanager
def recording() -> Iterator[Recorder]:
    """Install a recorder; stages inside are timed kernel by kernel."""
    import drjit as dr

    recorder = Recorder()
    token = _recorder.set(recorder)
    dr.sync_thread()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        try:
            yield recorder
        finally:
            _recorder.reset(token)
            dr.kernel_history_clear()


def count_compilations(history: list[dict[str, Any]]) -> int:
    """Return how many entries of a Dr.Jit kernel history were compiled rather than found in a cache."""
    return sum(1 for entry in history if "cache_hit" in entry and not entry["cache_hit"])
