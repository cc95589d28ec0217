"""Methods without an inspector or a workload: all goes on without them, and says so."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import pytest

from luxel import runtime
from luxel.cli import main
from luxel.errors import LuxelError
from luxel.inspect.explain import explain_pixel
from luxel.inspect.looks import draw_look, list_looks, take_shot
from luxel.methods import METHODS, Inspector, Light, Look, Method
from luxel.render.floor import count_rays, measure_floor
from luxel.render.renderer import Renderer


@dataclass
class Level:
    level: mi.Float


class Bare(Method):
    """As little as a method can be: it answers one number."""

    @dataclass
    class Params:
        level: float = 0.5
        """Irradiance everywhere."""

    name: ClassVar[str] = "bare"

    def build(self, scene, params, seed, *, workdir=None, progress=None):
        return Level(dr.opaque(mi.Float, params.level))

    def query(self, scene, state, surface):
        return Light(mi.Color3f(state.level), mi.Color3f(0.0), dr.select(surface.active, mi.Float(1.0), 0.0))


class Forgetful(Inspector):
    """Promises looks, and has nothing that reads them."""

    looks: ClassVar[tuple[Look, ...]] = (Look("level", "the level", "number"), Look("from", "from where", "source"))


@pytest.fixture
def bare() -> Iterator[Bare]:
    METHODS["bare"] = made = Bare()
    yield made
    del METHODS["bare"]


def rendered() -> Renderer:
    renderer = Renderer("cornell-box", "bare", size=(16, 16))
    renderer.run(2)
    return renderer


def test_all_goes_on_without_an_inspector(bare: Bare) -> None:
    runtime.start()
    shot = take_shot(rendered())
    found = explain_pixel(shot, 8, 14)
    assert not found.inspected and not found.contributions
    assert "Method 'bare' has no inspector, so nothing can be told or drawn of its cache." in found.words
    names = [look.name for look in list_looks(bare)]
    assert {"image", "irradiance"} <= set(names)
    assert draw_look("irradiance", shot).image.shape == (16, 16, 3)
    with pytest.raises(LuxelError, match="no look 'probes'.*no inspector"):
        draw_look("probes", shot)


def test_without_a_workload_neither_rays_nor_floor_are_told(bare: Bare) -> None:
    renderer = rendered()
    assert count_rays(renderer) is None and measure_floor(renderer) is None


def test_the_command_line_says_that_nothing_is_inspected(bare: Bare, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", "cornell-box", "--method", "bare", "--look", "list"]) == 0
    said = capsys.readouterr()
    assert "irradiance" in said.out and "method 'bare' has no inspector" in said.err
    words = ["explain", "cornell-box", "--pixel", "8,14", "--method", "bare", "--size", "16x16", "--frames", "2"]
    assert main(words) == 0
    assert "Method 'bare' has no inspector" in capsys.readouterr().out


@pytest.mark.parametrize(("look", "lacks"), [("level", "no `read`"), ("from", "no `sources`")])
def test_an_inspector_that_promises_too_much_is_named(
    bare: Bare, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, look: str, lacks: str
) -> None:
    monkeypatch.setattr(Bare, "inspector", Forgetful())
    shot = take_shot(rendered())
    with pytest.raises(LuxelError, match=f"Forgetful lists .*{lacks}"):
        draw_look(look, shot)


def test_the_viewer_says_it_too(bare: Bare) -> None:
    from luxel.viewer.host_looks import looks_of, shows_a_point, uninspected

    assert "no inspector" in uninspected("bare") and not uninspected("gibs") and not uninspected("none")
    assert "irradiance" in looks_of("bare") and not shows_a_point("bare", "irradiance")
