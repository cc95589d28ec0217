"""Boxes planned on the host: they enclose the scene, have near-cubic cells, and say what is wrong with their text."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.methods.ddgi.boxes import ProbeBox, plan_boxes
from luxel.methods.ddgi.params import DdgiParams

EXTENTS = [(2.0, 2.0, 2.0), (30.0, 5.0, 12.0), (1.0, 1.0, 9.0), (300.0, 40.0, 100.0)]


def plan(extent: tuple[float, ...], **settings: object) -> list[ProbeBox]:
    lower = np.array([-1.0, 3.0, 10.0])
    return plan_boxes(DdgiParams(**settings), lower, lower + np.array(extent))  # type: ignore[arg-type]


@pytest.mark.parametrize("extent", EXTENTS)
@pytest.mark.parametrize("target", [200, 2000, 50000])
def test_a_fitted_box_encloses_the_scene_with_near_cubic_cells(extent: tuple[float, ...], target: int) -> None:
    (box,) = plan(extent, probe_target=target)
    np.testing.assert_allclose(box.middle, np.array([-1.0, 3.0, 10.0]) + 0.5 * np.array(extent))
    margin = 0.5 * (np.array(box.size) - extent) / box.spacing
    assert margin.min() > 0.25 and margin.max() < 1.5
    # Few probes leave whole numbers little choice.
    assert box.spacing.max() < (2.0 if target > 1000 else 2.6) * box.spacing.min()
    assert 0.5 * target < box.probe_count <= target


@pytest.mark.parametrize("extent", [(8.0, 0.0, 8.0), (20.0, 0.1, 20.0), (0.0, 3.0, 4.0)])
def test_a_flat_scene_has_near_cubic_cells_too(extent: tuple[float, ...]) -> None:
    """A lone floor must not get four planes of probes within a millimetre: biases and reach are in shortest cells."""
    (box,) = plan(extent)
    assert box.spacing.max() < 3.0 * box.spacing.min()


def test_given_numbers_are_kept() -> None:
    (box,) = plan((8.0, 3.0, 4.0), num_probes_x=9, num_probes_y=2, num_probes_z=5)
    assert box.counts == (9, 2, 5)
    assert box.size[0] > 8.0 and box.size[1] == 1.5 and box.size[2] > 4.0, "two probes stand inside"
    (box,) = plan((8.0, 3.0, 4.0), num_probes_y=7)
    assert box.counts[1] == 7 and 1000 < box.probe_count <= 2000
    (box,) = plan((8.0, 3.0, 4.0), probe_box_size=(4.0, 0.0, 2.0), world_offset=(1.0, 2.0, 3.0))
    assert box.size[0] == 4.0 and box.size[2] == 2.0 and box.size[1] > 3.0
    np.testing.assert_allclose(box.middle, (-1.0 + 4.0 + 1.0, 3.0 + 1.5 + 2.0, 10.0 + 2.0 + 3.0))


def test_cascades_double() -> None:
    boxes = plan((8.0, 3.0, 4.0), cascades=3)
    assert len(boxes) == 3 and len({box.counts for box in boxes}) == len({box.middle for box in boxes}) == 1
    for fine, coarse in zip(boxes[:-1], boxes[1:], strict=True):
        np.testing.assert_allclose(coarse.spacing, 2.0 * fine.spacing)


def test_a_box_is_read_with_its_turn() -> None:
    coarse, fine = "0,0,0 size 8,8,8 probes 3,3,3", "1,2,3 size 4,2,6 probes 5,3,7 TURN 30"
    first, second = plan((8.0, 3.0, 4.0), boxes=f"{coarse}; {fine};")
    assert first == ProbeBox((1.0, 2.0, 3.0), (4.0, 2.0, 6.0), (5, 3, 7), 30.0), "the finest comes first"
    assert second.counts == (3, 3, 3)
    np.testing.assert_allclose(first.axes @ first.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(first.axes) == pytest.approx(1.0)
    # Conventions: angles about Y run from +Z towards +X.
    np.testing.assert_allclose(first.axes[2], (0.5, 0.0, np.sqrt(0.75)), atol=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        "here",
        "0,0,0 size 1,1 probes 2,2,2",
        "0,0,0 size 1,1,-1 probes 2,2,2",
        "0,0,0 size 1,1,1 probes 1,2,2",
        "0,0,0 size 1,1,nan probes 2,2,2",
        "0,0,0 size 1,1,1 probes 2,2,inf",
        "0,0,0 size 1,1,1 probes 2,2,2 turn left",
        "0,0,0,0 size 1,1 probes 2,2,2",
        "0,0,0 size 1,1,1 probes 2.7,2,2",
        "0,0,0 size 1,1,1 probes 1e300,2,2",
        ";",
    ],
)
def test_bad_text_is_refused(text: str) -> None:
    with pytest.raises(LuxelError, match="ddgi: .*box"):
        plan((1.0, 1.0, 1.0), boxes=text)


@pytest.mark.parametrize("other", [{"follow_camera": True}, {"cascades": 2}])
def test_boxes_contradict_what_moves(other: dict) -> None:
    with pytest.raises(LuxelError, match="boxes"):
        plan((1.0, 1.0, 1.0), boxes="0,0,0 size 1,1,1 probes 2,2,2", **other)


@pytest.mark.parametrize("count", [2, 3])
def test_few_probes_share_out_the_inside(count: int) -> None:
    """In the margin they would all stand outside the room that they are to light."""
    params = DdgiParams(num_probes_x=count, num_probes_y=count, num_probes_z=count)
    found = plan_boxes(params, np.zeros(3), np.full(3, 4.0))[0]
    assert found.size == pytest.approx([4.0 * (count - 1) / count] * 3)
