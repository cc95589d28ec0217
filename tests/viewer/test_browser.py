"""The viewer in a real browser: what a visitor sees and does."""

from __future__ import annotations

import io
import shlex
import subprocess
import sys
import time as clock
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from luxel.viewer import share
from luxel.viewer.app import App
from luxel.viewer.session import Session

from .conftest import wait_for

WINDOW = {"width": 760, "height": 420}


@pytest.fixture
def page(chromium: Any, app: App) -> Iterator[Any]:
    """The viewer, open in a fresh tab, its first picture there; fails on an error in the browser's console."""
    context = chromium.new_context(viewport=WINDOW, accept_downloads=True)
    tab = context.new_page()
    errors: list[str] = []
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    tab.goto(app.url)
    wait_for(lambda: app.session.visitors() and app.session.visitors()[0].is_sharp, what="a sharp picture")
    wait_for(lambda: look_at(tab).std() > 10.0, what="a picture in the browser")
    yield tab
    context.close()
    assert not errors, errors
    assert not app.session.faults, app.session.faults


def look_at(tab: Any) -> np.ndarray:
    """Return what the browser shows of the scene, (h, w, 3)."""
    box = tab.locator("canvas").first.bounding_box()
    shot = Image.open(io.BytesIO(tab.screenshot(clip=box))).convert("RGB")
    return np.asarray(shot, np.float64)


def control(tab: Any, label: str) -> Any:
    """Return the control that belongs to `label`."""
    found = tab.locator(f"label:text-is('{label}')").first
    return tab.locator(f"[id='{found.get_attribute('for')}']").first


def choose(tab: Any, label: str, option: str) -> None:
    """Choose an option of a list."""
    control(tab, label).click()
    tab.get_by_role("option", name=option, exact=True).click()


def test_dragging_turns_the_camera_and_the_picture(page: Any, session: Session) -> None:
    (visitor,) = session.visitors()
    before, eye = look_at(page), visitor.camera.eye
    page.mouse.move(150, 200)
    page.mouse.down()
    for step in range(8):
        page.mouse.move(150 + 6 * step, 200 + 2 * step)
    page.mouse.up()
    wait_for(lambda: np.linalg.norm(np.subtract(visitor.camera.eye, eye)) > 0.2, what="another camera")
    wait_for(lambda: np.abs(look_at(page) - before).mean() > 5.0, what="another picture")
    wait_for(lambda: visitor.is_sharp and not visitor.is_moving, what="a sharp picture")
    assert visitor.answers_ms


def test_the_picture_has_the_canvas_shape(page: Any, session: Session) -> None:
    (visitor,) = session.visitors()
    box = page.locator("canvas").first.bounding_box()
    shape = box["width"] / box["height"]
    wait_for(lambda: abs(visitor.window[0] / visitor.window[1] / shape - 1.0) < 0.02, what="the canvas's shape")
    assert box["width"] < WINDOW["width"]  # the panel docks beside the picture


def test_switching_the_method_and_moving_a_slider(page: Any, session: Session) -> None:
    page.get_by_role("tab", name="Method").click()
    slider = control(page, "rays per surfel").locator("[role=slider]")
    slider.focus()
    slider.press("ArrowRight")
    wait_for(lambda: session.facts.params.rays_per_surfel == 5, what="another ray")
    choose(page, "Method", "ddgi")
    wait_for(lambda: session.facts.choice.method == "ddgi", what="the other method")
    page.get_by_text("lit by").wait_for()
    wait_for(lambda: "lit by ddgi" in page.inner_text("body"), what="the method's name")
    wait_for(lambda: page.locator("label:text-is('probe target')").count() == 1, what="the method's own dials")
    assert page.locator("label:text-is('rays per surfel')").count() == 0


def test_keys_belong_to_the_control_that_has_the_focus(page: Any, session: Session) -> None:
    """Arrows on a slider, a list or a tab leave the camera alone; on the picture they turn it, as before."""
    (visitor,) = session.visitors()
    page.get_by_role("tab", name="Method").click()
    slider = control(page, "rays per surfel").locator("[role=slider]")
    home = visitor.camera.eye
    for focused, keys in (
        (slider, ("w", "a", "ArrowRight", "ArrowUp")),
        (page.get_by_role("tab", name="Method"), ("ArrowUp", "ArrowDown", "w")),
    ):
        for key in keys:
            focused.focus()
            page.keyboard.down(key)
            page.wait_for_timeout(150)
            page.keyboard.up(key)
    wait_for(lambda: session.facts.params.rays_per_surfel > 4, what="another count of rays")
    page.wait_for_timeout(300)
    np.testing.assert_allclose(visitor.camera.eye, home, atol=1e-6)
    box = page.locator("canvas").first.bounding_box()
    page.mouse.click(box["x"] + 5, box["y"] + 5)
    page.keyboard.down("ArrowRight")
    wait_for(lambda: np.linalg.norm(np.subtract(visitor.camera.eye, home)) > 0.05, what="another camera")
    page.keyboard.up("ArrowRight")


def test_a_bad_value_is_said_and_taken_back(page: Any, session: Session) -> None:
    page.get_by_role("tab", name="Method").click()
    field = control(page, "surfel target")
    field.fill("0")
    field.press("Enter")
    page.get_by_text("'surfel_target' is 0").wait_for(timeout=60000)
    wait_for(lambda: field.input_value() == "4000", what="the old value")
    assert session.facts.params.surfel_target == 4000
    assert session.running


