"""Methods from outside: a class in a file, and entry points of installed packages."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import pytest

import luxel
from luxel.cli import main
from luxel.errors import LuxelError
from luxel.methods import METHODS, find_method, load_method, make_params, own
from luxel.methods.base import describe_params
from luxel.viewer.dials import list_dials
from luxel.viewer.world import World, list_methods

WHOLE = '''
"""A method of one number."""
from dataclasses import dataclass, field
import drjit as dr
import mitsuba as mi
from luxel.methods import Light, Method


@dataclass
class State:
    level: mi.Float


class Level(Method):
    @dataclass
    class Params:
        level: float = 0.25
        """Irradiance everywhere."""
        names: list = field(default_factory=list)

    name = "level"
    presets = {"bright": {"level": 4.0}}

    def build(self, scene, params, seed, *, workdir=None, progress=None):
        return State(dr.opaque(mi.Float, params.level))

    def query(self, scene, state, surface):
        return Light(mi.Color3f(state.level), mi.Color3f(0.0), dr.select(surface.active, mi.Float(1.0), 0.0))


class Second(Level):
    name = "second"
'''


@pytest.fixture(autouse=True)
def untouched() -> Iterator[None]:
    """METHODS as it was, and no file remembered."""
    before, path = dict(METHODS), list(sys.path)
    yield
    METHODS.clear()
    METHODS.update(before)
    own.SOURCES.clear()
    sys.path[:] = path
    own.installed_methods.cache_clear()


def written(folder: Path, text: str = WHOLE, name: str = "mine.py") -> str:
    (folder / name).write_text(text)
    return str(folder / name)


# ------------------------------------------------------------------------------------------------ names


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("gibs", ("gibs", None)),
        ("gibs:ekberg", ("gibs", "ekberg")),
        ("mine.py:Level", ("mine.py:Level", None)),
        ("mine.py:Level:bright", ("mine.py:Level", "bright")),
        ("/a:b.py/mine.py:Level", ("/a:b.py/mine.py:Level", None)),
        ("a:b.py:Level", ("a:b.py:Level", None)),
        ("a:b.py:Level:x.py", ("a:b.py:Level", "x.py")),
        ("a.py:b.py:Level:bright", ("a.py:b.py:Level", "bright")),
        ("mine.py", ("mine.py", None)),
    ],
)
def test_methods_and_presets_come_apart(text: str, parts: tuple[str, str | None]) -> None:
    assert own.split_method(text) == parts


def test_lists_come_apart_though_paths_hold_commas(tmp_path: Path) -> None:
    file = written(tmp_path, name="a,b,c.py")
    assert own.split_list("gibs, ddgi,,path") == ["gibs", "ddgi", "path"]
    assert own.split_list(f"gibs,{file}:Level,path") == ["gibs", f"{file}:Level", "path"]
    assert own.split_list(f"{file}:Level:bright,{file}:Second") == [f"{file}:Level:bright", f"{file}:Second"]
    # Nothing is there: the part after the comma is what is complained of.
    assert own.split_list("gibs,none.py:Level") == ["gibs", "none.py:Level"]


# ------------------------------------------------------------------------------------------------ files


def test_a_class_of_a_file_is_a_method_by_its_name(tmp_path: Path) -> None:
    text = written(tmp_path) + ":Level"
    method = load_method(text)
    assert METHODS["level"] is method and find_method("level") is method and find_method(text) is method
    assert str(own.SOURCES["level"]) == text
    assert make_params("level", "bright", {}).level == 4.0 and make_params("level", None, {"level": "0.5"}).level == 0.5
    docs = {name: (default, doc) for name, default, doc in describe_params(method.Params)}
    assert docs == {"level": (0.25, "Irradiance everywhere."), "names": ([], "")}
    assert {dial.key for dial in list_dials("level")} == {"level", "names"}
    assert load_method("mine.py:Second", tmp_path).name == "second"


def test_it_renders_what_it_says(tmp_path: Path) -> None:
    renderer = luxel.Renderer("cornell-box", written(tmp_path) + ":Level", {"level": 3.0}, size=(16, 16))
    renderer.run(2)
    layers = renderer.layers()
    assert layers.indirect[layers.hit] == pytest.approx(3.0)


def test_an_edited_file_takes_its_own_place(tmp_path: Path) -> None:
    text = written(tmp_path) + ":Level"
    origin = own.SOURCES[load_method(text).name]
    written(tmp_path, WHOLE.replace("0.25", "0.75"))
    assert make_params(load_method(text).name).level == 0.75
    # Who was sent the file as it was does not run another one.
    with pytest.raises(LuxelError, match="differs from the file that was asked for"):
        origin.load()


MISTAKES = {
    "a word": (
        "dr.select(surface.active, mi.Float(1.0), 0.0))",
        "weigth=mi.Float(1.0))",
        r"TypeError.*'weigth'.*\(line 28\)",
    ),
    "a field": ("surface.active", "surface.lively", r"AttributeError.*'lively'.*\(line 28\)"),
    "a look at numbers": ("return Light(", "float(state.level[0]); return Light(", r"line 28"),
    "the answer": ("return Light(", "return (", "method 'level' answers with tuple; it must be a luxel.methods.Light"),
    "a function": (
        ", *, workdir=None, progress=None",
        "",
        r"`build` must take \(self, scene, params, seed, \*, workdir, ",
    ),
    "the order": ("def query(self, scene, state, surface)", "def query(self, scene, surface)", "`query` must take"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_in_the_file_is_bad_input_with_its_line(
    mistake: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    old, new, told = MISTAKES[mistake]
    assert old in WHOLE
    file = written(tmp_path, WHOLE.replace(old, new))
    words = ["render", "cornell-box", "--method", f"{file}:Level", "--size", "16x16", "--frames", "2"]
    assert main([*words, "-o", str(tmp_path / "out.png")]) == 2
    error = capsys.readouterr().err
    assert re.search(told, error) and len(error.splitlines()) == 1
    assert not (tmp_path / "out.png").exists()


def test_light_that_is_no_number_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = written(tmp_path, WHOLE.replace("Light(mi.Color3f(state.level)", 'Light(mi.Color3f(float("nan"))'))
    words = ["render", "furnace", "--method", f"{file}:Level", "--size", "16x16", "--frames", "2"]
    assert main([*words, "-o", str(tmp_path / "out.png")]) == 0
    assert "'level' gives NaN or infinite light in 100.00% of the pixels" in capsys.readouterr().err


def test_neighbours_of_the_file_can_be_imported(tmp_path: Path) -> None:
    written(tmp_path, "LEVEL = 0.125\n", "level_of_the_neighbour.py")
    text = WHOLE.replace("import drjit as dr", "import drjit as dr\nfrom level_of_the_neighbour import LEVEL")
    load_method(written(tmp_path, text.replace("0.25", "LEVEL")) + ":Level")
    assert make_params("level").level == 0.125


def test_a_file_may_enter_its_method_itself(tmp_path: Path) -> None:
    text = WHOLE + "\nimport luxel\nluxel.METHODS['level'] = Level()\n"
    assert load_method(written(tmp_path, text) + ":Level").name == "level"


BROKEN = {
    "no file": (None, "Level", "there is no file '.*mine.py'"),
    "no class": (WHOLE, "Levle", "has no class 'Levle' \\(its methods: Level, Second\\)"),
    "no class said": (WHOLE, "", "names a file, but no class"),
    "no method": (WHOLE, "State", "is no method: derive a class from luxel.methods.Method"),
    "not a class": (WHOLE + "\nLEVEL = 3\n", "LEVEL", "is no method"),
    "raises": (
        WHOLE + "\nraise ValueError('no\\nlight')\n",
        "Level",
        "cannot be imported: ValueError: no light \\(line 3",
    ),
    "exits": ("import sys\nsys.exit(3)\n", "Level", "cannot be imported: SystemExit: 3 \\(line 2\\)"),
    "syntax": ("def f(:\n", "Level", "cannot be imported: SyntaxError in line 1"),
    "null": ("\0", "Level", "cannot be imported"),
    "import": ("import nowhere_to_be_found\n", "Level", "ModuleNotFoundError: No module named 'nowhere_to_be_found'"),
    "abstract": (WHOLE.replace("def query", "def ask"), "Level", "lacks query"),
    "no name": (WHOLE.replace('name = "level"', "pass"), "Level", "needs a `name`"),
    "bad name": (WHOLE.replace('"level"', '"my level"'), "Level", "needs a `name`"),
    "no params": (WHOLE.replace("class Params:", "class Other:"), "Level", "needs `Params`"),
    "no default": (WHOLE.replace("float = 0.25", "float"), "Level", "needs a default"),
    "leaves": (WHOLE + "\n    def __init__(self):\n        raise SystemExit(3)\n", "Second", "SystemExit: 3"),
    "preset's value": (
        WHOLE.replace("4.0}", '"high"}'),
        "Level",
        "preset 'bright' sets 'level' to 'high', not to a number",
    ),
    "preset": (WHOLE.replace('{"level": 4.0}', '{"lever": 4.0}'), "Level", "preset 'bright' sets 'lever'"),
    "init": (
        WHOLE.replace("    name =", "    def __init__(self, size): pass\n    name =", 1),
        "Level",
        "cannot be made",
    ),
    "taken": (
        WHOLE.replace('name = "level"', 'name = "gibs"'),
        "Level",
        "calls itself 'gibs', and a method of that name is there",
    ),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_bad_file_is_one_sentence(tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    text, name, words = BROKEN[kind]
    file = str(tmp_path / "mine.py") if text is None else written(tmp_path, text)
    before = dict(METHODS)
    with pytest.raises(LuxelError, match=words):
        load_method(f"{file}:{name}" if name else file)
    assert before == METHODS
    capsys.readouterr()
    assert main(["render", "cornell-box", "--method", f"{file}:{name}" if name else file]) == 2
    said = capsys.readouterr()
    assert not said.out and len(said.err.splitlines()) == 1 and said.err.startswith("luxel: ")


def test_two_files_cannot_share_a_name(tmp_path: Path) -> None:
    load_method(written(tmp_path) + ":Level")
    other = written(tmp_path, name="other.py")
    with pytest.raises(LuxelError, match="a method of that name is there already"):
        load_method(other + ":Level")


# ------------------------------------------------------------------------------------------------ installed packages


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installed package with a whole method, some broken ones, and one whose name is taken."""
    (tmp_path / "fog_methods.py").write_text(WHOLE)
    (tmp_path / "fog_broken.py").write_text("raise RuntimeError('no fog')\n")
    info = tmp_path / "fog-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: fog\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[luxel.methods]\nlevel = fog_methods:Level\nwrong = fog_methods:Second\nbroken = fog_broken:Level\n"
        "absent = fog_methods:Nothing\nstate = fog_methods:State\ngibs = fog_methods:Level\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    own.installed_methods.cache_clear()
    for name in ("fog_methods", "fog_broken"):
        monkeypatch.delitem(sys.modules, name, raising=False)


