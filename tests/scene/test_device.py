"""What is uploaded: many objects, shared meshes, pictures that serve twice."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.errors import LuxelError
from luxel.kernels.surface import surface_at
from luxel.kernels.trace import trace_closest
from luxel.scene.device import set_time, upload
from luxel.scene.host import OBJECT_LIMIT
from luxel.scene.library.shapes import box, quad, translation
from luxel.scene.model import Material, Object, SceneData, Texture


def test_more_still_objects_than_ids() -> None:
    """70,000 boxes that share one mesh, and one thing that moves: every ray finds its own."""
    shared = box((0, 0, 0), (0.5, 0.5, 0.5), 0)
    count = OBJECT_LIMIT + 5000
    objects = [Object(f"box-{i}", [shared], translation(i % 300, 0, i // 300)) for i in range(count)]
    objects.insert(3, Object("mover", [shared], motion=lambda time: translation(0.0, 5.0 + time, 0.0)))
    scene = upload(SceneData("many", objects, [Material()]))
    chosen = np.array([0, 299, 31_234, count - 1])
    places = np.stack([chosen % 300 + 0.25, np.full(4, 3.0), chosen // 300 + 0.25], axis=1)
    places = np.concatenate([places, [[0.25, 9.0, 0.25]]]).astype(np.float32)
    origin = mi.Point3f(*(mi.Float(column.copy()) for column in places.T))
    hit = trace_closest(scene, origin, mi.Vector3f(0.0, -1.0, 0.0), mi.Bool(True))
    np.testing.assert_allclose(np.array(hit.t), [2.5, 2.5, 2.5, 2.5, 3.5], rtol=1e-5)
    names = [objects[scene.host.object_of_triangle(int(prim))].name for prim in np.array(hit.prim_id)]
    assert names == [*(f"box-{i}" for i in chosen), "mover"]
    ids = np.array(surface_at(scene, hit.prim_id, hit.barycentric, hit.valid).object_id)
    assert len(set(ids[:4])) == 1 and ids[4] != ids[0]
    assert scene.host.object_name(int(ids[4])) == "mover"


def test_one_picture_as_colour_and_as_data() -> None:
    """The same image is read through the sRGB curve as a colour, and plainly as roughness."""
    image = np.full((2, 2, 3), 128, np.uint8)
    colour, data = Texture(image, srgb=True), Texture(image, srgb=False)
    for first in (
        Material(base_color=(1, 1, 1), base_color_texture=colour, metallic_roughness_texture=data),
        Material(base_color=(1, 1, 1), base_color_texture=data, emission=(1, 1, 1), emission_texture=colour),
    ):
        plate = quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), 0)
        scene = upload(SceneData("plate", [Object("plate", [plate])], [first]))
        seen = surface_at(scene, mi.UInt32(0), mi.Point2f(0.2, 0.3), mi.Bool(True))
        plain = 128 / 255
        curved = ((plain + 0.055) / 1.055) ** 2.4
        as_data = np.array(dr.sqrt(seen.bsdf.alpha) if first.emission_texture is None else seen.albedo.x).ravel()[0]
        as_colour = np.array(seen.albedo.x if first.emission_texture is None else seen.emission.x).ravel()[0]
        assert abs(as_data - plain) < 0.005 and abs(as_colour - curved) < 0.005


@pytest.mark.parametrize("sides", [(0.0, 0.0, 0.0), (1.0, 0.0, 1.0)])
@pytest.mark.parametrize("late", [False, True])
def test_a_motion_that_flattens_its_object_is_refused_in_one_sentence(
    sides: tuple[float, float, float], late: bool
) -> None:
    flat = np.diag((*sides, 1.0))
    sheet = quad((-1, 0, -1), (1, 0, -1), (1, 0, 1), (-1, 0, 1), 0)
    still = Object("floor", [sheet])
    with pytest.raises(LuxelError, match="door.*flattens"):
        door = Object("door", [sheet], motion=lambda time: flat if time or not late else np.eye(4))
        scene = upload(SceneData("flat", [still, door], [Material()]))
        try:
            set_time(scene, 1.0)
        finally:
            assert scene.host.time == 0.0
