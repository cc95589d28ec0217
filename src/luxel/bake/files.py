"""The files of a bake: .glb for viewers, .exr with the light in numbers, .luxel.npz with the transport to relight."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from luxel import __version__, runtime
from luxel.bake.core import Baked, finish_bake
from luxel.bake.gltf import light_set_of, sheet_of, shown, write_glb
from luxel.bake.layout import Layout, layout_arrays, layout_from, leave_still
from luxel.errors import LuxelError
from luxel.files import replacing, require_writable, to_json
from luxel.image.write import write_exr
from luxel.methods.lightmap.method import Lightmap
from luxel.methods.lightmap.run.state import LightmapState
from luxel.methods.params import find_method, make_params
from luxel.methods.persistence import read_arrays
from luxel.render.exposure import Exposure
from luxel.scene.device import upload
from luxel.scene.model import SceneData

FORMAT = 1
"""Of `.luxel.npz`; a file of another is refused."""
SUFFIX = ".luxel.npz"


def check_places(path: str | Path) -> None:
    """Raise LuxelError, before the work, where the bake could not be written after it."""
    if Path(path).suffix.lower() != ".glb":
        raise LuxelError(f"cannot write {path}: a bake is written as .glb")
    for place in (Path(path), exr_of(path), transport_of(path)):
        require_writable(place)


def exr_of(path: str | Path) -> Path:
    """Return where the light of the bake at `path` stands in numbers."""
    return Path(path).with_suffix(".exr")


def transport_of(path: str | Path) -> Path:
    """Return where the transport of the bake at `path` stands."""
    return Path(path).with_suffix(SUFFIX)


def workdir_of(path: str | Path) -> Path:
    """Return the folder beside the bake that holds what a stopped one has done."""
    return Path(path).with_name(f".{Path(path).stem}.bake")


def write_bake(
    baked: Baked, path: str | Path, light_only: bool | None = None, exposure: Exposure | float | None = None
) -> dict[str, Any]:
    """Write every file of a bake, each whole or not at all; return their names, and the texture's exposure and set.

    The set is that of its texture coordinates in the .glb.
    The transport is written where the method has one (`lightmap`). `light_only` None: as the bake that was relit.
    """
    light_only = baked.light_only if light_only is None else light_only
    written: dict[str, Any] = {"glb": str(path), "exr": str(exr_of(path))}
    write_exr(exr_of(path), sheet_of(baked.layout, shown(baked, light_only)))
    written["exposure"] = write_glb(baked, path, light_only, exposure)
    written["texcoord"] = light_set_of(baked.data)
    if isinstance(baked.state, LightmapState):
        save_transport(baked, transport_of(path), light_only, written["exposure"])
        written["transport"] = str(transport_of(path))
    return written


def save_transport(baked: Baked, path: Path, light_only: bool = False, exposure: float | None = None) -> None:
    """Write the method's state with what a later `relight` needs to know of it."""
    about = {
        "format": FORMAT, "version": __version__, "scene": baked.data.name, "method": baked.method.name,
        "params": asdict(baked.params), "seed": baked.seed, "samples": baked.samples, "frames": baked.frames,
        "indirect_only": baked.indirect_only, "light_only": light_only, "exposure": exposure,
        "materials": baked.materials,
    }  # fmt: skip
    with replacing(path) as beside:
        baked.method.save(baked.state, beside)
        with zipfile.ZipFile(beside, "a", zipfile.ZIP_DEFLATED) as archive:
            _append(archive, "about", np.array(to_json(about)))
            for name, value in layout_arrays(baked.layout).items():
                _append(archive, f"layout.{name}", np.asarray(value))


def read_about(path: str | Path) -> tuple[dict[str, Any], Layout]:
    """Return what a transport says of itself, and its layout.

    Raises LuxelError for a file that is none, is damaged, or was written by another version.
    """
    path = Path(path)
    if not path.is_file():
        raise LuxelError(
            f"cannot read {path}: there is no such file; `luxel bake --method lightmap` writes one beside its .glb"
        )
    held = read_arrays(Lightmap.name, path)
    if "about" not in held:
        raise LuxelError(f"'{path}' is a saved cache without its layout; take the {SUFFIX} that `luxel bake` wrote")
    about = json.loads(str(held["about"]))
    if about.get("format") != FORMAT or about.get("version") != __version__:
        raise LuxelError(
            f"'{path}' was baked by luxel {about.get('version')}, and this is {__version__}; bake the scene anew"
        )
    prefix = "layout."
    return about, layout_from({key[len(prefix) :]: value for key, value in held.items() if key.startswith(prefix)})


def relight(
    path: str | Path, data: SceneData, *, frames: int | None = None, samples: int | None = None,
    device: str = "auto", report: Callable[[str, float], None] | None = None,
) -> Baked:  # fmt: skip
    """Return the bake at `path` (.luxel.npz) under the lights of `data`, the same scene with other ones.

    `frames` and `samples` None: as the bake.

    The transport is read, not traced: rays are the surfels' shadow rays and, where direct light was baked too, those
    of the texels' own. Raises LuxelError for another scene's or version's bake.
    """
    runtime.start(device)
    about, layout = read_about(path)
    if about["scene"] != data.name:
        raise LuxelError(f"'{path}' is a bake of '{about['scene']}', not of '{data.name}'; bake this scene anew")
    method = find_method(about["method"])
    params = make_params(method.name, None, about["params"])
    still = leave_still(data)
    scene = upload(still, recentre=True)
    still = replace(still, origin=scene.host.data.origin)
    state = _forget_light(method.load(scene, params, Path(path)))
    baked = finish_bake(
        still, scene, method, params, state, layout, frames=about["frames"] if frames is None else frames,
        samples=samples or about["samples"], seed=about["seed"], indirect_only=about["indirect_only"],
        materials=about.get("materials", "diffuse"), report=report,
    )  # fmt: skip
    return replace(baked, light_only=about["light_only"])


def _forget_light(state: LightmapState) -> LightmapState:
    """Return the state as it was before its first frame: the old lights' bounces are no part of the new ones'."""
    return replace(
        state,
        light=dr.zeros(mi.Float, dr.width(state.light)),
        radiosity=dr.zeros(mi.Float, dr.width(state.radiosity)),
        direct=dr.zeros(mi.Color3f, dr.width(state.direct)),
        direct_count=dr.opaque(mi.UInt32, 0),
    )


def _append(archive: zipfile.ZipFile, name: str, value: np.ndarray) -> None:
    with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
        np.lib.format.write_array(stream, value, allow_pickle=False)  # type: ignore[arg-type]
