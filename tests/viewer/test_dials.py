"""Which control a parameter gets."""

from __future__ import annotations

import pytest

from luxel.methods import METHODS, make_params
from luxel.viewer.dials import list_dials, make_dial


@pytest.mark.parametrize("method", METHODS)
def test_every_parameter_has_a_dial_with_its_doc(method: str) -> None:
    dials = list_dials(method)
    assert {dial.key for dial in dials} == set(vars(METHODS[method].Params()))
    assert all(dial.doc for dial in dials)


@pytest.mark.parametrize("method", METHODS)
def test_a_default_survives_its_control(method: str) -> None:
    params = METHODS[method].Params()
    for dial in list_dials(method):
        value = dial.from_control(dial.to_control(dial.default))
        if value == "":  # a text field left empty sends nothing
            continue
        again = make_params(method, None, {dial.key: value})
        assert getattr(again, dial.key) == getattr(params, dial.key), dial.key


@pytest.mark.parametrize(
    ("default", "doc", "kind"),
    [
        (True, "", "check"),
        (4, "Rays.", "slider"),
        (50000, "Surfels.", "number"),
        (0, "0 takes it from the scene.", "number"),
        (8, "Side: 4, 8 or 16.", "choice"),
        (0.97, "Share of the past.", "slider"),
        (0.5, "Size in metres.", "number"),
        ("a", "`a`: this. `b`: that.", "choice"),
        ("", "Such as `x`.", "text"),
        ((0.0, 0.0, 0.0), "Size.", "vector"),
        (None, "None: estimated.", "text"),
    ],
)
def test_kinds(default: object, doc: str, kind: str) -> None:
    assert make_dial("some_key", default, doc).kind == kind


def test_a_choice_of_numbers_gives_a_number_back() -> None:
    dial = make_dial("tile_size", 8, "Side: 4, 8 or 16.")
    assert dial.options == ("4", "8", "16")
    assert dial.from_control("16") == 16


def test_dials_can_be_listed_on_many_threads() -> None:
    """CPython 3.11 fails where two threads parse at once, and every visitor has a thread."""
    from concurrent.futures import ThreadPoolExecutor

    from luxel.viewer import dials

    dials._dials_of.cache_clear()
    with ThreadPoolExecutor(16) as pool:
        found = list(pool.map(lambda number: list_dials(("gibs", "ddgi")[number % 2]), range(64)))
    assert len(found) == 64 and all(found)
