"""A word of a row of transport: a cluster in its high bits, the rays that met it in its low ones."""

HIT_BITS = 12
"""Low bits of a word that hold a cluster's hits; the others name the cluster."""

NODE_LIMIT = 1 << (32 - HIT_BITS)
"""Clusters that a word can tell apart."""
