"""The names that a method's writer imports stay where they are."""

from __future__ import annotations

import luxel.methods
from luxel.kernels import gbuffer, records
from luxel.methods import CHECKS, Frame, GBuffer, Light, Method, NoScreen, Scene, Surface, base
from luxel.scene import device


def test_one_import_has_what_a_method_needs() -> None:
    assert (Light, Surface, GBuffer, Scene) == (records.Light, records.Surface, gbuffer.GBuffer, device.Scene)
    assert (Method, Frame, NoScreen, CHECKS) == (base.Method, base.Frame, base.NoScreen, base.CHECKS)


def test_every_name_is_there() -> None:
    assert all(hasattr(luxel.methods, name) for name in luxel.methods.__all__)
    assert {"METHODS", "make_params", "Frame", "GBuffer", "Light", "Method", "Scene", "Surface"} <= set(
        luxel.methods.__all__
    )
