"""Imports go down only, whether at a module's top or inside a function; those for type checkers are exempt."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[1] / "src"

LAYERS = (
    ("errors", "files", "runtime", "stages"),
    ("scene",),
    ("image",),
    ("metrics",),
    ("kernels",),
    ("methods",),
    ("render",),
    ("inspect",),
    ("report", "bake", "viewer", "bench"),
    ("cli", "__main__"),
)
"""From the bottom up; parts of one layer may import one another, but not in a circle."""

RANK = {part: rank for rank, parts in enumerate(LAYERS) for part in parts}
MODULES = sorted(SOURCE.glob("luxel/**/*.py"))


def part_of(module: str) -> str:
    """Return the first name below the package: `scene` for `luxel.scene.model`, "" for the package itself."""
    return module.split(".")[1] if "." in module else ""


def find_imports(tree: ast.AST, package: str) -> Iterator[tuple[int, str]]:
    """Yield (line, absolute name) of every import of luxel in a module of `package`, type checkers' aside."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            for branch in node.orelse:
                yield from find_imports(ast.Module([branch], []), package)
        elif isinstance(node, ast.Import):
            yield from ((node.lineno, name.name) for name in node.names if name.name.split(".")[0] == "luxel")
        elif isinstance(node, ast.ImportFrom):
            above = package.rsplit(".", node.level - 1)[0] + "." if node.level else ""
            module = (above + (node.module or "")).rstrip(".")
            if module == "luxel":
                yield from ((node.lineno, f"luxel.{name.name}") for name in node.names if name.name != "__version__")
            elif module.startswith("luxel."):
                yield node.lineno, module
        else:
            yield from find_imports(node, package)


def find_wrong_imports(path: Path, source: str) -> list[str]:
    relative = path.relative_to(SOURCE)
    package = ".".join(relative.parent.parts)
    part = part_of(".".join(relative.with_suffix("").parts))
    if part == "__init__":  # the package's face may show anything
        return []
    allowed = RANK[part]
    return [
        f"{relative}:{line} imports {name}"
        for line, name in find_imports(ast.parse(source), package)
        if RANK.get(part_of(name), len(LAYERS)) > allowed
    ]


def test_every_module_belongs_to_a_layer() -> None:
    parts = {part_of(".".join(path.relative_to(SOURCE).with_suffix("").parts)) for path in MODULES}
    assert parts - {"__init__"} <= RANK.keys()


def test_imports_go_down_only() -> None:
    wrong = [line for path in MODULES for line in find_wrong_imports(path, path.read_text())]
    assert not wrong, "\n".join(wrong)


def find_circles(imported: dict[str, set[str]]) -> list[str]:
    """Return the parts that import themselves by way of others."""

    def reach(part: str) -> set[str]:
        found: set[str] = set()
        ahead = list(imported.get(part, ()))
        while ahead:
            following = ahead.pop()
            if following not in found:
                found.add(following)
                ahead += imported.get(following, ())
        return found

    return sorted(part for part in imported if part in reach(part))


def test_no_parts_import_each_other() -> None:
    imported: dict[str, set[str]] = {}
    for path in MODULES:
        names = path.relative_to(SOURCE).with_suffix("").parts
        part = part_of(".".join(names))
        found = {part_of(name) for _, name in find_imports(ast.parse(path.read_text()), ".".join(names[:-1]))}
        imported.setdefault(part, set()).update(found - {part, ""})
    imported.pop("__init__")
    assert not find_circles(imported)


def test_the_oracle_answers_nobody() -> None:
    """Mitsuba's own pictures judge luxel's in tests and docs; none is given for luxel's."""
    for path in MODULES:
        if not path.stem.startswith("oracle"):
            package = ".".join(path.relative_to(SOURCE).with_suffix("").parts[:-1])
            found = {name for _, name in find_imports(ast.parse(path.read_text()), package)}
            assert not any("oracle" in name for name in found), path


def test_circles_are_found() -> None:
    assert find_circles({"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": set()}) == ["a", "b", "c"]


@pytest.mark.parametrize(
    ("source", "wrong"),
    [
        ("import luxel.render.renderer", 1),
        ("from luxel.cli import main", 1),
        ("from luxel import report, errors", 1),
        ("from ..render import tonemap", 1),
        ("def late():\n    from luxel.methods import METHODS", 1),
        ("import luxel", 1),
        ("from luxel.errors import LuxelError", 0),
        ("from . import grid\nfrom ..scene import model", 0),
        ("from luxel import __version__", 0),
        ("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from luxel.methods import METHODS", 0),
    ],
)
def test_the_walk_sees_every_kind_of_import(source: str, wrong: int) -> None:
    assert len(find_wrong_imports(SOURCE / "luxel" / "kernels" / "example.py", source)) == wrong
