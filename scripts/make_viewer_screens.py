"""Make the pictures of the viewer for the docs, in a headless browser.

    python scripts/make_viewer_screens.py [NAME ...] [--out docs/pictures] [--seconds S]

Needs the extras `view` and `dev` and a Chromium. Each picture waits S seconds for the light to settle; the default
suits two CPU cores.
"""

from __future__ import annotations

import argparse
import time as clock
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import Page
from sheets import PICTURES, open_browser, open_shot, write_row

import luxel
from luxel.viewer.app import App
from luxel.viewer.session import Session
from luxel.viewer.world import Choice

WINDOW = {"width": 1180, "height": 700}
BYTES_LIMIT = 150_000


@contextmanager
def open_viewer(scene: str, method: str) -> Iterator[Page]:
    """Yield the viewer of a scene, open in a browser."""
    session = Session(luxel.load(scene), Choice(method), size=(960, 720), text=scene).start()
    app = App(session, port=0)
    try:
        with open_browser() as browser:
            page = browser.new_page(viewport=WINDOW)  # type: ignore[arg-type]
            page.goto(app.url)
            page.get_by_text("lit by").wait_for()
            # The browser warns that it draws without a GPU, which says nothing of luxel.
            page.locator(".mantine-Notification-closeButton").first.click()
            yield page
    finally:
        app.stop()
        session.stop()


def choose(page: Page, label: str, option: str) -> None:
    """Choose an option of a list."""
    name = page.locator(f"label:text-is('{label}')").first.get_attribute("for")
    page.locator(f"[id='{name}']").first.click()
    page.get_by_role("option", name=option, exact=True).click()
    page.mouse.move(5, 5)


def open_tab(page: Page, name: str) -> None:
    page.get_by_role("tab", name=name).click()
    clock.sleep(1.0)


def take(page: Page, seconds: float) -> Image.Image:
    """Return the window after `seconds`."""
    clock.sleep(seconds)
    return open_shot(page.screenshot())


def viewer(seconds: float) -> Iterator[tuple[str, list[Image.Image]]]:
    """The whole window, and the truth beside the method."""
    with open_viewer("atrium", "gibs") as page:
        yield "viewer", [take(page, 2 * seconds)]
        page.get_by_text("Compare").click()
        choose(page, "With", "truth (path traced)")
        yield "viewer-compare", [take(page, 3 * seconds)]


def inside(seconds: float) -> Iterator[tuple[str, list[Image.Image]]]:
    """A look into the cache, and a clicked pixel."""
    with open_viewer("atrium", "gibs") as page:
        clock.sleep(seconds)
        choose(page, "Show", "surfels")
        first = take(page, seconds)
        choose(page, "Show", "image")
        open_tab(page, "Inside")
        page.mouse.click(260, 560)
        yield "viewer-inside", [first, take(page, seconds)]


def clusters(seconds: float) -> Iterator[tuple[str, list[Image.Image]]]:
    """A click under the lightmap: the clusters of a texel as discs, then in the picture itself."""
    with open_viewer("cornell-box", "lightmap") as page:
        clock.sleep(2 * seconds)
        open_tab(page, "Inside")
        page.mouse.click(300, 640)
        first = take(page, seconds)
        open_tab(page, "See")
        choose(page, "Show", "clusters")
        yield "viewer-clusters", [first, take(page, seconds)]


def panels(seconds: float) -> Iterator[tuple[str, list[Image.Image]]]:
    """The tabs side by side."""
    with open_viewer("moving", "ddgi") as page:
        clock.sleep(2.0)
        columns = []
        for name in ("See", "Method", "Light", "Scene", "Inside"):
            open_tab(page, name)
            if name == "Inside":
                page.locator("label:text-is('Time the stages')").click()
                clock.sleep(seconds)
            box = page.get_by_role("tab", name="See").bounding_box()
            assert box is not None
            columns.append(take(page, 0.5).crop((int(box["x"]) - 8, 60, WINDOW["width"], WINDOW["height"])))
        yield "viewer-panels", columns


MAKERS: dict[str, Callable[[float], Any]] = {"viewer": viewer, "inside": inside, "clusters": clusters, "panels": panels}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", default=[], help=f"of {', '.join(MAKERS)}; default: all")
    parser.add_argument("--out", type=Path, default=PICTURES)
    parser.add_argument("--seconds", type=float, default=15.0)
    options = parser.parse_args()
    for name in options.names or MAKERS:
        for stem, pictures in MAKERS[name](options.seconds):
            write_row(options.out / f"{stem}.jpg", pictures, limit=BYTES_LIMIT)


if __name__ == "__main__":
    main()
