"""A bake opened by a program that knows nothing of luxel: three.js, in a browser, shows the texels' light.

The page is viser's, which reads a .glb with three.js as it is. It develops what it shows by a film curve (ACES, as
React Three Fiber does unless told otherwise), unlit surfaces too, so the expected colours go through the same curve.
"""

from __future__ import annotations

import contextlib
import io
import json
import struct
import time as clock
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import viser
from PIL import Image

from luxel.bake.core import Baked, bake_scene
from luxel.bake.files import write_bake
from luxel.bake.layout import Layout
from luxel.image.tonemap import to_display
from luxel.kernels.trace import trace_closest
from luxel.methods.lightmap.flatten.origins import is_back
from luxel.scene import load

from .conftest import SMALL, leaf

WINDOW = {"width": 640, "height": 420}
PICTURE_ALONE = "* { visibility: hidden !important } canvas { visibility: visible !important }"
"""Style that leaves the page's panels and notices out."""
STEP = 5
"""Pixels between those that are compared."""
ATRIUM = {"texel_target": 6000, "surfel_target": 512, "rays_per_texel": 32, "probe_target": 8}


@dataclass
class Eye:
    """Where the browser's camera stands."""

    p: np.ndarray
    turn: np.ndarray
    """(3, 3) columns: right, down, forward."""
    fov: float
    """Radians, of the height."""


@dataclass
class Seen:
    """Points of the surfaces behind some pixels."""

    x: np.ndarray
    y: np.ndarray
    uv: np.ndarray
    """(n, 2) place in the atlas, texels."""
    beyond: np.ndarray
    """(m, 2) x and y of the pixels that no surface is behind."""


@pytest.fixture
def server() -> Iterator[Any]:
    with contextlib.redirect_stdout(io.StringIO()):
        serving = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    serving.gui.configure_theme(show_logo=False, show_share_button=False)
    serving.scene.set_up_direction("+y")
    yield serving
    with contextlib.redirect_stdout(io.StringIO()):
        serving.stop()


def bake_atrium() -> Baked:
    return bake_scene(load("atrium"), "lightmap", dict(ATRIUM), frames=8, samples=2)


def bake_leaf() -> Baked:
    return bake_scene(leaf(), "lightmap", dict(SMALL), frames=4, samples=2)


@pytest.mark.parametrize("name", ["cornell-box", "atrium", "leaf"])
def test_a_browser_shows_the_texels(
    name: str, request: pytest.FixtureRequest, chromium: Any, server: Any, tmp_path: Path
) -> None:
    makers = {"cornell-box": lambda: request.getfixturevalue("cornell"), "atrium": bake_atrium, "leaf": bake_leaf}
    baked: Baked = makers[name]()
    written = write_bake(baked, tmp_path / "baked.glb")
    camera = baked.data.cameras[0]
    server.scene.add_glb("/baked", (tmp_path / "baked.glb").read_bytes())
    server.initial_camera.position, server.initial_camera.look_at = camera.eye, camera.target
    server.initial_camera.fov = np.radians(camera.fov)
    picture, eye = look(chromium, server)

    sheet = np.array(mi.Bitmap(written["exr"]).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32))
    exposure = read_header(tmp_path / "baked.glb")["asset"]["extras"]["exposure"]
    seen = find_points(baked, eye)
    want = 255.0 * to_display(develop(look_up(sheet, seen.uv, exposure))[None])[0]
    shown = picture[seen.y, seen.x]
    smooth = roughness(picture)[seen.y, seen.x] < 6.0
    assert smooth.sum() > 300, "there is something to compare"
    assert want[smooth].std(axis=0).min() > 10.0, "the picture is not one colour"
    difference = np.abs(shown - want)[smooth].max(axis=1)
    assert np.median(difference) < 1.5
    assert np.quantile(difference, 0.95) < 3.0
    # Past the surfaces, and through their holes, stands the page's own white.
    column, row = seen.beyond.T
    assert (picture[row, column][roughness(picture)[row, column] < 6.0] > 250.0).all()


