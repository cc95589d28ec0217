"""`luxel report`: draw a comparison's page again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from luxel.cli import console, options
from luxel.errors import LuxelError


def report(
    folder: Annotated[str, typer.Argument(metavar="DIR", help="The folder that `luxel compare … -o DIR` wrote.")],
    debug: options.Debug = False,
) -> None:
    """Draw DIR/report.html again from its results.json and pictures; nothing is rendered."""
    with console.progress_bar() as told:
        from luxel.report.page import write_report

        try:
            path, complaint = write_report(Path(folder), progress=told)
        except (TypeError, ValueError, KeyError, AttributeError, ArithmeticError) as error:
            if debug:
                raise
            raise LuxelError(
                f"{Path(folder) / 'results.json'} holds figures that cannot be drawn ({error}): "
                "run `luxel compare` again"
            ) from error
    if complaint:
        console.warn([complaint])
    print(f"wrote {path} ({path.stat().st_size / 1e6:.1f} MB)")
