"""Files appear whole or not at all."""

from __future__ import annotations

import errno
import json
import os
import stat
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from luxel.errors import LuxelError
from luxel.render import write
from luxel.render.tonemap import to_display, write_image

IMAGE = np.random.default_rng(7).random((5, 7, 3)).astype(np.float32) * 2.0


def read_png(path: Path) -> np.ndarray:
    """Return (H, W, 3) int64."""
    with Image.open(path) as picture:
        return np.asarray(picture).astype(int)


def test_png_is_the_displayed_image(tmp_path: Path) -> None:
    path = tmp_path / "new" / "folder" / "image.png"
    write_image(path, IMAGE, 0.5)
    read = read_png(path)
    assert read.shape == (5, 7, 3)
    np.testing.assert_allclose(read / 255.0, to_display(IMAGE, 0.5), atol=0.5 / 255 + 1e-6)


def test_exr_keeps_linear_floats(tmp_path: Path) -> None:
    import mitsuba as mi

    path = tmp_path / "image.exr"
    write_image(path, IMAGE, 0.5)
    np.testing.assert_array_equal(np.array(mi.Bitmap(str(path))), IMAGE)


def test_a_new_file_can_be_read_by_others_and_an_old_one_keeps_its_permissions(tmp_path: Path) -> None:
    path = tmp_path / "image.png"
    mask = os.umask(0o022)
    try:
        write_image(path, IMAGE)
    finally:
        os.umask(mask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o644
    path.chmod(0o600)
    write_image(path, IMAGE)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_a_full_disk_leaves_the_old_file_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "image.png"
    write_image(path, IMAGE)
    before = path.read_bytes()

    def fail(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(write.os, "fsync", fail)
    with pytest.raises(LuxelError, match="disk is full"):
        write_image(path, IMAGE * 0.5)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["image.png"]


def test_an_interrupted_write_leaves_nothing_behind(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    path.write_text("old")
    with pytest.raises(KeyboardInterrupt), write.replacing(path) as beside:
        beside.write_text("half")
        raise KeyboardInterrupt
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["file.txt"]


def test_no_permission_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Faked, because the tests may run as root, whom permissions do not stop.
    def deny(**_: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(write.tempfile, "mkstemp", deny)
    monkeypatch.setattr(write.tempfile, "TemporaryFile", deny)
    for attempt in (write.require_writable, lambda path: write_image(path, IMAGE)):
        with pytest.raises(LuxelError, match="no permission") as caught:
            attempt(tmp_path / "image.png")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("place", ["folder", "file/image.png"])
def test_places_that_cannot_be_written(tmp_path: Path, place: str) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("")
    for attempt in (write.require_writable, lambda path: write.write_text(path, "")):
        with pytest.raises(LuxelError, match="folder"):
            attempt(tmp_path / place)


def test_asking_leaves_no_file_and_does_not_touch_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "image.png"
    path.write_text("old")
    write.require_writable(path)
    write.require_writable(tmp_path / "other.png")
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["image.png"]


def test_json_is_strict() -> None:
    value = {"a": np.float32(0.5), "b": np.array([1, 2]), "c": (Path("x"), None), "d": float("nan"), 3: np.int64(4)}
    assert json.loads(write.to_json(value)) == {"a": 0.5, "b": [1, 2], "c": ["x", None], "d": None, "3": 4}
    assert json.loads(write.to_json([float("inf"), np.float32("nan"), True])) == [None, None, True]
