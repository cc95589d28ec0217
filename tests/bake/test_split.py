"""A bake of a ground to the horizon: one triangle of the file is many of the .glb, each with its piece of the atlas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from luxel.bake.core import Baked, bake_scene
from luxel.bake.files import relight, write_bake
from luxel.bake.gltf import COLORS, write_glb
from luxel.scene.library.shapes import box
from luxel.scene.model import Camera, Material, Mesh, Object, SceneData, Sky

from .conftest import SMALL
from .test_gltf import open_file, read_accessor, read_picture, sample

HALF = 500.0
WALL = 2.0
HEIGHT = 3.0


def wall_on_plain() -> SceneData:
    """Return a black house on a black ground of 1 km with coordinates and colours by place, under a white sky."""
    p = np.array([[-HALF, 0, -HALF], [-HALF, 0, HALF], [HALF, 0, HALF], [HALF, 0, -HALF]], np.float32)
    uv = (p[:, [0, 2]] / (2.0 * HALF) + 0.5).astype(np.float32)
    colors = np.column_stack([uv, uv[:, 0], np.ones(4)]).astype(np.float32)
    ground = Mesh(p, np.array([[0, 1, 2], [0, 2, 3]], np.uint32), 0, uv=uv, colors=colors)
    house = box((-WALL, -0.5, -WALL), (WALL, HEIGHT, WALL), 0)
    objects = [Object("ground", [ground]), Object("house", [house])]
    black, sky = Material("black", (0.0, 0.0, 0.0)), Sky((1.0, 1.0, 1.0))
    camera = Camera((3.0, 2.0, 9.0), (0.0, 1.0, 0.0), fov=60.0)
    return SceneData("plain", objects, [black], cameras=[camera], sky=sky)


@pytest.fixture(scope="module")
def plain() -> Baked:
    return bake_scene(wall_on_plain(), "lightmap", {**SMALL, "texel_target": 6000}, frames=2, samples=1)


def light_at(distance: np.ndarray) -> np.ndarray:
    """Return the irradiance of the sky (N,) on the ground `distance` (N,) from the middle of a wall, closed form.

    The wall hides from a point at distance d before its middle, by the form factor of an element and a rectangle
    perpendicular to it (two quarters): (2 / 2 pi) (atan(w/d) - d/sqrt(d^2+h^2) atan(w/sqrt(d^2+h^2))).
    """
    reach = np.hypot(distance, HEIGHT)
    return np.pi - (np.arctan(WALL / distance) - distance / reach * np.arctan(WALL / reach))


def test_glb_keeps_the_ground_and_what_its_vertices_had(plain: Baked, tmp_path: Path) -> None:
    path = tmp_path / "plain.glb"
    write_glb(plain, path)
    file = open_file(path)
    ground = next(mesh for mesh in file.meshes if mesh.name == "ground").primitives[0]
    p = read_accessor(file, ground.attributes.POSITION).astype(np.float64)
    uv = read_accessor(file, ground.attributes.TEXCOORD_0)
    corners = p[read_accessor(file, ground.indices).reshape(-1, 3)]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # The house is sunk in, so that the ground's back is seen too.
    for up, front in ((1.0, cross[:, 1] > 0.0), (-1.0, cross[:, 1] < 0.0)):
        assert front.sum() > 20
        assert 0.5 * up * cross[front, 1].sum() == pytest.approx((2.0 * HALF) ** 2, rel=1e-6)
        assert len(np.unique(corners[front][..., 1])) == 1
    np.testing.assert_allclose(uv, p[:, [0, 2]] / (2.0 * HALF) + 0.5, atol=1e-6)
    colors = getattr(ground.attributes, COLORS)
    np.testing.assert_allclose(read_accessor(file, colors)[:, :2], uv, atol=1e-6)


def test_glb_shows_the_light_of_the_closed_form_beside_the_house(plain: Baked, tmp_path: Path) -> None:
    path = tmp_path / "plain.glb"
    write_glb(plain, path, light_only=True, exposure=0.5)
    file = open_file(path)
    ground = next(mesh for mesh in file.meshes if mesh.name == "ground").primitives[0]
    p = read_accessor(file, ground.attributes.POSITION).astype(np.float64)
    uv = read_accessor(file, ground.attributes.TEXCOORD_1).astype(np.float64)
    triangles = read_accessor(file, ground.indices).reshape(-1, 3)
    triangles = triangles[p[triangles][..., 1].max(axis=1) == 0.0]
    distance = np.array([0.5, 1.0, 2.0, 4.0, 8.0, 20.0, 100.0])
    places = []
    for at in np.stack([WALL + distance, np.zeros(len(distance))], axis=1):
        a, b, c = (p[triangles[:, i]][:, [0, 2]] for i in range(3))
        weights = np.linalg.solve(np.stack([b - a, c - a], axis=2), (at - a)[..., None])[..., 0]
        inside = np.minimum(weights.min(axis=1), 1.0 - weights.sum(axis=1))
        best = int(inside.argmax())
        assert inside[best] > -1e-6
        share = np.array([1.0 - weights[best].sum(), *weights[best]])
        places.append(share @ uv[triangles[best]])
    shown = sample(read_picture(file), np.array(places))[:, 1] / 255.0
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    wanted = 0.5 * light_at(distance) / np.pi
    np.testing.assert_allclose(linear, wanted, rtol=0.1)


def test_a_relit_bake_has_the_split_triangles_of_its_file(plain: Baked, tmp_path: Path) -> None:
    write_bake(plain, tmp_path / "plain.glb")
    relit = relight(tmp_path / "plain.luxel.npz", wall_on_plain(), frames=2, samples=1)
    np.testing.assert_array_equal(relit.corners, plain.corners)
    np.testing.assert_allclose(relit.light.indirect, plain.light.indirect, rtol=1e-4, atol=1e-5)
    surface = relit.layout.points(0, len(relit.layout.face), relit.scene)
    assert np.abs(np.array(surface.p)[1]).max() <= HEIGHT + 1e-3


def test_no_seam_where_the_ground_is_cut(plain: Baked) -> None:
    """Octaves meet along shared edges, so their borders are closed like others."""
    assert plain.seam_count > 20
    assert plain.seam < 0.01
