"""Depth around surfels in whole scenes: planes at known distances, and thin walls that let no light through."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.packing import unpack_normal
from luxel.kernels.surface import free_surface
from luxel.methods import METHODS, inspector_of
from luxel.methods.gibs.depth import WARP
from luxel.methods.gibs.depth_maps import unpack_texel
from luxel.render.renderer import Renderer
from luxel.scene import load
from luxel.scene.library.shapes import box, quad
from luxel.scene.model import Camera, Material, Object, SceneData, Sky

RADIUS = 0.1
REACH = 2.0 * RADIUS


def read_maps(renderer: Renderer) -> tuple[np.ndarray, ...]:
    """Return position (N, 3), directions of texel middles (N, 64, 3), mean and deviation (N, 64) of all mapped surfels.

    Directions are those of the published map with z stretched, in the surfel's frame.
    """
    state = renderer.state
    rows = np.array(state.depth.rows).reshape(-1, 4)
    chosen = np.flatnonzero((np.array(state.surfels.object_id) != 0) & (rows[:, 1] > 0.0))
    side, words = state.settings.depth.side, state.settings.depth.words_a_map
    held = np.array(state.depth.words).reshape(-1, words)[chosen].ravel()
    parts = [[np.array(v).reshape(len(chosen), words) for v in unpack_texel(mi.UInt32(held), k)] for k in range(2)]
    mean, deviation = (np.stack([part[k] for part in parts], axis=2).reshape(len(chosen), -1) for k in range(2))
    row, column = np.divmod(np.arange(side * side), side)
    u, v = (2.0 * column + 1.0) / side - 1.0, (2.0 * row + 1.0) / side - 1.0
    x, y = 0.5 * (u + v), 0.5 * (u - v)
    local = np.stack([x, y, (1.0 - np.abs(x) - np.abs(y)) / WARP], axis=1)
    local /= np.linalg.norm(local, axis=1, keepdims=True)
    p, n = (np.array(a).T[chosen].astype(float) for a in (state.surfels.p, state.surfels.n))
    s = np.array(unpack_normal(mi.Float(rows[chosen, 2]))).T.astype(float)
    axes = np.stack([s, np.cross(n, s), n], axis=1)
    np.testing.assert_allclose(axes @ axes.transpose(0, 2, 1), np.broadcast_to(np.eye(3), axes.shape), atol=5e-3)
    return p, np.einsum("tk,nkc->ntc", local, axes), mean.astype(float), deviation.astype(float)


def turned(angle: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[0, 0] = matrix[2, 2] = np.cos(angle)
    matrix[0, 2], matrix[2, 0] = np.sin(angle), -np.sin(angle)
    return matrix


def corner(angle_of: object = None) -> SceneData:
    """Return a floor with a wall in its middle, tall and thin, seen from above; `angle_of` turns both with time."""
    floor = quad((-0.5, 0, 0.5), (0.5, 0, 0.5), (0.5, 0, -0.5), (-0.5, 0, -0.5), 0)
    wall = quad((0.0, 0, 0.5), (0.0, 0, -0.5), (0.0, 3, -0.5), (0.0, 3, 0.5), 0)
    motion = None if angle_of is None else lambda time: turned(angle_of(time))  # type: ignore[operator]
    camera = Camera((0.0, 2.9, 0.0), (0.0, 0.0, 0.0), up=(0.0, 0.0, -1.0), orthographic_width=0.6)
    item = Object("corner", [floor, wall], np.eye(4), motion)
    return SceneData(
        "corner", [item], [Material("grey", (0.5, 0.5, 0.5))], sky=Sky((1.0, 1.0, 1.0)), cameras=[camera], duration=9.0
    )


def depth_to_plane(p: np.ndarray, d: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return how far the plane through the origin is along rays (N, T), in units of the reach, 1 beyond it."""
    with np.errstate(divide="ignore"):
        t = -(p @ normal)[:, None] / (d @ normal)
    return np.where((t > 0.0) & (t < REACH), t / REACH, 1.0)


def test_a_plane_is_where_it_is_from_the_first_frame() -> None:
    renderer = Renderer(
        corner(), "gibs", {"radius": RADIUS, "capacity": 512, "hit_spawn_threshold": 0.0}, size=(48, 48)
    )
    renderer.run(2)
    p, d, mean, _ = read_maps(renderer)
    on_floor = (np.abs(p[:, 1]) < 1e-4) & (np.abs(p[:, 0]) > 0.01)
    assert on_floor.sum() > 10
    wanted = depth_to_plane(p, d, np.array([1.0, 0.0, 0.0]))[on_floor]
    assert (wanted < 1.0).mean() > 0.1
    # Half a step of 8 bits and the dither's one; the tangent is packed to 2e-3.
    assert np.quantile(np.abs(mean[on_floor] - wanted), 0.98) < 0.01


def test_jittered_rays_find_mean_and_deviation_of_a_texel() -> None:
    """After many frames each texel holds the moments of the plane's depth over its square."""
    renderer = Renderer(
        corner(), "gibs", {"radius": RADIUS, "capacity": 512, "hit_spawn_threshold": 0.0}, size=(48, 48)
    )
    renderer.run(400)
    p, d, mean, deviation = read_maps(renderer)
    middle = depth_to_plane(p, d, np.array([1.0, 0.0, 0.0]))
    seen = (middle < 0.7) & (np.abs(p[:, 1]) < 1e-4)[:, None] & (np.abs(p[:, 0]) > 0.01)[:, None]
    assert seen.sum() > 50
    # Depth grows towards the texel's far side: on average a little beyond the middle's, and never the same all over.
    assert np.median(mean[seen] / middle[seen]) == pytest.approx(1.0, abs=0.1)
    assert 0.01 < np.median(deviation[seen] / middle[seen]) < 0.3


