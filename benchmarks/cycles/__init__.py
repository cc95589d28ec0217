"""Luxel's bakes beside those of Cycles, the path tracer of Blender: same atlas, same lights, one truth."""