def test_installed_methods_are_listed_and_loaded_when_asked_for(package: None) -> None:
    assert {"level", "broken", "wrong"} <= set(own.list_names()) and "level" not in METHODS
    assert "level" in list_methods() and list_methods().index("level") > list_methods().index("none")
    assert "fog_methods" not in sys.modules and "fog_broken" not in sys.modules
    with pytest.raises(LuxelError, match="choose one of .*level.*did you mean 'level'"):
        find_method("levle")
    assert make_params("level", "bright").level == 4.0 and METHODS["level"].name == "level"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("broken", "method 'broken' of package 'fog' cannot be loaded: RuntimeError: no fog"),
        ("absent", "method 'absent' of package 'fog' cannot be loaded: AttributeError"),
        ("state", "method 'state' of package 'fog' is no method"),
        ("wrong", "method 'wrong' of package 'fog' calls itself 'second'"),
    ],
)
def test_a_broken_package_is_named(package: None, name: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(LuxelError, match=words):
        find_method(name)
    assert main(["render", "cornell-box", "--method", name]) == 2
    assert words in capsys.readouterr().err
    assert find_method("gibs").name == "gibs"


def test_the_world_goes_on_where_a_package_is_broken(package: None) -> None:
    from luxel.viewer.world import Choice

    world = World(luxel.load("cornell-box"), Choice("none"))
    with pytest.raises(LuxelError, match="no fog"):
        world.switch_method("broken")
    assert world.main == "none"
    world.switch_method("level")
    assert world.main == "level"


def test_the_doctor_lists_them_and_warns(package: None, capsys: pytest.CaptureFixture[str]) -> None:
    from luxel.cli.doctor import list_methods as list_here

    names, notes = list_here()
    assert "level" in names and "gibs" in names and "broken" not in names
    assert any("'broken' of package 'fog' cannot be loaded" in note for note in notes)
    assert any("package 'fog' offers a method 'gibs'" in note for note in notes)
    assert METHODS["gibs"].Params.__module__.startswith("luxel.")


def test_a_file_cannot_take_the_name_of_an_installed_method(package: None, tmp_path: Path) -> None:
    with pytest.raises(LuxelError, match="a method of that name is there already"):
        load_method(written(tmp_path, name="mine.py") + ":Level")


def test_the_group_is_read_as_packages_write_it() -> None:
    assert own.GROUP == "luxel.methods" and not [e for e in metadata.entry_points(group=own.GROUP) if e.name == "gibs"]
