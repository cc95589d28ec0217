"""The suns of sky images: small, very bright spots are cut out and shine as lights, which cast shadows.

By chance alone a ray finds such a spot so seldom that its light is fireflies. A spot is what exceeds 50 times the
median of the image and is less than 5 degrees across. Where a glow around it makes it wider, what rises well above the
glow counts.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.ndimage import label
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from luxel.scene.colours import LUMINANCE
from luxel.scene.model import Light, SceneData, Sky
from luxel.scene.sky_image import NEIGHBOURS

MOST_SUNS = 4
"""Suns that are cut out of an image at most: the brightest ones."""
WIDEST = math.radians(5.0)
"""How far across a spot may be."""
BRIGHT = 50.0
"""A spot's least luminance, over the median of the pixels that are not black."""
BLACK_SHARE = 0.01
"""Share of the sphere under which lit pixels are no sky but lamps before a black one."""
LEVEL_STEP = 4.0
"""Where a spot is too wide, it is looked for above so many times the level; its mean then exceeds its rim's as much."""
LEAST_SHARE = 1e-3
"""Of the brightest spot's light, under which another one is not worth a shadow ray everywhere and stays."""
MEDIAN_PIXELS = 2_000_000
"""Pixels of a grid over the image that the median is taken of at most."""
SUN_NAME = "sky-sun"

Spot = tuple[np.ndarray, np.ndarray]
"""Rows and columns of its pixels."""


def part_suns(sky: Sky) -> Sky:
    """Return the sky with its suns cut out of the image and named in `suns`; itself where that has been done."""
    if sky.image is None or sky.suns is not None:
        return sky
    height, width = sky.image.shape[:2]
    image, suns = cut_suns(sky.image, *equal_rows(height, width))
    return replace(sky, image=image, suns=suns)


def with_suns(data: SceneData) -> SceneData:
    """Return the scene with the suns of its sky image among its lights; itself where there is nothing to do."""
    sky = part_suns(data.sky)
    return data if sky is data.sky else replace(data, sky=sky, lights=[*data.lights, *sky_lights(sky)])


def replace_sky(data: SceneData, sky: Sky) -> SceneData:
    """Return the scene under another sky, whose suns take the place of the old one's.

    Where the image is the same, its suns are turned and coloured with it; what a hand has changed of them stays.
    """
    if sky.suns is None and sky.image is data.sky.image:
        # Its suns have been cut out already.
        sky = replace(sky, suns=data.sky.suns)
    sky = part_suns(sky)
    if sky.image is not data.sky.image or (sky.suns or []) != (data.sky.suns or []):
        lights = [*(light for light in data.lights if not light.in_sky), *sky_lights(sky)]
        return replace(data, sky=sky, lights=lights)
    pairs = zip(sky_lights(data.sky), sky_lights(sky), strict=True)
    moves = {before.name: (before, after) for before, after in pairs}
    lights = [_follow(light, *moves[light.name]) if light.in_sky and light.name in moves else light
              for light in data.lights]  # fmt: skip
    return replace(data, sky=sky, lights=lights)


def _follow(light: Light, before: Light, after: Light) -> Light:
    """Return the light with those fields of `after` that it has as `before` has them."""
    names = (name for name in ("color", "direction") if getattr(light, name) == getattr(before, name))
    return replace(light, **{name: getattr(after, name) for name in names})


def sky_lights(sky: Sky) -> list[Light]:
    """Return the suns of a sky as they shine in the scene: turned and coloured as its image is."""
    turn = math.radians(sky.rotation)
    lights = []
    for sun in sky.suns or ():
        x, y, z = sun.direction
        # Positive turns from -Z towards +X.
        direction = (math.cos(turn) * x - math.sin(turn) * z, y, math.sin(turn) * x + math.cos(turn) * z)
        red, green, blue = (part * factor for part, factor in zip(sun.color, sky.color, strict=True))
        lights.append(replace(sun, direction=direction, color=(red, green, blue), in_sky=True))
    return lights


