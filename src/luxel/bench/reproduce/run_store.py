"""What has been measured so far, on disk after every run: a reproduction that is stopped goes on where it was."""

from __future__ import annotations

import datetime
import hashlib
import json
from pathlib import Path
from typing import Any

from luxel.files import to_json, write_text

FILE = "runs.json"


class RunStore:
    """Measured values by the name of the run that gave them; kept in `folder`/runs.json where there is a folder.

    Values come back as JSON gives them (NaN as None), whether they are fresh or were read, so that a report that went
    on later cannot differ from one that was made at once.
    """

    def __init__(self, folder: Path | None, made_with: dict[str, Any], *, fresh: bool = False) -> None:
        """Go on with what `folder` holds where it was `made_with` the same; `fresh` starts anew in any case."""
        self.path = None if folder is None else folder / FILE
        self.made_with = json.loads(to_json(made_with))
        self.runs: dict[str, dict[str, Any]] = {}
        self.tables: list[str] = []
        """Tables that were finished."""
        self.date = datetime.datetime.now(datetime.UTC).date().isoformat()
        """Day of the first run."""
        self.kept = 0
        """Runs that were read."""
        self.set_aside = False
        """True where the folder holds runs of other code, another machine or other settings: they are written over."""
        if not fresh:
            self._read()

    def get(self, run: str) -> dict[str, Any]:
        """Return the parts that were measured of `run`; empty where there are none."""
        return self.runs.get(run, {})

    def put(self, run: str, parts: dict[str, Any]) -> None:
        """Keep what was measured of `run`, beside what was there."""
        self.runs[run] = {**self.get(run), **json.loads(to_json(parts))}
        self._write()

    def finish(self, table: str) -> None:
        """Note that nothing is missing of `table`."""
        if table not in self.tables:
            self.tables.append(table)
            self._write()

    def _read(self) -> None:
        if self.path is None or not self.path.is_file():
            return
        try:
            found = json.loads(self.path.read_text())
            if found["made_with"] != self.made_with:
                self.set_aside = True
                return
            self.runs, self.tables, self.date = dict(found["runs"]), list(found["tables"]), str(found["date"])
        except (OSError, ValueError, KeyError, TypeError):
            self.set_aside = True
            return
        self.kept = len(self.runs)

    def _write(self) -> None:
        if self.path is not None:
            record = {"made_with": self.made_with, "date": self.date, "tables": self.tables, "runs": self.runs}
            write_text(self.path, to_json(record, indent=1) + "\n")


def describe_making(machine: dict[str, Any], device: str, settings: dict[str, Any], scene: str) -> dict[str, Any]:
    """Return what has to be equal for runs to stand in one report: code, machine, settings and `scene`."""
    about = ("cpu", "cores", "gpu", "driver", "versions", "commit")
    return {
        "code": digest_code(),
        "machine": {name: machine.get(name) for name in about},
        "device": device,
        "settings": settings,
        "scene": scene,
    }


def digest_code() -> str:
    """Return a hash of luxel's own sources: a commit says nothing about changes on top of it."""
    folder = Path(__file__).parents[2]
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(str(path.relative_to(folder)).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def digest_file(path: Path) -> str:
    """Return a hash of a file that has been read before."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
