"""Sequences start warm: by default until the view is covered, else after so many frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from luxel.cli import main
from luxel.errors import LuxelError
from luxel.render.animate import COVER_FRAMES, cover_view, render_sequence, warm_up
from luxel.render.renderer import WARM_UP_FRAMES, Renderer
from luxel.scene import load


def test_the_view_is_covered_before_the_first_picture(tmp_path: Path) -> None:
    renderer = Renderer(load("cornell-box"), "gibs", {"surfel_target": 4000}, size=(48, 48))
    times, compiled = render_sequence(renderer, f"{tmp_path}/run/", 2, exposure=1.0)
    assert len(times) == 2 and compiled == 0 and WARM_UP_FRAMES + 2 < renderer.frame_index < COVER_FRAMES
    layers = renderer.layers()
    assert (layers.weight[layers.hit] >= 1.0).mean() >= 0.98
    # The first picture is as bright as the last: nothing of the cache's beginnings shows.
    first, last = (np.asarray(Image.open(path), float).mean() for path in sorted((tmp_path / "run").iterdir()))
    assert first == pytest.approx(last, rel=0.01)


def test_a_number_of_frames_is_kept_to(tmp_path: Path) -> None:
    renderer = Renderer(load("cornell-box"), "none", size=(16, 16))
    render_sequence(renderer, f"{tmp_path}/cold/", 3, warm_up_frames=0)
    assert renderer.frame_index == 3
    warm_up(renderer, 5, start=2.0, fps=10.0)
    assert renderer.frame_index == 8 and renderer.time == pytest.approx(1.9)
    with pytest.raises(LuxelError, match="0 or more"):
        warm_up(renderer, -1)


def test_a_method_that_never_answers_in_full_does_not_hold_up_the_sequence() -> None:
    renderer = Renderer(load("cornell-box"), "none", size=(16, 16))
    share = cover_view(renderer)
    assert renderer.frame_index <= 2 * WARM_UP_FRAMES and 0.0 <= share <= 1.0


def test_warm_up_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["render", "cornell-box", "--method", "none", "--size", "16x16", "--frames", "2", "--warm-up", "1"]
    assert main([*words, "-o", str(tmp_path / "run.gif")]) == 0
    assert (tmp_path / "run.gif").exists()
    assert main([*words, "-o", str(tmp_path / "one.png")]) == 2
    assert "--warm-up is for sequences" in capsys.readouterr().err
