"""Many lamps, spots and emitting triangles at once, with shadows, beside `mi.render`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from luxel.scene.model import SceneData

Judge = Callable[..., SceneData]

PILLARS = "".join(
    f'<shape type="cube"><transform name="to_world"><scale x="0.12" y="0.7" z="0.12"/><translate x="{x}" y="0.7" '
    f'z="{z}"/></transform><ref id="white"/></shape>'
    for x in (-0.6, 0.5, 1.5)
    for z in (-1.2, 0.9)
)


HIDING = """<integrator type="path"><integer name="max_depth" value="24"/>
  <boolean name="hide_emitters" value="true"/></integrator>"""
"""Panels seen from the side are thinner than luxel's pixels are apart."""


def lamps(count: int, seed: int) -> str:
    """Return lamps, spots and small panels that hang among the pillars."""
    rng = np.random.default_rng(seed)
    lines = []
    for index in range(count):
        x, y, z = rng.uniform((-2.2, 1.8, -1.6), (2.2, 2.4, 1.8))
        r, g, b = rng.uniform(0.2, 1.0, 3) * 10.0 ** rng.uniform(-0.8, 0.3)
        place = f'<translate x="{x:.3f}" y="{y:.3f}" z="{z:.3f}"/>'
        if index % 3 == 0:
            lines.append(
                f'<emitter type="point"><transform name="to_world">{place}</transform>'
                f'<rgb name="intensity" value="{r}, {g}, {b}"/></emitter>'
            )
        elif index % 3 == 1:
            way = f"{x + rng.normal():.3f}, 0, {z + rng.normal():.3f}"
            lines.append(
                '<emitter type="spot"><transform name="to_world">'
                f'<lookat origin="{x:.3f}, {y:.3f}, {z:.3f}" target="{way}" up="0.1, 0, 1"/></transform>'
                f'<rgb name="intensity" value="{3 * r}, {3 * g}, {3 * b}"/>'
                f'<float name="cutoff_angle" value="{rng.uniform(15, 60):.1f}"/></emitter>'
            )
        else:
            turn = (
                f'<rotate x="1" angle="{rng.uniform(20, 160):.1f}"/><rotate y="1" angle="{rng.uniform(0, 360):.1f}"/>'
            )
            lines.append(
                f'<shape type="rectangle"><transform name="to_world"><scale value="0.1"/>{turn}{place}</transform>'
                f'<emitter type="area"><rgb name="radiance" value="{40 * r}, {40 * g}, {40 * b}"/></emitter>'
                '<bsdf type="diffuse"/></shape>'
            )
    return "".join(lines)


def test_many_lamps_among_pillars(stage: Any, judge: Judge) -> None:
    judge(stage.write(PILLARS + lamps(48, 48), integrator=HIDING), spp=64)
