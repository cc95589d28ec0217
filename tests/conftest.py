"""Starts the device once, before any test module is imported, and finds the real scenes and a browser."""

from __future__ import annotations

import base64
import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
import pytest

from luxel import runtime
from luxel.errors import LuxelError

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Playwright

REPOSITORY = Path(__file__).resolve().parents[1]


def pytest_sessionstart() -> None:
    """Test modules import Mitsuba at their top, and Dr.Jit takes its LLVM at that moment."""
    try:
        runtime.start(os.environ.get("LUXEL_TEST_DEVICE", "cpu"))
    except LuxelError as error:
        pytest.exit(str(error), returncode=2)


@pytest.fixture(scope="session")
def scenes_folder() -> Path:
    """The folder of real scenes, `LUXEL_TEST_SCENES`; a test that asks for it is skipped where there is none."""
    folder = Path(os.environ.get("LUXEL_TEST_SCENES") or REPOSITORY.parent / "shared" / "scenes")
    if not folder.is_dir():
        pytest.skip(f"no real scenes at {folder}: name their folder in LUXEL_TEST_SCENES")
    return folder


# ---------- Small glTF files ----------


@pytest.fixture
def write_gltf(tmp_path: Path) -> Callable[..., Path]:
    """A function (name, parts, **more) -> path of a .gltf.

    A part is (name, (F, 3, 3) corners in metres, glTF material as a dict); `more` adds to the file's top level.
    """

    def write(name: str, parts: list[tuple[str, np.ndarray, dict[str, Any]]], **more: Any) -> Path:
        data = np.concatenate([np.asarray(corners, np.float32).reshape(-1, 3) for _, corners, _ in parts])
        ends = np.cumsum([np.asarray(corners).size // 3 for _, corners, _ in parts])
        starts = [0, *map(int, ends[:-1])]
        extensions = {key for _, _, material in parts for key in material.get("extensions", {})}
        extensions |= set(more.get("extensions", {}))
        file = {
            "asset": {"version": "2.0"},
            "scenes": [{"nodes": list(range(len(parts)))}],
            "nodes": [{"name": title, "mesh": i} for i, (title, _, _) in enumerate(parts)],
            "meshes": [{"primitives": [{"attributes": {"POSITION": i}, "material": i}]} for i in range(len(parts))],
            "materials": [material for _, _, material in parts],
            "accessors": [
                {
                    "bufferView": 0, "byteOffset": 12 * a, "componentType": 5126, "count": int(b) - a, "type": "VEC3",
                    "min": data[a:b].min(axis=0).tolist(), "max": data[a:b].max(axis=0).tolist(),
                }
                for a, b in zip(starts, ends, strict=True)
            ],
            "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": data.nbytes}],
            "buffers": [
                {
                    "byteLength": data.nbytes,
                    "uri": "data:application/octet-stream;base64," + base64.b64encode(data.tobytes()).decode(),
                }
            ],
            "extensionsUsed": sorted(extensions),
            **more,
        }  # fmt: skip
        if not extensions:
            del file["extensionsUsed"]
        path = tmp_path / name
        path.write_text(json.dumps(file))
        return path

    return write


# ---------- A browser ----------

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
BROWSER_ARGUMENTS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""WebGL in software, which the viewer needs where there is no GPU."""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """A headless Chromium, the system's or Playwright's own.

    Where there is none its tests are skipped with the reason; under CI=true they fail.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        miss_browser("playwright is not installed: run `pip install playwright`")
    # One module long, because an event loop runs in this thread meanwhile and `asyncio.run` would refuse.
    with sync_playwright() as playwright:
        browser = launch_chromium(playwright)
        yield browser
        browser.close()


def launch_chromium(playwright: Playwright) -> Browser:
    """Start the first browser that starts; without one the test is skipped, or fails under CI=true."""
    from playwright.sync_api import Error

    found = [path for name in BROWSERS if (path := shutil.which(name))]
    reason = "no Chromium found: install it, or run `python -m playwright install chromium`"
    for path in [*found, None]:
        try:
            return playwright.chromium.launch(executable_path=path, args=list(BROWSER_ARGUMENTS))
        except Error as error:
            reason = f"{reason}; {path or 'playwright'}: {error.message.splitlines()[0]}"
    miss_browser(reason)


def miss_browser(reason: str) -> NoReturn:
    if os.environ.get("CI") == "true":
        pytest.fail(reason)
    pytest.skip(reason)
