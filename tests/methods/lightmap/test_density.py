"""Texels and surfels go where the scene is, not to its surroundings."""

from __future__ import annotations

import numpy as np
import pytest

from luxel.methods.lightmap.flatten.density import FALL, thin_out
from luxel.methods.lightmap.flatten.faces import find_faces, still_scene
from luxel.methods.lightmap.flatten.flat_scene import lay_out
from luxel.methods.lightmap.flatten.unwrap import unwrap
from luxel.methods.lightmap.params import LightmapParams
from luxel.scene.device import upload
from luxel.scene.library.shapes import box, quad
from luxel.scene.model import Camera, Material, Mesh, Object, SceneData

CAMERA = Camera((0.5, 1.5, 1.5), (-0.5, 1.4, -2.0), fov=70.0)
ROOM_AREA = 80.0


def room() -> Mesh:
    """Return a closed room of 4 by 3 by 4 m."""
    return box((-2.0, 0.0, -2.0), (2.0, 3.0, 2.0), 0)


def plate(half: float, height: float) -> Mesh:
    return quad((-half, height, -half), (-half, height, half), (half, height, half), (half, height, -half), 0)


def scene(*outside: Mesh) -> SceneData:
    objects = [Object(f"part {i}", [mesh]) for i, mesh in enumerate((room(), *outside))]
    return SceneData("room", objects, [Material()], cameras=[CAMERA])


@pytest.mark.parametrize("outside", [plate(1000.0, -0.5), plate(500.0, 400.0)], ids=["ground", "ceiling of the sky"])
def test_room_keeps_its_texels_and_surfels(outside: Mesh) -> None:
    """By area alone the room's 80 m^2 would get a ten thousandth of both."""
    params = LightmapParams(texel_target=8000)
    clean, wide = (lay_out(upload(data), params, 0) for data in (scene(), scene(outside)))
    assert wide.atlas.texel_size < 2.0 * clean.atlas.texel_size
    in_room = (np.abs(wide.points.p) < 3.5).all(axis=1)
    assert wide.weight[in_room].sum() > 0.3 * wide.weight.sum()
    # Areas stay true: light is sent by them.
    assert wide.points.area.sum() == pytest.approx(
        clean.points.area.sum() + 4.0 * outside.positions[:, 0].max() ** 2, rel=1e-3
    )


def test_density_of_a_chart_is_that_of_its_parts() -> None:
    """A plate wholly between one and three diagonals from the bounds has the density of that octave alone."""
    diagonal = float(np.linalg.norm((4.0, 3.0, 4.0)))
    away = Mesh(
        np.array(
            [[2.0 + 2.0 * diagonal, 0, 0], [2.0 + 2.0 * diagonal, 1, 0], [2.0 + 2.0 * diagonal, 0, 1]], np.float32
        ),
        np.array([[0, 1, 2]], np.uint32),
    )
    uploaded = upload(scene(away))
    faces = find_faces(uploaded, still_scene(uploaded))
    charts = thin_out(uploaded, faces, unwrap(faces, "room"))
    far = charts.chart[(faces.corners[:, :, 0] > 10.0).all(axis=1)]
    assert np.allclose(charts.density[far], 0.25**FALL)
    assert (np.delete(charts.density, far) == 1.0).all()
