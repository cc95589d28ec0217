"""Bakes light transport: surfels, their tree, and the clusters that each texel sees. Needs no lights."""
