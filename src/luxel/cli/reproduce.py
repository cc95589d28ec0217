"""`luxel reproduce`: the sources' tables and figures done again, ours beside theirs."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from luxel.cli import console, options
from luxel.errors import LuxelError

if TYPE_CHECKING:
    from luxel.bench.reproduce.runs import StudyBudget
    from luxel.bench.reproduce.study import Study
    from luxel.bench.reproduce.tables import StudyReport, Table

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
        str | None,
        typer.Option("-o", "--output", metavar="DIR", help="Write results there as they come; go on with what it has."),
    ] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Measure again what -o DIR already has.")] = False,
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
    with console.logs_on_stderr(), console.progress_bar() as report:
        report("loading", 0.0)
        budget = _make_budget(size, frames, spp, seed, quick)
        if output is not None:
            from luxel.bench.reproduce.tables import require_folder

            require_folder(Path(output))
        study = _start(what, scene, budget, chosen, bounces, device, Path(output) if output else None, fresh)
    _tell_kept(study)
    if not as_json:
        _print_head(study.report)
    for table in _measure(study):
        if not as_json:
            print()
            _print_table(table)
            # Whoever reads a pipe gets each table when it is there.
            sys.stdout.flush()
    if as_json:
        from luxel.files import to_json

        print(to_json(study.report.record()))
    elif output is not None:
        for path in study.report.paths(Path(output)):
            print(f"wrote {path}")


def _measure(study: Study) -> Iterator[Table]:
    """Yield the tables; between them the progress bar is gone and standard output is whole again."""
    measured = study.measure()
    while True:
        with console.logs_on_stderr(), console.progress_bar() as report:
            study.runner.progress = report
            table = next(measured, None)
        if table is None:
            return
        yield table


def _tell_kept(study: Study) -> None:
    """Say on stderr what an earlier call left in the folder."""
    store = study.runner.store
    if store.kept:
        print(f"luxel: {store.kept} runs are kept from {store.path}; --fresh measures them again", file=sys.stderr)
    elif store.set_aside:
        why = "is of other code, another machine or other settings, or damaged"
        print(f"luxel: {store.path} {why}: everything is measured anew", file=sys.stderr)


def _make_budget(size: str | None, frames: int | None, spp: int | None, seed: int, quick: bool) -> StudyBudget:
    """Return the default budget, or the quick one, with the options that were given."""
    from luxel.bench.reproduce.runs import QUICK, StudyBudget

    budget = replace(QUICK if quick else StudyBudget(), seed=seed)
    if size is not None:
        budget = replace(budget, size=options.parse_size(size))
    if frames is not None:
        budget = replace(budget, frames=frames)
    return budget if spp is None else replace(budget, spp=spp)


def _start(
    what: str,
    scene: str | None,
    budget: StudyBudget,
    tables: list[str] | None,
    bounces: str,
    device: str,
    folder: Path | None,
    fresh: bool,
) -> Study:
    if what == "rohacek":
        from luxel.bench.reproduce.rohacek import start_rohacek

        return start_rohacek(budget, tables=tables, bounces=bounces, device=device, folder=folder, fresh=fresh)
    if scene is not None:
        from luxel.bench.reproduce.ekberg import start_ekberg

        return start_ekberg(scene, budget, tables=tables, device=device, folder=folder, fresh=fresh)
    from luxel.bench.reproduce.fast_object import start_fast_object

    return start_fast_object(budget, tables=tables, device=device, folder=folder, fresh=fresh)


def _print_head(report: StudyReport) -> None:
    """Print what is measured here, and what differs from the source."""
    print(report.title)
    console.print_rows(report.header())
    for text in report.differences:
        print(f"- {text}")
    sys.stdout.flush()


def _print_table(table: Table) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table as Grid

    from luxel.bench.reproduce.tables import format_cell

    page = Console(width=None if sys.stdout.isatty() else PIPE_WIDTH, highlight=False)
    print(f"{table.name}: {table.title}")
    grid = Grid(box=box.SIMPLE_HEAD, pad_edge=False)
    for index, column in enumerate(table.columns):
        grid.add_column(column, justify="left" if index < len(table.keys) else "right")
    for row in table.rows:
        grid.add_row(*map(format_cell, table.cells(row)))
    page.print(grid)
    for note in table.notes:
        print(f"- {note}")
