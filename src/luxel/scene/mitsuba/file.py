"""A Mitsuba file as its parser reads it: includes, defaults and references resolved, each shape made once.

Mitsuba does not show the shapes of a `shapegroup` once it is made. So the groups that are used are opened before: their
shapes become shapes of the scene, in the space of their group, and the instances are kept beside as matrices.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError
from luxel.scene.mitsuba.log import catch_warnings
from luxel.scene.mitsuba.origin import measure_from
from luxel.scene.mitsuba.spectra import tabulate_spectra
from luxel.scene.warnings import Warnings


@dataclass
class Instance:
    """A group of shapes in one place."""

    name: str
    group: int
    """Key of `SceneFile.groups`."""
    to_world: np.ndarray
    """(4, 4) float64."""


@dataclass
class SceneFile:
    """What a file says, ready to be converted."""

    scene: Any
    """The `mi.Scene` of all shapes; those of `groups` stand in the space of their group."""
    full: Callable[[], Any]
    """-> the `mi.Scene` as Mitsuba loads it, with its instances."""
    groups: dict[int, list[str]] = field(default_factory=dict)
    """Key of a group -> ids of its shapes."""
    instances: list[Instance] = field(default_factory=list)
    has_sensor: bool = False
    hide_emitters: bool = False
    step: float = 0.0
    """Metres that single precision must have rounded its meshes to, where it is measured from an origin."""
    warnings: Warnings = field(default_factory=Warnings)
    """What Mitsuba warned of while it read the file."""


def read_scene_file(path: Path, origin: np.ndarray | None = None) -> SceneFile:
    """Read `path`, measured from `origin` (3,) where it is given.

    Raises `LuxelError` where the file is no scene, or with the heart of Mitsuba's message.
    """
    _check(path)
    try:
        with _searching(path) as resolver, catch_warnings() as heard:
            state, config = _parse(path)
            tabulate_spectra(state, config)
            _look_beside_includes(state, resolver)
            step = 0.0 if origin is None else measure_from(state, origin)
            whole: Any = mi.parser.ParserState(state)
            groups, instances = _open_groups(state)
            scene: Any = mi.parser.instantiate(config, state)
    except Exception as error:
        raise LuxelError(f"Mitsuba cannot load '{path}': {condense(str(error))}.") from error
    if not isinstance(scene, mi.Scene):
        raise LuxelError(f"'{path}' is not a whole Mitsuba scene; give the file whose root is <scene>.")
    return SceneFile(
        scene,
        full=(lambda: _load_whole(path, config, whole, resolver)) if instances else (lambda: scene),
        groups=groups,
        instances=instances,
        has_sensor=any(node.type == mi.ObjectType.Sensor for node in state.nodes),
        hide_emitters=any(_hides_emitters(node) for node in state.nodes),
        step=step,
        warnings=heard,
    )


def condense(message: str) -> str:
    """Return the cause that ends a nested message, with its place behind it and no full stop."""
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    # What a heading such as "2 unreferenced properties:" introduces stands in the lines below it, some with a dump.
    headings = [index for index, line in enumerate(lines) if "unreferenced" in line]
    start = (
        headings[0] if headings else max((at for at, line in enumerate(lines) if not line.startswith("-")), default=0)
    )
    listed = [line.lstrip("- ").rstrip("[") for line in lines[start + 1 :] if line.startswith("-")]
    cause = " ".join([*lines[start : start + 1], *listed]) or "no reason given"
    cause = re.sub(r"\[[\w.]+(:\d+)?\] ", "", cause)
    if "include recursion depth" in cause:
        return "its includes go round in a circle or too deep; a file may not include itself"
    placed = re.match(r"(?:Error while loading|While loading|At) .*? \(([^()]*line \d+[^()]*)\): (.+)", cause)
    if placed:
        return f"{placed[2].rstrip('.! ')} ({placed[1]})"
    return cause.rstrip(".! ")


def _check(path: Path) -> None:
    """Raise `LuxelError` where the file is no XML or no scene."""
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise LuxelError(f"'{path}' is not well-formed XML ({error}); export it again.") from error
    except OSError as error:
        raise LuxelError(f"'{path}' cannot be read ({error.strerror}).") from error
    if root.tag != "scene":
        raise LuxelError(f"'{path}' is XML but no Mitsuba scene: its root is <{root.tag}>, not <scene>.")


@contextmanager
def _searching(path: Path, resolver: Any = None) -> Iterator[Any]:
    """Let Mitsuba look for files beside `path`, or by `resolver`; its search path is afterwards as it was."""
    before: Any = mi.file_resolver()
    here: Any = mi.FileResolver(before) if resolver is None else resolver
    if resolver is None:
        here.prepend(str(path.resolve().parent))
    mi.set_file_resolver(here)
    try:
        yield here
    finally:
        mi.set_file_resolver(before)


def _look_beside_includes(state: Any, resolver: Any) -> None:
    """Add the folders of included files to the search path, and what they name in <path>: Mitsuba forgets those."""
    for file in [Path(str(name)) for name in state.files][1:]:
        resolver.append(str(file.parent))
        for entry in ElementTree.parse(file).getroot().iter("path"):
            resolver.append(str(file.parent / entry.get("value", "")))


def _parse(path: Path) -> tuple[Any, Any]:
    """Return the parser's state with all references resolved, and its settings; nothing is merged."""
    config: Any = mi.parser.ParserConfig(mi.variant())
    config.merge_equivalent = config.merge_meshes = False
    state = mi.parser.parse_file(config, str(path))
    mi.parser.transform_all(config, state)
    return state, config


