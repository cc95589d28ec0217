"""Lays the still scene flat: what carries light, its charts in one atlas, dense points and texels on them."""
