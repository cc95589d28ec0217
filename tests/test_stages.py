"""Stages: names, nesting, and what is computed inside them."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel.stages import count_compilations, recording, stage


def heavy(start: Any) -> Any:
    """Return an array that needs a kernel of its own."""
    return dr.sqrt(dr.arange(mi.Float, 1 << 16) + start)


def test_without_a_recorder_a_stage_keeps_and_records_nothing() -> None:
    start = dr.opaque(mi.Float, 1.0)
    with stage("quiet") as current:
        value = heavy(start)
        current.keep(value)
    np.testing.assert_allclose(np.array(value), np.sqrt(np.arange(1 << 16) + 1.0), rtol=1e-6)
    with recording() as recorder:
        pass
    assert not recorder.rows


def test_keep_evaluates_within_the_stage_and_counts_its_kernels() -> None:
    start = dr.opaque(mi.Float, 1.0)
    with recording() as recorder:
        with stage("first") as current:
            value = heavy(start)
            current.keep(value)
        assert value.state == dr.VarState.Evaluated
        with stage("second"):
            lazy = heavy(start) * 2.0
        with stage("third") as current:
            current.keep(lazy)
    launches = recorder.launches()
    assert launches["first"] >= 1 and launches["second"] == 0 and launches["third"] >= 1
    assert recorder.medians()["first"] > 0.0
    np.testing.assert_allclose(np.array(lazy), 2.0 * np.sqrt(np.arange(1 << 16) + 1.0), rtol=1e-6)


def test_rows_of_one_name_add_up_and_names_keep_their_order() -> None:
    with recording() as recorder:
        for _ in range(3):
            for name in ("b/one", "a", "b/two"):
                with stage(name) as current:
                    current.keep(heavy(dr.opaque(mi.Float, 2.0)))
    assert list(recorder.medians()) == ["b/one", "a", "b/two"]
    assert [len(rows) for rows in recorder.rows.values()] == [3, 3, 3]


def test_stages_nest() -> None:
    """An inner stage has its own row; the outer one is there too, and the work of each is counted."""
    with recording() as recorder, stage("outer") as outer:
        with stage("outer/inner") as inner:
            first = heavy(dr.opaque(mi.Float, 3.0))
            inner.keep(first)
        outer.keep(heavy(dr.opaque(mi.Float, 4.0)))
    assert set(recorder.rows) == {"outer", "outer/inner"}
    assert recorder.launches()["outer/inner"] >= 1 and recorder.launches()["outer"] >= 1


def test_recorders_do_not_outlive_their_block() -> None:
    with recording() as recorder, stage("inside") as current:
        current.keep(heavy(dr.opaque(mi.Float, 5.0)))
    with stage("outside") as current:
        current.keep(heavy(dr.opaque(mi.Float, 6.0)))
    assert set(recorder.rows) == {"inside"}
    assert not dr.flag(dr.JitFlag.KernelHistory)


def test_count_compilations() -> None:
    history = [{"cache_hit": True}, {"cache_hit": False}, {"type": "other"}, {"cache_hit": False}]
    assert count_compilations(history) == 2
