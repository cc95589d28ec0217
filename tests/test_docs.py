"""The docs hold: code blocks run, commands and flags exist, links lead somewhere, generated tables are up to date."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
PAGES = [
    *(REPOSITORY / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")),
    *sorted((REPOSITORY / "docs").rglob("*.md")),
]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)|<img[^>]*\bsrc=\"([^\"]+)\"")
PICTURES_LIMIT = 2_500_000


def relative(path: Path) -> str:
    return str(path.relative_to(REPOSITORY))


def find_blocks(language: str) -> list[tuple[Path, int, str]]:
    """Return (page, line, text) of each code block in `language`."""
    found = []
    for page in PAGES:
        text = page.read_text()
        for match in BLOCK.finditer(text):
            if match[1] == language:
                found.append((page, text.count("\n", 0, match.start()) + 1, match[2]))
    return found


def name_block(value: object) -> str:
    return relative(value) if isinstance(value, Path) else str(value) if isinstance(value, int) else "code"


@pytest.mark.parametrize(("page", "line", "code"), find_blocks("python"), ids=name_block)
def test_python_blocks_run(page: Path, line: int, code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import luxel

    monkeypatch.chdir(tmp_path)
    before = dict(luxel.METHODS)
    try:
        exec(compile("\n" * line + code, relative(page), "exec", dont_inherit=True), {"__name__": "docs"})
    finally:
        luxel.METHODS.clear()
        luxel.METHODS.update(before)


def test_there_are_blocks_to_run() -> None:
    assert len(find_blocks("python")) >= 4


@pytest.mark.parametrize("page", PAGES, ids=relative)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"`[^`\n]*`", "", BLOCK.sub("", page.read_text()))
    broken = []
    for match in LINK.finditer(text):
        link = match[1] or match[2]
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if not target.exists() or (anchor and anchor not in find_anchors(target)):
            broken.append(link)
    assert not broken


def find_anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", BLOCK.sub("", page.read_text()), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}


def test_generated_tables_are_up_to_date() -> None:
    spec = importlib.util.spec_from_file_location("make_docs", REPOSITORY / "scripts" / "make_docs.py")
    assert spec is not None and spec.loader is not None
    make_docs = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make_docs)
    stale = [
        relative(page) for page in make_docs.find_pages() if make_docs.update(page.read_text()) != page.read_text()
    ]
    assert not stale, "run `python scripts/make_docs.py`"
    gibs = (REPOSITORY / "docs" / "methods" / "gibs.md").read_text()
    assert "| `rays_per_surfel` | 4 |" in gibs


def test_every_method_has_a_page() -> None:
    import luxel

    pages = " ".join(page.read_text() for page in (REPOSITORY / "docs" / "methods").glob("*.md"))
    assert not [name for name in luxel.METHODS if f"`{name}`" not in pages]


def test_commands_and_flags_exist() -> None:
    import typer

    from luxel.cli.app import app

    commands = typer.main.get_command(app).commands  # pyright: ignore[reportAttributeAccessIssue]
    wrong = []
    for page, line, text in find_blocks("sh"):
        for command in text.replace("\\\n", " ").splitlines():
            words = command.split(" #")[0].split()
            if words[:1] != ["luxel"]:
                continue
            known = {flag for parameter in commands[words[1]].params for flag in parameter.opts}
            flags = [word.split("=")[0] for word in words[2:] if re.match(r"-{1,2}[a-z]", word)]
            wrong += [f"{relative(page)}:{line}: {flag}" for flag in flags if flag not in known]
    assert not wrong


def test_pictures_are_small_and_shown() -> None:
    pictures = sorted((REPOSITORY / "docs" / "pictures").iterdir())
    sizes = {relative(path): path.stat().st_size for path in pictures}
    assert max(sizes.values()) <= 200_000
    assert sum(sizes.values()) <= PICTURES_LIMIT
    shown = " ".join(page.read_text() for page in PAGES)
    assert not [name for name in sizes if Path(name).name not in shown]
