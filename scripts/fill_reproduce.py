"""Write measured tables into docs/reproduce.md from the folders that `luxel reproduce -o` left.

python scripts/fill_reproduce.py out/rohacek out/ekberg    # any of them, in any order
python scripts/fill_reproduce.py --pages out/rohacek       # and the whole page into benchmarks/results/reproduce/

Each is written where `<!-- measured: SOURCE | TABLE | COLUMNS [| KEY=VALUE] -->` asks for it: columns by their names
in results.json, rows with that value only. `TABLE` `head` is one line on what was measured with what.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path
from typing import Any

from luxel.bench.reproduce.tables import format_cell

REPOSITORY = Path(__file__).resolve().parents[1]
PAGE = REPOSITORY / "docs" / "reproduce.md"
PAGES = REPOSITORY / "benchmarks" / "results" / "reproduce"
MARKED = re.compile(r"(<!-- measured: (.+?) -->\n).*?(<!-- /measured -->)", re.DOTALL)
SOURCES = {"Roháček": "rohacek", "Ekberg": "ekberg"}
"""First word of a report's title -> the source's name in the markers."""


def read_reports(folders: list[Path]) -> dict[str, dict[str, Any]]:
    """Return the reports of `folders` by source. Raises ValueError for another study's, and for two of one."""
    found = {}
    for folder in folders:
        report = json.loads((folder / "results.json").read_text())
        name = SOURCES.get(report["title"].split()[0])
        if name is None:
            raise ValueError(f"'{folder}' holds '{report['title']}', which docs/reproduce.md has no table of")
        if name in found:
            raise ValueError(f"'{folder}' is the second folder of {name}; name one")
        found[name] = report
    return found


def fill(text: str, reports: dict[str, dict[str, Any]]) -> str:
    """Return a page with the marked parts of `reports` written anew; others stay.

    Raises ValueError for a table or a column that a report does not have.
    """

    def write(match: re.Match[str]) -> str:
        opening, asked, closing = match.groups()
        source, name, *rest = (part.strip() for part in asked.split("|"))
        if source not in reports:
            return match.group(0)
        report = reports[source]
        return opening + (_head(report) if name == "head" else _table(report, name, *rest)) + closing

    return MARKED.sub(write, text)


def machine_of(report: dict[str, Any]) -> str:
    """Return the chip that a report was measured on."""
    machine = report["machine"]
    return machine["gpu"] if report["device"] == "cuda" else f"{machine['cpu']}, {machine['cores']} cores"


def _head(report: dict[str, Any]) -> str:
    settings, machine = report["settings"], report["machine"]
    commit = str(machine.get("commit"))[:12]
    what = f"{settings['size']}, {settings['frames']} frames, truth of {settings['truth']}, seed {settings['seed']}"
    return f"*{machine_of(report)}; {report['date']}, commit {commit}; {what}.*\n"


def _table(report: dict[str, Any], name: str, columns: str, only: str = "") -> str:
    table = next((table for table in report["tables"] if table["name"] == name), None)
    if table is None:
        raise ValueError(f"'{report['title']}' was measured without table {name}")
    wanted = [column.strip() for column in columns.split(",")]
    missing = [column for column in wanted if column not in table["columns"]]
    if missing:
        raise ValueError(f"table {name} has no column '{missing[0]}'; it has {', '.join(table['columns'])}")
    places = [table["columns"].index(column) for column in wanted]
    rows = table["rows"]
    if only:
        key, _, value = only.partition("=")
        at = table["columns"].index(key.strip())
        rows = [row for row in rows if row[at] == value.strip()]
    rule = ["---:" if "(" in column else "---" for column in wanted]
    lines = [wanted, rule, *([format_cell(row[place]) for place in places] for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def main() -> int:
    """Fill the page, and copy the reports' own pages where that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--pages", action="store_true", help="copy tables.md to benchmarks/results/reproduce/, too")
    options = parser.parse_args()
    try:
        reports = read_reports(options.folders)
        PAGE.write_text(fill(PAGE.read_text(), reports))
    except (OSError, ValueError) as error:
        print(error, file=sys.stderr)
        return 2
    print(f"written: {PAGE.relative_to(REPOSITORY)}")
    if options.pages:
        for folder, (name, report) in zip(options.folders, reports.items(), strict=True):
            chip = "-".join(machine_of(report).lower().split()[:2]) if report["device"] == "cuda" else "cpu"
            path = PAGES / f"{name}-{chip}.md"
            path.write_text((folder / "tables.md").read_text())
            print(f"written: {path.relative_to(REPOSITORY)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
