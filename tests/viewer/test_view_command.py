"""`luxel view` as a command: what it says, where it listens, how it stops."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time as clock
import urllib.request
from collections.abc import Iterator

import pytest

from luxel.cli import main
from luxel.errors import LuxelError
from luxel.viewer.app import find_port

PROGRAM = "import sys; from luxel.cli import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture
def port() -> Iterator[int]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        number = probe.getsockname()[1]
    yield number


def start(port: int, *words: str) -> subprocess.Popen[str]:
    command = [
        sys.executable,
        "-u",
        "-c",
        PROGRAM,
        "view",
        "cornell-box",
        "--port",
        str(port),
        "--device",
        "cpu",
        *words,
    ]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_until_it_serves(program: subprocess.Popen[str]) -> str:
    """Return what it says on standard output until it serves."""
    said = ""
    assert program.stdout is not None
    while "Ctrl-C" not in said:
        line = program.stdout.readline()
        assert line, program.communicate()[1]
        said += line
    return said


def answers(port: int) -> bool:
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=5) as page:
            return page.status == 200
    except OSError:
        return False


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_and_stops_within_a_second(port: int, number: int) -> None:
    program = start(port)
    try:
        said = wait_until_it_serves(program)
        assert answers(port)
        asked = clock.perf_counter()
        program.send_signal(number)
        out, err = program.communicate(timeout=20)
        took = clock.perf_counter() - asked
    finally:
        program.kill()
    assert took < 1.5  # a second, and what a busy machine adds
    assert program.returncode == 0
    assert f"open http://localhost:{port}" in said and "stopped" in out
    assert "Traceback" not in err


def test_it_listens_on_this_machine_only_unless_told(port: int) -> None:
    program = start(port, "--host", "0.0.0.0")
    try:
        wait_until_it_serves(program)
        program.send_signal(signal.SIGINT)
        _, err = program.communicate(timeout=20)
    finally:
        program.kill()
    assert "whoever reaches this machine" in err and "no password" in err


def test_a_taken_port_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        number = taken.getsockname()[1]
        assert main(["view", "cornell-box", "--port", str(number), "--device", "cpu"]) == 2
        assert f"port {number}" in capsys.readouterr().err
        assert find_port("127.0.0.1", None) != number
    with pytest.raises(LuxelError, match="cannot listen"):
        find_port("203.0.113.1", None)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["view", "no-such-scene"], "no scene"),
        (["view", "cornell-box", "--method", "nothing"], "unknown method"),
        (["view", "cornell-box", "--set", "rays_per_surfel=0"], "rays_per_surfel"),
        (["view", "cornell-box", "--size", "wide"], "WIDTHxHEIGHT"),
    ],
)
def test_bad_input_is_one_sentence(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*words, "--device", "cpu"]) == 2
    err = capsys.readouterr().err
    assert message in err and "Traceback" not in err


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["view", "cornell-box"]) == 2
    assert "luxel[view]" in capsys.readouterr().err
