"""The texels that are compared, and the path tracer's light in them: the truth of both sides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from luxel.bake.layout import Layout
from luxel.bake.light import light_texels
from luxel.methods.lightmap.flatten.atlas import SUBTEXELS
from luxel.methods.lightmap.flatten.raster import cover
from luxel.methods.params import find_method, make_params
from luxel.scene.device import Scene

from .errors import Halves, patch_of_texels

CYCLES_REACH = 0.26
"""Texels from a texel's middle to the farthest inner point: Cycles draws its samples from the middle half of a texel (a
quarter of its area), measured by baking steps of emission, so it is judged by the mean of that part."""
LEAST_POINTS = SUBTEXELS * SUBTEXELS // 2
"""Points of a texel that its chart must cover: half of them, as along a border."""
TOUCH = 1e-4
"""Distance from another surface, as a share of the scene's size, from which a texel touches it."""


@dataclass
class Compared:
    """The texels that are compared, K of them."""

    texel: np.ndarray
    """(K,) of the layout's."""
    patch: np.ndarray
    """(K,)."""
    share: float
    """Of the layout's texels in the open."""

    def pick(self, layout: Layout, sheet: np.ndarray) -> np.ndarray:
        """Return the compared texels (K, 3) of a whole atlas (H, W, 4)."""
        return sheet.reshape(-1, sheet.shape[-1])[layout.slot[self.texel], :3].astype(np.float64)


