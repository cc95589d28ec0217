"""The alias table against its probabilities; which triangles emit, and how strongly."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.scene.alias import build_alias_table
from luxel.scene.device import upload
from luxel.scene.library.shapes import quad
from luxel.scene.lights import DELTA_EACH_LIMIT, ENTRY_IS_DELTA
from luxel.scene.model import Light, Material, Object, SceneData


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


def test_emitters_are_sampled_by_power() -> None:
    """Power is area times luminance, twice for a triangle that emits on both sides."""
    materials = [
        Material(),
        Material(emission=(1.0, 1.0, 1.0)),
        Material(emission=(0.0, 4.0, 0.0)),
        Material(emission=(1.0, 1.0, 1.0), emit_back=True),
    ]
    meshes = [quad((0, k, 0), (1 + k, k, 0), (1 + k, k, 1), (0, k, 1), k) for k in range(4)]
    scene = upload(SceneData("lamps", [Object("all", meshes)], materials))
    lights = scene.lights
    assert lights.entry_count == 6
    material = np.array(scene.geometry.triangles).reshape(-1, 4)[np.array(lights.entries), 3] & 0xFFFF
    power = {1: 2.0, 2: 3.0 * 4.0 * 0.7152, 3: 4.0 * 2.0}
    expected = np.array([power[int(m)] / 2.0 for m in material])
    np.testing.assert_allclose(np.array(lights.probabilities), expected / expected.sum(), rtol=1e-5)


def test_few_delta_lights_are_evaluated_each_and_many_are_sampled() -> None:
    floor = [Object("floor", [quad((0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1), 0)])]
    for count in (0, 1, DELTA_EACH_LIMIT, DELTA_EACH_LIMIT + 1, 30):
        lamps = [Light("point", (1.0, 1.0, 1.0 + index), (0.0, 1.0, 0.0)) for index in range(count)]
        lights = upload(SceneData("lamps", floor, [Material()], lights=lamps)).lights
        each = count if count <= DELTA_EACH_LIMIT else 0
        assert (lights.delta_each, lights.entry_count) == (each, count - each)
        if lights.entry_count:
            assert (np.array(lights.entries) & ENTRY_IS_DELTA).all()
            assert np.array(lights.probabilities).sum() == pytest.approx(1.0, abs=1e-5)
