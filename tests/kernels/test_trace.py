"""Rays against brute force: Möller and Trumbore 1997 over all triangles, in NumPy."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.trace import trace_closest, trace_occluded
from luxel.scene.device import set_time, upload
from luxel.scene.library.shapes import rotation, translation
from luxel.scene.model import Material, Mesh, Object, SceneData, Texture

RAYS = 1500


def soup(count: int, seed: int, size: float = 0.25, material: int = 0) -> Mesh:
    """Return `count` random triangles in the unit cube, with texture coordinates."""
    rng = np.random.default_rng(seed)
    corners = rng.random((count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    faces = np.arange(3 * count).reshape(-1, 3).astype(np.uint32)
    uv = rng.random((3 * count, 2)).astype(np.float32)
    return Mesh(corners.reshape(-1, 3).astype(np.float32), faces, material, uv=uv)


def random_rays(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    origin = rng.uniform(-1.0, 2.0, (RAYS, 3))
    direction = rng.random((RAYS, 3)) - origin
    return origin, direction / np.linalg.norm(direction, axis=1, keepdims=True)


def all_hits(origin: np.ndarray, direction: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances (R, T), infinite for a miss, and weights (R, T, 2) of the second and third corner."""
    a, edge_1, edge_2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    cross = np.cross(direction[:, None], edge_2[None])
    determinant = (cross * edge_1).sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = origin[:, None] - a[None]
        u = (offset * cross).sum(axis=-1) / determinant
        other = np.cross(offset, edge_1[None])
        v = (direction[:, None] * other).sum(axis=-1) / determinant
        t = (edge_2[None] * other).sum(axis=-1) / determinant
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    return np.where(inside, t, np.inf), np.stack([u, v], axis=-1)


def to_device(origin: np.ndarray, direction: np.ndarray) -> tuple[mi.Point3f, mi.Vector3f, mi.Bool]:
    lanes = mi.Bool(np.ones(len(origin), bool))
    return mi.Point3f(origin.T.astype(np.float32)), mi.Vector3f(direction.T.astype(np.float32)), lanes


def expect_hits(
    scene,  # noqa: ANN001
    origin: np.ndarray,
    direction: np.ndarray,
    t: np.ndarray,
    still: bool = False,
) -> np.ndarray:
    """Compare with distances `t` (R, T); return the triangles that both agree on, -1 elsewhere."""
    nearest = t.min(axis=1)
    o, d, lanes = to_device(origin, direction)
    hit = trace_closest(scene, o, d, lanes, still=still)
    found, valid = np.array(hit.t), np.array(hit.valid)
    # Rays through edges may fall to either side.
    same = (valid == np.isfinite(nearest)) & (~valid | np.isclose(found, nearest, rtol=1e-4, atol=1e-5))
    assert same.mean() > 0.998
    assert 0.2 < valid.mean() < 1.0
    # Shadow rays that end before the hit, and behind it.
    for share in (0.97, 1.03):
        length = np.where(np.isfinite(nearest), nearest * share, 3.0)
        blocked = np.array(trace_occluded(scene, o, d, mi.Float(length.astype(np.float32)), lanes, still=still))
        assert (blocked == (nearest < length)).mean() > 0.998
    prim = np.array(hit.prim_id).astype(int)
    return np.where(same & valid, prim, -1)


def test_opaque_triangles() -> None:
    mesh = soup(60, 1)
    scene = upload(SceneData("soup", [Object("soup", [mesh])], [Material()]))
    origin, direction = random_rays(2)
    t, weights = all_hits(origin, direction, mesh.positions[mesh.faces].astype(float))
    prim = expect_hits(scene, origin, direction, t)
    chosen = prim >= 0
    np.testing.assert_array_equal(prim[chosen], t.argmin(axis=1)[chosen])
    barycentric = np.array(trace_closest(scene, *to_device(origin, direction)).barycentric).T
    expected = weights[np.arange(RAYS), t.argmin(axis=1)]
    np.testing.assert_allclose(barycentric[chosen], expected[chosen], atol=2e-3)


def test_inactive_rays_hit_nothing() -> None:
    scene = upload(SceneData("soup", [Object("soup", [soup(60, 1)])], [Material()]))
    o, d, lanes = to_device(*random_rays(2))
    assert not np.array(trace_closest(scene, o, d, ~lanes).valid).any()
    assert not np.array(trace_occluded(scene, o, d, mi.Float(10.0), ~lanes)).any()


