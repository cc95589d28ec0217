"""What can be shown of the lightmap as a whole: the flat sheets, the surfels."""

from __future__ import annotations

import numpy as np

from luxel.methods.inspect import CacheView, LazyViews
from luxel.methods.lightmap.run.state import LightmapState


def lightmap_views(state: LightmapState) -> LazyViews:
    """Return the lightmap and its charts as flat images, and the surfels as discs by radiosity."""
    bake = state.bake.bake  # type: ignore[attr-defined]

    def sheet() -> CacheView:
        rows = np.array(state.light).reshape(-1, 4)[: bake.width * bake.height, :3]
        image = rows.reshape(bake.height, bake.width, 3)
        return CacheView("image", {"image": image, "tiles": [image]}, "irradiance of the texels")

    def charts() -> CacheView:
        number = np.full((bake.height, bake.width), -1.0, np.float32)
        number.ravel()[bake.texel_slot] = bake.texel_chart
        return CacheView("image", {"image": np.repeat(number[..., None], 3, axis=2)}, "chart of each texel, -1: none")

    def surfels() -> CacheView:
        radiosity = np.array(state.radiosity).reshape(-1, 4)[bake.tree.leaf_of[: len(bake.surfel_p)], :3]
        data = {
            "p": bake.surfel_p.astype(np.float32),
            "n": bake.surfel_normal.astype(np.float32),
            "radius": float(np.sqrt(bake.surfel_area.mean() / np.pi)),
            "color": radiosity,
        }
        return CacheView("points", data, "radiosity of each surfel")

    return LazyViews({"lightmap": sheet, "charts": charts, "surfels": surfels})
