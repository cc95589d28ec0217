"""The contract: what every GI method answers to, and the records that pass between it and the frame.

A method keeps a `State` (the world's: caches, no camera) and may keep a `Screen` (one camera's: history).
The frame calls, in order: `update`, `shade`, `observe`. `query` answers anywhere and changes nothing.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import mitsuba as mi
import numpy as np

from luxel.kernels.records import Light, Surface

if TYPE_CHECKING:
    from luxel.kernels.gbuffer import GBuffer
    from luxel.scene.device import Scene
from luxel.scene.host import Looks

CHECKS = frozenset(
    {
        "black",  # a scene without light is exactly black
        "furnace",  # closed emitting box: the analytic value
        "linear",  # light times k gives image times k
        "seeded",  # the same seed gives the same image
        "forgets",  # a light switched off is forgotten
        "follows",  # a moved object takes its light along and leaves none behind
        "saves",  # save, load: the same image
        "finite",  # never NaN, never Inf
        "sealed",  # a sealed dark room stays at or below `max_leak`
        "compiled",  # no kernel is compiled after warm-up
        "flat",  # memory does not grow
    }
)

Report = Callable[[str, float], None]
"""Takes what runs and the share of it that is done, 0..1."""


def stay_silent(text: str, share: float) -> None:
    """The report that tells nobody."""


@dataclass
class Frame:
    """What changes from frame to frame, as opaque Dr.Jit values: a new value never compiles a kernel."""

    index: mi.UInt32
    """Frame number since the build: the same in every step of a frame, and in every look at it."""
    seed: mi.UInt32
    """Another one for each look at a frame: with `index` it makes the random numbers of `shade` and `observe`."""
    still: mi.Bool
    """Camera, scene and lights are those of the last frame, so histories of the screen may go on."""


@dataclass(frozen=True)
class View:
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
    """The CLI word; the key for `Method.read` or `Method.views`."""
    doc: str
    kind: str
    """What `Method.read` gives: `number`, `cost` (a number of which less is better), `light` (E, W/m^2), `mix` (a
    displayed colour), `item` (which cache item); or which view is drawn: `spheres`, `sheet`; or `source`: one chosen
    point's light, by what `Method.sources` gives."""
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
    """(N,) the item that each belongs to; all of them are among those that `Method.explain` names."""
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


@dataclass
class NoScreen:
    """The screen state of a method that keeps none."""

    nothing: mi.UInt32 = field(default_factory=lambda: mi.UInt32(0))


class LazyViews(Mapping[str, View]):
    """Views by name, each made when it is asked for: some read whole atlases back."""

    def __init__(self, makers: dict[str, Callable[[], View]]) -> None:
        self._makers = makers

    def __getitem__(self, name: str) -> View:
        return self._makers[name]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)


