"""The one exception that means "the input was wrong": one clear sentence, exit code 2."""

from __future__ import annotations


class LuxelError(Exception):
    """Bad input: the message is one sentence that says what, where and what to do.

    The command line prints it and exits with code 2; library users may catch it.
    """
