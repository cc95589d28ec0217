"""Backs of another material stand just behind their fronts, as near as single precision tells, wherever they stand."""

from __future__ import annotations

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from luxel.kernels.trace import trace_closest
from luxel.scene import load
from luxel.scene.device import upload
from luxel.scene.triangles import world_corners

TWO = """<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="1, 0, 0"/></bsdf>
  <bsdf type="diffuse"><rgb name="reflectance" value="0, 1, 0"/></bsdf></bsdf>"""
FAR = """<shape type="rectangle"><transform name="to_world"><scale value="{scale}"/>
  <translate x="{away}" y="9" z="{away}"/></transform>
  </shape>"""
RAYS = 20_000
PLACES = {
    "near": (1.0, 0.0, 0.0, 0.0),
    "tiny": (1e-4, 0.0, 0.0, 0.0),
    "large": (1e3, 0.0, 0.0, 0.0),
    "far": (1.0, 2000.0, -700.0, 300.0),
    "tiny and far": (0.05, 2000.0, -700.0, 300.0),
}


def write(folder: Path, scale: float, at: tuple[float, float, float], instanced: bool) -> Path:
    turn = '<rotate x="0.3" y="1" z="0.2" angle="40"/>'
    steps = f'{turn}<scale value="{scale}"/><translate x="{at[0]}" y="{at[1]}" z="{at[2]}"/>'
    if instanced:
        body = f"""<shape type="shapegroup" id="group"><shape type="rectangle">{TWO}</shape></shape>
        <shape type="instance"><ref id="group"/><transform name="to_world">{steps}</transform></shape>"""
    else:
        body = f'<shape type="rectangle"><transform name="to_world">{steps}</transform>{TWO}</shape>'
    light = '<emitter type="constant"/>'
    path = folder / "sheet.xml"
    path.write_text(f'<scene version="3.0.0">{light}{body}{FAR.format(away=1e5, scale=scale)}</scene>')
    return path


@pytest.mark.parametrize("instanced", [False, True])
@pytest.mark.parametrize("place", PLACES)
def test_each_side_is_met_from_its_side(tmp_path: Path, place: str, instanced: bool) -> None:
    """A stray rectangle of their size, 100 km away, has no say in how far apart they are."""
    scale, *at = PLACES[place]
    data = load(write(tmp_path, scale, (at[0], at[1], at[2]), instanced))
    scene = upload(data)
    rows = np.array(scene.geometry.triangles).reshape(-1, 4)
    corners = np.array(scene.geometry.vertices).reshape(-1, 4)[rows[:, :3].astype(int), :3].astype(float)
    colors = np.array([data.materials[row & 0xFFFF].base_color for row in rows[:, 3]])
    red, green = (np.flatnonzero(colors[:, axis] - colors[:, 1 - axis] > 0.5) for axis in (0, 1))
    assert len(red) == len(green) == 2
    normal = np.cross(corners[red[0], 1] - corners[red[0], 0], corners[red[0], 2] - corners[red[0], 0])
    normal /= np.linalg.norm(normal)
    gap = ((corners[red[0], 0] - corners[green[0]]) @ normal).mean()
    largest = np.abs(corners[red]).max()
    assert 0.0 < gap < 1e-4 * largest
    rng, every = np.random.default_rng(1), dr.full(mi.Bool, True, RAYS)
    for side, wanted in ((1.0, red), (-1.0, green)):
        target = np.einsum("ni,nij->nj", rng.dirichlet([2, 2, 2], RAYS), corners[wanted[rng.integers(0, 2, RAYS)]])
        away = rng.normal(size=(RAYS, 3))
        away += (side * np.abs(away @ normal) - away @ normal)[:, None] * normal
        away += side * 0.02 * normal * np.linalg.norm(away, axis=1, keepdims=True)
        origin = (target + scale * away).astype(np.float32)
        way = target - origin
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        hit = trace_closest(scene, mi.Point3f(origin.T), mi.Vector3f(way.T.astype(np.float32)), every)
        met, valid = np.array(hit.prim_id), np.array(hit.valid)
        # Rays aimed from coordinates of thousands of metres may miss the rim of a sheet of centimetres.
        assert valid.mean() > 0.99 and np.isin(met[valid], wanted).all(), (side, np.isin(met[valid], wanted).mean())


@pytest.mark.parametrize("sides", [(0.001, 2.0, 1.0), (2.0, 3.0, 1e-4), (1.0, 1.0, 50.0)])
def test_the_gap_is_that_of_the_world_whatever_stretches_an_instance(
    tmp_path: Path, sides: tuple[float, float, float]
) -> None:
    """Strips of a millimetre, flattened and thickened ones: their backs stand where those of squares do."""
    x, y, z = sides
    steps = f'<scale x="{x}" y="{y}" z="{z}"/><rotate x="0.3" y="1" z="0.2" angle="40"/><translate x="3"/>'
    path = tmp_path / "strip.xml"
    path.write_text(f"""<scene version="3.0.0"><emitter type="constant"/>
        <shape type="shapegroup" id="group"><shape type="rectangle">{TWO}</shape></shape>
        <shape type="instance"><ref id="group"/><transform name="to_world">{steps}</transform></shape></scene>""")
    corners = world_corners(load(path)).reshape(-1, 3)
    assert len(corners) == 12
    middle = corners[:6].mean(axis=0) - corners[6:].mean(axis=0)
    # 64 steps of eight roundings of the largest coordinate.
    assert np.linalg.norm(middle) == pytest.approx(64 * 8 * 2.0**-24 * np.abs(corners).max(), rel=0.05)
