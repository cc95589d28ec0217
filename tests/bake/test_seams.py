"""Seams: both borders of a cut show the same light."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.bake.core import Baked, bake_scene, face_corners, face_normals
from luxel.bake.layout import make_layout
from luxel.bake.seams import find_seams, look_up, measure_seams
from luxel.methods.lightmap.flatten.flat_scene import lay_out
from luxel.methods.lightmap.params import LightmapParams
from luxel.scene.device import upload
from luxel.scene.model import Material, Mesh, Object, SceneData

from .conftest import SMALL, cut_floor

SEAM_LIMIT = 0.02


def test_a_cut_floor_shows_no_seam() -> None:
    baked = bake_scene(cut_floor(), "lightmap", dict(SMALL), frames=8, samples=2)
    assert baked.seam_count > 20
    assert baked.seam <= SEAM_LIMIT
    assert baked.seam < baked.seam_before


def test_a_seam_between_two_materials_mixes_light_alone() -> None:
    data = cut_floor()
    data.materials += [Material("lamp", (0.02, 0.02, 0.02), emission=(50.0, 50.0, 50.0))]
    data.objects[0].meshes[1].material = 2
    baked = bake_scene(data, "lightmap", dict(SMALL), frames=2, samples=1)
    assert baked.seam_count > 20
    albedo, emission = (np.unique(np.round(v[:, 1], 4)) for v in (baked.light.albedo, baked.light.emission))
    assert albedo.tolist() == [0.02, 0.1, 0.5] and emission.tolist() == [0.0, 50.0]


def test_the_cornell_box_has_only_creases(cornell: Baked) -> None:
    assert cornell.seam_count == 0 and cornell.seam == 0.0


def test_a_step_across_a_cut_is_seen() -> None:
    baked = bake_scene(cut_floor(), "lightmap", dict(SMALL), frames=1, samples=1)
    layout = baked.layout
    seams = find_seams(layout, baked.corners, baked.normals)
    side = (look_up(layout, seams.a).T @ np.ones(len(seams.a))) > 0.0
    values = np.where(side, 1.2, 1.0)[:, None].repeat(3, axis=1)
    assert measure_seams(layout, seams, values) > 0.1
    assert measure_seams(layout, seams, np.ones_like(values)) < 1e-6


@pytest.mark.parametrize("rounded", [True, False])
def test_a_bend_is_a_seam_where_it_is_shaded_round(rounded: bool) -> None:
    side = np.array([[-1, 0, -1], [-1, 0, 1], [0, 0, 1], [0, 0, -1]], np.float32)
    slope = np.array([[0, 0, -1], [0, 0, 1], [1, 0.6, 1], [1, 0.6, -1]], np.float32)
    uv2 = np.array([[0, 0], [0, 1], [0.45, 1], [0.45, 0]], np.float32)
    rises = np.array([[0.0, 1.0, 0.0], [-0.6, 1.0, 0.0], [-0.3, 1.0, 0.0]])
    level, steep, between = rises / np.linalg.norm(rises, axis=1, keepdims=True)
    at_bend = (between, between) if rounded else (level, steep)
    normals = np.stack([level, level, at_bend[0], at_bend[0], at_bend[1], at_bend[1], steep, steep])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], np.uint32)
    mesh = Mesh(
        np.concatenate([side, slope]), faces, 0, normals=normals.astype(np.float32),
        uv2=np.concatenate([uv2, uv2 + np.array([0.55, 0.0], np.float32)]),
    )  # fmt: skip
    scene = upload(SceneData("bend", [Object("bend", [mesh])], [Material()]))
    layout = make_layout(lay_out(scene, LightmapParams(texel_target=1024), 0))
    seams = find_seams(layout, face_corners(scene, layout), face_normals(scene, layout))
    assert (len(seams.a) > 20) == rounded and (len(seams.a) == 0) != rounded
