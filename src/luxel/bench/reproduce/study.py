"""A reproduction table by table: what its tables ask for is counted first, then measured once for all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from luxel.bench.reproduce.run_store import RunStore
from luxel.bench.reproduce.tables import StudyReport, Table
from luxel.errors import LuxelError

Progress = Callable[[str, float], None]
Tick = Callable[[int], None]
Make = Callable[[frozenset[str], Tick], dict[str, Any]]
Cost = Callable[[frozenset[str]], int]


@dataclass
class Job:
    """One run, and all that the chosen tables want to know of it."""

    parts: frozenset[str]
    cost: Cost
    """Frames that the run takes, by its parts: progress is counted in them."""


class StudyRunner:
    """Takes the requests of the tables; answers each from the store, or measures it."""

    def __init__(self, store: RunStore, progress: Progress | None = None) -> None:
        self.store = store
        self.progress: Progress = progress or (lambda text, share: None)
        self.counting = False
        """True while the tables are asked what they want: nothing is measured then, and what is not kept is missing."""
        self.table = ""
        self.jobs: dict[str, Job] = {}
        self.run_count = 0
        """Runs to do when the counting was over."""
        self.runs_done = 0
        self._frames = 0
        self._frames_done = 0

    def ask(self, run: str, parts: Sequence[str], cost: Cost, make: Make) -> dict[str, Any]:
        """Return `parts` of `run`; where one is missing, `make` measures all parts that any table wants.

        While the runner is counting, parts that are not kept are left out.
        """
        before = self.jobs.get(run)
        job = Job(frozenset(parts) | (before.parts if before else frozenset()), cost)
        self.jobs[run] = job
        if not self.counting and not job.parts <= self.store.get(run).keys():
            self.runs_done += 1
            self.tell(0)
            self.store.put(run, make(job.parts, self.tell))
            self._frames_done += cost(job.parts)
        kept = self.store.get(run)
        return {part: kept[part] for part in parts if part in kept}

    def count(self, tables: Sequence[Callable[[], Any]]) -> None:
        """Ask `tables` what they want, so that a run is done once and the share done is known."""
        self.counting = True
        try:
            for table in tables:
                table()
        finally:
            self.counting = False
        todo = [job for run, job in self.jobs.items() if not job.parts <= self.store.get(run).keys()]
        self.run_count, self._frames = len(todo), sum(job.cost(job.parts) for job in todo)

    def tell(self, frames: int, what: str = "") -> None:
        """Report `frames` of the present run; `what` takes the place of the run's number."""
        text = what or f"{self.table}: run {self.runs_done} of {max(self.run_count, self.runs_done)}"
        self.progress(text, min((self._frames_done + frames) / max(self._frames, 1), 1.0))


class Study:
    """The chosen tables of one source, measured one after the other."""

    def __init__(
        self,
        report: StudyReport,
        runner: StudyRunner,
        tables: Mapping[str, Callable[[], list[Table]]],
        wanted: Sequence[str],
        folder: Path | None = None,
    ) -> None:
        """`report` has no tables yet; `tables` holds all that the source has, `wanted` those to measure now."""
        self.report, self.runner, self.folder = report, runner, folder
        self._tables, self._wanted = tables, wanted
        report.date = runner.store.date

    def measure(self) -> Iterator[Table]:
        """Yield the wanted tables as they are measured; results.json and tables.md are written after each of them.

        Tables that an earlier call finished in the same folder stay in the files. Raises LuxelError where a file
        cannot be written.
        """
        store = self.runner.store
        self.runner.count([self._tables[name] for name in self._wanted])
        made = {name: self._tables[name]() for name in self._tables if name in store.tables}
        for name in self._wanted:
            self.runner.table = name
            if name not in made:
                made[name] = self._tables[name]()
                store.finish(name)
            self.report.tables = [table for known in self._tables for table in made.get(known, [])]
            if self.folder is not None:
                self.report.write(self.folder)
            yield from made[name]

    def finish(self) -> StudyReport:
        """Measure all wanted tables and return the report."""
        for _ in self.measure():
            pass
        return self.report


def choose_tables(names: Sequence[str] | None, known: Mapping[str, Any]) -> list[str]:
    """Return the tables to make, in their order. Raises LuxelError for one that is not known."""
    for name in names or ():
        if name not in known:
            raise LuxelError(f"there is no table '{name}' to reproduce; choose from {', '.join(known)}")
    return [name for name in known if not names or name in names]
