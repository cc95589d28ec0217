"""What the terminal sees: progress bars, clean standard output, figures in columns."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float], None]]:
    """Yield a function that takes what runs and the share done, 0..1; it draws on stderr where that is a terminal."""
    if not sys.stderr.isatty():
        yield lambda text, share: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description:<36}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=1.0)
        told = ""

        def tell(text: str, share: float) -> None:
            nonlocal told
            # Drawn at once where something new begins: some libraries hold the interpreter for seconds.
            bar.update(task, description=text, completed=share, refresh=text != told)
            told = text

        yield tell


@contextmanager
def logs_on_stderr() -> Iterator[None]:
    """Send to stderr what libraries print on file descriptor 1 meanwhile, so that stdout holds results only."""
    sys.stdout.flush()
    kept = os.dup(1)
    try:
        os.dup2(2, 1)
        yield
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)


def warn(messages: list[str]) -> None:
    """Print warnings on stderr, one a line."""
    for message in messages:
        print(f"luxel: warning: {message}", file=sys.stderr)


def print_rows(rows: list[tuple[str, str]]) -> None:
    """Print a label and a text a line; empty texts are left out."""
    width = max((len(label) for label, text in rows if text), default=0)
    for label, text in rows:
        if text:
            print(f"{label:<{width}}  {text}")


def format_number(value: Any) -> str:
    """Return a number for people: four digits, thousands by commas; `-` where there is none."""
    if value is None or value != value:
        return "-"
    if isinstance(value, int) or abs(value) >= 1000.0:
        return f"{value:,.0f}"
    return f"{value:.4g}"


def format_pairs(pairs: dict[str, Any]) -> str:
    """Return `name value` pairs in one line."""
    return "  ".join(f"{name} {format_number(value)}" for name, value in pairs.items())


def format_rays(rays: dict[str, int] | None) -> str:
    """Return the rays of a frame in one line; empty where there is no count of them."""
    return f"{format_pairs(rays)} a frame at most" if rays else ""
