"""From a hit to its surface: normals, sides, materials, vertex colours."""

from __future__ import annotations

import dataclasses
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.records import Surface
from luxel.kernels.surface import surface_at_hit
from luxel.kernels.trace import trace_closest
from luxel.scene.device import Scene, set_time, upload
from luxel.scene.library.shapes import quad, rotation, sphere, translation
from luxel.scene.model import Material, Mesh, Object, SceneData, Texture


def see(scene: Scene, origin: np.ndarray, direction: np.ndarray) -> Surface:
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    o, d = mi.Point3f(origin.T.astype(np.float32)), mi.Vector3f(direction.T.astype(np.float32))
    return surface_at_hit(scene, trace_closest(scene, o, d, mi.Bool(np.ones(len(origin), bool))), d)


def rows(value: object, count: int) -> np.ndarray:
    array = np.array(value)
    array = array.T if array.ndim == 2 else array[:, None]
    return np.broadcast_to(array, (count, array.shape[1]))


def wall(**changes: Any) -> Mesh:
    """Return the unit square in the plane z = 0, facing +z, uv = xy."""
    return dataclasses.replace(quad((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), 0), **changes)


def look_at_wall(material: Material, mesh: Mesh | None = None, side: float = 1.0, seed: int = 1) -> Surface:
    """Look at 200 points of the wall from the front (side 1) or the back (-1), at slanted angles."""
    rng = np.random.default_rng(seed)
    target = np.concatenate([rng.uniform(0.05, 0.95, (200, 2)), np.zeros((200, 1))], axis=1)
    origin = target + np.stack([*rng.uniform(-1, 1, (2, 200)), np.full(200, side)], axis=1)
    scene = upload(SceneData("wall", [Object("wall", [mesh or wall()])], [material]))
    return see(scene, origin, target - origin)


