"""Write the tables of the docs that follow from the code: methods' parameters, built-in scenes, looks.

python scripts/make_docs.py          # rewrite what lies between the markers
python scripts/make_docs.py --check  # change nothing; exit code 1 where a page is out of date
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path

import luxel
from luxel.inspect.diagnosis import VERDICTS
from luxel.inspect.looks import list_looks
from luxel.methods.base import describe_params
from luxel.methods.inspect import inspector_of

REPOSITORY = Path(__file__).resolve().parents[1]
MARKED = re.compile(r"(<!-- generated: (\S+?)(?: (\S+?))? -->\n).*?(<!-- /generated -->)", re.DOTALL)
"""`<!-- generated: KIND [NAME] -->` .. `<!-- /generated -->`; KIND is one of `WRITERS`."""


def find_pages() -> list[Path]:
    """Return the pages that may hold generated tables."""
    return [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]


def write_params_table(name: str) -> str:
    """Return the parameter table of method `name`; each preset has a column with what it changes."""
    method = luxel.METHODS[name]
    presets = list(method.presets)
    head = ["parameter", "default", *(f"in `{preset}`" for preset in presets), "what each end costs"]
    rows = [head, ["---"] * len(head)]
    for key, default, doc in describe_params(method.Params):
        changed = [_show(method.presets[preset][key]) if key in method.presets[preset] else "" for preset in presets]
        rows.append([f"`{key}`", _show(default), *changed, doc])
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def write_scenes_table(_: str) -> str:
    """Return the table of the built-in scenes."""
    rows = ["| scene | what it is | dials |\n", "| --- | --- | --- |\n"]
    for name, about, dials in luxel.list_scenes():
        settings = ", ".join(f"`{key}={value:g}`" for key, value in dials.items())
        rows.append(f"| `{name}` | {about} | {settings} |\n")
    return "".join(rows)


def write_looks_table(name: str) -> str:
    """Return the looks that method `name` adds, or for `every` those that all have."""
    every = list_looks(luxel.METHODS["none"])
    looks = every if name == "every" else inspector_of(luxel.METHODS[name]).looks
    rows = "".join(f"| `{look.name}` | {look.doc} | {look.unit} |\n" for look in looks)
    return "| look | what it shows | unit |\n| --- | --- | --- |\n" + rows


def write_verdicts_table(_: str) -> str:
    """Return what `luxel explain` may conclude."""
    rows = "".join(f"| `{verdict}` | {meaning} |\n" for verdict, meaning in VERDICTS.items())
    return "| verdict | meaning |\n| --- | --- |\n" + rows


WRITERS: dict[str, Callable[[str], str]] = {
    "params": write_params_table,
    "scenes": write_scenes_table,
    "looks": write_looks_table,
    "verdicts": write_verdicts_table,
}


def update(text: str) -> str:
    """Return a page with its generated parts written anew."""

    def fill(match: re.Match[str]) -> str:
        opening, kind, name, closing = match.groups()
        return opening + WRITERS[kind](name) + closing

    return MARKED.sub(fill, text)


def _show(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else "estimated" if value is None else str(value)


def main() -> int:
    """Rewrite the pages, or with --check say which are out of date."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    stale = []
    for page in find_pages():
        before = page.read_text()
        after = update(before)
        if after != before:
            stale.append(str(page.relative_to(REPOSITORY)))
            if not options.check:
                page.write_text(after)
    if stale:
        print(("out of date: " if options.check else "rewritten: ") + ", ".join(stale))
    return 1 if stale and options.check else 0


if __name__ == "__main__":
    raise SystemExit(main())
