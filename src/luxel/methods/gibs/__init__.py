"""Surfel GI: start reading at `method.py`."""
