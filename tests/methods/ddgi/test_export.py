"""Files of probes: what was written is what the state holds, and NumPy alone answers as luxel does."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.methods.ddgi import reader
from luxel.methods.ddgi.export import MOMENTS, PLANES, make_header, read_probes, write_atlases
from luxel.methods.ddgi.state import STATE_NAMES
from luxel.methods.persistence import load_state
from luxel.metrics.leak import box_points
from luxel.render.renderer import Renderer

SMALL = {"probe_target": 300, "extra_probes": 8, "num_samples_per_probe": 32}
TURNED = "0,0,0 size 1,1,1 probes 4,4,4 turn 30;0,0,0 size 3.1,3.2,3.3 probes 6,5,7"


def make(frames: int = 30, method: str = "ddgi", **params: Any) -> Renderer:
    settings = {**SMALL, **params} if method == "ddgi" else params
    renderer = Renderer("cornell-box", method, settings, size=(48, 48), seed=1)
    renderer.run(frames)
    return renderer


@pytest.fixture(scope="module")
def cornell() -> Renderer:
    return make()


@pytest.fixture(scope="module")
def saved(cornell: Renderer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("saved") / "probes.npz"
    cornell.method.save(cornell.state, path)
    return path


def points_on_walls() -> tuple[np.ndarray, np.ndarray]:
    points, normals = box_points(np.array([-1.0, -1.0, -1.0]), np.array([1.0, 1.0, 1.0]), 6)
    on_walls = normals[:, 2] > -0.5  # the front is open
    return points[on_walls], normals[on_walls]


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """Return the channels of an EXR file by their names."""
    bitmap = mi.Bitmap(str(path))
    return {field.name: np.array(bitmap)[..., index] for index, field in enumerate(bitmap.struct_())}


# ------------------------------------------------------------------------------------------------ header


def test_the_header_places_every_probe() -> None:
    state = make(3, boxes=TURNED, offset_dead_probes=False).state
    header = json.loads(make_header(state))
    assert header["format"] == "luxel-ddgi" and header["version"] == 2
    assert header["states"] == {str(index): name for index, name in enumerate(STATE_NAMES)}
    assert [box["counts"] for box in header["boxes"]] == [[4, 4, 4], [6, 5, 7]]
    p = np.array(state.probes.p).T
    for box in header["boxes"]:
        nx, ny, nz = box["counts"]
        for x, y, z in ((0, 0, 0), (1, 2, 3), (nx - 1, ny - 1, nz - 1)):
            place = np.array(box["origin"]) + np.array([x, y, z]) @ [box["step_x"], box["step_y"], box["step_z"]]
            np.testing.assert_allclose(p[box["first"] + x + nx * (y + ny * z)], place, atol=1e-5)
    assert header["probes"]["total"] == 4**3 + 6 * 5 * 7 + 8


def test_the_words_on_directions_are_true() -> None:
    """The formulas of the header, written out here, undo one another and agree with the reader."""
    square = np.random.default_rng(3).uniform(-1.0, 1.0, (500, 2))
    u, v = square.T
    z = 1.0 - np.abs(u) - np.abs(v)
    f = np.maximum(-z, 0.0)
    d = np.stack([u - f * np.where(u >= 0.0, 1.0, -1.0), v - f * np.where(v >= 0.0, 1.0, -1.0), z], axis=1)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    np.testing.assert_allclose(reader.direction_to_square(d), square, atol=1e-6)


# ------------------------------------------------------------------------------------------------ pictures


@pytest.mark.parametrize("params", [{}, {"depth_model": "moments", "depth_format": "float32"}, {"boxes": TURNED}])
def test_pictures_hold_the_texels_of_the_state(params: dict[str, Any], tmp_path: Path) -> None:
    state = make(20, **params).state
    written = write_atlases(state, tmp_path / "new" / "folder")
    assert sorted(path.name for path in (tmp_path / "new" / "folder").iterdir()) == sorted(p.name for p in written)
    light, depth, text = written
    header = json.loads(text.read_text())
    channels = read_exr(light)
    picture = np.stack([channels[name] for name in "RGB"], axis=-1)
    assert np.isfinite(picture).all() and picture.min() >= 0.0 and picture.max() > 0.1
    distances = read_exr(depth)
    assert set(distances) == set(MOMENTS if params.get("depth_model") == "moments" else PLANES)
    assert distances["deviation"].min() >= 0.0
    atlas = np.array(state.depth_atlas).reshape(state.settings.total, 18, 18, -1)

    mean = np.array(state.irradiance.mean).T.reshape(state.settings.total, 8, 8, 3)
    for box in header["boxes"]:
        nx, ny, nz = box["counts"]
        for number in range(nx * ny * nz):
            column, row = number % (nx * ny), box["sheet_row"] + number // (nx * ny)
            probe = box["first"] + number
            block = picture[10 * row : 10 * row + 10, 10 * column : 10 * column + 10]
            np.testing.assert_allclose(block[1:9, 1:9], mean[probe], rtol=2e-3, atol=1e-4)
            np.testing.assert_array_equal(block[0, 0], block[8, 8])  # the gutter's corner repeats the opposite one
            for index, name in enumerate(header["depth"]["channels"]):
                block = distances[name][18 * row : 18 * row + 18, 18 * column : 18 * column + 18]
                np.testing.assert_array_equal(block, atlas[probe, ..., index])
    np.testing.assert_allclose(header["probes"]["p"], np.array(state.probes.p).T)
    np.testing.assert_array_equal(header["probes"]["status"], np.array(state.probes.status))
    held_back = header["sheet"]["held_back_row"] * 10
    assert picture.shape[0] == held_back + 10 * -(-8 // header["sheet"]["held_back_columns"])


def test_a_place_that_cannot_be_written_is_named(cornell: Renderer, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("old")
    with pytest.raises(LuxelError, match="cannot write"):
        write_atlases(cornell.state, tmp_path / "file")
    assert (tmp_path / "file").read_text() == "old"
    (tmp_path / "atlases" / "depth_atlas.exr").mkdir(parents=True)
    with pytest.raises(LuxelError, match="depth_atlas.exr"):
        write_atlases(cornell.state, tmp_path / "atlases")
    assert not [path for path in (tmp_path / "atlases").iterdir() if path.name.startswith(".")]


# ------------------------------------------------------------------------------------------------ the reader


@pytest.mark.parametrize(
    "params",
    [
        {},
        {"depth_model": "moments", "irradiance_format": "float32", "depth_format": "float32"},
        {"cascades": 2},
        {"boxes": TURNED},
        {"corrected_weights": False, "backface_offset": 0.2, "view_bias": 0.3},
    ],
)
def test_numpy_answers_as_luxel_does(params: dict[str, Any], tmp_path: Path) -> None:
    renderer = make(30, **params)
    renderer.method.save(renderer.state, tmp_path / "probes.npz")
    probes = read_probes(tmp_path / "probes.npz")
    points, normals = points_on_walls()
    wanted = renderer.irradiance_at(points, normals)
    found = probes.irradiance(points, normals)
    assert wanted.mean() > 0.1 and found.shape == wanted.shape
    # Where a cage hardly sees the point luxel asks further probes, which the reader leaves out.
    off = np.abs(found - wanted).max(axis=1) / wanted.mean()
    assert np.quantile(off, 0.95) < 1e-4
    assert off.mean() < 0.01


def test_without_visibility_it_agrees_in_the_open(saved: Path, cornell: Renderer) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform((-0.4, 0.35, -0.4), (0.4, 0.6, 0.4), (200, 3))  # above the blocks, below the ceiling
    normals = rng.normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    wanted = cornell.irradiance_at(points, normals)
    found = read_probes(saved).irradiance(points, normals, visibility=False)
    assert np.median(np.abs(found - wanted).max(axis=1)) < 1e-4 * wanted.mean()
    walls = points_on_walls()
    leaky = read_probes(saved).irradiance(*walls, visibility=False) - cornell.irradiance_at(*walls)
    assert np.abs(leaky).max() > 0.05 * wanted.mean()


def test_the_reader_needs_neither_drjit_nor_mitsuba(saved: Path, cornell: Renderer) -> None:
    program = (
        "import importlib.util, sys\n"
        "sys.modules['drjit'] = sys.modules['mitsuba'] = None\n"
        "spec = importlib.util.spec_from_file_location('reader', sys.argv[1])\n"
        "module = sys.modules['reader'] = importlib.util.module_from_spec(spec)\n"
        "spec.loader.exec_module(module)\n"
        "print(*module.read_probes(sys.argv[2]).irradiance([[0.1, 0.5, 0.0]], [[0.0, 1.0, 0.0]])[0])\n"
    )
    command = [sys.executable, "-c", program, str(reader.__file__), str(saved)]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert ran.returncode == 0, ran.stderr
    wanted = cornell.irradiance_at(np.array([[0.1, 0.5, 0.0]]), np.array([[0.0, 1.0, 0.0]]))[0]
    np.testing.assert_allclose([float(word) for word in ran.stdout.split()], wanted, rtol=1e-3)


# ------------------------------------------------------------------------------------------------ damage


def rewrite(source: Path, target: Path, **changes: object) -> None:
    """Write the arrays of `source` to `target` with some changed, or left out where the change is None."""
    with np.load(source) as file:
        arrays = {key: file[key] for key in file.files} | changes
    np.savez(target, **{key: value for key, value in arrays.items() if value is not None})  # pyright: ignore


def test_damaged_files_are_refused(saved: Path, tmp_path: Path) -> None:
    path = tmp_path / "probes.npz"
    header = json.loads(str(np.load(saved)["header"]))
    with pytest.raises(LuxelError, match="damaged"):
        read_probes(path)
    for data in (b"", b"no probes", saved.read_bytes()[:5000]):
        path.write_bytes(data)
        with pytest.raises(LuxelError, match="damaged"):
            read_probes(path)
    torn = json.dumps({**header, "probes": {**header["probes"], "total": 5}})
    for changes in ({"rows": None}, {"depth_atlas": np.zeros(7)}, {"header": "{"}, {"header": "[]"}, {"header": torn}):
        rewrite(saved, path, **changes)
        with pytest.raises(LuxelError, match="damaged"):
            read_probes(path)
    rewrite(saved, path, header=json.dumps({**header, "version": 99}))
    with pytest.raises(LuxelError, match="99"):
        read_probes(path)


def test_the_state_of_another_method_is_refused(tmp_path: Path) -> None:
    other = make(1, method="ambient")
    other.method.save(other.state, tmp_path / "other.npz")
    with pytest.raises(LuxelError, match="'ddgi'"):
        read_probes(tmp_path / "other.npz")


def test_a_state_of_an_older_layout_is_refused(saved: Path, cornell: Renderer, tmp_path: Path) -> None:
    """Files from before probes knew how certainly they are too near lack an array: one sentence says so."""
    old = tmp_path / "old.npz"
    assert load_state("ddgi", cornell.state, saved).probes.unfit.shape == cornell.state.probes.dead.shape
    rewrite(saved, old, **{"probes.unfit": None})
    with pytest.raises(LuxelError, match=r"was saved for .* \('probes\.unfit' does not fit\)"):
        load_state("ddgi", cornell.state, old)
