"""What the scripts that make the docs' pictures share: where they go, a browser, sheets of pictures as JPEG."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image

from luxel.image.write import write_bytes

if TYPE_CHECKING:
    from playwright.sync_api import Browser

REPOSITORY = Path(__file__).resolve().parents[1]
PICTURES = REPOSITORY / "docs" / "pictures"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
ARGUMENTS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""As root in a container, and WebGL without a GPU."""
BYTES_LIMIT = 180_000
QUALITIES = (88, 84, 80, 76, 70, 64, 58, 50)
GAP = 8


@contextmanager
def open_browser() -> Iterator[Browser]:
    """Yield a headless Chromium, the system's where there is one, else Playwright's own."""
    from playwright.sync_api import sync_playwright

    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield browser
        browser.close()


def open_shot(shot: bytes) -> Image.Image:
    """Return a screenshot as a picture."""
    return Image.open(io.BytesIO(shot)).convert("RGB")


def write_row(
    path: Path,
    pictures: Sequence[Image.Image],
    *,
    background: str = "#242424",
    most_width: int = 2000,
    limit: int = BYTES_LIMIT,
) -> None:
    """Write pictures side by side as a JPEG at most `most_width` wide, of at most `limit` bytes where it can be."""
    width = sum(picture.width for picture in pictures) + GAP * (len(pictures) - 1)
    sheet = Image.new("RGB", (width, max(picture.height for picture in pictures)), background)
    x = 0
    for picture in pictures:
        sheet.paste(picture, (x, 0))
        x += picture.width + GAP
    if sheet.width > most_width:
        height = round(sheet.height * most_width / sheet.width)
        sheet = sheet.resize((most_width, height), Image.Resampling.LANCZOS)
    write_jpeg(path, sheet, limit)


def write_jpeg(path: Path, sheet: Image.Image, limit: int = BYTES_LIMIT, subsampling: int = -1) -> None:
    """Write a JPEG of the best quality that stays under `limit` bytes, or of the lowest there is."""
    stream, quality = io.BytesIO(), 0
    for quality in QUALITIES:
        stream = io.BytesIO()
        sheet.save(stream, "JPEG", quality=quality, optimize=True, progressive=True, subsampling=subsampling)
        if stream.tell() < limit:
            break
    write_bytes(path, stream.getvalue())
    print(f"{path}: {stream.tell() / 1000:.0f} kB, quality {quality}")
