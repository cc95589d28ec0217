"""Relightable surfel lightmaps: transport baked once, light summed anew each frame."""
