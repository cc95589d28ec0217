"""What the panels compute before anything is drawn."""

from __future__ import annotations

import re
import shlex
from html import unescape
from unittest.mock import MagicMock

import numpy as np
import pytest

from luxel.image.layers import Layers
from luxel.inspect.explanation import Explanation
from luxel.inspect.ramps import colorize
from luxel.methods.inspect import Contribution
from luxel.viewer.compare import ERROR_LEGEND, draw_error, enlarge, join_halves, measure
from luxel.viewer.panels.explain import draw_facts, draw_items
from luxel.viewer.panels.light import join_color, split_color
from luxel.viewer.panels.objects import ObjectsPanel
from luxel.viewer.panels.share import wrap_command
from luxel.viewer.panels.snippets import draw_snippet
from luxel.viewer.panels.stats import draw_bars, draw_table


def make_layers(indirect: float) -> Layers:
    shape = (32, 32, 3)
    zeros, ones = np.zeros(shape, np.float32), np.ones(shape, np.float32)
    return Layers(0.5 * ones, zeros, ones, indirect * ones, zeros, ones[..., 0], np.ones(shape[:2], bool))


def test_the_split_is_where_it_is_asked_for() -> None:
    left, right = np.full((8, 16, 3), 10, np.uint8), np.full((8, 16, 3), 200, np.uint8)
    joined = join_halves(left, right, 0.5)
    assert (joined[:, :7] == 10).all() and (joined[:, 9:] == 200).all() and (joined[:, 7:9] == 255).all()
    assert (join_halves(left, right, 0.0) == 200).all()
    assert (join_halves(left, right, 1.0) == 10).all()


def test_a_coarse_half_is_enlarged_to_the_fine_one() -> None:
    coarse = np.arange(4, dtype=np.uint8).reshape(2, 2, 1).repeat(3, axis=2)
    assert join_halves(coarse, np.zeros((8, 8, 3), np.uint8), 1.0).shape == (8, 8, 3)
    np.testing.assert_array_equal(enlarge(coarse, 4, 4)[..., 0], np.kron([[0, 1], [2, 3]], np.ones((2, 2))))


def test_the_error_map_is_dark_without_error_and_bright_with() -> None:
    truth = make_layers(1.0)
    dark, bright = (np.rint(255.0 * colorize(np.array(place), "heat")).tolist() for place in (0.0, 1.0))
    assert (draw_error(truth, truth) == dark).all() and max(dark) < 50
    assert (draw_error(make_layers(40.0), truth) == bright).all() and min(bright) > 150
    # The legend beside the map says what the brightest colour is.
    assert ERROR_LEGEND.scale is not None and ERROR_LEGEND.scale.high == 0.5
    figures = measure(make_layers(1.5), truth)
    assert figures["bias"] == pytest.approx(0.5, abs=1e-5)
    assert figures["regional"] == pytest.approx(0.5, abs=1e-5)


def test_what_is_let_go_before_it_was_taken_gets_no_gizmo() -> None:
    """The world takes an object between two frames; another may be chosen before that."""
    connection = MagicMock()
    panel = ObjectsPanel(connection)
    panel.build()
    panel.grab(0)
    (take,) = connection.post.call_args.args
    panel._let_go()
    world, visitor = MagicMock(), MagicMock()
    take(world, visitor)
    connection.client.scene.add_transform_controls.assert_not_called()
    assert not world.mock_calls and panel._gizmo is None


def test_what_is_let_go_while_it_is_being_taken_loses_its_gizmo(monkeypatch: pytest.MonkeyPatch) -> None:
    """To hold an object may mean to build the scene anew, which takes seconds."""
    connection = MagicMock()
    panel = ObjectsPanel(connection)
    panel.build()
    monkeypatch.setattr("luxel.viewer.panels.objects.hold", lambda *_: panel._let_go())
    item = MagicMock(matrix=np.eye(4), middle=np.zeros(3), size=1.0)
    monkeypatch.setattr("luxel.viewer.panels.objects.describe_object", lambda *_: item)
    connection.facts.lower, connection.facts.upper, connection.facts.origin = np.zeros(3), np.ones(3), np.zeros(3)
    panel.grab(0)
    (take,) = connection.post.call_args.args
    take(MagicMock(), MagicMock())
    connection.client.scene.add_transform_controls.return_value.remove.assert_called_once()
    assert panel._gizmo is None


@pytest.mark.parametrize("color", [(18.387, 13.9873, 6.75357), (1.0, 0.0, 0.0), (0.2, 0.2, 0.2)])
def test_a_light_survives_its_two_controls(color: tuple[float, float, float]) -> None:
    display, power = split_color(color)
    assert max(display) == 255 and power == pytest.approx(max(color), abs=1e-4)
    np.testing.assert_allclose(join_color(display, power), color, atol=0.01 * max(color))


def test_no_light_has_a_colour_too() -> None:
    assert split_color((0.0, 0.0, 0.0)) == ((255, 255, 255), 0.0)
    assert join_color((0, 0, 0), 2.0) == (2.0, 2.0, 2.0)


def test_a_wrapped_command_is_the_same_command() -> None:
    command = "luxel render 'my scene.glb' --method gibs --camera='1,2,3;0,0,0;60' -o out.png"
    wrapped = wrap_command(command)
    assert wrapped.count("\n") == 3
    assert shlex.split(wrapped.replace("\\\n", " ")) == shlex.split(command)


def test_a_snippet_holds_the_text_as_it_is() -> None:
    text = "luxel render '<b>.glb' --set a=1 && echo \"done\""
    drawn = draw_snippet("In a <shell>", text)
    found = re.search(r"<code[^>]*>(.*?)</code>", drawn, re.DOTALL)
    assert found is not None and unescape(found[1]) == text
    assert "<b>.glb" not in drawn and "<shell>" not in drawn and drawn.count("<button") == 1


def test_names_cannot_write_markup() -> None:
    assert "<b>" not in draw_table([("<b>name", "<b>value")]) + draw_bars({"<b>stage": 1.0})


def test_items_are_listed_with_shares_and_reasons() -> None:
    items = (
        Contribution(7, 0.75, (1.0, 1.0, 1.0)),
        Contribution(9, 0.25, (1.0, 1.0, 1.0)),
        *(Contribution(number, 0.0, (0.0, 0.0, 0.0), "too far") for number in range(20)),
    )
    found = Explanation(
        pixel=(3, 4),
        method="gibs",
        item="surfel",
        verdict="",
        words=("It is lit.",),
        radiance=(1.0, 1.0, 1.0),
        shown=(1.0, 1.0, 1.0),
        exposure=1.0,
        hit=True,
        position=(0.0, 1.0, 2.0),
        normal=(0.0, 1.0, 0.0),
        object_name="box",
        contributions=items,
    )
    listed = draw_items(found)
    assert "surfel 7" in listed and "75 %" in listed and "too far" in listed and "and 10 more" in listed
    assert "box" in draw_facts(found) and "3, 4" in draw_facts(found)
