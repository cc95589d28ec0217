"""The contract: what every GI method answers to, and the records that pass between it and the frame.

A method keeps a `State` (the world's: caches, no camera) and may keep a `Screen` (one camera's: history).
The frame calls, in order: `update`, `shade`, `observe`. `query` answers anywhere and changes nothing.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import mitsuba as mi
import numpy as np

from luxel.kernels.records import Light, Surface

if TYPE_CHECKING:
    from luxel.kernels.film import Film
    from luxel.kernels.gbuffer import GBuffer
    from luxel.methods.inspect import Inspector
    from luxel.methods.workload import Workload
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

Progress = Callable[[str, float], None]
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


@dataclass
class NoScreen:
    """The screen state of a method that keeps none."""

    nothing: mi.UInt32 = field(default_factory=lambda: mi.UInt32(0))


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
    shows_gloss: ClassVar[bool] = False
    """True where its pictures hold all that full materials do; others light their diffuse part alone."""
    max_leak: ClassVar[float] = 0.0
    """Light in a sealed room over light outside that the test lets pass; measured, never guessed."""
    bakes: ClassVar[frozenset[str]] = frozenset()
    """Parts of the scene that its state is made for and that no live edit may change: "geometry" of what stands still,
    "reflectance" of it, "sky" (its image, its turn, whether there is one)."""
    baseline: ClassVar[bool] = False
    """Every figure stands beside its own; it never wins, and gets no peer."""
    irradiance_param: ClassVar[str] = ""
    """The parameter that a comparison sets to the one irradiance that gives the truth's total, if there is one."""
    progressive: ClassVar[bool] = False
    """It caches nothing: each answer is a fresh sample made from `state.seed`, and their mean goes to the truth."""
    bakeable: ClassVar[bool] = False
    """Its light needs no camera, so it can be baked into textures."""
    workload: ClassVar[Workload | None] = None
    """What counts its rays and bytes; None where nothing does: then no ray count and no floor are reported."""
    inspector: ClassVar[Inspector | None] = None
    """What shows its cache; None where nothing does."""

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
        progress: Progress | None = None,
    ) -> Any:
        """Return the first state. Allocates everything the method will ever hold; `progress` hears of long work."""

    def retune(self, scene: Scene, state: Any, params: Any) -> Any | None:
        """Return `state` with the dials of `params`, all that it has learned kept; None: it must be built anew.

        Raises LuxelError for bad parameters.
        """
        return None

    def fits(self, scene: Scene, state: Any, params: Any) -> bool:
        """Return whether `state` serves on after an edit of the scene's lights or materials.

        Where it does not, it is built anew before the next frame.
        """
        return True

    def update(self, scene: Scene, state: Any, frame: Frame) -> Any:
        """Advance the world by one frame, without a camera: follow transforms, sort, trace, integrate."""
        return state

    @abc.abstractmethod
    def query(self, scene: Scene, state: Any, surface: Surface) -> Light:
        """Answer at any surface. Pure: serves cache hits, second cameras, free points and baking."""

    def screen(self, scene: Scene, state: Any, film: Film) -> Any:
        """Return the first screen state for a camera with `film`: `film.lane_count` pixels, in tile order, padded."""
        return NoScreen()

    def reprojects(self, state: Any) -> bool:
        """Return whether `shade` reads `gbuffer.taps`: what last frame's pixels were is then kept for it."""
        return False

    def shade(self, scene: Scene, state: Any, screen: Any, frame: Frame, gbuffer: GBuffer) -> tuple[Light, Any]:
        """Answer at the pixels; may keep history in `screen`. Returns light and the next screen."""
        return self.query(scene, state, gbuffer.surface), screen

    def observe(self, scene: Scene, state: Any, frame: Frame, gbuffer: GBuffer, light: Light) -> Any:
        """Learn from a view: spawn, last seen, failed points. The only step that may."""
        return state

    def texels(self, state: Any) -> np.ndarray | None:
        """Return indirect irradiance (T, 3), W/m^2, of the texels that it keeps; None where it answers at points.

        A bake then takes its texels from here, without asking at their points.
        """
        return None

    def cache(self, state: Any) -> dict[str, int | float]:
        """Sizes worth printing, such as {"surfel_count": 50000}."""
        return {}

    def warnings(self, state: Any) -> list[str]:
        """What the user should know of the state, one sentence each."""
        return []

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

    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(params_type)))
    except (OSError, TypeError, SyntaxError):
        tree = ast.Module([], [])  # a class that was made at run time has no source
    body = tree.body[0].body if tree.body and isinstance(tree.body[0], ast.ClassDef) else []
    docs: dict[str, str] = {}
    for statement, following in zip(body, body[1:], strict=False):
        if (
            isinstance(statement, ast.AnnAssign)
            and isinstance(statement.target, ast.Name)
            and isinstance(following, ast.Expr)
            and isinstance(following.value, ast.Constant)
        ):
            docs[statement.target.id] = " ".join(str(following.value.value).split())
    defaults = params_type()
    for item in fields(params_type):
        yield item.name, getattr(defaults, item.name), docs.get(item.name, "")
