"""The page in a real browser: it opens, the split moves, exposure changes pixels, tables sort, nothing complains."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from luxel.image.tonemap import to_display
from luxel.report.page import write_report

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

SIZE = (160, 96)
OPENING_SECONDS = 2.0
MOST_BYTES = 25_000_000


@pytest.fixture
def page(chromium: Browser, comparison: Any) -> Iterator[Page]:
    """The page of a made-up comparison, opened from disk without a network; any complaint of the browser fails."""
    path, _ = write_report(comparison(size=SIZE))
    context = chromium.new_context(viewport={"width": 1280, "height": 900}, offline=True)
    shown = context.new_page()
    complaints: list[str] = []
    requests: list[str] = []
    shown.on("console", lambda message: complaints.append(message.text))
    shown.on("pageerror", lambda error: complaints.append(str(error)))
    shown.on("request", lambda request: requests.append(request.url))
    shown.goto(path.as_uri())
    yield shown
    context.close()
    assert complaints == []
    assert [url for url in requests if not url.startswith(("file:", "data:", "blob:"))] == []


def show(page: Page, **choices: str) -> None:
    """Bring the first viewer into view, choose pictures by label and wait until they are painted."""
    page.locator(".viewer").first.scroll_into_view_if_needed()
    wait_until_painted(page)
    for side, label in choices.items():
        page.locator(f"[data-side={side}]").first.select_option(label=label)
        wait_until_painted(page)


def wait_until_painted(page: Page) -> None:
    page.wait_for_function("document.querySelector('.viewer').getAttribute('aria-busy') === 'false'", timeout=10_000)


def set_range(page: Page, name: str, value: float) -> None:
    page.locator(f"[data-set={name}]").first.fill(str(value))
    wait_until_painted(page)


def choose(page: Page, label: str) -> None:
    page.locator(".viewer").first.locator(f"fieldset label:has-text('{label}')").click()
    wait_until_painted(page)


def read_canvas(page: Page, x: float, y: float) -> list[int]:
    """Return red, green, blue of the canvas at a share of the stage's width and height."""
    script = """([x, y]) => {
        const canvas = document.querySelector(".viewer canvas");
        const at = [Math.floor(x * (canvas.width - 1)), Math.floor(y * (canvas.height - 1))];
        const copy = Object.assign(document.createElement("canvas"), { width: 1, height: 1 });
        const context = copy.getContext("2d", { willReadFrequently: true });
        context.drawImage(canvas, ...at, 1, 1, 0, 0, 1, 1);
        return [...context.getImageData(0, 0, 1, 1).data.slice(0, 3)];
    }"""
    return page.evaluate(script, [x, y])


def test_it_opens_at_once(chromium: Browser, comparison: Any) -> None:
    path, _ = write_report(comparison(size=SIZE))
    assert time_opening(chromium, path) < OPENING_SECONDS


@pytest.mark.soak
def test_a_full_report_is_small_and_opens_in_two_seconds(
    chromium: Browser, comparison: Any, full_results: dict[str, Any], record_property: Callable[[str, object], None]
) -> None:
    """Four scenes, four methods, three seeds, all peers; the path tracer's pictures are noise in every channel."""
    path, complaint = write_report(comparison(full_results, size=(512, 512), noise=0.5))
    size = path.stat().st_size
    seconds = min(time_opening(chromium, path) for _ in range(3))
    record_property("bytes", size)
    record_property("seconds", seconds)
    print(f"{size / 1e6:.1f} MB, opens in {seconds:.2f} s")
    assert complaint == ""
    assert size < MOST_BYTES
    assert seconds < OPENING_SECONDS


def time_opening(chromium: Browser, path: Path) -> float:
    """Return the seconds until the first picture pair of a page is painted, in a browser that never saw it."""
    context = chromium.new_context(viewport={"width": 1280, "height": 900}, offline=True)
    page = context.new_page()
    start = time.perf_counter()
    page.goto(path.as_uri())
    wait_until_painted(page)
    seconds = time.perf_counter() - start
    context.close()
    return seconds


def test_the_first_pair_is_the_nearest_method_beside_the_truth(page: Page) -> None:
    show(page)
    tags = page.locator(".viewer").first.locator(".tag").all_text_contents()
    assert tags == ["gibs", "truth"]


def test_exposure_brings_the_light_that_the_curve_says(page: Page) -> None:
    """The pictures are a ramp to four times white, made by `paint_light` at an exposure of one half."""
    show(page, left="truth", right="truth")
    for stops in (0.0, -2.0, 3.0):
        if stops:
            set_range(page, "exposure", stops)
        for x in (0.15, 0.4, 0.8):
            column = int(x * SIZE[0])
            ramp = np.linspace(0.0, 2.0, SIZE[0]) ** 2
            light = ramp[column] * np.array([1.0, 0.5, 0.25]) * 0.5 * 2.0**stops
            wanted = 255.0 * to_display(light[None, None, :])[0, 0]
            given = read_canvas(page, (column + 0.5) / SIZE[0], 0.5)
            assert np.abs(np.array(given) - wanted).max() <= 6.0, (stops, x)


