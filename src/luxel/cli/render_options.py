"""Options of `luxel render` alone; `options.py` has those that it shares."""

from __future__ import annotations

from typing import Annotated

import typer

from luxel.cli.options import TRUTH_SPP

_CACHE = "Cache options"

Truth = Annotated[
    int | None,
    typer.Option(
        "--truth",
        min=1,
        metavar="[SPP]",
        help=f"Add the error against the truth; alone it means {TRUTH_SPP} samples a pixel.",
    ),
]
Output = Annotated[
    str | None,
    typer.Option("-o", "--output", metavar="FILE", help="A .png or .exr; a folder, .gif or .mp4 for a sequence."),
]
Time = Annotated[
    float,
    typer.Option("--time", metavar="SECONDS", help="Time in an animated scene.", rich_help_panel="Scene options"),
]
FramesASecond = Annotated[float, typer.Option("--fps", min=0.1, max=1000.0, help="Frames a second of a sequence.")]
WarmUp = Annotated[
    int | None,
    typer.Option(
        "--warm-up",
        min=0,
        metavar="FRAMES",
        help="Frames before the first picture of a sequence; without, until the view is covered.",
    ),
]
SaveCache = Annotated[
    str | None,
    typer.Option(
        "--save-cache", metavar="FILE.npz", help="Write the method's cache after the frames.", rich_help_panel=_CACHE
    ),
]
LoadCache = Annotated[
    str | None,
    typer.Option(
        "--load-cache",
        metavar="FILE.npz",
        help="Go on from a cache of the same scene and parameters.",
        rich_help_panel=_CACHE,
    ),
]
Atlases = Annotated[
    str | None,
    typer.Option("--atlases", metavar="DIR", help="ddgi: write the probes' atlases as EXR.", rich_help_panel=_CACHE),
]
Look = Annotated[
    list[str] | None,
    typer.Option("--look", metavar="NAME", help="Also draw NAME beside the image; a comma list; `list` names all."),
]
Pixel = Annotated[
    str | None,
    typer.Option("--pixel", metavar="X,Y", help="The point of a look that shows what lights one; else the middle."),
]
