"""A picture on the host, as NumPy arrays: its layers, how it is displayed, its files."""
