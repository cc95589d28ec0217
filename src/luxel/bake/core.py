"""One bake: a still scene, a method's light, the atlas it is laid out in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from luxel import runtime
from luxel.bake.bounce import bounce_light
from luxel.bake.gltf_gloss import name_approximations, name_dark
from luxel.bake.layout import Layout, leave_still, make_layout
from luxel.bake.light import TexelLight, light_texels
from luxel.bake.seams import close_seams, find_seams, measure_seams
from luxel.errors import LuxelError
from luxel.kernels.triangle import read_normals, read_positions, read_triangles
from luxel.methods.base import Method, Progress, stay_silent
from luxel.methods.lightmap.flatten.flat_scene import lay_out
from luxel.methods.lightmap.method import Lightmap
from luxel.methods.lightmap.params import LightmapParams
from luxel.methods.lightmap.run.state import LightmapState
from luxel.methods.params import find_method, make_params
from luxel.methods.table import METHODS
from luxel.scene.choice import check_materials
from luxel.scene.device import Scene, upload
from luxel.scene.host import Looks
from luxel.scene.model import SceneData

SAMPLES = 16
"""Samples of direct light, and paths of `path`, at each point of a texel."""


@dataclass
class Baked:
    """A finished bake."""

    data: SceneData
    """The scene, without what moves."""
    scene: Scene
    method: Method
    params: Any
    state: Any
    layout: Layout
    light: TexelLight
    corners: np.ndarray
    """(F, 3, 3) positions of the layout's faces in the world, measured from the scene's origin."""
    normals: np.ndarray
    """(F, 3, 3) unit normals of their corners, on the face's side: what they are shaded by."""
    seam: float
    """Mean difference of light across chart borders over the mean light, after they were closed."""
    seam_before: float
    """The same before."""
    seam_count: int
    """Points along the borders that were compared."""
    seed: int
    samples: int
    frames: int | None
    """Frames that were asked for; None: until light has settled."""
    frames_run: int
    indirect_only: bool
    notes: list[str]
    """What the user should know, one sentence each."""
    surfel_rays: int
    """Shadow rays that the frames' surfels cast at most; 0 for methods without them."""
    materials: Looks = "diffuse"
    """What of their own materials surfaces keep in the .glb, and, with `path`, what light sees of them."""
    light_only: bool = False
    """Relit: the bake was written without the surfaces' colours."""


def bake_scene(
    data: SceneData, method: str = "lightmap", params: Any = None, *, preset: str | None = None,
    frames: int | None = None, samples: int = SAMPLES, seed: int = 0, indirect_only: bool = False,
    materials: Looks = "diffuse", device: str = "auto", workdir: Path | None = None, report: Progress | None = None,
) -> Baked:  # fmt: skip
    """Bake a scene's light into texels. A stopped bake takes the rays and samples that `workdir` holds.

    Texels hold diffuse light. `materials` "full": surfaces keep their gloss in the .glb, and the paths of `path` go
    through glass and off mirrors; "diffuse": neither.

    `params` is the method's, or a dict of settings; those of the atlas (`texel_target`, `texels_per_metre`) are taken
    for every method. Light bounces for `frames` frames, or until it has settled.

    Raises LuxelError for a method that cannot bake, bad parameters, or surfaces that cannot be unwrapped.
    """
    check_materials(materials)
    found = find_method(method)
    if not found.bakeable:
        able = ", ".join(name for name, one in METHODS.items() if one.bakeable)
        raise LuxelError(f"method '{method}' cannot bake: take one of {able}")
    runtime.start(device)
    settings, atlas = _split_settings(found, params)
    parameters = make_params(method, preset, settings) if isinstance(settings, dict) else settings
    still = leave_still(data)
    scene = upload(still, recentre=True, materials=found.shown_materials(materials))
    still = replace(still, origin=scene.host.data.origin)
    say = report or stay_silent
    if isinstance(found, Lightmap):
        parameters.check()
        flat = lay_out(scene, parameters, seed, say)
        state = found.build(scene, parameters, seed, workdir=workdir, progress=say, flat=flat)
    else:
        flat = lay_out(scene, atlas, seed, say)
        state = found.build(scene, parameters, seed, workdir=workdir, progress=say)
    return finish_bake(
        still, scene, found, parameters, state, make_layout(flat),
        frames=frames, samples=samples, seed=seed, indirect_only=indirect_only, materials=materials,
        workdir=workdir, report=report,
    )  # fmt: skip


