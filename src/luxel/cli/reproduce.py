"""`luxel reproduce`: the sources' tables and figures done again, ours beside theirs."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from luxel.cli import console, options
from luxel.errors import LuxelError

if TYPE_CHECKING:
    from rich.console import Console

    from luxel.bench.reproduce.runs import Budget, Progress
    from luxel.bench.reproduce.tables import Report, Table

WHAT = ("rohacek", "ekberg", "fast-object")
PIPE_WIDTH = 200
"""Characters of a line where no terminal says how many it has."""


def reproduce(
    what: Annotated[str, typer.Argument(metavar="|".join(WHAT), help="Whose measurements.")],
    scene: Annotated[
        str | None, typer.Argument(metavar="[SPONZA]", help="For ekberg: Crytek Sponza as .gltf or .glb.")
    ] = None,
    tables: Annotated[
        str | None, typer.Option("--tables", metavar="A,B", help="Only these, such as 4.2,4.3 or pillar,plant.")
    ] = None,
    output: Annotated[
        str | None, typer.Option("-o", "--output", metavar="DIR", help="Write results.json and tables.md there.")
    ] = None,
    size: Annotated[str | None, typer.Option("--size", metavar="WxH", help="Image size in pixels: 512x288.")] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="Frames before a figure is taken: 128.")] = None,
    spp: Annotated[int | None, typer.Option(min=2, metavar="N", help="Samples a pixel of the truth: 512.")] = None,
    bounces: Annotated[
        str, typer.Option("--bounces", metavar="path|feedback", help="For rohacek: how probe rays go on.")
    ] = "path",
    quick: Annotated[bool, typer.Option("--quick", help="Tiny and few: every table appears, none counts.")] = False,
    seed: options.Seed = 0,
    device: options.DeviceName = "auto",
    as_json: options.Json = False,
    debug: options.Debug = False,
) -> None:
    """Measure again what the two theses measured, and how light follows a fast object: ours beside theirs."""
    if what not in WHAT:
        raise LuxelError(f"there is no '{what}' to reproduce; choose from {', '.join(WHAT)}")
    if (scene is None) == (what == "ekberg"):
        wanted = "needs the file of Crytek Sponza: luxel reproduce ekberg Sponza.gltf"
        raise LuxelError(f"reproduce {what} {wanted if what == 'ekberg' else 'takes no scene file: leave it out'}")
    chosen = [name.strip() for name in tables.split(",") if name.strip()] if tables is not None else None
    if chosen is not None and what == "fast-object":
        raise LuxelError("reproduce fast-object has no tables to choose from: leave out --tables")
    with console.logs_on_stderr(), console.progress_bar() as report:
        budget = _make_budget(size, frames, spp, seed, quick)
        if output is not None:
            from luxel.bench.reproduce.tables import require_folder

            require_folder(Path(output))
        results = _run(what, scene, budget, chosen, bounces, device, report)
        written = results.write(Path(output)) if output is not None else []
    if as_json:
        from luxel.render.write import to_json

        print(to_json(results.record()))
        return
    _print_report(results)
    for path in written:
        print(f"wrote {path}")


def _make_budget(size: str | None, frames: int | None, spp: int | None, seed: int, quick: bool) -> Budget:
    """Return the default budget, or the quick one, with the options that were given."""
    from luxel.bench.reproduce.runs import QUICK, Budget

    budget = replace(QUICK if quick else Budget(), seed=seed)
    if size is not None:
        budget = replace(budget, size=options.parse_size(size))
    if frames is not None:
        budget = replace(budget, frames=frames)
    return budget if spp is None else replace(budget, spp=spp)


def _run(
    what: str,
    scene: str | None,
    budget: Budget,
    tables: list[str] | None,
    bounces: str,
    device: str,
    progress: Progress,
) -> Report:
    if what == "rohacek":
        from luxel.bench.reproduce.rohacek import reproduce_rohacek

        return reproduce_rohacek(budget, tables=tables, bounces=bounces, device=device, progress=progress)
    if scene is not None:
        from luxel.bench.reproduce.ekberg import reproduce_ekberg

        return reproduce_ekberg(scene, budget, tables=tables, device=device, progress=progress)
    from luxel.bench.reproduce.fast_object import reproduce_fast_object

    return reproduce_fast_object(budget, device=device, progress=progress)


def _print_report(results: Report) -> None:
    """Print the head, what differs, and every table with its notes."""
    from rich.console import Console

    print(results.title)
    console.print_rows(results.header())
    for text in results.differences:
        print(f"- {text}")
    page = Console(width=None if sys.stdout.isatty() else PIPE_WIDTH, highlight=False)
    for table in results.tables:
        print()
        _print_table(page, table)


def _print_table(page: Console, table: Table) -> None:
    from rich import box
    from rich.table import Table as Grid

    from luxel.bench.reproduce.tables import format_cell

    print(f"{table.name}: {table.title}")
    grid = Grid(box=box.SIMPLE_HEAD, pad_edge=False)
    for index, column in enumerate(table.columns):
        grid.add_column(column, justify="left" if index < len(table.keys) else "right")
    for row in table.rows:
        grid.add_row(*map(format_cell, table.cells(row)))
    page.print(grid)
    for note in table.notes:
        print(f"- {note}")
