"""Looks into a frame: what lights a pixel and why it is dark, and pictures of light, surfaces, errors and caches."""
