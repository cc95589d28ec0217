"""What is shown of a method's cache: why a point is lit so, looks drawn over the picture, views of what it holds.

No part of the frame. A method that wants to be looked into has an `Inspector` as its `inspector`; without one it
renders, saves and is measured all the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import mitsuba as mi
import numpy as np

from luxel.errors import LuxelError

if TYPE_CHECKING:
    from luxel.kernels.records import Surface
    from luxel.methods.base import Method
    from luxel.scene.device import Scene


@dataclass(frozen=True)
class CacheView:
    """Something that the viewer and the report can show."""

    kind: str
    """`points`: arrays `p`, `n`, `radius`, `color`; `image`: (H, W, 3), and the same in parts as a list `tiles`;
    `number`: a float; `spheres`, items in open space: `p` (N, 3), `radius` (float), `color` (N, 3) and `atlas`
    (N, R, R, 3), colours over each by octahedral map, with `names`, pairs of a name and its colour.
    """
    data: dict[str, Any]
    doc: str = ""


@dataclass(frozen=True)
class Look:
    """One way to show a method's cache over its scene; `inspect/looks` draws it."""

    name: str
    """The CLI word; the key for `Inspector.read` or `Inspector.views`."""
    doc: str
    kind: str
    """What `Inspector.read` gives: `number`, `cost` (a number of which less is better), `light` (E, W/m^2), `mix` (a
    displayed colour), `item` (which cache item); or which view is drawn: `spheres`, `sheet`; or `source`: one chosen
    point's light, by what `Inspector.sources` gives."""
    unit: str = ""
    span: tuple[float, float] | None = None
    """Ends of a number's scale; None fits it to the picture."""
    logarithmic: bool = False
    """Equal steps of a number's scale are equal factors."""
    view: str = ""
    """The view to draw, for `spheres` and `sheet`."""


@dataclass
class Reading:
    """What a method tells of each point of a surface, for one of its looks."""

    value: mi.Float | mi.UInt32 | mi.Color3f
    answered: mi.Bool
    """False where it has nothing to tell."""
    place: mi.Float | None = None
    """Where values belong to flat cache items: how far the point is from the nearest one's middle, in its radii."""
    radius: mi.Float | None = None
    """Metres that `place` 1 is."""
    dark: mi.Bool | None = None
    """True on every other piece of an item, as on a chessboard: drawn darker."""


@dataclass
class Sources:
    """Where the light of one chosen point comes from, told at each point of a surface."""

    item: mi.UInt32
    """The cache item that brings light from here to the chosen point."""
    share: mi.Float
    """That item's share of the answer, 0..1."""
    answered: mi.Bool
    """False where no light of the chosen point comes from."""
    marked: mi.Bool
    """The piece of surface that has the chosen point's answer, such as its texel."""
    words: str
    """A sentence on them all, or why there are none."""
    heaviest: tuple[tuple[str, int], ...] = ()
    """Names and numbers of the heaviest items, heaviest first."""


@dataclass(frozen=True)
class Discs:
    """The cache items that light one point, as N discs in the world."""

    item: np.ndarray
    """(N,) the item that each belongs to; all of them are among those that `Inspector.explain` names."""
    p: np.ndarray
    """(N, 3) middle, metres."""
    n: np.ndarray
    """(N, 3) unit normal."""
    radius: np.ndarray
    """(N,) metres."""


@dataclass(frozen=True)
class Contribution:
    """One cache item asked about a point: what it gave, or why it gave nothing."""

    item: int
    weight: float
    """Its share of the answer: all of them together are 1 wherever anything answered."""
    irradiance: tuple[float, float, float]
    reason: str = ""
    """Why it gives next to nothing, or how it comes to answer; empty where there is nothing to say."""
    p: tuple[float, float, float] | None = None
    """Where it is, world space."""
    why: str = ""
    """The reason in one word for programs, such as `dead`; one of `WHYS`."""

    @property
    def answers(self) -> bool:
        """Whether it has a say: one that does not see the point may keep some weight, and has none."""
        return self.weight > 0.0 and self.why in ("", *ANSWERING)


WHYS = {
    "normal": "behind the surface or facing away",
    "depth": "without sight of the point",
    "distance": "too far",
    "plane": "off the point's plane",
    "dead": "dead, inside geometry",
    "asleep": "asleep",
    "young": "without a sample yet",
    "unplaced": "held back",
    "outside": "answering from the nearest cage, as the point is outside the box",
    "borrowed": "standing in from neighbouring cages",
}
"""What is the matter with cache items, by the word that names why."""
ANSWERING = ("outside", "borrowed")
"""Those of them that tell how an item comes to answer, not why it does not."""


class LazyViews(Mapping[str, CacheView]):
    """Views by name, each made when it is asked for: some read whole atlases back."""

    def __init__(self, makers: dict[str, Callable[[], CacheView]]) -> None:
        self._makers = makers

    def __getitem__(self, name: str) -> CacheView:
        return self._makers[name]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)


class Inspector:
    """Shows the cache of one method. It keeps nothing itself: all is read from the method's state, and is pure."""

    item: ClassVar[str] = ""
    """What one item of the cache is called; empty where it is not made of items."""
    looks: ClassVar[tuple[Look, ...]] = ()
    """What can be drawn of the cache, known without one."""
    atlases: ClassVar[bool] = False
    """`write_atlases` writes what the cache holds as images."""

    def explain(self, scene: Scene, state: Any, surface: Surface) -> list[Contribution]:
        """For the first point of `surface`: which cache items answered, and why others did not."""
        return []

    def read(self, scene: Scene, state: Any, surface: Surface, look: str) -> Reading:
        """Return what look `look` shows at a surface; never asked for looks that draw a view."""
        raise LuxelError(f"look '{look}' cannot be drawn: {type(self).__name__} lists it and has no `read` for it")

    def sources(self, scene: Scene, state: Any, point: Surface, surface: Surface) -> Sources:
        """Return from which items the light of the first point of `point` comes, told at each point of `surface`.

        Pure. Only for inspectors that have a look of kind `source`. A miss of `surface` stands for the sky along -`wo`.
        """
        raise LuxelError(f"{type(self).__name__} lists a look of one point's light and has no `sources` for it")

    def discs(self, scene: Scene, state: Any, point: Surface) -> Discs | None:
        """Return the items that light the first point of `point` as discs; None where they are none, as probes."""
        return None

    def views(self, scene: Scene, state: Any) -> Mapping[str, CacheView]:
        """What can be shown of the cache."""
        return {}

    def write_atlases(self, state: Any, folder: str | Path) -> list[Path]:
        """Write the cache as images into `folder`; return the files. Raises LuxelError where it cannot."""
        raise LuxelError(f"{type(self).__name__} writes no atlases")


def inspector_of(method: Method) -> Inspector:
    """Return the inspector of `method`. Raises LuxelError where it has none."""
    if method.inspector is None:
        raise LuxelError(say_uninspected(method.name))
    return method.inspector


def say_uninspected(name: str) -> str:
    """Return the sentence on a method without an inspector."""
    return f"method '{name}' has no inspector, so nothing can be told or drawn of its cache"
