"""`load`: names, dials, files, and one sentence for everything that is wrong."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import luxel
from luxel import scene as scene_package
from luxel.errors import LuxelError
from luxel.scene import add_default_light, load
from luxel.scene.edit import has_glow, has_own_light
from luxel.scene.library.shapes import box
from luxel.scene.model import Light, Material, Mesh, Object, SceneData, Sky


def message_of(*arguments: object, **dials: float | str) -> str:
    with pytest.raises(LuxelError) as caught:
        load(*arguments, **dials)  # type: ignore[arg-type]
    message = str(caught.value)
    assert "\n" not in message and message.endswith((".", "?"))
    return message


def test_dials_come_from_text_and_keywords() -> None:
    assert load("two-rooms:wall=0.1").facts["sealed_lo_x"] == pytest.approx(0.1)
    assert load("two-rooms", wall="0.2").facts["sealed_lo_x"] == pytest.approx(0.2)
    assert load("two-rooms:wall=0.1,lamp=1", wall=0.3).facts["sealed_lo_x"] == pytest.approx(0.3)
    assert load("attic: beams = 3 , beam=0.1").name == "attic"


def test_unknown_scene_names_the_others_and_the_closest() -> None:
    message = message_of("cornel-box")
    assert "Did you mean 'cornell-box'?" in message and "atrium" in message
    assert "Did you mean" not in message_of("zzzzzz")
    assert "two-rooms" in message_of("two-room:wall=1")


@pytest.mark.parametrize("what", [None, 3, b"cornell-box"])
def test_what_is_no_name_and_no_path_is_one_sentence(what: Any) -> None:
    with pytest.raises(LuxelError, match="is no scene"):
        luxel.load(what)


def test_wrong_dials_are_named() -> None:
    message = message_of("two-rooms:wal=0.1")
    assert "no dial 'wal'" in message and "wall, lamp" in message and "Did you mean 'wall'?" in message
    assert "it has none" in message_of("cornell-box:size=2")
    assert "must be a number, not 'thick'" in message_of("two-rooms:wall=thick")
    assert "must be a number, not 'nan'" in message_of("two-rooms:wall=nan")
    assert "must be a whole number" in message_of("attic:beams=2.5")
    assert "between 0.001 and 1" in message_of("two-rooms:wall=-3")
    for text in ("two-rooms:", "two-rooms:wall", "two-rooms:wall=", "two-rooms:=3"):
        assert "is not a dial" in message_of(text)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    assert "There is no file" in message_of(tmp_path / "nothing.glb")
    assert "There is no file" in message_of("nothing.gltf")
    assert "is a folder" in message_of(str(tmp_path))
    (tmp_path / "scene.obj").write_text("v 0 0 0\n")
    assert "is not a scene that luxel reads" in message_of(tmp_path / "scene.obj")
    for suffix in (".glb", ".gltf", ".xml"):
        (tmp_path / f"empty{suffix}").write_bytes(b"")
        assert "is empty" in message_of(tmp_path / f"empty{suffix}")
    assert "has no dials" in message_of(tmp_path / "empty.glb", wall=1.0)


def test_what_gives_light_of_its_own() -> None:
    dark = SceneData("dark", [Object("box", [box((0, 0, 0), (1, 1, 1), 0)])], [Material()])
    assert not has_own_light(dark) and not has_glow(dark)
    add_default_light(dark)
    assert dark.sky.color == (0.7, 0.85, 1.0)
    assert dark.lights[0].direction == (0.2, -1.0, 0.15) and dark.lights[0].color == (10.0, 9.3, 8.2)
    assert len(dark.warnings) == 1 and "default sky and sun" in dark.warnings[0]
    objects, night = dark.objects, np.zeros((2, 4, 3), np.float32)
    assert has_own_light(SceneData("sky", objects, [Material()], sky=Sky((0.1, 0.1, 0.1))))
    assert not has_own_light(SceneData("night", objects, [Material()], sky=Sky((1.0, 1.0, 1.0), image=night)))
    assert has_own_light(SceneData("light", objects, [Material()], lights=[Light("point", (1.0, 1.0, 1.0))]))
    glowing = SceneData("lamp", objects, [Material(emission=(0.0, 1.0, 0.0))])
    assert has_glow(glowing) and not has_own_light(glowing)
    assert not has_glow(SceneData("unused", objects, [Material(), Material(emission=(9.0, 9.0, 9.0))]))


def test_listing_scenes_loads_nothing_heavy() -> None:
    code = (
        "import sys; from luxel.scene import list_scenes; assert list_scenes(); "
        "print([name for name in ('mitsuba', 'drjit', 'scipy', 'matplotlib') if name in sys.modules])"
    )
    source = Path(luxel.__file__).parents[1] if luxel.__file__ else Path(__file__).parents[2] / "src"
    environment = {**os.environ, "PYTHONPATH": str(source)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, timeout=60)
    assert done.stdout.strip() == "[]", done.stderr


def test_a_large_scene_says_what_memory_it_takes() -> None:
    """Instances share a mesh: 10 million triangles of 220 bytes are 2.2 GB, 9 million are below the limit."""
    faces = np.zeros((100_000, 3), np.uint32)
    mesh = Mesh(np.zeros((3, 3), np.float32), faces)
    for count, warned in ((90, False), (100, True)):
        data = SceneData("forest", [Object(f"tree-{i}", [mesh]) for i in range(count)], [Material()])
        scene_package._warn_of_size(data)
        assert any("10.0 million triangles take about 2.2 GB" in text for text in data.warnings) == warned
