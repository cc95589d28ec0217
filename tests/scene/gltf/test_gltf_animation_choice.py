"""Which of a file's animations plays: in Python, in a suite's scene and on the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

import luxel
from luxel.cli import main
from luxel.errors import LuxelError
from luxel.render.loading import load_choice
from luxel.report.suite import read_suite
from luxel.scene.choice import SceneChoice

if TYPE_CHECKING:
    from pathlib import Path

    from conftest import GltfBuilder

ENDS = {"walk": [1.0, 0.0, 0.0], "Run": [0.0, 2.0, 0.0], "1": [0.0, 0.0, 3.0]}
"""Where each animation brings a node of its own, after one, two and three seconds."""


@pytest.fixture
def path(builder: GltfBuilder) -> Path:
    mesh = builder.mesh()
    for seconds, (name, end) in enumerate(ENDS.items(), 1):
        node = builder.node(mesh=mesh, name=f"moved by {name}")
        times, places = builder.accessor([0.0, float(seconds)]), builder.accessor([[0.0, 0.0, 0.0], end])
        channel = {"sampler": 0, "target": {"node": node, "path": "translation"}}
        builder.add(
            "animations", {"name": name, "samplers": [{"input": times, "output": places}], "channels": [channel]}
        )
    return builder.write()


@pytest.mark.parametrize(
    ("choice", "playing"),
    [
        (None, ["walk"]), ("walk", ["walk"]), ("Run", ["Run"]), ("run", ["Run"]), (" Run ", ["Run"]), (1, ["Run"]),
        # In a text, a name goes before a number.
        ("1", ["1"]), (0, ["walk"]), ("0", ["walk"]), (2, ["1"]), ("2", ["1"]),
        ("all", ["walk", "Run", "1"]), ("ALL", ["walk", "Run", "1"]),
    ],
)  # fmt: skip
def test_the_chosen_animation_plays(path: Path, choice: str | int | None, playing: list[str]) -> None:
    data = luxel.load(path, animation=choice)
    moving = [item.name for item in data.objects if item.motion is not None]
    assert moving == [f"moved by {name}" for name in playing]
    assert data.duration == max(list(ENDS).index(name) + 1 for name in playing)
    for item in data.objects:
        if item.motion is not None:
            assert item.motion(9.0)[:3, 3].tolist() == ENDS[item.name.removeprefix("moved by ")]
    named = [warning for warning in data.warnings if "not played" in warning]
    assert len(named) == (len(playing) < len(ENDS))
    for name in ENDS:
        assert not named or (name in named[0].split("not played")[1]) == (name not in playing)


@pytest.mark.parametrize("choice", ["fly", "3", 99, -1, "", "*"])
def test_an_unknown_animation_is_refused_with_the_list(path: Path, choice: str | int) -> None:
    with pytest.raises(LuxelError) as caught:
        luxel.load(path, animation=choice)
    assert f"no animation '{choice}'; it has 0 'walk', 1 'Run', 2 '1', or write all." in str(caught.value)


def test_where_there_is_nothing_to_choose(builder: GltfBuilder, tmp_path: Path) -> None:
    builder.node(mesh=builder.mesh())
    with pytest.raises(LuxelError, match="animation 'walk' is asked for but the file has none"):
        luxel.load(builder.write(), animation="walk")
    (tmp_path / "a.xml").write_text('<scene version="3.0.0"/>')
    for scene in ("cornell-box", "two-rooms:wall=0.1", tmp_path / "a.xml"):
        with pytest.raises(LuxelError, match="has no animation 'walk' to choose; only glTF files do"):
            luxel.load(scene, animation="walk")


def test_two_animations_of_one_node(builder: GltfBuilder) -> None:
    node = builder.node(mesh=builder.mesh())
    builder.animate(node, "translation", [0.0, 1.0], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    builder.json["animations"].append({**builder.json["animations"][0], "name": "second"})
    data = luxel.load(builder.write(), animation="all")
    assert any("Where two animations move the same" in one and "second" in one for one in data.warnings)


def test_choices_carry_it(path: Path, tmp_path: Path) -> None:
    assert load_choice(SceneChoice(str(path), animation="Run")).duration == 2.0
    assert SceneChoice(str(path), animation="Run").anywhere().animation == "Run"
    suite = tmp_path / "suite.toml"
    suite.write_text('scenes = [{ scene = "scene.glb", animation = "Run" }]\nmethods = ["none"]\n')
    (scene,) = read_suite(suite)["scenes"]
    assert scene.animation == "Run" and load_choice(scene).duration == 2.0


COMMANDS: dict[str, list[Any]] = {
    "render": ["render", "{}", "--method", "none", "-o", "a.png"],
    "explain": ["explain", "{}", "--method", "none", "--pixel", "1,1"],
    "compare": ["compare", "{}", "--methods", "none", "-o", "report"],
    "bench": ["bench", "none", "--scene", "{}"],
    "bake": ["bake", "{}", "-o", "a.glb"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_refuse_an_unknown_one(
    path: Path, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([*(word.format(path) for word in COMMANDS[command]), "--animation", "fly"]) == 2
    error = capsys.readouterr().err.strip()
    assert "no animation 'fly'; it has 0 'walk'" in error and "\n" not in error
