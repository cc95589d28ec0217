"""Runs each frame: lights the surfels, sums clusters and texels, and looks light up at surfaces."""
