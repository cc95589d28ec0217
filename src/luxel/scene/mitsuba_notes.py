"""What a Mitsuba file holds that luxel does not do, gathered while it is read."""

from __future__ import annotations


class Warnings:
    """One sentence per kind, naming where."""

    def __init__(self) -> None:
        self._names: dict[str, list[str]] = {}

    def add(self, sentence: str, name: str = "") -> None:
        """Note `sentence`; its "{names}" becomes the list of all names given with it."""
        names = self._names.setdefault(sentence, [])
        if name and name not in names:
            names.append(name)

    def sentences(self) -> list[str]:
        """Return each sentence once; more than four names are counted instead."""
        said = []
        for sentence, names in self._names.items():
            more = f" and {len(names) - 4} more" if len(names) > 4 else ""
            said.append(sentence.replace("{names}", ", ".join(names[:4]) + more))
        return said
