"""A frozen function that outlives changes of Dr.Jit's registry."""

from __future__ import annotations

from collections.abc import Callable
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
                if "registry" not in str(error):
                    raise
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
