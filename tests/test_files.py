"""Files appear whole or not at all."""

from __future__ import annotations

import errno
import json
import os
import stat
import threading
from pathlib import Path

import numpy as np
import pytest

from luxel import files
from luxel.errors import LuxelError

SOURCE = Path(files.__file__).parent


def names(folder: Path) -> list[str]:
    return sorted(file.name for file in folder.iterdir())


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit, OSError])
@pytest.mark.parametrize("old", [None, "old"])
def test_a_write_that_fails_half_way_leaves_the_old_file_alone(
    tmp_path: Path, error: type[BaseException], old: str | None
) -> None:
    path = tmp_path / "file.txt"
    if old is not None:
        path.write_text(old)
    with pytest.raises(LuxelError if error is OSError else error), files.replacing(path) as beside:
        beside.write_text("half")
        raise error
    assert names(tmp_path) == ([] if old is None else ["file.txt"])
    assert old is None or path.read_text() == old


def test_a_full_disk_leaves_the_old_file_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(files.os, "fsync", fail)
    path = tmp_path / "file.npz"
    path.write_text("old")
    for write in (
        lambda: files.write_bytes(path, b"new"),
        lambda: files.write_text(path, "new"),
        lambda: files.write_npz(path, {"a": np.arange(3)}),
    ):
        with pytest.raises(LuxelError, match="disk is full"):
            write()
    assert path.read_text() == "old" and names(tmp_path) == ["file.npz"]


def test_two_writers_at_once_do_not_mix(tmp_path: Path) -> None:
    path = tmp_path / "file.bin"
    with files.replacing(path) as first, files.replacing(path) as second:
        assert first != second
        first.write_bytes(b"first")
        second.write_bytes(b"second")
    # The one that ends last stays, whole.
    assert path.read_bytes() == b"first" and names(tmp_path) == ["file.bin"]

    contents = [bytes([value]) * 100_000 for value in range(8)]
    start = threading.Barrier(len(contents))

    def write(data: bytes) -> None:
        start.wait()
        for _ in range(5):
            files.write_bytes(path, data)

    threads = [threading.Thread(target=write, args=(data,)) for data in contents]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert path.read_bytes() in contents and names(tmp_path) == ["file.bin"]


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_a_new_file_has_the_permissions_of_an_ordinary_one_and_an_old_one_keeps_its_own(
    tmp_path: Path, mask: int
) -> None:
    path, plain = tmp_path / "file.txt", tmp_path / "plain.txt"
    before = os.umask(mask)
    try:
        files.write_text(path, "new")
        plain.open("w").close()
    finally:
        os.umask(before)
    assert mode(path) == mode(plain) == 0o666 & ~mask
    path.chmod(0o640)
    files.write_text(path, "newer")
    assert mode(path) == 0o640


def test_places_are_taken_as_they_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    longest = "a" * 251 + ".txt"
    for path in ("file.txt", "./other", "new/folder/file.tar.gz", longest):
        files.write_text(path, path)
        assert (tmp_path / path).read_text() == path
    assert names(tmp_path) == sorted(["file.txt", "new", "other", longest])


@pytest.mark.parametrize("place", ["state.npz", "state", "state.luxel"])
@pytest.mark.parametrize("compress", [False, True])
def test_arrays_are_written_under_any_name(tmp_path: Path, place: str, compress: bool) -> None:
    files.write_npz(tmp_path / place, {"a": np.arange(3), "b.c": np.array("text"), "n": 4}, compress=compress)
    assert names(tmp_path) == [place]
    with (tmp_path / place).open("rb") as stream, np.load(stream) as held:
        assert held["a"].tolist() == [0, 1, 2] and str(held["b.c"]) == "text" and int(held["n"]) == 4


def test_no_permission_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Faked, because the tests may run as root, whom permissions do not stop.
    def deny(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(files.os, "open", deny)
    monkeypatch.setattr(files.tempfile, "TemporaryFile", deny)
    for attempt in (files.require_writable, lambda path: files.write_text(path, "")):
        with pytest.raises(LuxelError, match="no permission") as caught:
            attempt(tmp_path / "image.png")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("place", ["folder", "file/image.png"])
def test_places_that_cannot_be_written(tmp_path: Path, place: str) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("")
    for attempt in (files.require_writable, lambda path: files.write_text(path, "")):
        with pytest.raises(LuxelError, match="folder"):
            attempt(tmp_path / place)


def test_a_link_stays_a_link_and_its_file_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "file.txt").write_text("old")
    for name, target in (("link", "far/file.txt"), ("to-come", "far/new.txt")):
        link = tmp_path / name
        link.symlink_to(target)
        files.require_writable(link)
        files.write_text(link, name)
        assert link.is_symlink() and (tmp_path / target).read_text() == name
    assert names(tmp_path) == ["far", "link", "to-come"] and names(tmp_path / "far") == ["file.txt", "new.txt"]
    circle = tmp_path / "circle"
    circle.symlink_to("circle")
    for attempt in (files.require_writable, lambda path: files.write_text(path, "")):
        with pytest.raises(LuxelError, match="circle"):
            attempt(circle)


def test_devices_and_pipes_are_not_replaced_by_files(tmp_path: Path) -> None:
    pipe, link = tmp_path / "pipe", tmp_path / "link"
    os.mkfifo(pipe)
    link.symlink_to("pipe")
    for path in (pipe, link):
        for attempt in (files.require_writable, lambda path: files.write_text(path, "")):
            with pytest.raises(LuxelError, match="device or a pipe; name a file"):
                attempt(path)
    assert stat.S_ISFIFO(pipe.stat().st_mode) and names(tmp_path) == ["link", "pipe"]


def test_asking_leaves_no_file_and_does_not_touch_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "image.png"
    path.write_text("old")
    files.require_writable(path)
    files.require_writable(tmp_path / "other.png")
    assert path.read_text() == "old"
    assert names(tmp_path) == ["image.png"]


def test_json_is_strict() -> None:
    value = {"a": np.float32(0.5), "b": np.array([1, 2]), "c": (Path("x"), None), "d": float("nan"), 3: np.int64(4)}
    assert json.loads(files.to_json(value)) == {"a": 0.5, "b": [1, 2], "c": ["x", None], "d": None, "3": 4}
    assert json.loads(files.to_json([float("inf"), np.float32("nan"), True])) == [None, None, True]


def test_renaming_stands_in_one_place() -> None:
    renames = [path.name for path in SOURCE.rglob("*.py") if "os.replace(" in path.read_text()]
    assert renames == ["files.py"]