def test_the_split_moves_by_pointer_and_keys(page: Page) -> None:
    show(page, left="none", right="truth")
    stage, handle = page.locator(".stage").first, page.locator(".split").first
    box = stage.bounding_box()
    assert box is not None
    right = read_canvas(page, 0.7, 0.5)
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + 0.5 * box["height"], steps=4)
    page.mouse.up()
    assert handle.get_attribute("aria-valuenow") == "80"
    left = read_canvas(page, 0.7, 0.5)
    assert left != right  # what was the truth's is now the other's
    handle.press("Home")
    assert handle.get_attribute("aria-valuenow") == "0"
    assert read_canvas(page, 0.7, 0.5) == right
    for _ in range(3):
        handle.press("Shift+ArrowRight")
    handle.press("ArrowRight")
    assert handle.get_attribute("aria-valuenow") == "31"
    handle.press("End")
    assert read_canvas(page, 0.7, 0.5) == left


def test_the_difference_is_signed_and_scaled(page: Page) -> None:
    show(page, left="none", right="truth")
    choose(page, "Difference")
    one_way = read_canvas(page, 0.6, 0.5)
    page.locator("[data-do=swap]").first.click()
    wait_until_painted(page)
    other_way = read_canvas(page, 0.6, 0.5)
    # Amber where brighter, blue where darker.
    assert (one_way[0] > one_way[2]) != (other_way[0] > other_way[2])
    before = page.locator(".legend .high").first.text_content()
    set_range(page, "gain", 0)
    weak = read_canvas(page, 0.6, 0.5)
    assert page.locator(".legend .high").first.text_content() != before
    assert max(weak) < max(other_way)
    show(page, left="truth", right="truth")
    assert read_canvas(page, 0.6, 0.5) == [22, 23, 26]


def test_flip_maps_are_shown_and_the_truth_has_none(page: Page) -> None:
    show(page, left="gibs", right="truth")
    choose(page, "FLIP")
    red, green, blue = read_canvas(page, 0.25, 0.5)
    assert abs(red - 80) < 6 and abs(green - 20) < 6 and abs(blue - 120) < 6
    assert page.locator(".legend").first.is_visible()
    assert page.locator(".range[data-for=exposure]").first.is_hidden()


def test_zoom_enlarges_and_fits_again(page: Page) -> None:
    show(page, left="truth", right="truth")
    zoom = page.locator(".zoom output").first
    assert zoom.text_content() == "fit"
    page.locator("[data-do=one]").first.click()
    assert zoom.text_content() == "100 %"
    before = [read_canvas(page, x, 0.5) for x in (0.45, 0.55)]
    for _ in range(8):
        page.locator("[data-do=in]").first.click()
    after = [read_canvas(page, x, 0.5) for x in (0.45, 0.55)]
    assert abs(after[1][0] - after[0][0]) < abs(before[1][0] - before[0][0])  # the ramp is flatter
    page.locator("[data-do=fit]").first.click()
    assert zoom.text_content() == "fit"


def test_pointing_at_a_pixel_tells_its_light(page: Page) -> None:
    show(page, left="truth", right="gibs")
    page.locator(".stage").first.hover()
    text = page.locator(".probe").first.text_content() or ""
    assert text.startswith("pixel 80, 48") or text.startswith("pixel 79, 47") or text.startswith("pixel 80, 47")
    assert "left" in text and "right" in text


def test_tables_sort_both_ways_and_keep_empty_cells_last(page: Page) -> None:
    table = page.locator("table.sortable").first
    heading = table.locator("thead button", has_text="Frame").first

    def column(index: int) -> list[str]:
        return table.locator(f"tbody tr > :nth-child({index}) ").all_inner_texts()

    names = [text.split("\n")[0] for text in column(1)]
    assert names[:2] == ["gibs", "ddgi"]
    heading.click()
    first = [text.split("\n")[0] for text in column(1)]
    assert first[:4] == ["none", "ambient", "ddgi", "gibs"]
    assert heading.locator("xpath=..").get_attribute("aria-sort") == "ascending"
    heading.click()
    second = [text.split("\n")[0] for text in column(1)]
    assert second[:2] == ["gibs", "ddgi"]
    assert all("path" in name for name in first[4:]) and all("path" in name for name in second[4:])
    table.locator("thead button", has_text="Method").focus()
    page.keyboard.press("Enter")
    assert [text.split("\n")[0] for text in column(1)][0] == "ambient"


def test_curves_tell_their_values(page: Page) -> None:
    mark = page.locator("svg.plot circle.mark").first
    mark.scroll_into_view_if_needed()
    mark.hover()
    tip = page.locator("#tip")
    assert tip.is_visible() and "frame 1: " in (tip.text_content() or "")


def test_headings_explain_themselves_to_the_keyboard(page: Page) -> None:
    table = page.locator("table.sortable").first
    table.locator("thead button", has_text="Method").focus()
    page.keyboard.press("Tab")
    tip = page.locator("#tip")
    assert tip.is_visible() and (tip.text_content() or "").startswith("regional, the main figure")


def test_the_command_is_copied(page: Page) -> None:
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    button = page.locator("[data-copy=command]")
    button.click()
    page.wait_for_function("document.querySelector('[data-copy=command]').textContent === 'Copied'")
    copied = page.evaluate("navigator.clipboard.readText()")
    assert copied == "luxel compare box two-rooms:wall=0.05 -o out/report/"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_can_be_read_in_both_schemes(page: Page, scheme: Any) -> None:
    page.emulate_media(color_scheme=scheme)
    ink, paper = page.evaluate(
        "[getComputedStyle(document.body).color, getComputedStyle(document.documentElement).backgroundColor]"
    )
    first, second = (np.mean([int(part) for part in text[4:-1].split(",")]) for text in (ink, paper))
    assert abs(first - second) > 150
    assert (second < 128) == (scheme == "dark")


def test_nothing_runs_over_the_edge_of_a_small_window(page: Page) -> None:
    page.set_viewport_size({"width": 390, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
