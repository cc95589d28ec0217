"""The house rules that a program can check."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
SOURCES = sorted((REPOSITORY / "src").rglob("*.py"))
PAGES = [REPOSITORY / name for name in ("README.md", "CONTRIBUTING.md")]
MOST_LINES = 450
HEAVY = {"mitsuba", "drjit", "numpy", "scipy", "PIL", "matplotlib", "pygltflib", "typer", "rich"}


def relative(path: Path) -> str:
    return str(path.relative_to(REPOSITORY))


def test_files_are_short() -> None:
    lengths = {relative(path): len(path.read_text().splitlines()) for path in SOURCES}
    assert not {path: count for path, count in lengths.items() if count > MOST_LINES}


def test_no_source_is_ignored_by_git() -> None:
    """A pattern such as `report/` for an output folder would also leave a package of that name out of every clone."""
    if shutil.which("git") is None or not (REPOSITORY / ".git").exists():
        pytest.skip("not a git checkout")
    names = "\n".join(map(relative, SOURCES))
    command = ["git", "check-ignore", "--no-index", "--stdin"]
    ran = subprocess.run(command, cwd=REPOSITORY, input=names, capture_output=True, text=True, timeout=60)
    assert not ran.stdout.split()


def test_nothing_is_put_off() -> None:
    marks = re.compile(r"\b(TODO|FIXME)\b")
    assert not [relative(path) for path in SOURCES if marks.search(path.read_text())]


def compared_with(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield (line, text) for each text that a comparison or a membership test names."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            for side in (node.left, *node.comparators):
                every = side.elts if isinstance(side, ast.Tuple | ast.List | ast.Set) else [side]
                for each in every:
                    if isinstance(each, ast.Constant) and isinstance(each.value, str):
                        yield node.lineno, each.value


def test_what_uses_methods_asks_their_classes_and_not_for_their_names() -> None:
    """The theses' tables in `bench/reproduce` are about two methods by name."""
    from luxel.methods import METHODS

    users = [path for part in ("bake", "bench", "cli", "inspect", "render", "report", "viewer") for path in SOURCES
             if f"luxel/{part}/" in relative(path) and "reproduce" not in relative(path)]  # fmt: skip
    assert len(users) > 80
    found = [
        f"{relative(path)}:{line} '{text}'"
        for path in users
        for line, text in compared_with(ast.parse(path.read_text()))
        if text in METHODS
    ]
    assert not found


SHARED_NAMES = {"Light"}
"""`luxel.Light` is a lamp of the scene, `luxel.methods.Light` a method's answer."""


def find_shared_names(sources: dict[str, str]) -> dict[str, list[str]]:
    """Return the names that several classes have, with the files; a class inside a class is a part of it."""
    homes: dict[str, list[str]] = {}
    for path, source in sources.items():
        for node in ast.walk(ast.parse(source)):
            for each in [] if isinstance(node, ast.ClassDef) else ast.iter_child_nodes(node):
                if isinstance(each, ast.ClassDef):
                    homes.setdefault(each.name, []).append(path)
    return {name: paths for name, paths in homes.items() if len(paths) > 1}


def test_no_two_classes_have_one_name() -> None:
    shared = find_shared_names({relative(path): path.read_text() for path in SOURCES})
    assert shared.keys() == SHARED_NAMES, shared
    assert len(shared["Light"]) == 2


def test_the_walk_sees_classes_of_one_name() -> None:
    sources = {
        "a.py": "class View: pass\nclass A:\n    class Params: pass",
        "b.py": "def make():\n    class View: pass\nclass B:\n    class Params: pass",
        "c.py": "if True:\n    class A: pass",
    }
    assert find_shared_names(sources) == {"View": ["a.py", "b.py"], "A": ["a.py", "c.py"]}


def test_the_walk_sees_names_in_comparisons() -> None:
    source = 'a = name == "path"; b = "gibs" != name; c = name in ("ambient", other); d = ("none",)'
    assert [text for _, text in compared_with(ast.parse(source))] == ["path", "gibs", "ambient"]


def test_no_variant_is_set_elsewhere() -> None:
    setters = {relative(path) for path in SOURCES if re.search(r"\bset_variant\(", path.read_text())}
    assert setters <= {"src/luxel/runtime.py"}


def test_no_variant_dependent_names_are_imported() -> None:
    wrong = re.compile(r"^\s*from (mitsuba|drjit)(\.\w+)* import", re.MULTILINE)
    assert not [relative(path) for path in SOURCES if wrong.search(path.read_text())]


def test_every_module_says_what_it_is() -> None:
    silent = [path for path in SOURCES if path.read_text().strip() and not path.read_text().startswith('"""')]
    assert not [relative(path) for path in silent]


def test_importing_luxel_is_light() -> None:
    program = "import sys, luxel; print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert not HEAVY & set(ran.stdout.split())


def test_public_names_are_sorted_and_complete() -> None:
    import luxel

    assert list(luxel.__all__) == sorted(luxel.__all__)
    for name in luxel.__all__:
        assert getattr(luxel, name) is not None
    features = {"annotations"}  # `from __future__ import annotations` leaves its own name behind
    visible = {
        name for name, value in vars(luxel).items() if not name.startswith("_") and not isinstance(value, ModuleType)
    }
    assert visible - features <= set(luxel.__all__)


def find_commands(page: Path, program: str) -> list[list[str]]:
    """Return the words after `program` of each command in the code blocks of a page, comments cut off."""
    commands = []
    for block in re.findall(r"^```(?:sh|bash|shell|console)?\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL):
        for line in block.replace("\\\n", " ").splitlines():
            words = line.removeprefix("$ ").split(" #")[0].split()
            if words and words[0].rsplit("/")[-1] == program:
                commands.append(words[1:])
    return commands


@cache
def read_help(command: str) -> str:
    program = "import sys; from luxel.cli import main; sys.exit(main())"
    environment = {**os.environ, "COLUMNS": "250", "TERM": "dumb", "NO_COLOR": "1"}
    ran = subprocess.run(
        [sys.executable, "-c", program, *([command] if command else []), "--help"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert ran.returncode == 0, f"luxel {command} --help: {ran.stdout}{ran.stderr}"
    return ran.stdout


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_in_the_pages_exist(page: Path) -> None:
    for words in find_commands(page, "luxel"):
        command = words[0] if words and not words[0].startswith("-") else ""
        answer = read_help(command)
        for word in words:
            if word.startswith("--"):
                assert re.search(rf"{word.split('=')[0]}\b", answer), f"{page.name}: luxel {' '.join(words)}: {word}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_make_targets_in_the_pages_exist(page: Path) -> None:
    makefile = (REPOSITORY / "Makefile").read_text()
    for words in find_commands(page, "make"):
        for target in words:
            if "=" not in target and not target.startswith(("-", '"', "'")) and words.index(target) == 0:
                assert re.search(rf"^{re.escape(target)}:", makefile, re.MULTILINE), f"{page.name}: make {target}"


def test_the_readme_names_its_two_first_commands() -> None:
    assert [words[:1] for words in find_commands(REPOSITORY / "README.md", "make")][:2] == [["render"], ["test"]]