def find_inner(layout: Layout) -> np.ndarray:
    """Return which points (P,) lie in the middle half of their texel along both sides: what Cycles samples of it."""
    owner = np.repeat(np.arange(len(layout.slot)), np.diff(layout.starts))
    place = (layout.uv[layout.face] * layout.weights[..., None]).sum(axis=1)
    middle = np.stack([layout.slot % layout.width, layout.slot // layout.width], axis=1)[owner]
    return np.abs(place - middle).max(axis=1) < CYCLES_REACH


def choose_texels(layout: Layout, corners: np.ndarray, covered: np.ndarray) -> Compared:
    """Return the texels that lie in the open with all that their charts cover of them, and that Cycles baked.

    `covered` (H, W) says which it did: those whose middle a triangle holds. What it samples of them lies within that
    triangle, so this must be true of the texel's inner points too. `corners` (T, 3, 3) are the scene's triangles: where
    two lie in one place, which of them is lit is a matter of rounding.
    """
    held = layout.chart >= 0
    cell, _, _ = cover((layout.uv[held] + 0.5) * SUBTEXELS, (layout.width * SUBTEXELS, layout.height * SUBTEXELS))
    cell = np.unique(cell)
    columns = layout.width * SUBTEXELS
    own = (cell // columns // SUBTEXELS) * layout.width + cell % columns // SUBTEXELS
    raw = np.bincount(own, minlength=layout.width * layout.height)[layout.slot]
    counts = np.diff(layout.starts)
    owner, inner = np.repeat(np.arange(len(counts)), counts), find_inner(layout)
    lowest, highest = np.full(len(counts), len(layout.uv)), np.full(len(counts), -1)
    np.minimum.at(lowest, owner[inner], layout.face[inner])
    np.maximum.at(highest, owner[inner], layout.face[inner])
    whole = layout.open & (raw >= LEAST_POINTS) & (counts == raw) & (lowest == highest)
    texel = np.flatnonzero(whole & covered.ravel()[layout.slot])
    texel = texel[~find_touching(layout, corners, texel)]
    x, y = layout.slot[texel] % layout.width, layout.slot[texel] // layout.width
    return Compared(texel, patch_of_texels(x, y, layout.chart[lowest[texel]]), len(texel) / int(layout.open.sum()))


def find_touching(layout: Layout, corners: np.ndarray, texel: np.ndarray) -> np.ndarray:
    """Return which of `texel` (K,) have points that lie on a second triangle of the scene as well."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    distance = (normal * corners[:, 0]).sum(axis=1)
    slack = TOUCH * float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    chosen = np.zeros(len(layout.slot), bool)
    chosen[texel] = True
    owner = np.repeat(np.arange(len(layout.slot)), np.diff(layout.starts))
    point = np.flatnonzero(chosen[owner])
    prim = layout.prim[layout.face[point]]
    place = (corners[prim] * layout.weights[point][..., None]).sum(axis=1)
    touching = np.zeros(len(layout.slot), bool)
    # All points of a triangle are looked at together.
    order = np.argsort(prim, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(prim[order])) + 1) if len(order) else ():
        own = prim[members[0]]
        along = normal @ normal[own]
        near = (np.abs(along) > 0.9999) & (np.abs(distance - np.sign(along) * distance[own]) < slack)
        near[own] = False
        for triangle in corners[near]:
            touching[owner[point[members[_inside(place[members], triangle, normal[own])]]]] = True
    return touching[texel]


def _inside(p: np.ndarray, triangle: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return which points (K, 3) of a triangle's plane lie in the triangle (3, 3), not on its edges."""
    edges = [(triangle[k], triangle[(k + 1) % 3] - triangle[k]) for k in range(3)]
    signed = np.stack([np.cross(edge, p - start) @ normal / max(float(edge @ edge), 1e-30) for start, edge in edges])
    return np.logical_or((signed > 1e-4).all(axis=0), (signed < -1e-4).all(axis=0))


@dataclass
class Truth:
    """Irradiance of all texels (M, 3), W/m^2, in two independent halves."""

    direct: Halves
    indirect: Halves

    @property
    def total(self) -> Halves:
        return Halves(self.direct.a + self.indirect.a, self.direct.b + self.indirect.b)

    def take(self, chosen: np.ndarray) -> Truth:
        """Return the truth of the texels `chosen`."""
        return Truth(self.direct.take(chosen), self.indirect.take(chosen))


def make_truth(
    scene: Scene, layout: Layout, rounds: int, seed: int, report: Callable[[str, float], None]
) -> tuple[Truth, Truth]:
    """Return the path tracer's light as means over whole texels, and over their middle halves (Cycles' texels).

    In each of `rounds` (even) every point of a texel gets a new place in its cell, and one path from there.
    """
    method = find_method("path")
    state = method.build(scene, make_params("path", None, {}), seed)
    count = len(layout.face)
    single = replace(layout, starts=np.arange(count + 1), source=np.arange(count))
    sums = np.zeros((2, count, 6), np.float32)
    random = np.random.default_rng(seed)
    for number in range(rounds):
        light = light_texels(scene, method, state, jitter(single, random), samples=1, seed=seed + 1000 + number)
        sums[number % 2] += np.concatenate([light.direct, light.indirect], axis=1)
        report("truth", (number + 1) / rounds)
    sums /= rounds / 2
    inner = find_inner(layout)
    return _average(layout, sums, np.ones(count)), _average(layout, sums, inner.astype(float))


def _average(layout: Layout, halves: np.ndarray, weight: np.ndarray) -> Truth:
    """Return the means over each texel's points of `halves` (2, P, 6), points weighed by `weight` (P,)."""
    owner = np.repeat(np.arange(len(layout.slot)), np.diff(layout.starts))
    total = np.maximum(np.bincount(owner, weights=weight, minlength=len(layout.slot)), 1e-9)[:, None]
    means = [
        np.stack([np.bincount(owner, half[:, c] * weight, len(layout.slot)) for c in range(6)], axis=1) / total
        for half in halves
    ]
    return Truth(*(Halves(means[0][:, part], means[1][:, part]) for part in (slice(0, 3), slice(3, 6))))


def jitter(layout: Layout, random: np.random.Generator) -> Layout:
    """Return the layout with every point somewhere in its cell, so that edges of shadows are no stair of cells.

    A point that would leave its triangle goes the other way, or stays.
    """
    corners = layout.uv[layout.face].astype(np.float64)
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    step = (random.random((len(corners), 2)) - 0.5) / SUBTEXELS
    area = edge_1[:, 0] * edge_2[:, 1] - edge_1[:, 1] * edge_2[:, 0]
    area = np.where(np.abs(area) > 1e-12, area, np.inf)
    first = (step[:, 0] * edge_2[:, 1] - step[:, 1] * edge_2[:, 0]) / area
    second = (edge_1[:, 0] * step[:, 1] - edge_1[:, 1] * step[:, 0]) / area
    move = np.stack([-first - second, first, second], axis=1)
    there, back = layout.weights + move, layout.weights - move
    found = np.where((back >= 0.0).all(axis=1, keepdims=True), back, layout.weights)
    found = np.where((there >= 0.0).all(axis=1, keepdims=True), there, found)
    return replace(layout, weights=found.astype(np.float32))
