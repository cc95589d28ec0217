"""Make the committed truth of flights: sums over blocks in `benchmarks/references/motion`. A GPU is for it.

    python benchmarks/make_motion_references.py [--size 640x360] [--spp 512] two-rooms atrium
    python benchmarks/make_motion_references.py --name sponza --flight-path="-9,2,0;3,2.5,0;5,2.5,0;13,3,-3;65" FILE

`luxel compare SCENE --motion` of that size, path and number of frames finds it on a CPU, in place of an hour of work.
"""

from __future__ import annotations

import argparse
from datetime import date
from pathlib import Path

import drjit as dr
import mitsuba as mi

from luxel import runtime
from luxel.errors import LuxelError
from luxel.render.loading import load
from luxel.render.motion_path import MOTION_FRAMES, find_motion
from luxel.render.motion_truth import MOTION_SPP, motion_key, render_motion_truth, write_sums
from luxel.scene.device import upload


def main() -> None:
    """Render each flight's judged frames and write their sums."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--name", help="what the file of a single scene is called; else the scene's name")
    parser.add_argument("--flight-path", metavar="EYE;EYE;TARGET;TARGET[;FOV]")
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--frames", type=int, default=MOTION_FRAMES)
    parser.add_argument("--spp", type=int, default=MOTION_SPP)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/references/motion"))
    options = parser.parse_args()
    runtime.start()
    try:
        for name in options.scenes:
            print(make(name, options))
    except LuxelError as error:
        raise SystemExit(f"make_motion_references: {error}") from None


def make(name: str, options: argparse.Namespace) -> Path:
    """Write the sums of one scene's flight; return their file."""
    width, height = (int(part) for part in options.size.split("x"))
    scene = upload(load(name))
    flight = find_motion(scene, options.frames, options.flight_path)
    key = motion_key(scene, flight, (width, height))
    truth = render_motion_truth(scene, flight, (width, height), options.spp)
    called = options.name or scene.host.data.name.lower().partition(":")[0]
    path = options.out / f"{called}-{key}.npz"
    about = {
        "scene": name if options.name is None else options.name,
        "size": [width, height],
        "path": options.flight_path,
        "flown": options.frames,
        "mitsuba": mi.__version__,
        "drjit": dr.__version__,
        "date": date.today().isoformat(),
    }
    write_sums(path, truth, about)
    return path


if __name__ == "__main__":
    main()
