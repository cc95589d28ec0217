"""Make the pictures of luxel's web pages for the docs, in a headless browser.

    python scripts/make_screens.py [NAME ...] [--out docs/pictures] [--comparison DIR]

`report` shows the page of a real comparison: of DIR, where one is given, else of one that is run now (minutes).
Needs the extra `dev` and a Chromium (`scripts/ensure_browser.sh`).
"""

from __future__ import annotations

import argparse
import io
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image

from luxel.render.write import write_bytes

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

REPOSITORY = Path(__file__).resolve().parents[1]
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
BYTES_LIMIT = 200_000
WINDOW = (1360, 900)
PICTURE_WIDTH = 1100
SCENES = ["cornell-box", "two-rooms"]
METHODS = ["gibs", "ddgi"]


# ---------- Browser and files ----------


@contextmanager
def open_browser() -> Iterator[Browser]:
    """Yield a headless Chromium, the system's where there is one, else Playwright's own."""
    from playwright.sync_api import sync_playwright

    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


def write_jpeg(path: Path, shots: list[bytes]) -> None:
    """Write screenshots one below the other as a JPEG of at most 200 kB."""
    pictures = [Image.open(io.BytesIO(shot)).convert("RGB") for shot in shots]
    sheet = Image.new("RGB", (pictures[0].width, sum(one.height for one in pictures)))
    top = 0
    for one in pictures:
        sheet.paste(one, (0, top))
        top += one.height
    height = round(sheet.height * PICTURE_WIDTH / sheet.width)
    sheet = sheet.resize((PICTURE_WIDTH, height), Image.Resampling.LANCZOS)
    for quality in (88, 84, 80, 76, 70, 62):
        stream = io.BytesIO()
        sheet.save(stream, "JPEG", quality=quality, optimize=True, progressive=True)
        if stream.tell() < BYTES_LIMIT:
            break
    write_bytes(path, stream.getvalue())
    print(f"{path}: {stream.tell() / 1000:.0f} kB, quality {quality}")


# ---------- The report ----------


def run_comparison(folder: Path) -> None:
    """Compare the methods on the scenes of the docs, with every part that a report can have."""
    import luxel

    luxel.compare(SCENES, METHODS, seeds=(0, 1, 2), size=(256, 256), frames=128, out=folder)


def shoot_report(out: Path, comparison: Path | None) -> None:
    """Make report.jpg, the summary and a picture pair, and report-plots.jpg, tables, plots and stages."""
    from luxel.report.page import write_report

    with tempfile.TemporaryDirectory() as scratch, open_browser() as browser:
        folder = comparison or Path(scratch)
        if comparison is None:
            run_comparison(folder)
        page_file, _ = write_report(folder)
        page = browser.new_page(viewport={"width": WINDOW[0], "height": WINDOW[1]})
        page.goto(page_file.resolve().as_uri())
        viewer = page.locator(".viewer").first
        viewer.scroll_into_view_if_needed()
        page.wait_for_function("document.querySelector('.viewer').getAttribute('aria-busy') === 'false'")
        page.locator("[data-side=left]").first.select_option(label=METHODS[-1])
        page.wait_for_function("document.querySelector('.viewer').getAttribute('aria-busy') === 'false'")
        write_jpeg(out / "report.jpg", [cut(page, "#summary", ".viewer")])
        write_jpeg(out / "report-plots.jpg", [cut(page, "#scene-0 h3", "#scene-0 .bars")])


def cut(page: Page, first: str, last: str) -> bytes:
    """Return a screenshot of the page from the top of one element to the bottom of another."""
    # The bar at the top sticks to the window and would lie across the cut.
    page.add_style_tag(content=".top { display: none !important; }")
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
    parser.add_argument("--out", type=Path, default=REPOSITORY / "docs" / "pictures")
    parser.add_argument("--comparison", type=Path, metavar="DIR", help="a folder that `luxel compare -o DIR` wrote")
    options = parser.parse_args()
    unknown = set(options.names) - set(screens)
    if unknown:
        parser.error(f"no such screen: {', '.join(sorted(unknown))}")
    for name in options.names or screens:
        screens[name](options)


if __name__ == "__main__":
    main()
