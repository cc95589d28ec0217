"""Records whose fields are checked when they are set, and whose copies can be held so that nothing changes them.

A value that cannot be raises one sentence at construction or assignment. Readers of files work `clamping`: there such
a value takes the nearest one that can be, and a sentence says so.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, ClassVar

from luxel.errors import LuxelError
from luxel.scene.rules import RULES, Rule, show

HELD = "_held"
"""Key under which a held record keeps the sentence that says what to call instead."""

_clamped: ContextVar[list[str] | None] = ContextVar("clamped", default=None)


class Record:
    """Base of the scene's records."""

    _rules: ClassVar[dict[str, Rule]] = {}

    def __init_subclass__(cls) -> None:
        cls._rules = RULES.get(cls.__name__, {})

    def __setattr__(self, name: str, value: Any) -> None:
        if HELD in self.__dict__:
            raise LuxelError(
                f"{describe(self)} belongs to a renderer, so '{name}' cannot be assigned: {vars(self)[HELD]}"
            )
        rule = self._rules.get(name)
        if rule is not None:
            value = _checked(self, name, value, rule)
        object.__setattr__(self, name, value)

    def __delattr__(self, name: str) -> None:
        raise LuxelError(f"{describe(self)} cannot lose its '{name}'")

    def __getstate__(self) -> dict[str, Any]:
        # What is copied or sent elsewhere belongs to nobody.
        return {key: value for key, value in self.__dict__.items() if key != HELD}


def describe(record: Record) -> str:
    """Return what a sentence calls a record: its kind, and its name where it has one."""
    kind, name = type(record).__name__, record.__dict__.get("name")
    kind = "scene" if kind == "SceneData" else kind.lower()
    return f"{kind} '{name}'" if name else kind


@contextmanager
def clamping() -> Iterator[list[str]]:
    """Let values out of range take the nearest one that can be; yields the sentences that say so, each once."""
    sentences: list[str] = []
    token = _clamped.set(sentences)
    try:
        yield sentences
    finally:
        _clamped.reset(token)


def _checked(record: Record, name: str, value: Any, rule: Rule) -> Any:
    """Return `value` as the rule wants it. Raises LuxelError where it cannot be and nobody clamps."""
    try:
        converted = value if rule.convert is None else rule.convert(value)
        if rule.accepts(converted):
            return converted
    except (TypeError, ValueError, OverflowError):
        converted = None
    sentence = f"{describe(record)}: {name} {show(value)} cannot be"
    sentences = _clamped.get()
    if sentences is None or rule.mend is None or converted is None:
        raise LuxelError(f"{sentence}: give {rule.words}")
    mended = rule.mend(converted)
    note = f"{sentence}, so {show(mended)} is used."
    note = note[0].upper() + note[1:]
    if note not in sentences:
        sentences.append(note)
    return mended