class Method(abc.ABC):
    """A GI method. Concrete ones are final: compose, do not subclass further."""

    name: ClassVar[str]
    """The CLI word, the report's column, the prefix of its stages."""
    Params: ClassVar[type]
    """A dataclass; each field's doc says what each end of the dial costs."""
    presets: ClassVar[dict[str, dict[str, Any]]] = {}
    """Named sets of parameters, such as a paper's own."""
    holds: ClassVar[frozenset[str]] = frozenset({"indirect"})
    """What its `irradiance` holds; one that also holds "direct" makes the frame leave its own out."""
    claims: ClassVar[frozenset[str]] = CHECKS
    """The contract checks it promises."""
    counts_rays: ClassVar[bool] = True
    """False where the number of rays is left to chance: then no ray count and no floor are reported."""
    shows_gloss: ClassVar[bool] = False
    """True where its pictures hold all that full materials do; others light their diffuse part alone."""
    max_leak: ClassVar[float] = 0.0
    """Light in a sealed room over light outside that the test lets pass; measured, never guessed."""
    bakes: ClassVar[frozenset[str]] = frozenset()
    """Parts of the scene that its state is made for and that no live edit may change: "geometry" of what stands still,
    "reflectance" of it, "sky" (its image, its turn, whether there is one)."""
    item: ClassVar[str] = ""
    """What one item of its cache is called; empty where it keeps none."""
    looks: ClassVar[tuple[Look, ...]] = ()
    """What can be drawn of its cache, known without one."""

    def shown_materials(self, wanted: Looks) -> Looks:
        """Return what its pictures show where `wanted` is asked for: what scenes are uploaded with for it."""
        return wanted if self.shows_gloss else "diffuse"

    def plan(self, scene: Scene, params: Any) -> list[str]:
        """One sentence each on what `build` would allocate. Raises LuxelError for bad parameters."""
        return []

    @abc.abstractmethod
    def build(
        self,
        scene: Scene,
        params: Any,
        seed: int,
        *,
        workdir: Path | None = None,
        progress: Report | None = None,
    ) -> Any:
        """Return the first state. Allocates everything the method will ever hold; `progress` hears of long work."""

    def retune(self, scene: Scene, state: Any, params: Any) -> Any | None:
        """Return `state` with the dials of `params`, all that it has learned kept; None: it must be built anew.

        Raises LuxelError for bad parameters.
        """
        return None

    def update(self, scene: Scene, state: Any, frame: Frame) -> Any:
        """Advance the world by one frame, without a camera: follow transforms, sort, trace, integrate."""
        return state

    @abc.abstractmethod
    def query(self, scene: Scene, state: Any, surface: Surface) -> Light:
        """Answer at any surface. Pure: serves cache hits, second cameras, free points and baking."""

    def screen(self, scene: Scene, state: Any, pixel_count: int) -> Any:
        """Return the first screen state for a camera of `pixel_count` pixels (tile order, padded)."""
        return NoScreen()

    def shade(self, scene: Scene, state: Any, screen: Any, frame: Frame, gbuffer: GBuffer) -> tuple[Light, Any]:
        """Answer at the pixels; may keep history in `screen`. Returns light and the next screen."""
        return self.query(scene, state, gbuffer.surface), screen

    def observe(self, scene: Scene, state: Any, frame: Frame, gbuffer: GBuffer, light: Light) -> Any:
        """Learn from a view: spawn, last seen, failed points. The only step that may."""
        return state

    def ray_counts(self, state: Any) -> dict[str, int]:
        """Rays a frame at most, by kind: `closest`, `shadow`, and `sky` for shadow rays that look for the sky."""
        return {}

    def ray_origins(self, scene: Scene, state: Any) -> tuple[mi.Point3f, mi.Normal3f, mi.Bool] | None:
        """World points, normals and activity of the method's own rays, one lane a ray; None where it casts none.

        The floor is measured with bare casts from there.
        """
        return None

    def ray_directions(self, scene: Scene, state: Any) -> mi.Vector3f | None:
        """World unit directions of those rays, lane by lane; None: spread by the cosine about the normals."""
        return None

    def touched_bytes(self, state: Any) -> int:
        """Bytes of its state that a frame must read and write."""
        return 0

    def cache(self, state: Any) -> dict[str, int | float]:
        """Sizes worth printing, such as {"surfel_count": 50000}."""
        return {}

    def warnings(self, state: Any) -> list[str]:
        """What the user should know of the state, one sentence each."""
        return []

    def explain(self, scene: Scene, state: Any, surface: Surface) -> list[Contribution]:
        """For the first point of `surface`: which cache items answered, and why others did not."""
        return []

    def read(self, scene: Scene, state: Any, surface: Surface, look: str) -> Reading:
        """Return what look `look` shows at a surface. Pure, like `query`; never asked for looks that draw a view."""
        raise NotImplementedError(f"{self.name} has no reading '{look}'")

    def sources(self, scene: Scene, state: Any, point: Surface, surface: Surface) -> Sources:
        """Return from which items the light of the first point of `point` comes, told at each point of `surface`.

        Pure. Only for methods that have a look of kind `source`. A miss of `surface` stands for the sky along -`wo`.
        """
        raise NotImplementedError(f"{self.name} does not tell where the light of a point comes from")

    def discs(self, scene: Scene, state: Any, point: Surface) -> Discs | None:
        """Return the items that light the first point of `point` as discs; None where they are none, as probes."""
        return None

    def views(self, scene: Scene, state: Any) -> Mapping[str, View]:
        """What can be shown of the cache."""
        return {}

    def save(self, state: Any, path: Path) -> None:
        """Write the state to `path` (.npz)."""
        from luxel.methods.persistence import save_state

        save_state(self.name, state, path)

    def load(self, scene: Scene, params: Any, path: Path) -> Any:
        """Read what `save` wrote, into a state built for the same scene and parameters."""
        from luxel.methods.persistence import load_state

        return load_state(self.name, self.build(scene, params, 0), path)


def describe_params(params_type: type) -> Iterable[tuple[str, Any, str]]:
    """Yield (name, default, doc) for each field of a `Params` dataclass; docs are the strings under the fields."""
    import ast
    import inspect
    import textwrap

    tree = ast.parse(textwrap.dedent(inspect.getsource(params_type)))
    body = tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else []
    docs: dict[str, str] = {}
    for statement, following in zip(body, body[1:], strict=False):
        if (
            isinstance(statement, ast.AnnAssign)
            and isinstance(statement.target, ast.Name)
            and isinstance(following, ast.Expr)
            and isinstance(following.value, ast.Constant)
        ):
            docs[statement.target.id] = " ".join(str(following.value.value).split())
    for item in fields(params_type):
        yield item.name, item.default, docs.get(item.name, "")
