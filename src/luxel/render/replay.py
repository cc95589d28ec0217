"""A frozen function that outlives changes of Dr.Jit's registry."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import drjit as dr

from luxel.render.collection import collection_paused

KEPT_RECORDINGS = 8


class Replay:
    """A frozen function that records itself anew where Dr.Jit's registry of shapes has changed.

    Scenes that come and go elsewhere in the process change it, and a replay then refuses before it launches anything.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self._frozen: Any = self._freeze()
        self._before = 0

    def __call__(self, *arguments: Any) -> Any:
        with collection_paused():
            try:
                return self._frozen(*arguments)
            except RuntimeError as error:
                fault = error
            if "registry" not in str(fault):
                # What the function raised while it was recorded says more than Dr.Jit's word that it did.
                raise fault.__cause__ or fault
            self._before += self._frozen.n_recordings
            self._frozen = self._freeze()
            return self._frozen(*arguments)

    def _freeze(self) -> Any:
        # Whoever turns the dials may ask for many recordings over a session; only the last ones are kept.
        return dr.freeze(self._function, limit=KEPT_RECORDINGS, warn_after=1 << 30)

    @property
    def recordings(self) -> int:
        """How often the function was recorded; each recording may compile kernels, a replay never does."""
        return self._before + self._frozen.n_recordings


def constants_of(*trees: Any) -> tuple[Any, ...]:
    """Return the plain numbers, words and gaps of records: what a recording has built in.

    Dr.Jit compares them when it looks for a recording, but takes one that occurs a second time for any other that
    does (seen in 1.5: a flag turned on was not noticed where another flag was on already). So they choose the replay.
    """
    return tuple(_walk(trees))


def _walk(tree: Any) -> Iterator[Any]:
    if tree is None or isinstance(tree, bool | int | float | str):
        yield tree
    elif isinstance(tree, list | tuple):
        yield len(tree)
        for item in tree:
            yield from _walk(item)
    elif is_dataclass(tree) and not isinstance(tree, type):
        for item in fields(tree):
            yield from _walk(getattr(tree, item.name))
