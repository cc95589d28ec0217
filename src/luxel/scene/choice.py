"""A scene as text: its name or path, and what the command line changes in it. Any process can make it from that.

`render/loading.py` does. And the words for what of its materials counts, and for what a pixel shows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from luxel.errors import LuxelError

MATERIALS = ("diffuse", "full")
"""What counts of a scene's materials: their diffuse albedo alone, the condition of every table; or all of them."""
FILTERS = ("box", "gaussian", "none")
"""What a pixel shows of what is seen around its centre; `none`: the centre alone, as in every measurement."""
PICTURE_FILTER = "box"
"""What pictures are shown with unless told otherwise."""
FILE_TYPES = (".glb", ".gltf", ".xml")


@dataclass(frozen=True)
class SceneChoice:
    """A built-in scene or a scene file, with the options that change it; each is the text of its flag, or None."""

    source: str
    sun: str | None = None
    """AZIMUTH,ELEVATION[,STRENGTH[,DIAMETER]]."""
    sky: str | None = None
    """none, L or R,G,B."""
    envmap: str | None = None
    """Path of a latitude-longitude image."""
    camera: str | None = None
    """A camera's name, or EYE;TARGET[;FOV]."""
    name: str | None = None
    """What reports call it; None: a file's stem, or a built-in scene's name with its dials."""
    animation: str | None = None
    """NAME, INDEX or all: what of a glTF file plays."""
    flight_path: str | None = None
    """EYE;EYE;TARGET;TARGET[;FOV]: what `compare --motion` flies; None: a curve through the scene's key views."""

    @property
    def label(self) -> str:
        """What reports call it."""
        return self.name or scene_label(self.source)

    def anywhere(self) -> SceneChoice:
        """Return the same choice with absolute paths, for a process that runs in another folder."""
        source = str(Path(self.source).absolute()) if is_file(self.source) else self.source
        envmap = str(Path(self.envmap).absolute()) if self.envmap is not None else None
        return replace(self, source=source, envmap=envmap, name=self.label)


def check_materials(word: str) -> None:
    """Raise LuxelError unless `word` is one of `MATERIALS`."""
    if word not in MATERIALS:
        raise LuxelError(f"there are no materials {word!r}: they are {' or '.join(MATERIALS)}")


def check_filter(word: str) -> None:
    """Raise LuxelError unless `word` is one of `FILTERS`."""
    if word not in FILTERS:
        raise LuxelError(f"there is no filter {word!r}: it is {', '.join(FILTERS[:-1])} or {FILTERS[-1]}")


def scene_label(scene: str | Path) -> str:
    """Return what a scene is called in reports: a file's stem, or a built-in scene's name with its dials."""
    text = str(scene)
    return Path(text).stem if is_file(text) else text


def is_file(scene: str) -> bool:
    """Return whether the text names a scene file rather than a built-in scene."""
    return Path(scene).suffix.lower() in FILE_TYPES
