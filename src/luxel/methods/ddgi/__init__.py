"""Probe GI: dynamic diffuse global illumination (DDGI)."""
