"""The transport: relit it is the same bake, and what does not fit is refused in one sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pygltflib
import pytest

from luxel.bake import files
from luxel.bake.core import Baked, bake_scene
from luxel.bake.lamps import name_lights, only_light, scale_lights
from luxel.errors import LuxelError
from luxel.scene import load
from luxel.scene.model import Light, Sky

from .conftest import SMALL, cut_floor


@pytest.fixture(scope="module")
def saved(cornell: Baked, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bake") / "box.glb"
    written = files.write_bake(cornell, path)
    assert all(Path(written[key]).is_file() for key in ("glb", "exr", "transport"))
    assert sorted(item.name for item in path.parent.iterdir()) == ["box.exr", "box.glb", "box.luxel.npz"]
    return Path(written["transport"])


def test_half_the_power_is_half_the_light(cornell: Baked, saved: Path) -> None:
    half = files.relight(saved, scale_lights(load("cornell-box"), {"lamp": 0.5}), frames=24)
    assert half.light.direct == pytest.approx(0.5 * cornell.light.direct, rel=1e-4, abs=1e-6)
    assert half.light.indirect.mean() == pytest.approx(0.5 * cornell.light.indirect.mean(), rel=0.02)


def test_nothing_is_left_of_the_old_light(cornell: Baked, saved: Path) -> None:
    dark = files.relight(saved, scale_lights(load("cornell-box"), {"lamp": 0.0}), frames=1)
    assert cornell.light.indirect.max() > 0.0
    assert not dark.light.irradiance.any() and not dark.light.emission.any()


def test_relighting_casts_shadow_rays_alone(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import luxel.kernels.trace as trace

    def refuse(*arguments: object, **more: object) -> None:
        raise AssertionError("a closest-hit ray was cast")

    for module in (
        "luxel.kernels.gbuffer",
        "luxel.methods.lightmap.run.query",
        "luxel.methods.lightmap.flatten.origins",
    ):
        monkeypatch.setattr(f"{module}.trace_closest", refuse)
    monkeypatch.setattr(trace, "trace_closest", refuse)
    relit = files.relight(saved, load("cornell-box"), frames=2)
    assert relit.surfel_rays > 0 and np.isfinite(relit.light.irradiance).all()


def test_a_relit_bake_holds_what_the_bake_held(cornell: Baked, tmp_path: Path) -> None:
    files.write_bake(cornell, tmp_path / "light.glb", light_only=True)
    relit = files.relight(tmp_path / "light.luxel.npz", load("cornell-box"), frames=1, samples=1)
    for light_only, holds in ((None, "light"), (False, "light and albedo")):
        files.write_bake(relit, tmp_path / "again.glb", light_only)
        file = pygltflib.GLTF2().load(str(tmp_path / "again.glb"))
        assert file is not None and (file.asset.extras or {})["holds"] == holds
        assert files.read_about(tmp_path / "again.luxel.npz")[0]["light_only"] == (holds == "light")


def test_another_scenes_bake_is_refused(saved: Path) -> None:
    with pytest.raises(LuxelError, match="is a bake of 'cornell-box', not of 'attic'"):
        files.relight(saved, load("attic"))


def test_a_changed_scene_is_refused(saved: Path) -> None:
    data = load("cornell-box")
    data.objects[1].meshes[0].positions = data.objects[1].meshes[0].positions * np.float32(1.01)
    with pytest.raises(LuxelError, match="another scene or of other parameters"):
        files.relight(saved, data)


def test_another_versions_bake_is_refused(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "__version__", "9.9")
    with pytest.raises(LuxelError, match="was baked by luxel .*, and this is 9.9"):
        files.relight(saved, load("cornell-box"))


def test_a_sky_can_be_taken_away_but_not_added(tmp_path: Path) -> None:
    data = cut_floor()
    data.lights, data.sky = [], Sky((1.0, 1.0, 1.0), np.ones((8, 16, 3), np.float32))
    small, place = {**SMALL, "texel_target": 256, "rays_per_texel": 32}, tmp_path / "floor.glb"
    baked = bake_scene(data, "lightmap", small, frames=2, samples=1)
    files.write_bake(baked, place)
    assert baked.light.indirect.min() > 0.0
    dark = scale_lights(data, {"sky": 0.0})
    relit = files.relight(tmp_path / "floor.luxel.npz", dark)
    assert not relit.light.irradiance.any()
    files.write_bake(bake_scene(dark, "lightmap", small, frames=2, samples=1), place)
    with pytest.raises(LuxelError, match="baked without a sky"):
        files.relight(tmp_path / "floor.luxel.npz", data)


def test_what_is_no_bake_is_refused(tmp_path: Path) -> None:
    broken = tmp_path / "broken.luxel.npz"
    broken.write_bytes(b"PK nothing")
    with pytest.raises(LuxelError, match="not a saved luxel state"):
        files.read_about(broken)
    with pytest.raises(LuxelError, match="there is no such file"):
        files.read_about(tmp_path / "none.luxel.npz")


def test_every_light_has_a_name_of_its_own() -> None:
    data = load("cornell-box")
    data.lights = [Light("point", (1.0, 1.0, 1.0), name=name) for name in ("a", "a", "a-2", "", "point", "a")]
    names = ["a", "a-3", "a-2", "point", "point-2", "a-4", "lamp"]
    assert name_lights(data) == names
    for index, name in enumerate(names[:-1]):
        alone = only_light(data, name)
        assert [light.color[0] for light in alone.lights] == [float(other == index) for other in range(6)]


def test_lights_are_called_by_name() -> None:
    with pytest.raises(LuxelError, match="has no light 'lamb'; its lights: 'lamp'"):
        scale_lights(load("cornell-box"), {"lamb": 2.0})
    many = load("cornell-box")
    many.lights = [Light("point", (1.0, 1.0, 1.0), name=f"bulb {index}") for index in range(400)]
    with pytest.raises(LuxelError, match="its lights: 'bulb 0', .*'bulb 11' and 389 more$"):
        scale_lights(many, {"lamb": 2.0})
    with pytest.raises(LuxelError, match="no factor of its power"):
        scale_lights(load("cornell-box"), {"lamp": -1.0})
    with pytest.raises(LuxelError, match="from 0 to 1e\\+09"):
        scale_lights(load("cornell-box"), {"lamp": 1e30})
