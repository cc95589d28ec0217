"""What Mitsuba warns of while it reads a file: caught from its log, which goes to stdout, and said as luxel says it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mitsuba as mi

from luxel.scene.warnings import Warnings

NOTHING_SAID = "Mitsuba warns of the file and does not say of what; look at its meshes' attributes."


@contextmanager
def catch_warnings() -> Iterator[Warnings]:
    """Keep Mitsuba's warnings from the console; what this yields has them in the end, each kind once, by file."""
    caught, lines = Warnings(), set[str]()
    log: Any = mi.logger()
    before = [log.appender(index) for index in range(log.appender_count())]
    catcher = _Catcher(lines, before)
    log.clear_appenders()
    log.add_appender(catcher)
    try:
        yield caught
    finally:
        log.remove_appender(catcher)
        for appender in before:
            log.add_appender(appender)
        # Its threads read meshes in another order every time.
        for line in sorted(map(_without_place, lines)):
            _note(line, caught)


class _Catcher(mi.Appender):
    """Takes warnings out of Mitsuba's log, from whichever of its threads they come, and passes on the rest."""

    def __init__(self, lines: set[str], others: list[Any]) -> None:
        super().__init__()
        self._lines, self._others = lines, others

    def append(self, level: Any, text: str) -> None:
        """Note a message of the log."""
        if level == mi.LogLevel.Warn:
            self._lines.add(text)
            return
        for other in self._others:
            other.append(level, text)

    def log_progress(self, progress: float, name: str, formatted: str, eta: str, ptr: Any = None) -> None:
        """Pass on how far a task is."""
        for other in self._others:
            other.log_progress(progress, name, formatted, eta, ptr)


def _without_place(line: str) -> str:
    """Return what a line of Mitsuba's log says, without '2026-01-31 12:00:00 WARN  [ply.h:366] ' before it."""
    return " ".join(re.sub(r"^[^\[]*(\[[\w.:]+\]\s*)+", "", line).split())


def _note(message: str, warnings: Warnings) -> None:
    """Add what Mitsuba says, such as '"a.ply": attribute "quality" ignored.'."""
    named = re.match(r'"([^"]+)": (.+)', message)
    if named:
        # Braces are the list of names.
        heard = named[2].rstrip(".! ").replace("{", "(").replace("}", ")")
        warnings.add(f"Mitsuba warns of {{names}}: {heard}.", f"'{named[1]}'")
    elif re.search(r"\w", message):
        warnings.add(f"Mitsuba warns: {message.rstrip('.! ')}.")
    else:
        # Some of its messages come out empty.
        warnings.add(NOTHING_SAID)
