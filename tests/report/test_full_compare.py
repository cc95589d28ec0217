"""`compare --materials full` beside Mitsuba: its truth, and who comes near."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel.metrics.error import image_errors
from luxel.render.oracle import render_full
from luxel.report import compare
from luxel.report.jobs import MethodSetup
from luxel.scene import load

SIZE = (32, 32)
CHROME = """<scene version="3.0.0"><integrator type="path"/>
  <sensor type="perspective"><float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0, 1.4, 4" target="0, 0.9, 0" up="0, 1, 0"/></transform></sensor>
  <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/><scale value="6"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.35, 0.2"/></bsdf></shape>
  <shape type="sphere"><point name="center" x="0" y="1" z="0"/><bsdf type="conductor"/></shape>
  <emitter type="constant"><rgb name="radiance" value="0.5, 0.6, 0.7"/></emitter></scene>"""


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory, short_rest: None) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("chrome")
    (folder / "chrome.xml").write_text(CHROME)
    few = MethodSetup("gibs", "gibs", None, {"surfel_target": "500"})
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LUXEL_CACHE", str(folder / "cache"))
        results = compare(
            [folder / "chrome.xml"], ["path", few], materials="full", reference_spp=128, size=SIZE, frames=48,
            out=folder / "out",
        )  # fmt: skip
    (scene,) = results["scenes"].values()
    return folder, scene


def test_the_truth_and_path_come_near_mitsuba(compared: tuple[Path, dict[str, Any]]) -> None:
    folder, scene = compared
    data = load(folder / "chrome.xml")
    wanted = render_full(data, data.cameras[0], size=SIZE, spp=256)

    def read(name: str) -> np.ndarray:
        return np.array(mi.Bitmap(str(folder / "out" / scene["folder"] / f"{name}.exr")))[..., :3]

    def flip(name: str) -> float:
        return image_errors(read(name), wanted, np.ones(SIZE, bool))["flip"]

    assert read("truth").mean() == pytest.approx(wanted.mean(), rel=0.01)
    assert flip("truth") < 0.03 and flip("path") < 0.04
    assert flip("gibs") > 0.1, "its ball is black"
    assert flip("path_at_gibs") < 0.04, "the equal-time peer shows the chrome, too"


def test_displayed_images_are_judged_and_results_say_who_shows_what(compared: tuple[Path, dict[str, Any]]) -> None:
    folder, scene = compared
    assert scene["reference"]["kind"] == "full" and scene["reference"]["spp"] == 128
    methods = scene["methods"]
    shown = {name: one["materials"] for name, one in methods.items()}
    assert shown == {"none": "diffuse", "ambient": "diffuse", "path": "full", "gibs": "diffuse"}
    assert methods["path"]["flip"] < 0.04 and methods["gibs"]["flip"] > 0.1
    # The paths' own noise at 48 frames against the truth's at 128: less, and the same for all that it judges.
    (noise,) = {one["truth_noise"] for one in [*methods.values(), *scene["peers"]]}
    assert 0.0 < noise < methods["path"]["flip"] and "its noise" in (folder / "out" / "report.html").read_text()
    assert all(one["regional"] is None for one in [*methods.values(), *scene["peers"]])
    assert "path shows all of it" in (folder / "out" / "report.html").read_text()
