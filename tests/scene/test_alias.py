"""The alias table against its probabilities."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.scene.alias import build_alias_table


def weights(kind: str) -> np.ndarray:
    rng = np.random.default_rng(1)
    raw = {
        "one": np.ones(1),
        "even": np.ones(37),
        "spread": rng.pareto(1.0, 500) + 1e-6,
        "with zeros": np.where(rng.random(64) < 0.5, 0.0, rng.random(64)),
        "one giant": np.r_[1e6, np.ones(200)],
    }[kind]
    return raw / raw.sum()


@pytest.mark.parametrize("kind", ["one", "even", "spread", "with zeros", "one giant"])
def test_alias_table_holds_the_probabilities(kind: str) -> None:
    """An entry is chosen by its own slot up to the threshold, and by each slot that names it beyond."""
    p = weights(kind)
    table = build_alias_table(p)
    threshold, partner = table[:, 0], table[:, 1].astype(int)
    assert ((threshold >= -1e-12) & (threshold <= 1.0 + 1e-12)).all()
    assert ((partner >= 0) & (partner < len(p))).all()
    chosen = threshold.copy()
    np.add.at(chosen, partner, 1.0 - threshold)
    np.testing.assert_allclose(chosen / len(p), p, atol=1e-12)


def test_alias_table_gives_the_frequencies() -> None:
    p = weights("spread")
    table = build_alias_table(p)
    draws = np.random.default_rng(2).random(400_000) * len(p)
    slot = draws.astype(int)
    entry = np.where(draws - slot < table[slot, 0], slot, table[slot, 1].astype(int))
    frequency = np.bincount(entry, minlength=len(p)) / len(draws)
    assert np.abs(frequency - p).max() < 5.0 * np.sqrt(p.max() / len(draws))