def equal_rows(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return each row's angle from the zenith and the solid angle of its pixels, for rows from pole to pole."""
    edges = np.linspace(0.0, math.pi, height + 1)
    return 0.5 * (edges[1:] + edges[:-1]), (np.cos(edges[:-1]) - np.cos(edges[1:])) * (2.0 * math.pi / width)


def cut_suns(image: np.ndarray, polar: np.ndarray, solid_angle: np.ndarray) -> tuple[np.ndarray, list[Light]]:
    """Return the (H, W, 3) image without its suns, and the suns as directional lights, the brightest first.

    The image is as in `Sky`; what is missing in it is what the lights bring. `polar` (H,) are the angles of the rows
    from the zenith, `solid_angle` (H,) is that of a pixel in each.
    """
    # In single precision: an image of 8,192 columns has a hundred million numbers.
    spots = find_spots(np.asarray(image[..., :3] @ np.array(LUMINANCE, np.float32)), polar, solid_angle)
    if not spots:
        return image, []
    left, suns = np.array(image, np.float32), []
    for number, spot in enumerate(spots):
        name = SUN_NAME if number == 0 else f"{SUN_NAME}-{number + 1}"
        suns.append(_cut(left, spot, polar, solid_angle, name))
    return left, suns


def _cut(image: np.ndarray, spot: Spot, polar: np.ndarray, solid_angle: np.ndarray, name: str) -> Light:
    """Fill the spot of `image` from its rim, in place, and return what it shone above that."""
    rows, columns = spot
    inside = np.asarray(image[rows, columns, :3], np.float64)
    fill = np.minimum(_rim(image[..., :3], spot), inside).astype(image.dtype)
    excess = (inside - fill) * solid_angle[rows, None]
    image[rows, columns, :3] = fill
    flux, weight = excess.sum(axis=0), excess @ LUMINANCE
    axis = weight @ directions(rows, columns, polar, image.shape[1])
    x, y, z = (-axis / np.linalg.norm(axis)).tolist()
    # A disc of one radiance with the same flux and the same mean of the radiance: of a spot of one radiance, its size.
    wide = float(weight.sum() ** 2 / (weight**2 / solid_angle[rows]).sum())
    versine = wide / (2.0 * math.pi)
    red, green, blue = (flux * (1.0 - 0.5 * versine)).tolist()
    diameter = math.degrees(4.0 * math.asin(math.sqrt(0.5 * versine)))
    return Light(
        "directional",
        (red, green, blue),
        direction=(x, y, z),
        angular_diameter=min(diameter, math.degrees(WIDEST)),
        in_sky=True,
        name=name,
    )


def _rim(image: np.ndarray, spot: Spot) -> np.ndarray:
    """Return the mean (3,) of the pixels around a spot."""
    (height, width), (rows, columns) = image.shape[:2], spot
    around = []
    for dy, dx in NEIGHBOURS:
        row = rows + dy
        within = (row >= 0) & (row < height)
        around.append(row[within] * width + (columns[within] + dx) % width)
    rim = np.setdiff1d(np.concatenate(around), rows * width + columns)
    if not len(rim):
        return np.zeros(3)
    rows, columns = np.divmod(rim, width)
    return np.asarray(image[rows, columns], np.float64).mean(axis=0)


def directions(rows: np.ndarray, columns: np.ndarray, polar: np.ndarray, width: int) -> np.ndarray:
    """Return the unit vectors (N, 3) towards pixels of an image as in `Sky`, at rotation 0."""
    theta, phi = polar[rows], ((columns + 0.5) / width - 0.5) * 2.0 * math.pi
    return np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], axis=-1)


# --- where they are ------------------------------------------------------------------------------------------------


def find_spots(luminance: np.ndarray, polar: np.ndarray, solid_angle: np.ndarray) -> list[Spot]:
    """Return the brightest spots of an image of luminances (H, W), at most `MOST_SUNS`, the brightest first."""
    median, share = _median(luminance, solid_angle)
    level = BRIGHT * median if share >= BLACK_SHARE else 0.0
    left, found, first = luminance > level, [], True
    sizes = _pixel_size(polar, luminance.shape[1])
    while left.any():
        rows, columns = np.nonzero(left)
        part, count = _components(left, rows, columns)
        power = luminance[rows, columns] * solid_angle[rows]
        towards = directions(rows, columns, polar, luminance.shape[1])
        small = _width(part, count, towards, solid_angle[rows], sizes[rows]) < WIDEST
        if not first:
            small &= _stands_out(luminance, left, part, count, rows, columns)
        total = np.where(small, np.bincount(part, power, count), -1.0)
        for index in np.argsort(-total, kind="stable")[:MOST_SUNS]:
            if small[index]:
                found.append((float(total[index]), (rows[part == index], columns[part == index])))
        level = LEVEL_STEP * level if level > 0.0 else median
        # What is one spot holds no other; what is too wide may hold brighter ones.
        left[rows[small[part]], columns[small[part]]] = False
        left &= luminance > level
        first = False
    found.sort(key=lambda pair: -pair[0])
    return [spot for total, spot in found[:MOST_SUNS] if total >= LEAST_SHARE * found[0][0]]


