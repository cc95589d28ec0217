"""What Mitsuba warns of while it reads a file is said once, by luxel, with the file's name, and never on stdout."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mitsuba as mi
import pytest

from luxel.cli import main
from luxel.errors import LuxelError
from luxel.scene import load

SENSOR = (
    '<sensor type="perspective"><transform name="to_world"><lookat origin="0,0,3" target="0,0,0" up="0,1,0"/>'
    "</transform></sensor>"
)


def write_ply(path: Path, *properties: str) -> Path:
    """Write one triangle whose vertices have more numbers than places."""
    extra = "".join(f"property float {name}\n" for name in properties)
    head = f"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n{extra}"
    numbers = " 0.5" * len(properties)
    rows = "".join(f"{place}{numbers}\n" for place in ("0 0 0", "1 0 0", "0 1 0"))
    path.write_text(f"{head}element face 1\nproperty list uchar int vertex_indices\nend_header\n{rows}3 0 1 2\n")
    return path


def write_scene(folder: Path, shapes: str) -> Path:
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0">{shapes}<emitter type="constant"/>{SENSOR}</scene>')
    return path


def ply(name: str) -> str:
    return f'<shape type="ply"><string name="filename" value="{name}"/></shape>'


def appenders() -> list[Any]:
    log: Any = mi.logger()
    return [log.appender(index) for index in range(log.appender_count())]


def test_warnings_of_meshes_are_luxels_own(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Six files with the same fault are one sentence, which names four; another fault is another one."""
    for index in range(6):
        write_ply(tmp_path / f"part {index}.ply", "quality")
    write_ply(tmp_path / "scan.ply", "confidence")
    write_ply(tmp_path / "plain.ply")
    before = appenders()
    names = [*(f"part {index}.ply" for index in range(6)), "scan.ply", "plain.ply"]
    warnings = load(write_scene(tmp_path, "".join(map(ply, names)))).warnings
    shown = capfd.readouterr()
    assert shown.out == "" and shown.err == ""
    parts, scan = sorted((text for text in warnings if "Mitsuba warns" in text), key=len, reverse=True)
    assert "'part 0.ply', 'part 1.ply', 'part 2.ply', 'part 3.ply' and 2 more" in parts and '"quality"' in parts
    assert "'scan.ply'" in scan and '"confidence"' in scan
    assert all(text.endswith(".") and "WARN" not in text and "ply.h" not in text for text in warnings)
    assert "plain.ply" not in " ".join(warnings)
    assert appenders() == before


def test_a_warning_that_says_nothing_is_told_of(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Mitsuba's message about an attribute without a channel's letter is a lone quotation mark."""
    write_ply(tmp_path / "odd.ply", "vertex_sheen")
    warnings = load(write_scene(tmp_path, ply("odd.ply"))).warnings
    assert capfd.readouterr().out == ""
    assert [text for text in warnings if "Mitsuba warns" in text]


def test_json_stays_one_object(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_ply(tmp_path / "scan.ply", "quality")
    scene = str(write_scene(tmp_path, ply("scan.ply")))
    words = ["--method", "none", "--size", "8x8", "--frames", "1", "-o", str(tmp_path / "image.png")]
    assert main(["render", scene, *words, "--json"]) == 0
    found = json.loads(capfd.readouterr().out)
    assert sum("'scan.ply'" in text for text in found["warnings"]) == 1
    assert main(["render", scene, *words]) == 0
    shown = capfd.readouterr()
    assert "WARN" not in shown.out + shown.err and shown.err.count("'scan.ply'") == 1


def test_instances_are_read_twice_and_warned_of_once(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_ply(tmp_path / "scan.ply", "quality")
    group = f'<shape type="shapegroup" id="group">{ply("scan.ply")}</shape>'
    placed = '<shape type="instance"><ref id="group"/></shape>'
    data = load(write_scene(tmp_path, group + placed))
    assert sum("'scan.ply'" in text for text in data.warnings) == 1
    assert data.mitsuba_full is not None and data.mitsuba_full() is not None
    assert capfd.readouterr().out == ""


def test_the_log_is_as_before_after_a_file_that_fails(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_ply(tmp_path / "scan.ply", "quality")
    before = appenders()
    with pytest.raises(LuxelError, match="gone.ply"):
        load(write_scene(tmp_path, ply("scan.ply") + ply("gone.ply")))
    assert appenders() == before and capfd.readouterr().out == ""
