"""EXT_mesh_gpu_instancing: one node that shows its mesh many times."""

from __future__ import annotations

import numpy as np

from luxel.scene.gltf.accessors import AccessorReader
from luxel.scene.gltf.document import Document
from luxel.scene.gltf.nodes import LARGEST_ENTRY, REST, compose
from luxel.scene.gltf.schema import GltfNode

INSTANCING = "EXT_mesh_gpu_instancing"
ELEMENTS = {"TRANSLATION": "VEC3", "ROTATION": "VEC4", "SCALE": "VEC3"}


def read_instances(document: Document, reader: AccessorReader, index: int, node: GltfNode) -> np.ndarray | None:
    """(K, 4, 4) matrices of the instances of node `index` in its own space; None where it has the mesh once.

    Rotations may be floats or normalised integers. Raises `LuxelError` for attributes of unequal length and for
    numbers that are not finite.
    """
    if INSTANCING not in node.extensions:
        return None
    attributes = node.extensions[INSTANCING].get("attributes") or {}
    found: dict[str, np.ndarray] = {}
    for name, accessor in attributes.items():
        if name in ELEMENTS:
            unit = name == "ROTATION"
            found[name] = reader.read_floats(accessor, (ELEMENTS[name],), unit=unit).astype(np.float64)
            if not (np.abs(found[name]) < LARGEST_ENTRY).all():
                document.fail(f"the instance {name} of node {index} holds NaN, infinity or a value that is too large")
        elif not name.startswith("_"):
            document.warn("Instance attributes other than place, turn and size are ignored: {names}.", name)
    counts = {name: len(values) for name, values in found.items()}
    if len(set(counts.values())) > 1:
        listed = ", ".join(f"{name} {count}" for name, count in counts.items())
        document.fail(f"the instance attributes of node {index} are of unequal length ({listed})")
    if not counts:
        document.warn("Instancing without TRANSLATION, ROTATION or SCALE shows its mesh once.")
        return None
    count = next(iter(counts.values()))
    parts = [found.get(path.upper(), np.tile(rest, (count, 1))) for path, rest in REST.items()]
    return compose(*parts)