def _load_whole(path: Path, config: Any, state: Any, resolver: Any) -> Any:
    try:
        # Its warnings were said when the file was read.
        with _searching(path, resolver), catch_warnings():
            return mi.parser.instantiate(config, mi.parser.ParserState(state))
    except Exception as error:
        raise LuxelError(f"Mitsuba cannot load '{path}': {condense(str(error))}.") from error


def _hides_emitters(node: Any) -> bool:
    return node.type == mi.ObjectType.Integrator and bool(node.props.get("hide_emitters", False))


# --- instances -----------------------------------------------------------------------------------------------------


def _open_groups(state: Any) -> tuple[dict[int, list[str]], list[Instance]]:
    """Put the shapes of the groups that are used in place of all instances; return groups and instances."""
    nodes, root = state.nodes, state.root.props
    groups: dict[int, list[str]] = {}
    instances: list[Instance] = []
    for key, index in _references(root):
        props = nodes[index].props
        if props.plugin_name() != "instance":
            continue
        group = next((at for _, at in _references(props) if nodes[at].props.plugin_name() == "shapegroup"), None)
        if group is None:
            # Mitsuba says what is wrong with it.
            return {}, []
        matrix = np.array(props["to_world"].matrix, float).reshape(4, 4) if "to_world" in props else np.eye(4)
        instances.append(Instance(props.id() or f"instance-{len(instances)}", group, matrix))
        groups.setdefault(group, [])
        del root[key]
    for key, index in _references(root):
        if index in groups:
            del root[key]
    for group, names in groups.items():
        for number, index in enumerate(_members(nodes, group)):
            props = nodes[index].props
            if not props.id():
                props.set_id(f"group-{group}-shape-{number}")
            names.append(props.id())
            root[f"member_{group}_{number}"] = mi.Properties.ResolvedReference(index)
    return groups, instances


def _members(nodes: Any, group: int) -> list[int]:
    """Return the nodes of the shapes below `group`. Raises `ValueError` for what Mitsuba refuses in a group."""
    found = []
    for _, index in _references(nodes[group].props):
        node = nodes[index]
        if node.type != mi.ObjectType.Shape:
            continue
        kind = node.props.plugin_name()
        if kind == "merge":
            found += _members(nodes, index)
        elif kind in ("shapegroup", "instance"):
            raise ValueError(f"shape group '{nodes[group].props.id()}' holds another group or instance; nest none")
        elif any(nodes[at].type == mi.ObjectType.Emitter for _, at in _references(node.props)):
            raise ValueError(f"shape group '{nodes[group].props.id()}' holds an emitter; place lamps without instances")
        else:
            found.append(index)
    return found


def _references(props: Any) -> list[tuple[str, int]]:
    """Return (key, node) of each object that `props` names."""
    kind = mi.Properties.ResolvedReference
    return [(key, props[key].index()) for key in list(props.keys()) if isinstance(props[key], kind)]
