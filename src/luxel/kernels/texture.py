"""Read textures of the shared table: wrap, bilinear filter, decode."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from luxel.scene.textures import TEXTURE_DATA, TEXTURE_NEAREST, TEXTURE_UV2, MaterialTables


def fetch_texture(
    tables: MaterialTables, row: mi.UInt32, uv: mi.Point2f, uv2: mi.Point2f, active: mi.Bool
) -> mi.Vector4f:
    """Return the filtered, decoded RGBA of texture `row` at `uv`; ones where `row` is 0 or the lane is inactive."""
    active = active & (row != 0)
    info = dr.gather(mi.Vector4u, tables.textures, row, active)
    if tables.has_uv2:
        uv = dr.select((info.w & TEXTURE_UV2) != 0, uv2, uv)
    if tables.has_transforms:
        first = dr.gather(mi.Vector4f, tables.transforms, 2 * row, active)
        second = dr.gather(mi.Vector4f, tables.transforms, 2 * row + 1, active)
        uv = mi.Point2f(
            dr.fma(first.x, uv.x, dr.fma(first.y, uv.y, first.z)),
            dr.fma(first.w, uv.x, dr.fma(second.x, uv.y, second.y)),
        )
    size = mi.Vector2i(mi.Int32(info.y), mi.Int32(info.z))
    position = uv * mi.Vector2f(size) - 0.5
    base = dr.floor(position)
    nearest = (info.w & TEXTURE_NEAREST) != 0
    weight = dr.select(nearest, dr.select(position - base >= 0.5, mi.Vector2f(1.0), mi.Vector2f(0.0)), position - base)
    corner = mi.Vector2i(base)
    x = [_wrap(corner.x + step, size.x, info.w & 3) for step in (0, 1)]
    y = [_wrap(corner.y + step, size.y, (info.w >> 2) & 3) for step in (0, 1)]
    data = (info.w & TEXTURE_DATA) != 0

    def texel(i: int, j: int) -> mi.Vector4f:
        word = dr.gather(mi.UInt32, tables.texels, info.x + mi.UInt32(y[j] * size.x + x[i]), active)
        return _decode(word, data)

    upper = dr.lerp(texel(0, 0), texel(1, 0), weight.x)
    lower = dr.lerp(texel(0, 1), texel(1, 1), weight.x)
    return dr.select(active, dr.lerp(upper, lower, weight.y), mi.Vector4f(1.0))


def _decode(word: mi.UInt32, data: mi.Bool) -> mi.Vector4f:
    """Unpack RGBA8; colours are stored as square roots."""
    scale = 1.0 / 255.0
    rgba = mi.Vector4f(
        mi.Float(word & 0xFF), mi.Float((word >> 8) & 0xFF), mi.Float((word >> 16) & 0xFF), mi.Float(word >> 24)
    )
    rgba *= scale
    squared = mi.Vector4f(dr.square(rgba.x), dr.square(rgba.y), dr.square(rgba.z), rgba.w)
    return dr.select(data, rgba, squared)


def _wrap(coordinate: mi.Int32, size: mi.Int32, mode: mi.UInt32) -> mi.Int32:
    """Bring a texel coordinate into 0..size-1: 0 repeats, 1 clamps, 2 mirrors."""
    size = dr.maximum(size, 1)
    period = dr.select(mode == 2, 2 * size, size)
    # Integer remainders take the sign of the dividend; a float quotient is exact enough for texel counts.
    folded = coordinate - period * mi.Int32(dr.floor(mi.Float(coordinate) / mi.Float(period)))
    mirrored = dr.select(folded >= size, 2 * size - 1 - folded, folded)
    repeated = dr.select(mode == 2, mirrored, folded)
    return dr.clip(dr.select(mode == 1, coordinate, repeated), 0, size - 1)
