"""What a file holds that luxel does not do, said once."""

from __future__ import annotations

NAMES_SHOWN = 4


class Warnings:
    """What a file holds that luxel does not do: one sentence per kind, naming where."""

    def __init__(self) -> None:
        self._names: dict[tuple[str, bool], dict[str, None]] = {}
        """The names given with a sentence, and whether it is of the diffuse condition alone."""

    def add(self, sentence: str, name: str = "", *, diffuse_only: bool = False) -> None:
        """Note `sentence`; its "{names}" becomes the list of all names given with it.

        `diffuse_only`: full materials do what it says is not done. A sentence that holds of some names always and of
        others under the diffuse condition alone is said twice.
        """
        names = self._names.setdefault((sentence, diffuse_only), {})
        if name:
            names[name] = None

    def sentences(self, *, diffuse_only: bool = False) -> list[str]:
        """Return each sentence once; more than four names are counted instead.

        `diffuse_only`: those alone that hold under the diffuse condition and not with full materials.
        """
        always = {self._write(*entry) for entry in self._names.items() if not entry[0][1]}
        every = dict.fromkeys(self._write(*entry) for entry in self._names.items())
        return [sentence for sentence in every if not (diffuse_only and sentence in always)]

    @staticmethod
    def _write(entry: tuple[str, bool], names: dict[str, None]) -> str:
        more = f" and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else ""
        return entry[0].replace("{names}", ", ".join(list(names)[:NAMES_SHOWN]) + more)
