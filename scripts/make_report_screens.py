"""Make the pictures of luxel's web pages for the docs, in a headless browser.

    python scripts/make_report_screens.py [NAME ...] [--out docs/pictures] [--comparison DIR]

`report` shows the page of a real comparison: of DIR, where one is given, else of one that is run now (minutes).
Needs the extra `dev` and a Chromium (`scripts/ensure_browser.sh`).
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from sheets import PICTURES, open_browser, open_shot, write_row

if TYPE_CHECKING:
    from playwright.sync_api import Page

WINDOW = (1360, 900)
PICTURE_WIDTH = 1100
SCENES = ["cornell-box", "two-rooms"]
METHODS = ["gibs", "ddgi"]


# ---------- The report ----------


def run_comparison(folder: Path) -> None:
    """Compare the methods on the scenes of the docs, with every part that a report can have."""
    import luxel

    luxel.compare(SCENES, METHODS, seeds=(0, 1, 2), size=(256, 256), frames=128, out=folder)


def shoot_report(out: Path, comparison: Path | None) -> None:
    """Make the pictures of docs/report.md.

    report.jpg is the summary and a picture pair, report-views.jpg the pair's three views, report-plots.jpg tables,
    plots and stages.
    """
    from luxel.report.page import write_report

    with tempfile.TemporaryDirectory() as scratch, open_browser() as browser:
        folder = comparison or Path(scratch)
        if comparison is None:
            run_comparison(folder)
        page_file, _ = write_report(folder)
        page = browser.new_page(viewport={"width": WINDOW[0], "height": WINDOW[1]})
        page.goto(page_file.resolve().as_uri())
        # The bar at the top sticks to the window and would lie across the cuts.
        page.add_style_tag(content=".top { display: none !important; }")
        viewer = page.locator(".viewer").first
        viewer.scroll_into_view_if_needed()
        viewer.locator("[data-side=left]").select_option(label=METHODS[-1])
        wait_until_painted(page)
        write(out / "report.jpg", [cut(page, "#summary", ".viewer")])
        write(out / "report-plots.jpg", [cut(page, "#scene-0 h3", "#scene-0 .bars")])
        write(out / "report-views.jpg", shoot_views(page))


def write(path: Path, shots: list[bytes]) -> None:
    write_row(path, [open_shot(shot) for shot in shots], background="white", most_width=PICTURE_WIDTH)


def shoot_views(page: Page) -> list[bytes]:
    """Return the first viewer's stage as image, difference and FLIP maps of two methods."""
    page.add_style_tag(content=".stage { width: 640px !important; height: 640px; max-height: none !important; }")
    viewer = page.locator(".viewer").first
    viewer.locator("[data-side=right]").select_option(label="truth")
    shots = []
    for view in ("Split", "Difference", "FLIP"):
        viewer.locator(f"fieldset label:has-text('{view}')").click()
        if view == "FLIP":
            viewer.locator("[data-side=right]").select_option(label=METHODS[0])
        wait_until_painted(page)
        shots.append(viewer.locator(".stage").screenshot())
    return shots


def wait_until_painted(page: Page) -> None:
    page.wait_for_function("document.querySelector('.viewer').getAttribute('aria-busy') === 'false'")


def cut(page: Page, first: str, last: str) -> bytes:
    """Return a screenshot of the page from the top of one element to the bottom of another."""
    top, bottom = page.evaluate(
        """([first, last]) => [document.querySelector(first).getBoundingClientRect().top + scrollY,
            document.querySelector(last).getBoundingClientRect().bottom + scrollY]""",
        [first, last],
    )
    clip = {"x": 0, "y": top - 16, "width": WINDOW[0], "height": bottom - top + 32}
    return page.screenshot(full_page=True, clip=clip)  # pyright: ignore[reportArgumentType]


def main() -> None:
    """Make the named pictures, or all of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    screens: dict[str, Callable[[argparse.Namespace], None]] = {
        "report": lambda options: shoot_report(options.out, options.comparison),
    }
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of: {', '.join(screens)}")
    parser.add_argument("--out", type=Path, default=PICTURES)
    parser.add_argument("--comparison", type=Path, metavar="DIR", help="a folder that `luxel compare -o DIR` wrote")
    options = parser.parse_args()
    unknown = set(options.names) - set(screens)
    if unknown:
        parser.error(f"no such screen: {', '.join(sorted(unknown))}")
    for name in options.names or screens:
        screens[name](options)


if __name__ == "__main__":
    main()
