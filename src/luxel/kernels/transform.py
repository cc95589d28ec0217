"""Matrices of a scene's objects: fetch one, and bring points, vectors and normals to the world or back.

Tables are (K, 12): the three upper rows of each matrix, row by row, as `Geometry.to_world` and `to_object` hold them.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


def fetch_matrix(
    table: mi.Float, index: mi.UInt32, active: mi.Bool | bool = True
) -> tuple[mi.Vector4f, mi.Vector4f, mi.Vector4f]:
    """Return the three rows of matrix `index` of a (K, 12) table."""
    first, second, third = (dr.gather(mi.Vector4f, table, 3 * index + row, active) for row in range(3))
    return first, second, third


def transform_point(table: mi.Float, index: mi.UInt32, p: mi.Point3f, active: mi.Bool | bool = True) -> mi.Point3f:
    """Apply matrix `index` of a (K, 12) table to points."""
    x, y, z = fetch_matrix(table, index, active)
    q = mi.Vector4f(p.x, p.y, p.z, 1.0)
    return mi.Point3f(dr.dot(x, q), dr.dot(y, q), dr.dot(z, q))


def transform_vector(table: mi.Float, index: mi.UInt32, v: mi.Vector3f, active: mi.Bool | bool = True) -> mi.Vector3f:
    """Apply the linear part of matrix `index` of a (K, 12) table to vectors."""
    x, y, z = fetch_matrix(table, index, active)
    q = mi.Vector4f(v.x, v.y, v.z, 0.0)
    return mi.Vector3f(dr.dot(x, q), dr.dot(y, q), dr.dot(z, q))


def transform_normal(
    inverses: mi.Float, index: mi.UInt32, n: mi.Normal3f, active: mi.Bool | bool = True
) -> mi.Normal3f:
    """Bring unit normals to the space from which matrix `index` of the (K, 12) table `inverses` leads back.

    By the inverse transpose: `to_object` brings normals of objects to the world, `to_world` those of the world back.
    """
    rows = fetch_matrix(inverses, index, active)
    x, y, z = (mi.Normal3f(row.x, row.y, row.z) for row in rows)
    return dr.normalize(n.x * x + n.y * y + n.z * z)


def carry_normal(
    inverses: mi.Float, table: mi.Float, index: mi.UInt32, n: mi.Normal3f, active: mi.Bool | bool = True
) -> mi.Normal3f:
    """Return unit normals of the world as they are where matrix `index` of `table` places their object instead.

    `inverses` are the matrices that place it now, (K, 12) as `table`; neither is inverted.
    """
    n_object = transform_normal(inverses, index, n, active)
    x, y, z = (mi.Vector3f(row.x, row.y, row.z) for row in fetch_matrix(table, index, active))
    # The cofactors are the inverse transpose times the determinant, whose sign tells a matrix that mirrors.
    carried = mi.Normal3f(
        dr.dot(dr.cross(y, z), n_object), dr.dot(dr.cross(z, x), n_object), dr.dot(dr.cross(x, y), n_object)
    )
    length = dr.squared_norm(carried)
    carried *= dr.mulsign(dr.rsqrt(dr.fmax(length, 1e-36)), dr.dot(x, dr.cross(y, z)))
    return dr.select(length > 1e-36, carried, n)


def determinant(table: mi.Float, index: mi.UInt32, active: mi.Bool | bool = True) -> mi.Float:
    """Return the determinant of matrix `index` of a (K, 12) table: negative for one that mirrors."""
    x, y, z = (mi.Vector3f(row.x, row.y, row.z) for row in fetch_matrix(table, index, active))
    return dr.dot(x, dr.cross(y, z))
