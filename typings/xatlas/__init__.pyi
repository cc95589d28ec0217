"""Names without types for the type checker.

The published stubs describe arrays by generics that reject sound arithmetic (`1 - Float`, `dot` of two vectors), and
mean one fixed variant, while ours is picked at run time.
"""

from typing import Any

def __getattr__(name: str) -> Any: ...
