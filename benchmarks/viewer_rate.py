"""How many pictures a second reach a client, and how soon a drag is answered. Speaks viser's protocol; no browser.

    python benchmarks/viewer_rate.py [SCENE] [--method M] [--size WxH] [--window WxH] [--seconds S] [--device D]

Prints one JSON object. The camera turns all the time, as in a drag; a second run leaves it at rest.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time as clock

import luxel
from luxel.files import to_json
from luxel.viewer.app import App
from luxel.viewer.headless_client import HeadlessClient, turned
from luxel.viewer.session import Session
from luxel.viewer.world import Choice


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scene", nargs="?", default="cornell-box")
    parser.add_argument("--method", default="gibs")
    parser.add_argument("--size", default="1280x720", help="most pixels of a picture")
    parser.add_argument("--window", default="", help="the client's window; default: --size")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--device", default="auto")
    options = parser.parse_args()
    size = read_size(options.size)
    window = read_size(options.window or options.size)
    session = Session(luxel.load(options.scene), Choice(options.method), size=size, device=options.device).start()
    app = App(session, port=0)
    try:
        result = measure(session, app, window, options.seconds)
    finally:
        app.stop()
        session.stop()
    print(to_json({"scene": options.scene, "method": options.method, "device": session.device.name, **result}))


def measure(session: Session, app: App, window: tuple[int, int], seconds: float) -> dict[str, object]:
    """Return pictures a second while dragging and at rest, and the answers' milliseconds."""
    home = session.camera
    with HeadlessClient(app.url, window) as client:
        client.look(home)
        client.listen(max(5.0, 0.5 * seconds))
        (visitor,) = session.visitors()
        warm = session.stats.recordings

        # A drag: a new camera every 20 ms, as the browser sends them.
        visitor.answers_ms.clear()
        before, start = client.pictures, clock.perf_counter()
        while (now := clock.perf_counter() - start) < seconds:
            client.look(turned(home, 0.3 * math.sin(1.3 * now), 0.1 * math.sin(now)))
            client.listen(0.02)
        dragged = (client.pictures - before) / seconds
        answers, stride = list(visitor.answers_ms), visitor.stride_controller.stride

        # One look at a time: from the message to the picture in the client's hands.
        waits = []
        for step in range(20):
            client.listen(0.6)
            asked = clock.perf_counter()
            client.look(turned(home, 0.02 * step, 0.0))
            if client.listen(5.0, until_picture=True):
                waits.append(1e3 * (clock.perf_counter() - asked))
        start = clock.perf_counter()
        rested = client.listen(seconds) / seconds
        return {
            "size": list(visitor.size),
            "pictures_per_second_dragging": dragged,
            "pictures_per_second_at_rest": rested,
            "stride_dragging": stride,
            "answer_ms_in_a_drag": summarise(answers),
            "answer_ms_first_of_a_drag": summarise(waits),
            "frame_ms": session.stats.frame_ms,
            "sharp_at_the_end": visitor.is_sharp,
            "recordings_after_warmup": session.stats.recordings - warm,
            "picture_kb": client.picture_bytes / max(client.pictures, 1) / 1024,
            "faults": session.faults,
        }


def summarise(values: list[float]) -> dict[str, float]:
    """Return median and 95th percentile."""
    if not values:
        return {}
    return {"median": statistics.median(values), "p95": sorted(values)[math.ceil(0.95 * len(values)) - 1]}


def read_size(text: str) -> tuple[int, int]:
    """Return (width, height) of `1280x720`."""
    width, height = (int(part) for part in text.split("x"))
    return width, height


if __name__ == "__main__":
    main()