def _median(luminance: np.ndarray, solid_angle: np.ndarray) -> tuple[float, float]:
    """Return the median of the pixels that are not black, by solid angle, and their share of all."""
    step = math.ceil(math.sqrt(luminance.size / MEDIAN_PIXELS))
    sparse = luminance[::step, ::step]
    weights = np.broadcast_to(solid_angle[::step, None], sparse.shape)
    lit = sparse > 0.0
    if not lit.any():
        # All black but for what lies between the grid's pixels.
        return float(np.median(luminance[luminance > 0.0])) if (luminance > 0.0).any() else 0.0, 0.0
    values, shares = sparse[lit], weights[lit]
    order = np.argsort(values)
    sums = np.cumsum(shares[order])
    middle = int(np.searchsorted(sums, 0.5 * sums[-1]))
    return float(values[order[middle]]), float(sums[-1] / weights.sum())


def _components(mask: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the number (N,) of the connected part that each pixel of the mask is in, and how many parts there are.

    Neighbours meet at corners too, the left edge meets the right one, and all pixels of a pole's row meet.
    """
    labels = np.zeros(mask.shape, np.int32)
    count = int(label(mask, np.ones((3, 3), int), output=labels))  # type: ignore[arg-type]
    height = mask.shape[0]
    pairs = []
    for shift in (-1, 0, 1):
        other = np.clip(np.arange(height) + shift, 0, height - 1)
        pairs.append(np.stack([labels[:, -1], labels[other, 0]], axis=1))
    for row in (0, height - 1):
        pole = np.unique(labels[row][labels[row] > 0])
        pairs.append(np.stack([pole[:-1], pole[1:]], axis=1))
    edges = np.concatenate(pairs)
    edges = edges[(edges > 0).all(axis=1)] - 1
    graph = coo_matrix((np.ones(len(edges), np.int8), (edges[:, 0], edges[:, 1])), shape=(count, count))
    parts, part_of = connected_components(graph, directed=False)
    return part_of[labels[rows, columns] - 1], int(parts)


def _pixel_size(polar: np.ndarray, width: int) -> np.ndarray:
    """Return the longer side of a pixel of each row, radians (H,)."""
    step = np.abs(np.gradient(polar)) if len(polar) > 1 else np.full(1, math.pi)
    return np.maximum(step, 2.0 * math.pi / width * np.sin(polar))


def _width(part: np.ndarray, count: int, towards: np.ndarray, solid_angle: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return how far across each part is, radians (count,), from its pixels' directions (N, 3) and sizes (N,)."""
    sums = [np.bincount(part, towards[:, axis] * solid_angle, count) for axis in range(3)]
    middle = np.stack(sums, axis=1)
    middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-300)
    chord = np.linalg.norm(towards - middle[part], axis=1)
    reach = np.zeros(count)
    np.maximum.at(reach, part, 4.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)) + size)
    return reach


def _stands_out(
    luminance: np.ndarray, mask: np.ndarray, part: np.ndarray, count: int, rows: np.ndarray, columns: np.ndarray
) -> np.ndarray:
    """Return whether each part's mean exceeds its rim's `LEVEL_STEP` times (count,), as a sun in its glow does."""
    height, width = luminance.shape
    rim, rims = np.zeros(count), np.zeros(count)
    for dy, dx in NEIGHBOURS:
        row, column = rows + dy, (columns + dx) % width
        outside = (row >= 0) & (row < height)
        row = np.clip(row, 0, height - 1)
        outside &= ~mask[row, column]
        rim += np.bincount(part[outside], luminance[row, column][outside], count)
        rims += np.bincount(part[outside], minlength=count)
    mean = np.bincount(part, luminance[rows, columns], count) / np.maximum(np.bincount(part, minlength=count), 1)
    return (rims > 0) & (mean * np.maximum(rims, 1) >= LEVEL_STEP * rim)
