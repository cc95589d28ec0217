"""Make the committed truths of `benchmarks/references`; a GPU does it in minutes.

python benchmarks/make_references.py [--spp 32768] [--out benchmarks/references] [--sponza FILE] [NAME ...]

With `--rename` nothing is rendered: the files of these views get the names that they are found by now. That is for a
change of how keys are made, or of a loader that makes the same picture of a file; never for a scene that looks
different. A new truth of few paths is compared with each file first, and one that does not fit stays as it is.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel import runtime
from luxel.render.references import block_means, read_reference, reference_key, write_reference
from luxel.render.truth import render_truth
from luxel.scene import load
from luxel.scene.device import Scene, upload
from luxel.scene.edit import default_camera, parse_camera
from luxel.scene.model import Camera

SPONZA_CAMERA = "-9,2,0;5,2.5,0;65"
CHECK_SPP = 64
FITS = 0.03
"""Relative difference of the block means of all light, as an RMSE, up to which a truth of `CHECK_SPP` paths fits:
their noise is 1 %."""


@dataclass
class _View:
    name: str
    scene: Scene
    camera: Camera
    size: tuple[int, int]

    @property
    def key(self) -> str:
        """What its file is found by."""
        return reference_key(self.scene, self.camera, self.size, 0.0)


def main() -> None:
    """Render each named view and write it with what it took, or rename its file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spp", type=int, default=32768)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/references"))
    parser.add_argument("--sponza", type=Path, help="Crytek Sponza as glTF")
    parser.add_argument(
        "--rename", action="store_true", help="render nothing; give files of unchanged scenes their key"
    )
    parser.add_argument("names", nargs="*", default=["cornell-box", "two-rooms", "atrium"])
    options = parser.parse_args()
    device = runtime.start()
    options.out.mkdir(parents=True, exist_ok=True)
    for view in _views(options.names, options.sponza):
        if options.rename:
            _rename(view, options.out)
            continue
        truth = render_truth(view.scene, camera=view.camera, size=view.size, spp=options.spp, cache=False)
        about = {
            "scene": view.name,
            "spp": truth.spp,
            "size": list(view.size),
            "seed": 0,
            "device": device.name,
            "mitsuba": mi.__version__,
            "drjit": dr.__version__,
            "date": date.today().isoformat(),
            "seconds": round(truth.seconds, 1),
        }
        write_reference(options.out / f"{view.name}-{view.key}.exr", truth.layers, truth.halves, about)
        print(f"{view.name}: {truth.spp} paths a pixel in {truth.seconds:.1f} s")


def _views(names: list[str], sponza: Path | None) -> Iterator[_View]:
    for name in names:
        data = load(name)
        yield _View(name, upload(data), default_camera(data), (256, 256))
    if sponza is not None:
        data = load(sponza)
        yield _View("sponza", upload(data), parse_camera(SPONZA_CAMERA, data), (480, 270))


def _rename(view: _View, folder: Path) -> None:
    """Give the file of `view` the name that it is found by, if it still shows what the scene looks like."""
    for path in sorted(folder.glob(f"{view.name}-*.exr")):
        wanted = path.with_name(f"{view.name}-{view.key}.exr")
        found = read_reference(path)
        if found is None or found[3]["size"] != list(view.size) or path == wanted:
            continue
        truth = render_truth(view.scene, camera=view.camera, size=view.size, spp=CHECK_SPP, cache=False)
        albedo = truth.layers.albedo
        kept, now = (block_means(a + b, albedo) for a, b in (found[:2], (truth.layers.direct, truth.layers.indirect)))
        difference = float(np.sqrt(np.mean((kept - now) ** 2)) / kept.mean())
        if difference > FITS:
            print(f"{path}: stays, as it differs from the scene by {difference:.1%}; make it anew")
            continue
        os.rename(path, wanted)
        print(f"{path} -> {wanted.name} (differs by {difference:.2%}, noise of {CHECK_SPP} paths included)")


if __name__ == "__main__":
    main()