def test_cut_outs_are_walked_through() -> None:
    """Alpha is a checker read without filter; opaque triangles stand among the cut-outs."""
    alpha = np.full((4, 4, 4), 255, np.uint8)
    alpha[(np.indices((4, 4)).sum(axis=0) % 2) == 0, 3] = 90
    leaf = Material(base_color_texture=Texture(alpha, nearest=True), alpha_mode="mask")
    leaves, stones = soup(80, 3, 0.4, material=1), soup(25, 4)
    scene = upload(SceneData("leaves", [Object("all", [leaves, stones])], [Material(), leaf]))
    origin, direction = random_rays(5)

    t, weights = all_hits(origin, direction, leaves.positions[leaves.faces].astype(float))
    assert leaves.uv is not None
    uv = leaves.uv[leaves.faces].astype(float)
    b = np.nan_to_num(weights, posinf=0.0, neginf=0.0)
    at = uv[None, :, 0] + b[..., :1] * (uv[:, 1] - uv[:, 0]) + b[..., 1:] * (uv[:, 2] - uv[:, 0])
    texel = np.floor(np.clip(at, -9.0, 9.0) * 4).astype(int) % 4
    holes = alpha[texel[..., 1], texel[..., 0], 3] < 128
    walked = np.where(holes, np.inf, t)
    stone_t, _ = all_hits(origin, direction, stones.positions[stones.faces].astype(float))
    expect_hits(scene, origin, direction, np.concatenate([walked, stone_t], axis=1))
    # The holes matter: without them many rays would end earlier.
    assert (t.min(axis=1) < walked.min(axis=1) - 1e-3).mean() > 0.2


def test_alpha_factor_below_the_cutoff_lets_everything_pass() -> None:
    glass = Material(alpha=0.3, alpha_mode="mask")
    scene = upload(SceneData("glass", [Object("all", [soup(60, 1)])], [glass]))
    o, d, lanes = to_device(*random_rays(2))
    assert not np.array(trace_closest(scene, o, d, lanes).valid).any()
    assert not np.array(trace_occluded(scene, o, d, mi.Float(10.0), lanes)).any()


@pytest.mark.parametrize("one_accel", [None, True])
@pytest.mark.parametrize("cutout", [False, True])
def test_moving_objects(cutout: bool, one_accel: bool | None) -> None:
    """A still and a turning, sliding, scaled part, at several times and back; and what stands still alone."""
    still, turning = soup(30, 6), soup(30, 7, 0.35, material=1)
    alpha = np.full((2, 2, 4), 255, np.uint8)
    material = Material(base_color_texture=Texture(alpha), alpha_mode="mask") if cutout else Material()

    def motion(time: float) -> np.ndarray:
        middle = translation(0.5, 0.5, 0.5)
        scale = np.diag([1.0 + 0.3 * time, 0.7, 1.0, 1.0])
        return (
            translation(0.4 * time, 0.0, -0.2 * time)
            @ middle
            @ rotation("y", 50.0 * time)
            @ scale
            @ np.linalg.inv(middle)
        )

    objects = [Object("still", [still]), Object("turning", [turning], motion(0.0), motion)]
    scene = upload(SceneData("turning", objects, [Material(), material], duration=2.0), one_accel)
    origin, direction = random_rays(8)
    fixed, _ = all_hits(origin, direction, still.positions[still.faces].astype(float))
    for time in (0.0, 0.8, 2.0, 0.3):
        set_time(scene, time)
        matrix = motion(time)
        world = turning.positions.astype(float) @ matrix[:3, :3].T + matrix[:3, 3]
        moved, _ = all_hits(origin, direction, world[turning.faces])
        expect_hits(scene, origin, direction, np.concatenate([fixed, moved], axis=1))
        expect_hits(scene, origin, direction, fixed, still=True)


def test_deforming_objects() -> None:
    base = soup(40, 9)

    def deform(time: float) -> list[tuple[np.ndarray, np.ndarray | None]]:
        wave = 0.3 * np.sin(3.0 * base.positions[:, :1] + 4.0 * time)
        return [((base.positions + wave * np.array([0.0, 1.0, 0.4])).astype(np.float32), None)]

    item = Object("cloth", [base], translation(0.1, 0.0, 0.0), deform=deform)
    scene = upload(SceneData("cloth", [item], [Material()], duration=1.0))
    origin, direction = random_rays(10)
    for time in (0.0, 0.4, 1.0, 0.2):
        set_time(scene, time)
        world = deform(time)[0][0].astype(float) + (0.1, 0.0, 0.0)
        t, _ = all_hits(origin, direction, world[base.faces])
        expect_hits(scene, origin, direction, t)
