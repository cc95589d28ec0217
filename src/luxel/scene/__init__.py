"""Scenes: `load` one by name or from a file, `list_scenes` the built-in ones."""

from __future__ import annotations

import difflib
from pathlib import Path

from luxel.errors import LuxelError
from luxel.scene.choice import FILE_TYPES
from luxel.scene.edit import add_default_light, has_glow, has_own_light
from luxel.scene.library import BUILT_IN
from luxel.scene.library.dials import convert_dials, parse_dials, read_dials
from luxel.scene.model import SceneData
from luxel.scene.records import clamping

BYTES_A_TRIANGLE = 220
"""What an uploaded scene takes at most, buffers and acceleration structure together."""
MEMORY_WARNED_OF = 2e9

__all__ = ["add_default_light", "is_built_in", "list_scenes", "load"]


def load(path_or_name: str | Path, *, animation: str | int | None = None, **dials: float | int | str) -> SceneData:
    """Return a built-in scene ("cornell-box", "two-rooms:wall=0.05") or read a file (.gltf, .glb, .xml).

    Keyword `dials` override those in the text; they are for built-in scenes only. `animation` chooses what of a glTF
    file plays: a name, a number from 0, or "all"; None: its first animation. A file without any light gets the default
    one. Whether a file that only glows is too dark to be seen takes a render: `luxel.load` (`render/loading.py`)
    decides that on top of this.
    Raises `LuxelError` for an unknown name, dial or animation, and for a file that is missing, empty or malformed.
    """
    if not isinstance(path_or_name, str | Path):
        raise LuxelError(f"{path_or_name!r} is no scene: give the name of a built-in one, or the path of a file.")
    text = str(path_or_name)
    name, colon, settings = text.partition(":")
    if is_built_in(path_or_name):
        if animation is not None:
            raise LuxelError(f"'{name}' has no animation '{animation}' to choose; only glTF files do.")
        given = {**(parse_dials(settings) if colon else {}), **dials}
        return BUILT_IN[name](**convert_dials(name, BUILT_IN[name], given))
    path = Path(path_or_name)
    if not isinstance(path_or_name, Path) and not _looks_like_a_file(path):
        close = difflib.get_close_matches(name, BUILT_IN, n=1, cutoff=0.5)
        hint = f" Did you mean '{close[0]}'?" if close else ""
        raise LuxelError(
            f"There is no scene '{name}'; built-in ones are {', '.join(BUILT_IN)}, "
            f"or give a file ({', '.join(FILE_TYPES)}).{hint}"
        )
    if dials:
        raise LuxelError(f"'{path}' is a file and has no dials; only built-in scenes do.")
    # What a file should not hold takes the nearest value that can be, with a warning.
    with clamping() as notes:
        data = _load_file(path, animation)
    data.warnings.extend(note for note in notes if note not in data.warnings)
    _warn_of_size(data)
    return data if has_own_light(data) or has_glow(data) else add_default_light(data)


def is_built_in(path_or_name: str | Path) -> bool:
    """Return whether it names a built-in scene, with or without dials, rather than a file."""
    return not isinstance(path_or_name, Path) and path_or_name.partition(":")[0] in BUILT_IN


def list_scenes() -> list[tuple[str, str, dict[str, float | int]]]:
    """Return (name, what it is, dials with their defaults) for each built-in scene."""
    return [(name, (maker.__doc__ or "").splitlines()[0], read_dials(maker)) for name, maker in BUILT_IN.items()]


def _warn_of_size(data: SceneData) -> None:
    """Say what a large scene will take of memory: instances share a mesh in the file, not when they are traced."""
    count = sum(len(mesh.faces) for item in data.objects for mesh in item.meshes)
    if count * BYTES_A_TRIANGLE > MEMORY_WARNED_OF:
        size = count * BYTES_A_TRIANGLE / 1e9
        data.warnings.append(f"Its {count / 1e6:.1f} million triangles take about {size:.1f} GB when uploaded.")


def _looks_like_a_file(path: Path) -> bool:
    return path.exists() or path.suffix.lower() in FILE_TYPES or len(path.parts) > 1


def _load_file(path: Path, animation: str | int | None) -> SceneData:
    """Hand the file to the reader of its type. Raises `LuxelError` where there is none, or no file."""
    if path.is_dir():
        raise LuxelError(f"'{path}' is a folder; name the scene file in it ({', '.join(FILE_TYPES)}).")
    if not path.exists():
        raise LuxelError(f"There is no file '{path}'; check the path.")
    suffix = path.suffix.lower()
    if suffix not in FILE_TYPES:
        raise LuxelError(f"'{path}' is not a scene that luxel reads; give one of {', '.join(FILE_TYPES)}.")
    if path.stat().st_size == 0:
        raise LuxelError(f"'{path}' is empty; export the scene again.")
    if suffix == ".xml" and animation is not None:
        raise LuxelError(f"'{path}' has no animation '{animation}' to choose; only glTF files do.")
    if suffix == ".xml":
        from luxel.scene.mitsuba.xml import load_mitsuba_xml

        return load_mitsuba_xml(path)
    from luxel.scene.gltf import load_gltf

    return load_gltf(path, animation)
