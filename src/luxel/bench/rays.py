"""How many rays a second this machine traces: random ones into a bumpy sphere, in about a second."""

from __future__ import annotations

import time

import numpy as np

RINGS = 250
"""Rows of the sphere's triangles: 2 * 250 * 250 in all."""
RAYS = 1 << 20


def ray_benchmark(seconds: float = 1.0) -> dict[str, float | int]:
    """Trace batches of 2^20 random rays into 125,000 triangles for about `seconds`.

    Returns `rays_per_second`, `triangles` and `batches`. The device must have been started; compile time and the
    build of the acceleration structure are left out.
    """
    import drjit as dr
    import mitsuba as mi

    from luxel.kernels.sampling import random_2d
    from luxel.scene.accel import make_accel

    positions, faces = bumpy_sphere(RINGS)
    scene = make_accel(positions, faces)

    def trace(seed: int) -> None:
        lane = dr.arange(mi.UInt32, RAYS)
        counter = dr.opaque(mi.UInt32, 2 * seed)
        origin = 2.0 * mi.warp.square_to_uniform_sphere(random_2d(counter, lane))
        target = 0.9 * mi.warp.square_to_uniform_sphere(random_2d(counter + 1, lane))
        ray = mi.Ray3f(mi.Point3f(origin), dr.normalize(mi.Vector3f(target - origin)))
        dr.eval(scene.ray_intersect_preliminary(ray).t)
        dr.sync_thread()

    for seed in range(2):
        trace(seed)
    batches, start = 0, time.perf_counter()
    while (spent := time.perf_counter() - start) < seconds:
        batches += 1
        trace(batches + 1)
    return {"rays_per_second": batches * RAYS / spent, "triangles": len(faces), "batches": batches}


def bumpy_sphere(rings: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a sphere of radius about 1 with bumps: (V, 3) float32 positions and (2 rings^2, 3) uint32 faces."""
    polar, azimuth = np.meshgrid(np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, rings + 1), indexing="ij")
    radius = 1.0 + 0.05 * np.sin(9 * polar) * np.sin(11 * azimuth)
    around = np.sin(polar)
    positions = np.stack([around * np.cos(azimuth), np.cos(polar), around * np.sin(azimuth)], axis=-1)
    positions = (positions * radius[..., None]).reshape(-1, 3).astype(np.float32)
    row, column = (index.ravel() for index in np.mgrid[:rings, :rings])
    corner = row * (rings + 1) + column
    below = corner + rings + 1
    faces = np.concatenate([np.stack([corner, corner + 1, below], 1), np.stack([corner + 1, below + 1, below], 1)])
    return positions, faces.astype(np.uint32)
