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


def told_by(table: np.ndarray) -> np.ndarray:
    """Return the probability (E,) of each entry: its own slot up to the threshold, and slots that name it beyond."""
    threshold, partner = table[:, 0], table[:, 1].astype(int)
    assert ((threshold >= 0.0) & (threshold <= 1.0)).all() and ((partner >= 0) & (partner < len(table))).all()
    told = threshold / len(table)
    np.add.at(told, partner, (1.0 - threshold) / len(table))
    return told


@pytest.mark.parametrize("kind", ["one", "even", "spread", "with zeros", "one giant"])
def test_alias_table_holds_the_probabilities(kind: str) -> None:
    p = weights(kind)
    np.testing.assert_allclose(told_by(build_alias_table(p)), p, atol=1e-12)


EXAMPLES = {
    "one": [1.0],
    "a share that is the mean": [1 / 3, 1 / 6, 1 / 2],
    "the mean beside nothing": [1 / 3, 0.0, 2 / 3],
    "lamps of two powers": [1.0, 1.0, 2.0, 2.0, 1.0, 1.0, 2.0, 2.0],
    "all the same": [1.0] * 7,
    "gone at the same time": [0.5, 1.5, 0.5, 1.5, 1.0, 1.0],
    "a chain": [0.0, 1.1, 1.2, 1.3, 1.4, 1.0],
    "one for all": [0.0, 0.0, 0.0, 5.0, 0.0],
}


@pytest.mark.parametrize("shares", EXAMPLES.values(), ids=EXAMPLES.keys())
def test_a_table_tells_the_probabilities_it_was_made_of(shares: list[float]) -> None:
    probabilities = np.array(shares) / np.sum(shares)
    np.testing.assert_allclose(told_by(build_alias_table(probabilities)), probabilities, atol=1e-12)


@pytest.mark.parametrize("levels", [1, 2, 4, 16, 10**9])
def test_tables_of_chance_do_too(levels: int) -> None:
    """Few levels: many shares are equal, so they use one another up at the same moment."""
    rng = np.random.default_rng(levels)
    for _ in range(300):
        shares = rng.integers(0, levels + 1, rng.integers(1, 40)) * np.exp2(rng.integers(-3, 4))
        if shares.any():
            probabilities = shares / shares.sum()
            np.testing.assert_allclose(told_by(build_alias_table(probabilities)), probabilities, atol=1e-12)


def test_alias_table_gives_the_frequencies() -> None:
    p = weights("spread")
    table = build_alias_table(p)
    draws = np.random.default_rng(2).random(400_000) * len(p)
    slot = draws.astype(int)
    entry = np.where(draws - slot < table[slot, 0], slot, table[slot, 1].astype(int))
    frequency = np.bincount(entry, minlength=len(p)) / len(draws)
    assert np.abs(frequency - p).max() < 5.0 * np.sqrt(p.max() / len(draws))