def test_position_and_sides() -> None:
    rng = np.random.default_rng(2)
    ball = sphere((0.3, 0.1, -0.2), 1.0, 0, rings=24, sectors=48)
    scene = upload(SceneData("ball", [Object("ball", [ball])], [Material()]))
    direction = rng.normal(size=(800, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    for inside in (False, True):
        centre = np.array([0.3, 0.1, -0.2])
        origin = centre + 0.1 * rng.normal(size=(800, 3)) if inside else centre + 3.0 * direction
        towards = direction if inside else centre - origin + 0.2 * rng.normal(size=(800, 3))
        surface = see(scene, origin, towards)
        assert rows(surface.active, 800).all()
        p, wo = rows(surface.p, 800), rows(surface.wo, 800)
        away = p - origin
        np.testing.assert_allclose(
            np.cross(away / np.linalg.norm(away, axis=1, keepdims=True), wo), np.zeros((800, 3)), atol=1e-5
        )
        radial = (p - centre) * (-1.0 if inside else 1.0)
        radial /= np.linalg.norm(radial, axis=1, keepdims=True)
        for normal in (surface.n_geometric, surface.n_shading):
            n = rows(normal, 800)
            np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, atol=1e-5)
            assert ((n * radial).sum(axis=1) > 0.98).all()
        assert ((rows(surface.n_geometric, 800) * wo).sum(axis=1) >= 0.0).all()
        assert (rows(surface.front, 800)[:, 0] != inside).all()
        # Vertex normals follow the ball more closely than its facets.
        flat, smooth = ((rows(n, 800) * radial).sum(axis=1).mean() for n in (surface.n_geometric, surface.n_shading))
        assert smooth > flat


def test_vertex_normals_that_oppose_their_triangle_follow_it() -> None:
    for side in (1.0, -1.0):
        wrong = wall(normals=np.tile(np.array([0.0, 0.3, -0.95], np.float32), (4, 1)))
        surface = look_at_wall(Material(), wrong, side)
        agreement = (rows(surface.n_shading, 200) * rows(surface.n_geometric, 200)).sum(axis=1)
        assert (agreement > 0.9).all()
        assert (rows(surface.n_geometric, 200)[:, 2] * side > 0.99).all()


def test_albedo_on_the_back() -> None:
    color = (0.5, 0.25, 0.75)
    for reflects in (True, False):
        material = Material(base_color=color, reflect_back=reflects)
        front, back = (rows(look_at_wall(material, side=side).albedo, 200) for side in (1.0, -1.0))
        np.testing.assert_allclose(front, [color] * 200, atol=1e-6)
        np.testing.assert_allclose(back, [color if reflects else (0.0, 0.0, 0.0)] * 200, atol=1e-6)


def test_emission_on_the_back() -> None:
    for emits in (True, False):
        material = Material(emission=(5.0, 6.0, 7.0), emit_back=emits)
        front, back = (rows(look_at_wall(material, side=side).emission, 200) for side in (1.0, -1.0))
        np.testing.assert_allclose(front, [(5.0, 6.0, 7.0)] * 200, rtol=1e-6)
        np.testing.assert_allclose(back, [(5.0, 6.0, 7.0) if emits else (0.0, 0.0, 0.0)] * 200, rtol=1e-6)


def test_metals_have_no_diffuse_albedo() -> None:
    half = look_at_wall(Material(base_color=(0.8, 0.4, 0.2), metallic=0.5))
    np.testing.assert_allclose(rows(half.albedo, 200), [(0.4, 0.2, 0.1)] * 200, atol=1e-6)
    assert not rows(look_at_wall(Material(metallic=1.0)).albedo, 200).any()
    # A texture whose blue channel is metallic: left half metal, right half not.
    image = np.zeros((1, 2, 3), np.uint8)
    image[0, 0, 2] = 255
    texture = Texture(image, srgb=False, nearest=True, wrap_u="clamp")
    surface = look_at_wall(Material(base_color=(0.6, 0.6, 0.6), metallic=1.0, metallic_roughness_texture=texture))
    left = rows(surface.p, 200)[:, 0] < 0.5
    np.testing.assert_allclose(rows(surface.albedo, 200), np.where(left, 0.0, 0.6)[:, None].repeat(3, 1), atol=0.005)


def test_base_colour_texture_and_vertex_colours_multiply() -> None:
    image = np.full((1, 1, 3), 128, np.uint8)
    colors = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], np.float32)
    material = Material(base_color=(0.9, 0.8, 0.7), base_color_texture=Texture(image, srgb=False))
    surface = look_at_wall(material, wall(colors=colors))
    p = rows(surface.p, 200).astype(float)
    # Corners a, b, c, d of the square; triangles (a, b, c) and (a, c, d).
    x, y = p[:, :1], p[:, 1:2]
    lower = (1 - x) * colors[0] + (x - y) * colors[1] + y * colors[2]
    upper = (1 - y) * colors[0] + x * colors[2] + (y - x) * colors[3]
    expected = np.where(y < x, lower, upper) * material.base_color * 128 / 255
    np.testing.assert_allclose(rows(surface.albedo, 200), expected, atol=0.006)


def test_texture_coordinates() -> None:
    other = np.array([[3, 1], [4, 1], [4, 3], [3, 3]], np.float32)
    surface = look_at_wall(Material(), wall(uv2=other))
    p = rows(surface.p, 200)
    np.testing.assert_allclose(rows(surface.uv, 200), p[:, :2], atol=1e-5)
    np.testing.assert_allclose(rows(surface.uv2, 200), p[:, :2] * (1, 2) + (3, 1), atol=1e-5)


# ------------------------------------------------------------------------------------------------------ normal maps


def normal_map(x: float, y: float) -> Texture:
    """Return a constant map that leans by (x, y) in tangent space."""
    n = np.array([x, y, np.sqrt(1.0 - x * x - y * y)])
    return Texture((0.5 * n + 0.5).astype(np.float32)[None, None], srgb=False)


def test_a_flat_normal_map_changes_nothing() -> None:
    flat = Texture(np.array([[[0.5, 0.5, 1.0]]], np.float32), srgb=False)
    for side in (1.0, -1.0):
        with_map, without = (
            rows(look_at_wall(material, side=side).n_shading, 200)
            for material in (Material(normal_texture=flat), Material())
        )
        np.testing.assert_allclose(with_map, without, atol=0.006)


