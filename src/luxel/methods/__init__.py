"""The methods, in one explicit table."""

from __future__ import annotations

from luxel.methods.params import make_params
from luxel.methods.table import METHODS

__all__ = ["METHODS", "make_params"]