def finish_bake(
    data: SceneData, scene: Scene, method: Method, params: Any, state: Any, layout: Layout, *, frames: int | None,
    samples: int, seed: int, indirect_only: bool, materials: Looks = "diffuse", workdir: Path | None = None,
    report: Progress | None = None,
) -> Baked:  # fmt: skip
    """Run `frames` frames of a built method (None: until its light has settled) and read its texels."""
    say = report or stay_silent
    state, run, settled = bounce_light(scene, method, params, state, layout, frames=frames, seed=seed, say=say)
    left_out = data.diffuse_warnings if scene.host.looks == "full" else []
    notes = [*(sentence for sentence in data.warnings if sentence not in left_out), *method.warnings(state)]
    if materials == "full":
        # What loaders say of metals and glass under the diffuse condition comes first where it holds.
        notes += name_dark(data) if scene.host.looks == "full" or not data.diffuse_warnings else []
        notes += name_approximations(data)
    if not settled:
        notes.append(f"Light still changed after {run} frames: more of them (`frames`) come nearer to its end.")
    light = light_texels(
        scene, method, state, layout, samples=samples, seed=seed, direct=not indirect_only, workdir=workdir,
        progress=lambda share: say("lighting texels", share),
    )  # fmt: skip
    say("closing seams", 0.0)
    corners, normals = face_corners(scene, layout), face_normals(scene, layout)
    seams = find_seams(layout, corners, normals)
    before = measure_seams(layout, seams, light.irradiance)
    # Light is one on both sides of a seam; the surfaces' own colours need not be.
    light.direct, light.indirect = (close_seams(layout, seams, values) for values in (light.direct, light.indirect))
    return Baked(
        data=data, scene=scene, method=method, params=params, state=state, layout=layout, light=light, corners=corners,
        normals=normals, seam=measure_seams(layout, seams, light.irradiance), seam_before=before,
        seam_count=len(seams.a), seed=seed, samples=samples, frames=frames, frames_run=run,
        indirect_only=indirect_only, notes=notes, materials=materials,
        surfel_rays=run * _surfel_rays(method, state),
    )  # fmt: skip


def _surfel_rays(method: Method, state: Any) -> int:
    """Return the shadow rays that the surfels cast in a frame at most; 0 for methods without them."""
    if method.workload is None or not isinstance(state, LightmapState):
        return 0
    return method.workload.ray_counts(state).get("shadow", 0)


def face_corners(scene: Scene, layout: Layout) -> np.ndarray:
    """Return the positions (F, 3, 3) of the layout's faces in the world, measured from the scene's origin."""
    rows = read_triangles(scene).vertices[layout.prim]
    return layout.at_corners(np.arange(len(rows)), read_positions(scene)[rows])


def face_normals(scene: Scene, layout: Layout) -> np.ndarray:
    """Return the corners' unit normals (F, 3, 3) on each face's side; the face's own where it has none."""
    rows = read_triangles(scene).vertices[layout.prim]
    given = read_normals(scene)[rows]
    face = np.broadcast_to(layout.normal[:, None], given.shape)
    normal = np.where(np.linalg.norm(given, axis=2, keepdims=True) > 1e-6, given, face)
    normal = np.where((normal * face).sum(axis=2, keepdims=True) < 0.0, -normal, normal)
    normal = layout.at_corners(np.arange(len(rows)), normal)
    return normal / np.linalg.norm(normal, axis=2, keepdims=True)


def _split_settings(method: Method, params: Any) -> tuple[Any, LightmapParams]:
    """Return the method's own settings, and the atlas's for methods that have none."""
    if isinstance(method, Lightmap) or not isinstance(params, dict):
        return ({} if params is None else params), LightmapParams()
    names = ("texel_target", "texels_per_metre")
    atlas = make_params(Lightmap.name, None, {key: params[key] for key in names if key in params})
    atlas.check()
    return {key: value for key, value in params.items() if key not in names}, atlas
