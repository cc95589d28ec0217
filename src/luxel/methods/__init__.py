"""The methods in one explicit table, and the names that a method's writer needs: the stable import for both.

from luxel.methods import Frame, GBuffer, Light, Method, Scene, Surface
"""

from __future__ import annotations

from luxel.kernels.gbuffer import GBuffer
from luxel.kernels.records import Light, Surface
from luxel.methods.base import (
    CHECKS,
    Contribution,
    Discs,
    Frame,
    Look,
    Method,
    NoScreen,
    Reading,
    Sources,
    View,
    describe_params,
)
from luxel.methods.params import find_method, make_params
from luxel.methods.table import METHODS
from luxel.scene.device import Scene

__all__ = [
    "CHECKS",
    "METHODS",
    "Contribution",
    "Discs",
    "Frame",
    "GBuffer",
    "Light",
    "Look",
    "Method",
    "NoScreen",
    "Reading",
    "Scene",
    "Sources",
    "Surface",
    "View",
    "describe_params",
    "find_method",
    "make_params",
]
