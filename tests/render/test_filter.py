"""Edges of pictures, smoothed by a pixel filter over the frames of a still view, against Mitsuba's own filters."""

from __future__ import annotations

import json
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel.cli import main
from luxel.errors import LuxelError
from luxel.render.renderer import Renderer
from luxel.render.shared import Cache
from luxel.scene import load
from luxel.scene.device import upload
from luxel.scene.model import SceneData
from luxel.viewer.display import DisplayEncoder
from luxel.viewer.interleaved import DisplaySettings, InterleavedView

SIZE = (48, 36)
FRAMES = 64
WHITE = '<bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.6, 0.6"/></bsdf>'
CARD = """<shape type="rectangle"><transform name="to_world"><scale x="1.1" y="0.8"/><rotate z="1" angle="17"/>
  </transform>{inside}</shape>"""
GLOWING = CARD.format(inside='<emitter type="area"><rgb name="radiance" value="1, 1, 1"/></emitter>')
LIGHTS = """<emitter type="point"><point name="position" x="0.3" y="0.4" z="3"/>
  <rgb name="intensity" value="30, 30, 30"/></emitter>
  <emitter type="constant"><rgb name="radiance" value="0.2, 0.2, 0.2"/></emitter>"""
LIT = CARD.format(inside=WHITE) + LIGHTS


def write_scene(folder: Path, body: str, kind: str = "box") -> Path:
    path = folder / f"{kind}.xml"
    path.write_text(
        f"""<scene version="3.0.0"><integrator type="path"/><sensor type="perspective"><float name="fov" value="50"/>
        <transform name="to_world"><lookat origin="0.1, 0.05, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="{SIZE[0]}"/><integer name="height" value="{SIZE[1]}"/>
        <boolean name="sample_border" value="true"/><rfilter type="{kind}"/></film></sensor>{body}</scene>"""
    )
    return path


def render_mitsuba(path: Path, spp: int = 4096) -> np.ndarray:
    scene: Any = mi.load_file(str(path))
    return np.array(mi.render(scene, spp=spp), float)[..., :3]


def edge_error(image: np.ndarray, reference: np.ndarray) -> float:
    """Return the mean error of the pixels that an edge of the card runs through, in steps over that edge."""
    coverage = render_coverage(reference.shape[0])
    edge = (coverage > 0.02) & (coverage < 0.98)
    step = np.median(reference[coverage > 0.98]) - np.median(reference[coverage < 0.02])
    assert 50 < edge.sum() / 3 < 400 and step > 0.1
    return float(np.abs(image - reference)[edge].mean() / step)


@cache
def render_coverage(height: int) -> np.ndarray:
    """Return how much of each pixel the card covers."""
    with tempfile.TemporaryDirectory() as folder:
        return render_mitsuba(write_scene(Path(folder), GLOWING))


def run(data: SceneData, method: str = "none", frames: int = FRAMES, **more: Any) -> Renderer:
    renderer = Renderer(data, method, size=SIZE, **more)
    renderer.run(frames)
    return renderer


@pytest.mark.parametrize("kind", ["box", "gaussian"])
def test_edges_are_those_of_mitsubas_filter(kind: str, tmp_path: Path) -> None:
    path = write_scene(tmp_path, GLOWING, kind)
    reference, data = render_mitsuba(path), load(path)
    renderer = run(data, filter=kind)
    assert edge_error(renderer.image(), reference) < 0.02
    # Through the centres an edge is a step, and the filters are told apart.
    assert edge_error(run(data).image(), reference) > 0.1
    assert edge_error(run(data, filter="gaussian" if kind == "box" else "box").image(), reference) > 0.03


@pytest.mark.parametrize("method", ["path", "gibs"])
def test_the_mean_is_that_of_the_light_and_not_of_its_layers(method: str, tmp_path: Path) -> None:
    """At an edge albedo and irradiance change together: their product's mean is not the product of their means."""
    path = write_scene(tmp_path, LIT)
    image, reference = run(load(path), method, filter="box").image(), render_mitsuba(path, 8192)
    inside = render_coverage(SIZE[1]) > 0.98
    assert image[inside].mean() == pytest.approx(reference[inside].mean(), rel=0.02)
    assert edge_error(image, reference) < 0.03


def test_all_frames_of_a_progressive_method_count_the_same() -> None:
    """Else a path-traced picture would be as noisy as one of fewer than half as many frames."""
    data, noise = load("cornell-box"), {}
    for kind in ("box", "none"):
        first, second = (run(data, "path", filter=kind, seed=seed).image() for seed in (1, 2))
        noise[kind] = np.median(np.abs(first - second))
    assert 0.0 < noise["box"] < 1.2 * noise["none"]


def test_a_view_that_moves_is_seen_through_the_centres(tmp_path: Path) -> None:
    data = load(write_scene(tmp_path, GLOWING))
    plain, filtered = (run(data, frames=1, filter=kind) for kind in ("none", "box"))
    np.testing.assert_array_equal(filtered.image(), plain.image())
    filtered.run(20)
    assert not np.array_equal(filtered.image(), plain.image())
    filtered.set_light_scale(0.5)
    filtered.step()
    np.testing.assert_allclose(filtered.image(), 0.5 * plain.image(), rtol=1e-6)


@pytest.mark.parametrize("method", ["path", "gibs", "ddgi"])
def test_nothing_is_recorded_anew(method: str) -> None:
    renderer = run(load("cornell-box"), method, frames=8, filter="box")
    before = renderer.compilations
    renderer.run(24)
    assert renderer.compilations == before <= 2
    assert np.isfinite(renderer.image()).all()


def test_one_camera_of_many_passes_smooths_alike(tmp_path: Path) -> None:
    """The viewer's picture is laid together from films of every second pixel; a pixel stays one of the picture's."""
    path = write_scene(tmp_path, GLOWING)
    data = load(path)
    cache = Cache(upload(data, recentre=True), "none", None)
    view = InterleavedView(cache, SIZE, SIZE[0] / SIZE[1], 2, "box")
    encoder = DisplayEncoder()
    for _ in range(4 * FRAMES):
        view.rest(data.cameras[0], encoder, DisplaySettings(), False)
    assert edge_error(view.layers().image(), render_mitsuba(path)) < 0.02


def test_figures_belong_to_the_centres(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("LUXEL_CACHE", str(tmp_path / "cache"))
    path = write_scene(tmp_path, LIT)
    images, errors = {}, {}
    for kind in ("none", "box"):
        place = tmp_path / f"{kind}.exr"
        words = ["render", str(path), "--method", "path", "--size", "48x36", "--frames", "16", "--truth", "16"]
        assert main([*words, "--filter", kind, "-o", str(place), "--json"]) == 0
        errors[kind] = json.loads(capsys.readouterr().out)["error"]
        images[kind] = np.array(mi.Bitmap(str(place)))
    assert errors["none"] == errors["box"]
    reference = render_mitsuba(path)
    assert edge_error(images["box"], reference) < 0.05 < edge_error(images["none"], reference)


@pytest.mark.parametrize("words", [["render", "furnace"], ["view", "furnace"]])
def test_an_unknown_filter_is_one_sentence(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*words, "--filter", "sinc"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "'sinc'" in line and "box, gaussian or none" in line
    with pytest.raises(LuxelError, match="sinc"):
        Renderer("furnace", "none", size=(8, 8), filter="sinc")
