"""The command line: thin. Parse, call, print; nothing heavy is imported before it is needed."""

from __future__ import annotations

from luxel.cli.app import main

__all__ = ["main"]