def test_clicking_a_pixel_says_what_lights_it(page: Any, session: Session) -> None:
    page.get_by_role("tab", name="Inside").click()
    box = page.locator("canvas").first.bounding_box()
    page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.85 * box["height"])
    page.get_by_text("indirect E").wait_for(timeout=30000)
    words = page.inner_text("body")
    assert any(item.name in words for item in session.facts.objects)
    assert "surfel 1" in words or "surfel " in words.split("coverage")[1]


def test_every_tab_opens(page: Any, session: Session) -> None:
    for name, word in (("Light", "All light"), ("Scene", "Objects"), ("Inside", "Cost of a frame"), ("See", "Camera")):
        page.get_by_role("tab", name=name).click()
        page.get_by_text(word, exact=True).first.wait_for(timeout=10000)


def done_in_a_still_view(visitor: Any, act: Callable[[], Any]) -> tuple[Any, share.SharedView]:
    """Return what `act` returns and the view it was done in; `act` is done again where the view changed meanwhile.

    A panel that has just been opened may change the canvas by a pixel, and the camera's angle with it, late on a busy
    machine: what was asked for then shows a view that nobody else knows.
    """
    for _ in range(5):
        wait_for(lambda: is_still(visitor), what="a page that has found its size")
        camera, size = visitor.camera, visitor.size
        result = act()
        if (visitor.camera, visitor.size) == (camera, size):
            return result, share.SharedView(camera, size, 0.0)
    pytest.fail("the view changed each time that something was asked of it")


def is_still(visitor: Any) -> bool:
    """Return whether the visitor's view stays as it is for a second: opening a panel may still change its size."""
    before = (visitor.camera, visitor.size)
    clock.sleep(1.0)
    return (visitor.camera, visitor.size) == before


def test_a_screenshot_is_what_the_command_renders(page: Any, session: Session, tmp_path: Path) -> None:
    page.get_by_text("Take along").click()
    (visitor,) = session.visitors()
    kept = tmp_path / "kept.png"

    def save() -> None:
        with page.expect_download(timeout=90000) as download:
            page.get_by_text("PNG", exact=True).click()
        download.value.save_as(kept)

    _, view = done_in_a_still_view(visitor, save)
    command = shlex.split(share.write_command(session.launch, session.facts, view))
    assert command[0] == "luxel"
    command[command.index("-o") + 1] = str(tmp_path / "rendered.png")
    # Fewer frames than it names: what is left of the noise is far below the limits.
    command[command.index("--frames") + 1] = "24"
    subprocess.run([sys.executable, "-m", *command], check=True, capture_output=True, timeout=300)
    ours, theirs = (np.asarray(Image.open(path).convert("RGB"), np.float64) for path in (kept, command[-1]))
    assert ours.shape == theirs.shape == (view.size[1], view.size[0], 3)
    # Noise of the direct light and the surfels' places differ; a wrong view or exposure would be off by tens.
    assert np.abs(ours - theirs).mean() < 6.0
    assert abs(ours.mean() - theirs.mean()) < 3.0


def test_copy_as_command_shows_both_texts_and_copies_them(page: Any, session: Session) -> None:
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.get_by_text("Take along").click()
    (visitor,) = session.visitors()

    def ask() -> None:
        if page.get_by_text("In a shell").count():
            page.get_by_role("button", name="Close", exact=True).click()
            page.get_by_text("In a shell").wait_for(state="detached")
        page.get_by_text("Copy as command").click()
        page.get_by_text("In a shell").wait_for(timeout=60000)

    _, view = done_in_a_still_view(visitor, ask)
    words = page.inner_text("body")
    assert "luxel render cornell-box" in words and "luxel.load" in words
    texts = (write(session.launch, session.facts, view) for write in (share.write_command, share.write_python))
    for number, text in enumerate(texts):
        button = page.locator(".luxel-snippet button").nth(number)
        button.click()
        wait_for(lambda button=button: button.inner_text() == "Copied", what="the button's answer")
        copied = page.evaluate("navigator.clipboard.readText()")
        assert shlex.split(copied.replace("\\\n", " ")) == shlex.split(text)
    # Nothing is cut off: no line is wider than its box.
    boxes = "[...document.querySelectorAll('.luxel-snippet pre')]"
    assert page.evaluate(f"{boxes}.every(box => box.scrollWidth <= box.clientWidth)")


def test_switches_show_what_is_on(page: Any, session: Session) -> None:
    """Flying and grabbing are check boxes: another object lets go of the first one."""
    fly = control(page, "Fly")
    assert not fly.is_checked()
    page.locator("label:text-is('Fly')").click()
    wait_for(fly.is_checked, what="the mark")
    page.get_by_role("tab", name="Scene").click()
    page.locator("label:text-is('Grab')").click()
    wait_for(lambda: control(page, "Grab").is_checked(), what="the mark")
    last = len(session.facts.objects)
    choose(page, "Object", f"{last}  {session.facts.objects[-1].name}")
    wait_for(lambda: not control(page, "Grab").is_checked(), what="no mark")


def test_the_error_map_has_a_legend(page: Any, session: Session) -> None:
    page.get_by_text("Compare", exact=True).click()
    choose(page, "With", "none")
    count = page.locator("img").count()
    page.locator("label:text-is('Error map')").click()
    wait_for(lambda: page.locator("img").count() == count + 1, what="the legend")
    page.locator("label:text-is('Error map')").click()
    wait_for(lambda: page.locator("img").count() == count, what="no legend")
