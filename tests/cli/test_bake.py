"""`luxel bake` and `luxel relight` from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from luxel.cli import main

SMALL = [
    word
    for pair in ("texel_target=1024", "surfel_target=128", "rays_per_texel=64", "probe_target=8")
    for word in ("--set", pair)
]


def test_bake_then_relight(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    place = tmp_path / "box.glb"
    assert main(["bake", "cornell-box", "-o", str(place), "--frames", "4", "--samples", "2", "--json", *SMALL]) == 0
    first = json.loads(capfd.readouterr().out)
    assert first["seam_difference"] <= 0.02 and first["texel_count"] > 500
    relit = tmp_path / "dim.glb"
    words = ["relight", first["transport"], "cornell-box", "--light", "lamp=0.5", "-o", str(relit), "--light-only"]
    assert main([*words, "--exposure", "1", "--samples", "1", "--device", "cpu"]) == 0
    assert "shadow rays only" in capfd.readouterr().out
    assert main([*words, "--frames", "3", "--json"]) == 0
    counted = json.loads(capfd.readouterr().out)
    assert first["materials"] == counted["materials"] == "full"
    assert counted["frames"] == 3 and first["frames"] == 4
    assert counted["exposure"] == first["exposure"] and first["lights"] == ["lamp"]
    assert counted["surfel_shadow_rays"] / 3 == first["surfel_shadow_rays"] / 4 > 0
    assert counted["texel_shadow_rays"] == first["texel_shadow_rays"] > 0
    assert relit.is_file() and relit.with_suffix(".exr").is_file()
    # Nothing is left of the work.
    assert {item.suffix for item in tmp_path.iterdir()} == {".glb", ".exr", ".npz"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["bake", "cornell-box", "-o", "box.obj"], "a bake is written as .glb"),
        (["bake", "cornell-box", "--method", "gibs", "-o", "box.glb"], "'gibs' cannot bake"),
        (["bake", "cornell-box", "--materials", "shiny", "-o", "box.glb"], "there are no materials 'shiny'"),
        (["bake", "cornell-box", "--light", "lamp", "-o", "box.glb"], "is not NAME=FACTOR"),
        (["bake", "cornell-box", "--light", "sun=2", "-o", "box.glb"], "has no light 'sun'"),
        (["relight", "none.luxel.npz", "cornell-box", "-o", "box.glb"], "there is no such file"),
    ],
)
def test_bad_input_is_one_sentence(
    words: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    error = capfd.readouterr().err
    assert message in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_stopped_bake_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    import luxel.methods.lightmap.bake.rows as rows
    from luxel.bake import core

    place = tmp_path / "box.glb"
    words = ["bake", "cornell-box", "-o", str(place), "--frames", "2", "--samples", "1", *SMALL]

    def stop(*arguments: object, **more: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(core, "make_layout", stop)
        assert main(words) == 130
    # The rays are kept; no part of a .glb is.
    assert [item.name for item in tmp_path.iterdir()] == [".box.bake"]
    with monkeypatch.context() as patched:
        patched.setattr(rows, "cast_rows", stop)
        assert main(words) == 0
    assert sorted(item.name for item in tmp_path.iterdir()) == ["box.exr", "box.glb", "box.luxel.npz"]