def test_a_map_turns_with_its_object() -> None:
    """A quarter turn in one frame: too fast for new rays, so what the maps say must have turned along."""
    renderer = Renderer(
        corner(lambda time: 0.5 * np.pi * time), "gibs",
        {"radius": RADIUS, "capacity": 512, "hit_spawn_threshold": 0.0}, size=(48, 48),
    )  # fmt: skip
    renderer.run(3)
    renderer.step(time=1.0)
    p, d, mean, _ = read_maps(renderer)
    normal = turned(0.5 * np.pi)[:3, :3] @ [1.0, 0.0, 0.0]
    on_floor = (np.abs(p[:, 1]) < 1e-4) & (np.abs(p @ normal) > 0.01)
    error = np.abs(mean - depth_to_plane(p, d, normal))[on_floor]
    not_turned = np.abs(mean - depth_to_plane(p, d, np.array([1.0, 0.0, 0.0])))[on_floor]
    assert error.mean() < 0.02 < 0.05 < not_turned.mean()


# --- leaks ---------------------------------------------------------------------------------------------------------


def rooms_askew(wall: float) -> SceneData:
    """Return a lit room under a dark attic, both turned by 35 degrees and far from the origin, `wall` metres apart.

    The lit room is seen; what they share are four wall planes that run on from one to the other.
    """
    lit = box((-1.5, 0.0, -1.0), (1.5, 2.0, 1.0), 0, inward=True)
    dark = box((-1.5, 2.0 + wall, -1.0), (1.5, 4.0, 1.0), 0, inward=True)
    lamp = quad((-0.4, 0.02, 0.4), (0.4, 0.02, 0.4), (0.4, 0.02, -0.4), (-0.4, 0.02, -0.4), 1)
    place = turned(0.6)
    place[:3, 3] = (20.0, -3.0, 7.0)
    materials = [Material("white", (0.8, 0.8, 0.8)), Material("lamp", (0.8, 0.8, 0.8), emission=(10.0, 10.0, 10.0))]
    eye, target = (place @ [*at, 1.0] for at in ((-1.2, 0.5, 0.8), (0.6, 1.9, -1.0)))
    camera = Camera(tuple(eye[:3]), tuple(target[:3]), fov=100.0)
    objects = [Object("lit", [lit, lamp], place), Object("dark", [dark], place)]
    return SceneData("askew", objects, materials, cameras=[camera])


def leak_along_the_seam(depth_texels: int, frames: int) -> tuple[float, Renderer, np.ndarray, np.ndarray]:
    """Return E in the dark within 10 to 60 mm of the seam over E as near to it in the lit room; and the dark points."""
    renderer = Renderer(
        rooms_askew(0.01),
        "gibs",
        {"radius": 0.1, "capacity": 16384, "depth_texels": depth_texels},
        size=(96, 96),
        seed=2,
    )
    renderer.run(frames)
    place, found = turned(0.6), []
    place[:3, 3] = (20.0, -3.0, 7.0)
    along, away = (a.ravel() for a in np.meshgrid(np.linspace(-1.2, 1.2, 60), np.linspace(0.01, 0.06, 6)))
    for height in (2.01 + away, 2.0 - away):
        points = np.stack([along, height, np.full_like(along, -1.0)], axis=1) @ place[:3, :3].T + place[:3, 3]
        normals = np.tile(place[:3, :3] @ [0.0, 0.0, 1.0], (len(points), 1))
        found.append((renderer.irradiance_at(points, normals).mean(), points, normals))
    (dark, points, normals), (lit, _, _) = found
    assert lit > 0.05
    return float(dark / lit), renderer, points, normals


def test_light_stays_under_a_thin_ceiling() -> None:
    leak, renderer, points, normals = leak_along_the_seam(8, 48)
    assert leak < 0.005
    inspector, whys = inspector_of(METHODS["gibs"]), set()
    for index in range(0, len(points), 30):
        surface = free_surface(points[index : index + 1], normals[index : index + 1])
        whys |= {entry.why for entry in inspector.explain(renderer.scene, renderer.state, surface)}
    assert "depth" in whys


def test_without_depth_the_ceiling_leaks() -> None:
    """So the test above can fail."""
    assert leak_along_the_seam(0, 48)[0] > 0.3


def test_it_is_closed_from_the_first_frames() -> None:
    assert leak_along_the_seam(8, 4)[0] < 0.05


def test_points_before_all_walls_see_all_of_the_light() -> None:
    """In the middle of a room's floor nothing is near: maps take nothing away."""
    renderer = Renderer(load("furnace"), "gibs", {"surfel_target": 500}, size=(32, 32), seed=1)
    renderer.run(12)
    state = renderer.state
    rows = np.array(state.depth.rows).reshape(-1, 4)
    alive = (np.array(state.surfels.object_id) != 0) & (rows[:, 1] > 0.0)
    assert (rows[alive, 0] > 0.0).mean() > 0.9
    assert dr.width(state.depth.words) == state.settings.capacity * 32
