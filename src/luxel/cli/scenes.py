"""`luxel scenes`: the built-in ones."""

from __future__ import annotations

from luxel.cli import options


def scenes(as_json: options.Json = False, debug: options.Debug = False) -> None:
    """List the built-in scenes and their dials, set as in two-rooms:wall=0.05."""
    from luxel.scene import list_scenes

    listed = list_scenes()
    if as_json:
        from luxel.files import to_json

        print(to_json({name: {"about": about, "dials": dials} for name, about, dials in listed}))
        return
    width = max(len(name) for name, _, _ in listed)
    for name, about, dials in listed:
        shown = ",".join(f"{dial}={value:g}" for dial, value in dials.items())
        print(f"{name:<{width}}  {about}" + (f"\n{'':<{width}}  dials: {shown}" if shown else ""))
