"""How far a method is from the truth while the camera flies straight on: 96 steps at 30 a second.

    python benchmarks/straight_flight.py atrium [--methods gibs,ddgi] [--size 640x360] [--spp 1024] [--device D]
    python benchmarks/straight_flight.py atrium --methods path --set history=32
    python benchmarks/straight_flight.py Sponza.gltf --path="-9,2,0;5,2.5,0" --path="3,2.5,0;13,3,-3"

After 48 still frames the camera goes from the first view to the last, and six steps on the way are held against the
truth of their moment. Prints one JSON object a method.
"""

from __future__ import annotations

import argparse
import statistics
import time as clock
from dataclasses import replace

import drjit as dr

from luxel import runtime
from luxel.errors import LuxelError
from luxel.files import to_json
from luxel.metrics.error import bias, regional
from luxel.render.loading import load
from luxel.render.renderer import Renderer
from luxel.render.truth import Truth, render_truth
from luxel.scene.device import Scene, upload
from luxel.scene.edit import parse_camera
from luxel.scene.model import Camera

STILL, STEPS = 48, 96
JUDGED = (16, 32, 48, 64, 80, 95)
FOV = 65.0
PATHS = {
    "atrium": ("-10,2,0;4,2,0", "-4,2,1;4,3,0"),
    "sponza": ("-9,2,0;5,2.5,0", "3,2.5,0;13,3,-3"),
}
"""First and last view of scenes by name, EYE;TARGET."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--path", action="append", metavar="EYE;TARGET", help="twice: where it starts, where it ends")
    parser.add_argument("--methods", default="gibs,ddgi")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a parameter of the methods")
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--spp", type=int, default=1024)
    parser.add_argument("--device", default="auto")
    options = parser.parse_args()
    runtime.start(options.device)
    try:
        scene = upload(load(options.scene))
        ends = options.path or PATHS.get(scene.host.data.name.lower())
        if ends is None or len(ends) != 2:
            raise LuxelError("a flight has two ends: give --path twice, as EYE;TARGET")
        width, height = (int(part) for part in options.size.split("x"))
        views = straight_flight(*(parse_camera(f"{end};{FOV}", scene.host.data) for end in ends))
        truths = make_truths(scene, views, (width, height), options.spp)
        settings: dict[str, object] = dict(word.split("=", 1) for word in options.set if "=" in word)
        for method in options.methods.split(","):
            found = fly(scene, method, settings, views, truths)
            print(to_json({"scene": options.scene, "method": method, "settings": settings, **found}))
    except LuxelError as error:
        raise SystemExit(f"straight_flight: {error}") from None


def straight_flight(first: Camera, last: Camera) -> list[Camera]:
    """Return the views of all steps, eye and target on straight lines."""
    return [
        replace(first, eye=_between(first.eye, last.eye, share), target=_between(first.target, last.target, share))
        for share in (step / (STEPS - 1) for step in range(STEPS))
    ]


def make_truths(scene: Scene, views: list[Camera], size: tuple[int, int], spp: int) -> dict[int, Truth]:
    """Return the truth of each step that is judged."""
    return {step: render_truth(scene, camera=views[step], size=size, spp=spp) for step in JUDGED}


def fly(
    scene: Scene, method: str, params: dict[str, object], views: list[Camera], truths: dict[int, Truth]
) -> dict[str, object]:
    """Return mean `regional` and `bias` on the way, those of each judged step, and the milliseconds of a step."""
    height, width = truths[JUDGED[0]].layers.hit.shape
    renderer = Renderer(scene, method, params, size=(width, height), camera=views[0])
    renderer.run(STILL)
    rows, spent = [], []
    for step, view in enumerate(views):
        start = clock.perf_counter()
        renderer.step(camera=view)
        dr.sync_thread()
        spent.append(1e3 * (clock.perf_counter() - start))
        if step in truths:
            layers, truth = renderer.layers(), truths[step].layers
            rows.append({"step": step, "regional": regional(layers, truth), "bias": bias(layers, truth)})
    return {
        "regional": statistics.mean(row["regional"] for row in rows),
        "bias": statistics.mean(row["bias"] for row in rows),
        "steps": rows,
        "step_ms": statistics.median(spent),
        "size": [width, height],
        "device": renderer.device.name,
    }


def _between(a: tuple[float, ...], b: tuple[float, ...], share: float) -> tuple[float, float, float]:
    x, y, z = ((1.0 - share) * first + share * last for first, last in zip(a, b, strict=True))
    return x, y, z


if __name__ == "__main__":
    main()
