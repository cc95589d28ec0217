"""What a file holds that luxel does not do, said once."""

from __future__ import annotations

NAMES_SHOWN = 4


class Warnings:
    """What a file holds that luxel does not do: one sentence per kind, naming where."""

    def __init__(self) -> None:
        self._names: dict[str, dict[str, None]] = {}
        self._always: set[str] = set()
        """Sentences that hold with full materials too."""

    def add(self, sentence: str, name: str = "", *, diffuse_only: bool = False) -> None:
        """Note `sentence`; its "{names}" becomes the list of all names given with it.

        `diffuse_only`: full materials do what it says is not done.
        """
        names = self._names.setdefault(sentence, {})
        if name:
            names[name] = None
        if not diffuse_only:
            self._always.add(sentence)

    def sentences(self, *, diffuse_only: bool = False) -> list[str]:
        """Return each sentence once; more than four names are counted instead.

        `diffuse_only`: those alone that hold under the diffuse condition and not with full materials.
        """
        said = []
        for sentence, names in self._names.items():
            if diffuse_only and sentence in self._always:
                continue
            more = f" and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else ""
            said.append(sentence.replace("{names}", ", ".join(list(names)[:NAMES_SHOWN]) + more))
        return said
