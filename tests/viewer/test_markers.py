"""What a click leaves in the scene: discs where the items are, in the colours of looks, those in sight only."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import luxel
from luxel.inspect.explanation import Explanation
from luxel.inspect.ramps import id_colors
from luxel.methods.inspect import Contribution, Discs
from luxel.viewer.app import App
from luxel.viewer.headless_client import HeadlessClient
from luxel.viewer.markers import ANSWERED, LINED, SILENT, Markers, find_visible, item_color, turn_to_normals, unit_disc

from .conftest import start_session, wait_for

WHITE = (1.0, 1.0, 1.0)
TINY: dict[str, Any] = {"texel_target": 800, "surfel_target": 160, "rays_per_texel": 64, "probe_target": 27}


class FakeScene:
    """Notes what is added to it."""

    def __init__(self) -> None:
        self.nodes: dict[str, Any] = {}

    def __getattr__(self, kind: str) -> Any:
        def add(name: str, *values: Any, **more: Any) -> Any:
            node = SimpleNamespace(kind=kind, values=values, visible=True, remove=lambda: self.nodes.pop(name), **more)
            self.nodes[name] = node
            return node

        return add


def make_explanation(count: int, placed: bool = True) -> Explanation:
    share = 1.0 / count
    items = tuple(
        Contribution(10 + k, share * (2 - k % 2), WHITE, p=(float(k), 0.0, 0.0) if placed else None)
        for k in range(count)
    )
    return Explanation(
        pixel=(0, 0),
        method="lightmap",
        item="cluster",
        verdict="",
        words=("Lit.",),
        radiance=WHITE,
        shown=WHITE,
        exposure=1.0,
        hit=True,
        position=(0.0, 1.0, 2.0),
        normal=(0.0, 1.0, 0.0),
        contributions=items,
    )


def make_discs(count: int) -> Discs:
    p = np.zeros((count, 3))
    p[:, 0] = np.arange(count)
    return Discs(10 + np.arange(count), p, np.tile((0.0, 1.0, 0.0), (count, 1)), np.full(count, 0.5))


def rotate(wxyz: np.ndarray, v: np.ndarray) -> np.ndarray:
    w, axis = wxyz[:, :1], wxyz[:, 1:]
    cross = np.cross(axis, np.broadcast_to(v, axis.shape))
    return v + 2.0 * (w * cross + np.cross(axis, cross))


def test_discs_face_along_their_normals() -> None:
    normals = np.random.default_rng(1).normal(size=(40, 3))
    normals = np.concatenate([normals, np.eye(3), -np.eye(3)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    turns = turn_to_normals(normals)
    np.testing.assert_allclose(np.linalg.norm(turns, axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(rotate(turns, np.array([0.0, 0.0, 1.0])), normals, atol=1e-5)
    corners, faces = unit_disc()
    a, b, c = (corners[faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0.0).all()  # seen from their front only


def test_items_with_discs_have_their_own_colours() -> None:
    scene, found, discs = FakeScene(), make_explanation(20), make_discs(20)
    markers = Markers(scene, 10.0)  # pyright: ignore[reportArgumentType]
    visible = np.arange(20) % 2 == 0
    markers.draw(found, discs, visible)
    mesh = scene.nodes["/explain/discs"]
    np.testing.assert_array_equal(mesh.batched_scales > 0.0, visible)
    # Heavier is brighter; the brightest is the colour that looks give the item.
    shown = (mesh.batched_colors / 255.0) ** (1.0 / 2.2)
    np.testing.assert_allclose(shown[::2], id_colors(discs.item[::2]), atol=0.06)
    assert (shown[1::2].sum(axis=1) < id_colors(discs.item[1::2]).sum(axis=1) - 0.1).all()
    ends, tints = scene.nodes["/explain/lines"].values
    assert ends.shape == (LINED, 2, 3)
    np.testing.assert_array_equal(tints[3, 0], item_color(found.contributions[3]))
    markers.show(False)
    assert not any(node.visible for node in scene.nodes.values())
    markers.show_discs(make_discs(20), visible)  # those of an older click: nothing happens
    markers.show_discs(discs, ~visible)
    np.testing.assert_array_equal(mesh.batched_scales > 0.0, ~visible)
    markers.clear()
    assert not scene.nodes and markers.discs is None


def test_items_without_discs_are_dots() -> None:
    scene = FakeScene()
    markers = Markers(scene, 10.0)  # pyright: ignore[reportArgumentType]
    markers.draw(make_explanation(3), None, None)
    assert set(scene.nodes) == {"/explain/point", "/explain/items", "/explain/lines"}
    markers.draw(make_explanation(3, placed=False), None, None)
    assert set(scene.nodes) == {"/explain/point"}


def test_a_dot_is_lit_by_its_reason_not_by_its_weight() -> None:
    """A client that does not see the point keeps a trace of weight: it is no answer, and no line leads to it."""
    from dataclasses import replace

    from luxel.viewer.panels.explain import draw_items

    cases = [(0.7, ""), (0.2, "outside"), (0.1, "borrowed"), (9e-4, "depth"), (1e-9, "normal"), (0.0, "dead")]
    items = tuple(
        Contribution(k, weight, WHITE, why, (float(k), 0.0, 0.0), why) for k, (weight, why) in enumerate(cases)
    )
    scene, found = FakeScene(), replace(make_explanation(1), item="client", contributions=items)
    Markers(scene, 10.0).draw(found, None, None)  # pyright: ignore[reportArgumentType]
    _, colors = scene.nodes["/explain/items"].values
    np.testing.assert_array_equal(colors, [ANSWERED] * 3 + [SILENT] * 3)
    ends, _ = scene.nodes["/explain/lines"].values
    np.testing.assert_array_equal(ends[:, 1, 0], [0.0, 1.0, 2.0])
    text = draw_items(found)
    assert text.count(" %") == 3 and text.count("–") == 3
    assert text.count(f"rgb{ANSWERED}") == text.count(f"rgb{SILENT}") == 3


def test_what_is_hidden_is_found() -> None:
    """Seen from before the Cornell box: the back wall beside the boxes, not the one behind them."""
    renderer = luxel.Renderer("cornell-box", "none", size=(16, 16))
    p = np.array([[0.8, 0.8, -0.99], [0.3, -0.9, -0.99], [-0.9, 0.9, -0.99]])
    discs = Discs(np.arange(3), p, np.tile((0.0, 0.0, 1.0), (3, 1)), np.full(3, 0.02))
    assert find_visible(renderer.scene, (0.0, 0.0, 3.9), discs).tolist() == [True, False, True]
    assert find_visible(renderer.scene, (0.0, 0.0, -3.0), discs).tolist() == [False, False, False]


class Watcher(HeadlessClient):
    """A visitor that also notes what stands in the scene."""

    discs: dict[str, Any] | None = None

    def _take(self, message: dict[str, Any]) -> None:
        super()._take(message)
        if message["type"] == "BatchedMeshesMessage":
            self.discs = message["props"]


def test_a_click_shows_the_clusters_of_the_texel() -> None:
    session = start_session(method="lightmap", **TINY)
    app = App(session, port=0)
    try:
        visitor = Watcher(app.url, window=(240, 168))
        with visitor:
            visitor.look(session.camera)
            visitor.listen(60.0, until_picture=True)
            wait_for(lambda: visitor.listen(0.2) >= 0 and session.visitors()[0].is_sharp, what="a sharp picture")
            visitor.click(0.5, 0.95)
            wait_for(lambda: visitor.listen(0.2) >= 0 and visitor.discs is not None, what="discs in the scene")
            # The look of one point now shows the one that was clicked.
            (there,) = session.visitors()
            visitor.set(visitor.find("Show"), "clusters")
            wait_for(
                lambda: visitor.listen(0.2) >= 0 and there.host_look is not None, what="the clusters in the picture"
            )
            assert there.host_look is not None and there.host_look.legend is not None
            white = np.argwhere(there.host_look.pixels.min(axis=2) > 240)
            height, width = there.host_look.pixels.shape[:2]
            np.testing.assert_allclose(white.mean(axis=0) / (height, width), (0.95, 0.5), atol=0.05)
    finally:
        app.stop()
        session.stop(20.0)
    assert not session.faults


@pytest.mark.parametrize("weight", [0.02, 0.9])
def test_the_list_shows_the_colour_of_each_item(weight: float) -> None:
    from dataclasses import replace

    from luxel.viewer.panels.explain import draw_items

    item = Contribution(77, weight, WHITE, "12 surfels", (0.0, 0.0, 0.0))
    found = replace(make_explanation(1), contributions=(item,))
    color = tuple(int(channel) for channel in item_color(item))
    assert f"rgb{color}" in draw_items(found, True) and f"rgb{color}" not in draw_items(found)
