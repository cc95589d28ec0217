"""The progress bar: what begins is drawn before it holds the interpreter."""

from __future__ import annotations

import io
import sys

import pytest

from luxel.cli.console import progress_bar


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_what_begins_is_drawn_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", Terminal())
    written = sys.stderr.getvalue  # type: ignore[attr-defined]
    with progress_bar() as report:
        for text in ("unwrapping", "casting rays"):
            report(text, 0.0)
            assert text in written()


def test_a_pipe_stays_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with progress_bar() as report:
        report("unwrapping", 0.5)
    assert not sys.stderr.getvalue()  # type: ignore[attr-defined]
