"""Inside the lightmap imports go down only: what bakes knows nothing of what runs, and nobody of what shows."""

from __future__ import annotations

import ast
from pathlib import Path

import luxel.methods.lightmap as lightmap

FOLDER = Path(lightmap.__path__[0])
ORDER = ("params", "flatten", "bake", "run", "inspect", "inspector", "workload", "method", "__init__")
"""From the bottom up."""


def part_of(path: Path) -> str:
    return path.relative_to(FOLDER).with_suffix("").parts[0]


def find_imported(source: str) -> set[str]:
    """Return the parts of the lightmap that a module imports, at its top or inside functions."""
    prefix = lightmap.__name__ + "."
    nodes = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ImportFrom)]
    modules = [node.module or "" for node in nodes]
    return {module.removeprefix(prefix).split(".")[0] for module in modules if module.startswith(prefix)}


def test_imports_between_the_folders_go_down_only() -> None:
    wrong = [
        f"{path.relative_to(FOLDER)} imports {other}"
        for path in FOLDER.rglob("*.py")
        for other in find_imported(path.read_text())
        if ORDER.index(other) > ORDER.index(part_of(path))
    ]
    assert not wrong, "\n".join(wrong)


def test_the_walk_sees_imports_inside_functions() -> None:
    late = "def late():\n    from luxel.methods.lightmap.run.state import LightmapState"
    assert find_imported(late) == {"run"}
