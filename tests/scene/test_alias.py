"""The alias table against the probabilities that it was made of: a row's own share, and what falls to its partner."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.scene.alias import build_alias_table


def told_by(table: np.ndarray) -> np.ndarray:
    """Return the probability (E,) of each entry: a row is taken by one in E, and says itself or its partner."""
    count = len(table)
    told = table[:, 0] / count
    np.add.at(told, table[:, 1].astype(int), (1.0 - table[:, 0]) / count)
    return told


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
            table = build_alias_table(probabilities)
            np.testing.assert_allclose(told_by(table), probabilities, atol=1e-12)
            assert (table[:, 0] >= 0.0).all() and (table[:, 0] <= 1.0).all()
