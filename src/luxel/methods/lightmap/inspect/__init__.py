"""Shows what the lightmap holds: looks, views, and which clusters light a point."""
