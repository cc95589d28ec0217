"""What a file holds that luxel does not do, said once."""

from __future__ import annotations

NAMES_SHOWN = 4


class Warnings:
    """What a file holds that luxel does not do: one sentence per kind, naming where."""

    def __init__(self) -> None:
        self._names: dict[str, dict[str, None]] = {}

    def add(self, sentence: str, name: str = "") -> None:
        """Note `sentence`; its "{names}" becomes the list of all names given with it."""
        names = self._names.setdefault(sentence, {})
        if name:
            names[name] = None

    def sentences(self) -> list[str]:
        """Return each sentence once; more than four names are counted instead."""
        said = []
        for sentence, names in self._names.items():
            more = f" and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else ""
            said.append(sentence.replace("{names}", ", ".join(list(names)[:NAMES_SHOWN]) + more))
        return said
