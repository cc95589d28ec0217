"""What tells bakes apart: a hash of all that the transport is made from, and one of the rows it is cast for.

Lights are no part of it, and neither are cameras, moving things and the gloss of materials: a bake is relit under
others. Cameras and lamps have a say in which sides and pieces are laid flat, so what a stopped bake left is known by
the rows themselves.
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict

import numpy as np

from luxel import __version__
from luxel.kernels.material import describe_reflection
from luxel.kernels.triangle import read_triangles
from luxel.methods.lightmap.params import LightmapParams
from luxel.scene.device import Scene

HASH_LENGTH = 32
"""Characters of a hash."""


def fingerprint_scene(scene: Scene, params: LightmapParams) -> str:
    """Return a hash of the still geometry, what its materials reflect, the parameters and luxel's version."""
    digest = hashlib.sha256(repr((__version__, sorted(asdict(params).items()))).encode())
    count = sum(group.prim_count for group in scene.groups if group.object_id == 0)
    geometry = scene.geometry
    triangles = np.array(geometry.triangles).reshape(-1, 4)[:count]
    used = int(triangles[:, :3].max()) + 1 if count else 0
    for array, width in ((geometry.vertices, 4), (geometry.normals, 4), (geometry.colors, 4), (geometry.uv2, 2)):
        digest.update(np.array(array)[: width * used].tobytes())
    digest.update(triangles.tobytes())
    for part in describe_reflection(scene, np.unique(read_triangles(scene).material[:count])):
        digest.update(part.tobytes())
    return digest.hexdigest()[:HASH_LENGTH]


def fingerprint_rows(scene_mark: str, *made_of: np.ndarray) -> str:
    """Return a hash of a scene's fingerprint and of what rows are cast from and to."""
    digest = hashlib.sha256(scene_mark.encode())
    for array in made_of:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:HASH_LENGTH]
