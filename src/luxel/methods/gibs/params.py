"""Every dial of GIBS. Where a default is not the document's, the note says why."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

EKBERG: dict[str, Any] = {
    "recycle": False,
    "spawn_by_size": False,
    "share_rays": False,
    "ray_budget": 0,
    "tile_size": 16,
    "spawn_chance": 0.08,
    "spawn_once_a_cell": False,
    "hit_spawn_threshold": 0.0,
    "warm_samples": 0,
    "normal_power": 1,
    "low_discrepancy": False,
    "fade_in": 0,
    "memory_radii": 0.0,
    "fill_bare": False,
    "sky_share": 0.0,
    "cell_surfels": 0,
    "normal_light": False,
    "even_share": 0.0,
    "guide_share": 0.0,
    "depth_texels": 0,
    "view_radius": False,
    "radius_pixels": 0.0,
    "birth_samples": 0.0,
}
"""The document's own setting: surfels on screen only, the estimator from cold."""


@dataclass
class GibsParams:
    """Dials of surfel GI (Ekberg 2022, chapter 4)."""

    rays_per_surfel: int = 4
    """Rays a surfel and frame (the document tests 1, 2, 4); with `share_rays`, of an ordinary one in view. More: less
    noise and lag; time grows in proportion."""
    share_rays: bool = True
    """Surfels get rays as they need them, together no more than `ray_budget`: young ones four times as many, those that
    no view sees a quarter, settled ones ever fewer. Off: `rays_per_surfel` each, however many surfels there are."""
    ray_budget: int = 0
    """Rays a frame at most, with `share_rays`; 0 takes `rays_per_surfel` times `surfel_target`; `surfel_target` itself
    is the one ray a surfel on average of Brinck et al. Less: noisier, and slower to follow a change; an eighth of
    `capacity` at least."""
    surfel_target: int = 50000
    """Surfels that should cover the scene (the document's count for Sponza); sets the radius from the area within its
    robust bounds. More: finer light, fewer leaks, more rays; fewer: blurrier and faster."""
    radius: float = 0.0
    """Surfel radius in metres; 0 takes it from `surfel_target`. Smaller follows shadows better and costs surfels."""
    view_radius: bool = True
    """Surfels have one size on the screen: views that see a place ask for a radius there. Off, and where `radius` is
    given: one radius in metres."""
    radius_pixels: float = 0.0
    """That size, a radius in pixels; 0 takes the one with which 0.6 of `surfel_target` cover the view, from 2 to 16.
    Smaller: finer light and more surfels, which then lack elsewhere; larger: blurrier, calmer and faster."""
    capacity: int = 0
    """Surfels at most, allocated at the start; 0 takes 2 times `surfel_target`. Too few leave gaps."""
    recycle: bool = False
    """Surfels are given back by need: by number, time unseen, distance and what covers their place without them; where
    many lie on top of each other, in view too; with one radius as well, so that a full pool leaves room where a view
    looks. Off: with `view_radius` by number and time unseen alone, else never (the document's chapter 4)."""
    cell_size: float = 1.0
    """Grid cell in radii. Smaller: shorter lists to read, more memory and sorting; larger: the opposite."""
    items_per_surfel: int = 24
    """Grid list entries reserved a surfel. Too few drop surfels from crowded cells."""
    cell_surfels: int = 64
    """Surfels of a grid cell that a look-up reads at most, the first by a hash of their birth, so that none flicker; 0
    reads all. Fewer: an even time in crowded corners; so few that they do not cover the cell leave gaps."""
    tile_size: int = 8
    """Pixels of a spawn tile's side: 4, 8 or 16 (the document: 16). Smaller covers a view in fewer frames."""
    spawn_threshold: float = 1.0
    """A tile's least covered pixel spawns below this coverage (the document: 1). Higher: denser, slower, smoother."""
    spawn_chance: float = 1.0
    """Chance that it does (the document: 0.08, against surfels that spawn side by side; here `spawn_once_a_cell`
    prevents that, so that a view is covered in a few frames)."""
    spawn_by_size: bool = False
    """That chance times the square of a tile's side over a surfel's diameter, at most 1 (Brinck et al. vary it by size
    on the screen). On: no flood of surfels on walls close by, and their light comes later."""
    spawn_once_a_cell: bool = True
    """One spawn a grid cell and frame. Off: neighbouring tiles may spawn on top of each other."""
    hit_spawn_threshold: float = 0.3
    """Rays spawn surfels where they hit below this coverage (the document: never, 0). Without them light that only
    unseen surfaces carry is guessed by `fill_bare`, and 8 % is missing in the Cornell box; without both 25 %. Higher:
    denser off screen, at the cost of the pool."""
    plane_scale: float = 4.0
    """How many times farther a point off the surfel's plane counts (Lehtinen et al. 2008). Higher: fewer leaks and
    shorter lists; lower: smoother on curved surfaces."""
    normal_power: int = 4
    """Exponent of the normals' cosine in the weight: 1, 2, 4 or 8 (the document: 1). Higher keeps unlike surfaces
    apart; lower blends around curves."""
    short_blend: float = 0.08
    """Blend of the short mean (Ray Tracing Gems: 0.08). Higher notices changes sooner and flickers more."""
    warm_samples: int = 64
    """Frames in which recent rays weigh more. 0 is the document's cold start: a quarter too dark after 256
    frames (measured), as the cache's own bounces arrive late."""
    longest_window: int = 2048
    """Frames that the mean spans at most while nothing changes. Longer: calmer; the estimator still reacts."""
    memory_radii: float = 8.0
    """Radii (as with `view_radius` off) that a surfel on a moving object travels until its light counts as that of
    another place; 0: it is never told (the document). Lower: objects take on the light around them sooner, with more
    noise; higher: calmer, later."""
    low_discrepancy: bool = True
    """Rays follow a low-discrepancy sequence (the document: random). Off: half as much error again after 256 frames in
    the Cornell box (measured)."""
    sky_share: float = 0.5
    """Share of the rays that look for the bright places of a sky image, times the part of the sky's light that is in
    them; none under a sky of one colour. Higher: less noise from windows and glows; lower: more rays for all else."""
    normal_light: bool = True
    """Where the scene has smooth normals or normal maps, surfels keep the light for other normals than their own, so
    that these are lit as they should. Off (the document): what a surfel knows serves all normals around it."""
    even_share: float = 0.1
    """Share of the rays that are spread evenly over the hemisphere, not by the cosine, where `normal_light` is on.
    Higher: less noise in what normals change of the light; lower: less noise in the rest."""
    guide_share: float = 0.5
    """Share of the rays, at most, that go where rays of neighbouring surfels have found light (the document: none); the
    less is known, the fewer do. Higher: less noise where little of what is seen shines; lower: less elsewhere."""
    depth_texels: int = 8
    """Side of each surfel's map of the depth around it, in texels: 8, 4, or 0 for none (the document). With it light
    stays on its side of walls. 4: a quarter of a newborn surfel's rays and of the memory, and more leaks."""
    fade_in: int = 8
    """Frames until a new surfel has its full say where older ones answer too. 0: at once, which flickers."""
    birth_samples: float = 8.0
    """Samples that the light which a pixel has already counts for in the surfel that it spawns; 0: it starts from
    nothing (the document). More: calmer while the camera moves; what was wrong around it stays longer."""
    fill_bare: bool = True
    """What no surfel answers borrows light: a pixel casts a ray and takes the mean around it, a ray's hit takes the
    light of the surfel that cast it. Off (the document): black, for some frames, or for good once the pool is full."""

    def radius_for(self, area: float) -> float:
        """Return the radius in metres for a scene of `area` m^2: coverage 1 needs about 1.6 surfels a radius^2."""
        if self.radius > 0.0:
            return self.radius
        return (SURFELS_PER_SQUARE_RADIUS * max(area, 1e-12) / self.surfel_target) ** 0.5

    @property
    def by_view(self) -> bool:
        """Whether surfels are as large as views ask for."""
        return self.view_radius and self.radius == 0.0

    def largest_radius(self, area: float) -> float:
        """Return the radius in metres of the largest surfels, those that only rays see; without sizes, of all."""
        return self.radius_for(area / (1.0 - VIEW_SHARE) if self.by_view else area)

    def most_rays(self) -> int:
        """Return how many rays a frame has at most."""
        if not self.share_rays:
            return self.rays_per_surfel * self.capacity_for()
        return self.ray_budget or min(max(self.rays_per_surfel * self.surfel_target, self.least_rays()), MOST_RAYS)

    def least_rays(self) -> int:
        """Return how many rays a frame serve all surfels in turn, whichever are in view."""
        return -(-self.capacity_for() // VIEW_TURN)

    def capacity_for(self) -> int:
        """Return the pool's size, a multiple of 64."""
        wanted = self.capacity if self.capacity > 0 else self.surfel_target * 2
        return max(64, -(-wanted // 64) * 64)


VIEW_TURN = 8
"""Frames within which each surfel in view casts a ray, where rays are shared."""
MOST_RAYS = 2**24
"""Rays a frame that can be shared: their parts are counted in 32 bits."""
VIEW_SHARE = 0.6
"""Of `surfel_target`, for the view; the rest cover all that only rays see, with the largest radius."""
SURFELS_PER_SQUARE_RADIUS = 1.6
"""Surfels a radius^2 that cover a surface once. Screen spawning and ray hits together place up to 1.5 times as many
(measured on `atrium` after its flight: 1.5; Sponza, one view: 1.1)."""
