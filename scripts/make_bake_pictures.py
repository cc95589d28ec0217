"""Make the pictures of baked scenes for the docs: .glb files that three.js shows in a headless browser.

    python scripts/make_bake_pictures.py [NAME ...] [--out docs/pictures]

Needs the extras `view` and `dev` and a Chromium. Real scenes are looked for in the folder LUXEL_TEST_SCENES (default
`../shared/scenes`). The page is viser's, which knows nothing of luxel and develops what it shows by a film curve.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import viser
from PIL import Image
from sheets import PICTURES, REPOSITORY, open_browser, open_shot, write_row

import luxel
from luxel.bake.files import relight, transport_of, write_bake
from luxel.scene.edit import apply_sun
from luxel.scene.model import Camera

SCENES = Path(os.environ.get("LUXEL_TEST_SCENES") or REPOSITORY.parent / "shared" / "scenes")
SETTINGS = {"texel_target": 60000, "rays_per_texel": 256}
REAL = (
    ("bathroom/scene.xml", Camera((0.007, 0.912, -0.228), (-0.745, 0.85, -0.887), fov=85.0), 0.6),
    ("sponza-crytek/Sponza.gltf", Camera((-9.5, 1.8, 0.0), (0.0, 3.3, -0.3), fov=85.0), 9.0),
)
"""Scene, camera, exposure."""
PICTURE_ALONE = "* { visibility: hidden !important } canvas { visibility: visible !important }"
WAIT_MS, TRIES = 1000, 120
"""Between two looks at the page, and how many there are at most."""


def shoot(glb: Path, camera: Camera, size: tuple[int, int]) -> Image.Image:
    """Return what the browser shows of a .glb from `camera`, once it is at rest."""
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    server.scene.set_up_direction("+y")
    server.scene.add_glb("/baked", glb.read_bytes())
    server.initial_camera.position, server.initial_camera.look_at = camera.eye, camera.target
    # The page takes the angle of the height.
    server.initial_camera.fov = float(2.0 * np.arctan(np.tan(np.radians(camera.fov) / 2.0) * size[1] / size[0]))
    try:
        with open_browser() as browser:
            page = browser.new_page(viewport={"width": size[0], "height": size[1]})
            page.goto(f"http://127.0.0.1:{server.get_port()}")
            page.add_style_tag(content=PICTURE_ALONE)
            before = np.zeros(0)
            for _ in range(TRIES):
                page.wait_for_timeout(WAIT_MS)
                shot = open_shot(page.screenshot())
                now = np.asarray(shot, np.float64)
                if now.std() > 5.0 and now.shape == before.shape and np.abs(now - before).max() < 1.0:
                    return shot
                before = now
            raise SystemExit(f"{glb.name}: the browser showed nothing at rest")
    finally:
        server.stop()


def bake(folder: Path) -> Iterator[tuple[str, list[Image.Image]]]:
    """The Cornell box, the atrium, and the atrium under another sun."""
    box, atrium, size = luxel.load("cornell-box"), luxel.load("atrium"), (390, 320)
    write_bake(luxel.bake_scene(box, "lightmap", {"texel_target": 20000}), folder / "box.glb")
    write_bake(luxel.bake_scene(atrium, "lightmap", dict(SETTINGS)), folder / "atrium.glb")
    afternoon = apply_sun(luxel.load("atrium"), "100,50,20")
    write_bake(relight(transport_of(folder / "atrium.glb"), afternoon), folder / "afternoon.glb")
    cameras = {"box": box.cameras[0], "atrium": atrium.cameras[0], "afternoon": atrium.cameras[0]}
    yield "bake", [shoot(folder / f"{name}.glb", camera, size) for name, camera in cameras.items()]


def bake_real(folder: Path) -> Iterator[tuple[str, list[Image.Image]]]:
    """The bathroom and Crytek Sponza, exposed for what lies in the shade."""
    pictures = []
    for name, camera, exposure in REAL:
        data = luxel.load(str(SCENES / name))
        write_bake(luxel.bake_scene(data, "lightmap", dict(SETTINGS)), folder / "real.glb", exposure=exposure)
        pictures.append(shoot(folder / "real.glb", camera, (590, 400)))
    yield "bake-real", pictures


MAKERS = {"bake": bake, "bake-real": bake_real}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", default=[], help=f"of {', '.join(MAKERS)}; default: all")
    parser.add_argument("--out", type=Path, default=PICTURES)
    options = parser.parse_args()
    for name in options.names or MAKERS:
        with tempfile.TemporaryDirectory() as folder:
            for stem, pictures in MAKERS[name](Path(folder)):
                write_row(options.out / f"{stem}.jpg", pictures)


if __name__ == "__main__":
    main()
