"""Every dial: bad values are refused by name, and the thesis's names are there."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest

from luxel.errors import LuxelError
from luxel.methods.base import describe_params
from luxel.methods.ddgi.params import MAJERCIK, ROHACEK, DdgiParams, check_params

THESIS_3_4 = (
    "num_probes_x", "num_probes_y", "num_probes_z", "probe_box_size", "world_offset", "hysteresis", "depth_sharpness",
    "num_samples_per_probe", "detect_dead_probes", "offset_dead_probes", "dead_probes_hysteresis",
    "dead_probe_threshold", "show_debug_layer",
)  # fmt: skip
NAN, INF = float("nan"), float("inf")
BAD = [
    ("num_probes_x", 1), ("num_probes_y", -3), ("num_probes_z", 5000), ("probe_target", 7), ("probe_target", 10**9),
    ("probe_box_size", (1.0, 2.0)), ("probe_box_size", (1.0, -2.0, 1.0)), ("probe_box_size", (1.0, NAN, 1.0)),
    ("probe_box_size", ("a", "b", "c")), ("world_offset", (INF, 0.0, 0.0)), ("world_offset", 3.0), ("cascades", -1),
    ("interpolation", "cubic"), ("outside", "dark"),
    ("cascades", 9), ("num_samples_per_probe", 3), ("num_samples_per_probe", 5000), ("ray_budget", "all"),
    ("bounces", "none"), ("hysteresis", 1.0), ("hysteresis", -0.1), ("hysteresis", NAN), ("depth_sharpness", 0),
    ("far_depth", "drop"), ("depth_model", "cubes"), ("irradiance_resolution", 1), ("depth_resolution", 65),
    ("irradiance_format", "float8"), ("depth_format", "int"), ("backface_offset", -0.1), ("backface_offset", NAN),
    ("normal_bias", 2.0), ("view_bias", NAN), ("offset_pattern", "spiral"), ("backface_rule", "none"),
    ("dead_probes_hysteresis", 1.0),
    ("dead_probe_threshold", -2.0), ("dead_probe_threshold", INF), ("dead_probe_threshold", NAN),
    ("extra_probes", -1), ("extra_probes", 10**6), ("sleep_after", -1), ("show_debug_layer", -2),
    ("sky_rays", -1), ("sky_rays", 10**5),
    ("boxes", "here"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value"), BAD)
def test_bad_values_are_refused_by_name(name: str, value: object) -> None:
    from luxel.methods.ddgi.boxes import plan_boxes

    params = replace(DdgiParams(), **{name: value})  # type: ignore[arg-type]
    with pytest.raises(LuxelError, match=name if name != "boxes" else "box"):
        check_params(params)
        plan_boxes(params, [-1.0, -1.0, -1.0], [1.0, 1.0, 1.0])  # type: ignore[arg-type]


@pytest.mark.parametrize("preset", [{}, MAJERCIK, ROHACEK])
def test_defaults_and_presets_are_fine(preset: dict) -> None:
    check_params(replace(DdgiParams(), **preset))


def test_every_number_and_word_is_checked() -> None:
    """A new dial must not come without a bad value here."""
    free = {item.name for item in fields(DdgiParams) if isinstance(item.default, bool)}
    assert {item.name for item in fields(DdgiParams)} - free == {name for name, _ in BAD}


def test_the_controls_of_the_thesis_are_there() -> None:
    docs = {name: doc for name, _, doc in describe_params(DdgiParams)}
    assert set(THESIS_3_4) <= set(docs)
    assert all(docs[name] for name in docs)