def look(chromium: Any, server: Any) -> tuple[np.ndarray, Eye]:
    """Return what the browser shows of the scene, (h, w, 3), and from where."""
    context = chromium.new_context(viewport=WINDOW)
    try:
        tab = context.new_page()
        tab.goto(f"http://127.0.0.1:{server.get_port()}")
        tab.add_style_tag(content=PICTURE_ALONE)
        before, end = None, clock.perf_counter() + 60.0
        while clock.perf_counter() < end:
            tab.wait_for_timeout(500)
            picture = np.asarray(Image.open(io.BytesIO(tab.screenshot())).convert("RGB"), np.float64)
            # Loaded, and at rest.
            if before is not None and picture.std() > 10.0 and np.abs(picture - before).max() < 1.0:
                (client,) = server.get_clients().values()
                box = tab.locator("canvas").first.bounding_box()
                assert (box["x"], box["y"]) == (0.0, 0.0)
                assert (box["width"], box["height"]) == (WINDOW["width"], WINDOW["height"])
                camera = client.camera
                return picture, Eye(np.array(camera.position), turn_of(np.array(camera.wxyz)), float(camera.fov))
            before = picture
        pytest.fail("the browser showed nothing within 60 s")
    finally:
        context.close()


def turn_of(wxyz: np.ndarray) -> np.ndarray:
    """Return the rotation of a unit quaternion."""
    w, x, y, z = wxyz
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def find_points(baked: Baked, eye: Eye) -> Seen:
    """Return the baked surfaces behind every few pixels of the window."""
    across, along = (np.arange(2, WINDOW[side] - 2, STEP) for side in ("width", "height"))
    x, y = (grid.ravel() for grid in np.meshgrid(across, along))
    half = np.tan(0.5 * eye.fov)
    right = (2.0 * (x + 0.5) / WINDOW["width"] - 1.0) * half * WINDOW["width"] / WINDOW["height"]
    down = (2.0 * (y + 0.5) / WINDOW["height"] - 1.0) * half
    way = np.stack([right, down, np.ones(len(x))]).T @ eye.turn.T
    direction = mi.Vector3f(np.ascontiguousarray((way / np.linalg.norm(way, axis=1, keepdims=True)).T, np.float32))
    hit = trace_closest(baked.scene, mi.Point3f(*map(float, eye.p)), direction, mi.Bool(True))
    back = np.array(is_back(baked.scene, hit, direction)).astype(bool)
    face = face_of(baked.layout, np.array(hit.prim_id).astype(np.int64), back, np.array(hit.valid).astype(bool))
    u, v = np.array(hit.barycentric)
    corner = np.stack([1.0 - u - v, u, v], axis=1)[face >= 0]
    uv = np.einsum("ni,nij->nj", corner, baked.layout.uv[face[face >= 0]])
    miss = ~np.array(hit.valid).astype(bool)
    return Seen(x[face >= 0], y[face >= 0], uv, np.column_stack([x, y])[miss])


def face_of(layout: Layout, prim: np.ndarray, back: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Return the face (n,) on each hit's side; -1: the atlas holds none."""
    table = np.full(2 * (int(max(layout.prim.max(), prim[valid].max())) + 1), -1)
    held = np.flatnonzero(layout.chart >= 0)
    table[2 * layout.prim[held] + layout.back[held]] = held
    return np.where(valid, table[np.where(valid, 2 * prim + back, 0)], -1)


def look_up(sheet: np.ndarray, uv: np.ndarray, exposure: float) -> np.ndarray:
    """Return the EXR's light (n, 3) at places in the atlas, exposed and clipped, then filtered bilinearly."""
    light = np.clip(sheet * exposure, 0.0, 1.0)
    base = np.clip(np.floor(uv).astype(int), 0, np.array(sheet.shape[1::-1]) - 2)
    part = np.clip(uv - base, 0.0, 1.0)
    found = np.zeros((len(uv), 3))
    for i in (0, 1):
        for j in (0, 1):
            weight = (part[:, 0] if i else 1 - part[:, 0]) * (part[:, 1] if j else 1 - part[:, 1])
            found += weight[:, None] * light[base[:, 1] + j, base[:, 0] + i]
    return found


def develop(light: np.ndarray) -> np.ndarray:
    """Return linear light (n, 3) after the film curve: Stephen Hill's fit of ACES, as three.js scales it."""
    to_film = np.array([[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]])
    back = np.array([[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]])
    film = (light / 0.6) @ to_film.T
    curve = (film * (film + 0.0245786) - 0.000090537) / (film * (0.983729 * film + 0.4329510) + 0.238081)
    return np.clip(curve @ back.T, 0.0, 1.0)


def roughness(picture: np.ndarray) -> np.ndarray:
    """Return the largest difference (h, w) of a pixel from those around it: edges, where half a pixel counts."""
    around = [np.abs(np.roll(picture, (j, i), (0, 1)) - picture).max(axis=2) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    return np.max(around, axis=0)


def read_header(path: Path) -> dict[str, Any]:
    """Return the JSON part of a .glb."""
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length])
