"""Sequences as folders, GIF and MP4."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageSequence

from luxel.errors import LuxelError
from luxel.render.sequence import is_sequence, open_sequence

FRAMES = [np.full((9, 11, 3), level, np.float32) for level in (0.1, 0.5, 0.9)]


def read_png(path: Path) -> np.ndarray:
    """Return (H, W, 3) int64."""
    with Image.open(path) as picture:
        return np.asarray(picture).astype(int)


@pytest.mark.parametrize(
    ("place", "expected"),
    [("out/", True), ("out", True), ("a.gif", True), ("a.MP4", True), ("a.png", False), ("out.d/a.exr", False)],
)
def test_what_is_a_sequence(place: str, expected: bool) -> None:
    assert is_sequence(place) is expected


def test_a_folder_gets_numbered_images(tmp_path: Path) -> None:
    with open_sequence(tmp_path / "new" / "run") as add:
        for frame in FRAMES:
            add(frame)
    files = sorted((tmp_path / "new" / "run").iterdir())
    assert [file.name for file in files] == ["frame_0000.png", "frame_0001.png", "frame_0002.png"]
    assert [int(read_png(file)[0, 0, 0]) for file in files] == [26, 128, 230]


def test_gif_holds_every_frame_and_its_time(tmp_path: Path) -> None:
    path = tmp_path / "run.gif"
    with open_sequence(path, fps=10.0) as add:
        for frame in FRAMES:
            add(frame)
    with Image.open(path) as picture:
        assert getattr(picture, "n_frames", 1) == 3
        assert picture.size == (11, 9)
        assert picture.info["duration"] == 100


def read_gif(path: Path) -> list[tuple[int, int]]:
    """Return (milliseconds, red of the first pixel) of each frame."""
    with Image.open(path) as picture:
        frames = ImageSequence.all_frames(picture)
        return [(frame.info["duration"], int(np.asarray(frame.convert("RGB"))[0, 0, 0])) for frame in frames]


@pytest.mark.parametrize("fps", [15.0, 23.976, 24.0, 30.0, 48.0, 50.0, 59.94, 60.0, 75.0, 100.0, 120.0, 144.0])
def test_a_second_of_scene_is_a_second_of_gif(tmp_path: Path, fps: float) -> None:
    """GIF counts in hundredths of a second, of which players keep two at least: what is left over is carried on."""
    count = round(fps)
    path = tmp_path / "run.gif"
    with open_sequence(path, fps=fps) as add:
        for index in range(count):
            add(np.full((4, 4, 3), index / count, np.float32))
    shown = read_gif(path)
    assert sum(duration for duration, _ in shown) == pytest.approx(1e3 * count / fps, abs=10.0)
    assert min(duration for duration, _ in shown) >= 20
    assert len(shown) == min(count, 50)
    # Each picture stands where it belongs, within a frame and the clock's step.
    start = 0.0
    for duration, red in shown:
        assert red / 255.0 * count / fps == pytest.approx(1e-3 * start, abs=0.03)
        start += duration


def test_a_frame_shorter_than_a_gif_can_hold_still_shows(tmp_path: Path) -> None:
    path = tmp_path / "run.gif"
    with open_sequence(path, fps=240.0) as add:
        add(FRAMES[0])
    assert [duration for duration, _ in read_gif(path)] == [20]


def test_a_frame_longer_than_a_gif_can_hold_is_refused_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(LuxelError, match="0.001 frames a second"), open_sequence(tmp_path / "run.gif", fps=0.001):
        raise AssertionError("the block must not be entered")


def test_a_failed_run_leaves_the_old_gif(tmp_path: Path) -> None:
    path = tmp_path / "run.gif"
    path.write_bytes(b"old")
    with pytest.raises(RuntimeError), open_sequence(path) as add:
        add(FRAMES[0])
        raise RuntimeError
    assert path.read_bytes() == b"old"
    with pytest.raises(LuxelError, match="at least one frame"), open_sequence(path):
        pass
    assert path.read_bytes() == b"old"


def test_a_missing_extra_is_named_before_the_first_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio", None)
    with pytest.raises(LuxelError, match=r"luxel\[video\]"), open_sequence(tmp_path / "run.mp4"):
        raise AssertionError("the block must not be entered")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(importlib.util.find_spec("imageio_ffmpeg") is None, reason="needs the extra luxel[video]")
def test_mp4_takes_odd_sizes(tmp_path: Path) -> None:
    import imageio_ffmpeg  # type: ignore[import-not-found]

    path = tmp_path / "run.mp4"
    with open_sequence(path, fps=25.0) as add:
        for frame in FRAMES:
            add(frame)
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert frames == 3
    assert seconds == pytest.approx(3 / 25.0, abs=0.02)
    assert [file.name for file in tmp_path.iterdir()] == ["run.mp4"]


@pytest.mark.parametrize("fps", [0, -1.0, float("nan"), float("inf"), "fast", None])
@pytest.mark.parametrize("name", ["run.gif", "run.mp4", "run"])
def test_a_rate_that_cannot_be_is_said_before_the_first_frame(tmp_path: Path, name: str, fps: Any) -> None:
    with pytest.raises(LuxelError, match="frames a second above 0"), open_sequence(tmp_path / name, fps):
        raise AssertionError("the block must not be entered")
    assert not list(tmp_path.iterdir())
