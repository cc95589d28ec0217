"""The thesis's formula for memory, and the refusal that comes before anything is allocated."""

from __future__ import annotations

import re
from unittest import mock

import pytest

from luxel.errors import LuxelError
from luxel.methods import METHODS
from luxel.methods.ddgi.boxes import ProbeBox
from luxel.methods.ddgi.memory import atlas_bytes, check_memory, count_probes, describe_memory, probe_bytes
from luxel.methods.ddgi.params import DdgiParams
from luxel.scene.device import Scene

# Table 4.1 of the thesis: irradiance and depth resolution, bytes a depth component, what formula 4.1 gives. The rows
# are printed as 1200, 2096, 5424, 1600, 3392, 10048, 3888, 10544: all agree with the formula.
TABLE = [
    (8, 8, 2, 1200), (8, 16, 2, 2096), (8, 32, 2, 5424), (8, 8, 4, 1600),
    (8, 16, 4, 3392), (8, 32, 4, 10048), (16, 16, 2, 3888), (32, 16, 2, 10544),
]  # fmt: skip
MIB = 2**20


def grid(counts: tuple[int, int, int]) -> ProbeBox:
    return ProbeBox((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), counts)


@pytest.mark.parametrize(("light", "depth", "width", "expected"), TABLE)
def test_table_4_1(light: int, depth: int, width: int, expected: int) -> None:
    params = DdgiParams(
        irradiance_resolution=light,
        depth_resolution=depth,
        depth_format="float16" if width == 2 else "float32",
        depth_model="moments",
    )
    assert (depth + 2) ** 2 * width * 2 + (light + 2) ** 2 * 2 * 4 == expected
    assert atlas_bytes(params) == expected


def test_planes_and_wide_light_are_counted() -> None:
    assert atlas_bytes(DdgiParams()) == 18**2 * 2 * 4 + 10**2 * 2 * 4
    assert atlas_bytes(DdgiParams(irradiance_format="float32")) == 18**2 * 2 * 4 + 10**2 * 4 * 4


@pytest.mark.parametrize("counts", [(40, 40, 40), (2, 900, 2), (1000, 3, 5), (64, 8, 200)])
@pytest.mark.parametrize("free", [40 * MIB, 300 * MIB, 2000 * MIB])
def test_the_largest_grid_that_fits_is_named_and_fits(counts: tuple[int, int, int], free: int) -> None:
    params = DdgiParams(extra_probes=64)
    if count_probes(params, [grid(counts)]) * probe_bytes(params) <= 0.6 * free:
        check_memory(params, [grid(counts)], free)
        return
    with pytest.raises(LuxelError, match="the largest grid of this shape that fits") as caught:
        check_memory(params, [grid(counts)], free)
    found = re.search(r"fits is (\d+)x(\d+)x(\d+)", str(caught.value))
    assert found is not None
    x, y, z = (int(n) for n in found.groups())
    check_memory(params, [grid((x, y, z))], free)
    # And it is the largest but for rounding: half as many again on each axis would not fit.
    with pytest.raises(LuxelError):
        check_memory(params, [grid((3 * x // 2 + 1, 3 * y // 2 + 1, 3 * z // 2 + 1))], free)


def test_numbers_beyond_64_bits_are_refused() -> None:
    with pytest.raises(LuxelError):
        check_memory(DdgiParams(), [grid((2**22, 2**22, 2**22))], 10**12)


def test_nothing_is_allocated_before_the_refusal(bare: Scene) -> None:
    params = DdgiParams(num_probes_x=1000, num_probes_y=1000, num_probes_z=1000)
    with mock.patch("luxel.methods.ddgi.method.make_volume") as made, pytest.raises(LuxelError, match="MiB are free"):
        METHODS["ddgi"].build(bare, params, 1)
    assert not made.called


def test_the_sentence_says_bytes_and_total() -> None:
    said = describe_memory(DdgiParams(extra_probes=0, depth_model="moments"), [grid((10, 10, 10)), grid((2, 2, 2))])
    assert "10x10x10 + 2x2x2" in said and "2,096 bytes a probe" in said and "2.0 MiB" in said


def test_the_count_covers_what_a_state_holds(bare: Scene, build) -> None:
    """The estimate must not be less than what is allocated: arrays of the state, and the rays of a frame."""
    import drjit as dr

    state = build(bare, num_probes_x=5, num_probes_y=4, num_probes_z=3, extra_probes=0)
    held = 0

    def add(value: object) -> None:
        nonlocal held
        if dr.is_jit_v(value) and dr.depth_v(value) == 1:
            held += dr.width(value) * dr.itemsize_v(value)
        elif dr.is_jit_v(value):
            for part in value:  # type: ignore[attr-defined]
                add(part)

    for part in (state.irradiance, state.depth, state.probes):
        for value in vars(part).values():
            add(value)
    for value in (state.rows, state.irradiance_atlas, state.depth_atlas):
        add(value)
    rays = 4 * state.settings.total * state.settings.rays_per_probe * (4 + 4)
    counted = state.settings.total * probe_bytes(DdgiParams())
    assert held + rays <= counted < 2.0 * (held + rays)
