"""The methods in one explicit table, and the names that a method's writer needs: the stable import for both.

from luxel.methods import Frame, GBuffer, Light, Method, Scene, Surface
"""

from __future__ import annotations

from luxel.kernels.gbuffer import GBuffer
from luxel.kernels.records import Light, Surface
from luxel.methods.base import (
    CHECKS,
    Frame,
    Method,
    NoScreen,
    describe_params,
)
from luxel.methods.inspect import (
    CacheView,
    Contribution,
    Discs,
    Inspector,
    Look,
    Reading,
    Sources,
    inspector_of,
)
from luxel.methods.own import load_method
from luxel.methods.params import find_method, make_params
from luxel.methods.table import METHODS
from luxel.methods.workload import Workload
from luxel.scene.device import Scene

__all__ = [
    "CHECKS",
    "METHODS",
    "Contribution",
    "Discs",
    "Frame",
    "GBuffer",
    "Inspector",
    "Light",
    "Look",
    "Method",
    "NoScreen",
    "Reading",
    "Scene",
    "Sources",
    "Surface",
    "CacheView",
    "Workload",
    "describe_params",
    "find_method",
    "inspector_of",
    "load_method",
    "make_params",
]
