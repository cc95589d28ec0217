"""Make the committed truths of `benchmarks/references`; a GPU does it in minutes.

python benchmarks/make_references.py [--spp 32768] [--out benchmarks/references] [--sponza FILE] [NAME ...]
"""

from __future__ import annotations

import argparse
from datetime import date
from pathlib import Path

import drjit as dr
import mitsuba as mi

from luxel import runtime
from luxel.render.references import reference_key, write_reference
from luxel.render.truth import render_truth
from luxel.scene import load
from luxel.scene.device import upload
from luxel.scene.edit import default_camera, parse_camera

SPONZA_CAMERA = "-9,2,0;5,2.5,0;65"


def main() -> None:
    """Render each named view and write it with what it took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--spp", type=int, default=32768)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/references"))
    parser.add_argument("--sponza", type=Path, help="Crytek Sponza as glTF")
    parser.add_argument("names", nargs="*", default=["cornell-box", "two-rooms", "atrium"])
    options = parser.parse_args()
    device = runtime.start()
    options.out.mkdir(parents=True, exist_ok=True)
    views = [(name, name, None, (256, 256)) for name in options.names]
    if options.sponza:
        views.append(("sponza", str(options.sponza), SPONZA_CAMERA, (480, 270)))
    for name, source, view, size in views:
        data = load(source)
        camera = parse_camera(view, data) if view else default_camera(data)
        scene = upload(data)
        truth = render_truth(scene, camera=camera, size=size, spp=options.spp, cache=False)
        key = reference_key(scene, camera, size, 0.0)
        about = {
            "scene": name,
            "spp": truth.spp,
            "size": list(size),
            "seed": 0,
            "device": device.name,
            "mitsuba": mi.__version__,
            "drjit": dr.__version__,
            "date": date.today().isoformat(),
            "seconds": round(truth.seconds, 1),
        }
        write_reference(options.out / f"{name}-{key}.exr", key, truth.layers, truth.halves, about)
        print(f"{name}: {truth.spp} paths a pixel in {truth.seconds:.1f} s")


if __name__ == "__main__":
    main()
