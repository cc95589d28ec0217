"""The app, and what its exit codes mean: 0 done, 2 bad input, 1 a fault of luxel's own, 130 interrupted."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence
from typing import Any

import typer
from typer.main import get_command

from luxel.cli.bake import bake, relight
from luxel.cli.bench import bench
from luxel.cli.compare import compare
from luxel.cli.doctor import doctor
from luxel.cli.explain import explain
from luxel.cli.options import TRUTH_SPP
from luxel.cli.render import render
from luxel.cli.report import report
from luxel.cli.reproduce import reproduce
from luxel.cli.scenes import scenes
from luxel.cli.view import view
from luxel.errors import LuxelError

app = typer.Typer(
    name="luxel",
    help="Real-time diffuse global illumination, every method beside path-traced truth.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (render, view, explain, compare, report, bake, relight, bench, reproduce, scenes, doctor):
    app.command()(command)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line `argv` (default: that of the process) and return the exit code.

    Errors are one sentence on stderr; with `--debug` the traceback stands above it.
    """
    words = fill_in_spp(sys.argv[1:] if argv is None else argv)
    try:
        command: Any = get_command(app)
        require_values(command, words)
        return command(words, prog_name="luxel", standalone_mode=False) or 0
    except typer.Exit as stop:
        return stop.exit_code
    except (KeyboardInterrupt, typer.Abort):
        return 130
    except LuxelError as error:
        return _fail(str(error), 2, "--debug" in words)
    except BrokenPipeError:
        # The reader of a pipe has gone (`luxel scenes | head -1`): not a fault, and nobody is left to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        # What the parser raises knows its own message and exit code; its class is not public.
        if hasattr(error, "format_message"):
            return _fail(_describe_usage(error), getattr(error, "exit_code", 2), "--debug" in words)
        from luxel.methods.own import describe_fault

        fault = describe_fault(error)
        if fault is not None:
            return _fail(f"{fault} (--debug shows the traceback)", 2, "--debug" in words)
        text = " ".join(f"{type(error).__name__}: {error}".split())
        return _fail(f"internal error: {text} (run again with --debug)", 1, "--debug" in words)


def fill_in_spp(argv: Sequence[str]) -> list[str]:
    """Return `argv` with the default sample count behind every `--truth` that has none."""
    words: list[str] = []
    for place, word in enumerate(argv):
        words.append(word)
        following = argv[place + 1] if place + 1 < len(argv) else ""
        if word == "--truth" and not following.isdecimal():
            words.append(str(TRUTH_SPP))
    return words


def require_values(group: Any, words: Sequence[str]) -> None:
    """Raise LuxelError where an option that takes a value is the last word, or another option stands after it.

    The parser would take that one for the value, and complain of something else or of nothing.
    """
    command = group.commands.get(words[0]) if words else None
    if command is None:
        return
    options = {name: one for one in command.params for name in (*one.opts, *one.secondary_opts) if name[:1] == "-"}
    rest = iter(words[1:])
    for word in rest:
        if word == "--":
            return
        option = options.get(word)
        if option is None or option.is_flag:
            continue
        value = next(rest, None)
        if value is None or value in options or value == "--help":
            form = f": {option.metavar}" if option.metavar else ""
            raise LuxelError(f"option '{word}' requires a value{form} (see luxel {words[0]} --help)")


def _describe_usage(error: Exception) -> str:
    """Return what is wrong with the command line; nothing for an empty one, whose help has been shown."""
    message = " ".join(getattr(error, "format_message", lambda: "")().split()).rstrip(".")
    path = getattr(getattr(error, "ctx", None), "command_path", "luxel")
    return f"{message} (see {path} --help)" if message else ""


def _fail(message: str, code: int, debug: bool) -> int:
    if debug:
        traceback.print_exc()
    if message:
        print(f"luxel: {message}", file=sys.stderr)
    return code
