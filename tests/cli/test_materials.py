"""`luxel render --materials`: what of a file's materials a picture shows, by whom, and what is said of it."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel.cli.app import main

DEVICE = os.environ.get("LUXEL_TEST_DEVICE", "cpu")
SCENE = """<scene version="3.0.0">
  <sensor type="perspective"><float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0, 2, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="32"/></film></sensor>
  <emitter type="constant"><rgb name="radiance" value="1, 1, 1"/></emitter>
  <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="9"/></transform>
    <bsdf type="{}"/></shape></scene>"""
METAL, MATT = "conductor", "diffuse"


def render(folder: Path, capsys: pytest.CaptureFixture[str], bsdf: str, *words: str) -> tuple[dict[str, Any], float]:
    """Return what `--json` says, and the mean of the picture."""
    file, image = folder / "scene.xml", folder / "image.exr"
    file.write_text(SCENE.format(bsdf))
    told = ["--size", "32x32", "--frames", "4", "--device", DEVICE, "--json", "-o", str(image)]
    assert main(["render", str(file), *told, *words]) == 0
    picture = np.array(mi.Bitmap(str(image)), float)[..., :3]
    return json.loads(capsys.readouterr().out), float(picture.mean())


def test_path_shows_all_of_them_unless_told_otherwise(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A mirror that loses nothing, Mitsuba's default conductor, in a white sky is as white; its diffuse part black."""
    result, mean = render(tmp_path, capsys, METAL, "--method", "path")
    assert result["materials"] == "full" and mean == pytest.approx(1.0, abs=0.01)
    assert not result["warnings"]
    result, mean = render(tmp_path, capsys, METAL, "--method", "path", "--materials", "diffuse")
    assert result["materials"] == "diffuse" and mean < 0.1  # a strip of sky
    assert "black to diffuse light" in " ".join(result["warnings"])


def test_a_cache_lights_the_diffuse_part_and_its_error_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--method", "none", "--truth", "2")
    result, _ = render(tmp_path, capsys, METAL, *words)
    assert result["materials"] == "diffuse"
    assert "error is that of diffuse materials" in " ".join(result["warnings"])
    for bsdf, more in ((METAL, ("--materials", "diffuse")), (MATT, ())):
        result, _ = render(tmp_path, capsys, bsdf, *words, *more)
        assert "error is that of" not in " ".join(result["warnings"])


def test_what_path_shows_is_not_named_with_what_nobody_shows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Mitsuba's `hair` lets light pass straight whatever is asked for; glass under `path` does not."""
    extra = '"/></shape><shape type="sphere"><bsdf type="{}" id="{}"/></shape><shape type="sphere"><bsdf type="diffuse'
    file = tmp_path / "scene.xml"
    file.write_text(SCENE.format("diffuse" + extra.format("hair", "fur") + extra.format("dielectric", "pure")))
    words = ["--size", "8x8", "--frames", "1", "--device", DEVICE, "-o", str(tmp_path / "out.png")]
    assert main(["render", str(file), *words, "--method", "path"]) == 0
    error = capsys.readouterr().err
    assert "straight through it: fur.\n" in error and "pure" not in error
    assert main(["render", str(file), *words, "--method", "none"]) == 0
    error = capsys.readouterr().err
    assert "straight through it: fur.\n" in error and "straight through it: pure.\n" in error


def test_who_leaves_metals_black_says_who_shows_them(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = ["--size", "16x16", "--frames", "1", "--device", DEVICE, "-o", str(tmp_path / "out.png")]
    for scene, more, told in (
        ("glossy", ["--method", "none"], True),
        ("glossy", ["--method", "path"], False),
        ("glossy", ["--method", "none", "--materials", "diffuse"], False),
        ("cornell-box", ["--method", "none"], False),
    ):
        assert main(["render", scene, *words, *more]) == 0
        assert ("'--method path' shows all that they do" in capsys.readouterr().err) == told


def test_other_words_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "scene.xml"
    file.write_text(SCENE.format(METAL))
    assert main(["render", str(file), "--device", DEVICE, "--materials", "shiny"]) == 2
    assert "no materials 'shiny'" in capsys.readouterr().err