@pytest.mark.parametrize(("x", "y"), [(0.5, 0.0), (0.0, 0.5), (-0.3, 0.4)])
def test_a_normal_map_leans_along_u_and_against_v(x: float, y: float) -> None:
    """glTF 2.0, 3.9.3: green points up in texture space, and v of a glTF image points down."""
    surface = look_at_wall(Material(normal_texture=normal_map(x, y)))
    # uv = xy here, so +u is +x of the world and "up" in the image is -y.
    expected = np.array([x, -y, np.sqrt(1.0 - x * x - y * y)])
    np.testing.assert_allclose(rows(surface.n_shading, 200), [expected] * 200, atol=0.01)
    np.testing.assert_allclose(rows(surface.n_geometric, 200), [(0.0, 0.0, 1.0)] * 200, atol=1e-6)


def test_a_mirrored_texture_mirrors_its_map() -> None:
    mirrored = wall(uv=np.array([[1, 0], [0, 0], [0, 1], [1, 1]], np.float32))
    surface = look_at_wall(Material(normal_texture=normal_map(0.5, 0.3)), mirrored)
    expected = np.array([-0.5, -0.3, np.sqrt(1.0 - 0.34)])
    np.testing.assert_allclose(rows(surface.n_shading, 200), [expected] * 200, atol=0.01)


def test_normal_scale() -> None:
    surface = look_at_wall(Material(normal_texture=normal_map(0.6, 0.0), normal_scale=0.5))
    expected = np.array([0.3, 0.0, 0.8]) / np.hypot(0.3, 0.8)
    np.testing.assert_allclose(rows(surface.n_shading, 200), [expected] * 200, atol=0.01)


# --------------------------------------------------------------------------------------------------- moving objects


def test_surfaces_of_moving_objects_are_in_world_and_in_object_space() -> None:
    def motion(time: float) -> np.ndarray:
        return translation(0.5 * time, 0.2, 0.0) @ rotation("y", 60.0 * time) @ np.diag([1.0, 2.0, 0.5, 1.0])

    ball = sphere((0.0, 0.0, 0.0), 0.5, 0, rings=48, sectors=96)
    still = quad((-5, -5, -5), (5, -5, -5), (5, 5, -5), (-5, 5, -5), 0)
    data = SceneData("moving", [Object("still", [still]), Object("ball", [ball], motion(0), motion)], [Material()])
    scene = upload(data)
    rng = np.random.default_rng(3)
    for time in (0.0, 1.3):
        set_time(scene, time)
        matrix = motion(time)
        origin = matrix[:3, 3] + np.array([0.0, 0.0, 4.0]) + 0.1 * rng.normal(size=(300, 3))
        surface = see(scene, origin, matrix[:3, 3] - origin)
        assert (rows(surface.object_id, 300) == 2).all()
        p, local = rows(surface.p, 300), rows(surface.p_object, 300)
        np.testing.assert_allclose(np.linalg.norm(local, axis=1), 0.5, atol=2e-3)
        np.testing.assert_allclose(local @ matrix[:3, :3].T + matrix[:3, 3], p, atol=1e-5)
        normal = local @ np.linalg.inv(matrix[:3, :3])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        assert ((rows(surface.n_shading, 300) * normal).sum(axis=1) > 0.999).all()
        assert ((rows(surface.n_geometric, 300) * normal).sum(axis=1) > 0.99).all()


def test_free_points_have_what_is_known_and_defaults_for_the_rest() -> None:
    """A new field of a surface needs a default for points on no object, or `Surface.at` fails here."""
    p, n, lean = mi.Point3f(1.0, 2.0, 3.0), mi.Normal3f(0.0, 0.0, 1.0), mi.Normal3f(0.6, 0.0, 0.8)
    surface = Surface.at(p, n, n_shading=lean, albedo=mi.Color3f(0.25))
    for name, right in {
        "p": (1, 2, 3), "p_object": (1, 2, 3), "n_geometric": (0, 0, 1), "n_shading": (0.6, 0, 0.8), "wo": (0, 0, 1),
        "object_id": 0, "albedo": 0.25, "emission": 0, "front": True, "active": True,
    }.items():  # fmt: skip
        np.testing.assert_allclose(rows(getattr(surface, name), 1).ravel(), right, rtol=1e-6, err_msg=name)
    assert all(getattr(surface, field.name) is not None for field in dataclasses.fields(Surface))
    with pytest.raises(TypeError, match="colour"):
        Surface.at(p, n, colour=lean)
