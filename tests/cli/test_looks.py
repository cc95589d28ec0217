"""`luxel render --look` and `luxel explain`: what they write and print, and what they refuse."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from luxel.cli import main

DEVICE = os.environ.get("LUXEL_TEST_DEVICE", "cpu")
SMALL = ["cornell-box", "--size", "32x32", "--device", DEVICE, "--frames", "8", "--set", "surfel_target=300"]


def test_looks_are_written_beside_the_image(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = tmp_path / "new" / "box.png"
    words = ["render", *SMALL, "-o", str(place), "--look", "surfels, depth", "--look", "error,surfels", "--truth", "4"]
    assert main([*words, "--json"]) == 0
    written = json.loads(capsys.readouterr().out)["looks"]
    assert written == {name: str(place.with_name(f"box_{name}.png")) for name in ("surfels", "depth", "error")}
    assert {path.name for path in place.parent.iterdir()} == {"box.png", *(Path(p).name for p in written.values())}
    for path in written.values():
        with Image.open(path) as picture:
            assert picture.width == 32 and picture.height > 32  # the legend stands below
            assert np.asarray(picture)[:32].std() > 5.0


def test_people_are_told_where_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = tmp_path / "box.exr"
    assert main(["render", *SMALL, "-o", str(place), "--look", "normals"]) == 0
    assert str(tmp_path / "box_normals.png") in capsys.readouterr().out and (tmp_path / "box_normals.png").is_file()


def test_looks_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    """By method, without rendering or even a scene."""
    assert main(["render", "no-such-scene", "--look", "list"]) == 0
    rows = capsys.readouterr().out.splitlines()
    names = [row.split()[0] for row in rows]
    assert names[0] == "image" and "surfels" in names and "probes" not in names
    assert all(len(row.split()) > 1 for row in rows)
    assert main(["render", "no-such-scene", "--method", "ddgi", "--look", "list", "--json"]) == 0
    looks = json.loads(capsys.readouterr().out)
    assert looks["probes"]["unit"] == "W/m²" and looks["probe-state"]["doc"] and "surfels" not in looks


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--look", "warmth"], "no look 'warmth'"),
        (["--look", "probes"], "method 'gibs' has no look 'probes'"),
        (["--look", "error"], "add --truth"),
        (["--look", " , "], "names nothing"),
        (["--look", "depth", "-o", "frames/"], "not beside the sequence"),
        (["--look", "depth", "-o", "film.gif"], "not beside the sequence"),
        (["--look", "depth", "--method", "magic"], "magic"),
    ],
)
def test_bad_looks_are_refused(
    words: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["render", "cornell-box", "--size", "16x16", *words]) == 2
    error = capsys.readouterr().err
    assert says in error and len(error.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_pixel_is_explained(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", *SMALL, "--pixel", "16,16"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("It is lit by") and "large-box" in text and "1,024 paths" in text
    table = text[text.index("  surfel  ") :].splitlines()
    shares = [float(row.split("%")[0].split()[-1]) for row in table[1:] if "%" in row]
    assert len(table) > 1 and shares == sorted(shares, reverse=True) and 90.0 < sum(shares) < 100.6


def test_a_pixel_is_explained_to_programs(capsys: pytest.CaptureFixture[str]) -> None:
    """The same run as an image: the pixel's figures are those of its layers."""
    probes = ["--method", "ddgi", "--set", "probe_target=120", "--set", "num_samples_per_probe=16"]
    assert main(["explain", *SMALL[:-2], *probes, "--pixel", " 16 , 20", "--json", "--exposure", "2"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["scene"] == "cornell-box" and found["pixel"] == [16, 20] and found["item"] == "probe"
    assert found["exposure"] == 2.0 and found["verdict"] == "lit" and found["words"][0].startswith("It is lit")
    assert sum(item["weight"] for item in found["contributions"]) == pytest.approx(1.0, abs=1e-3)
    light = np.array(found["direct"]) + found["indirect"]
    np.testing.assert_allclose(found["radiance"], np.array(found["albedo"]) / np.pi * light, rtol=1e-4)


def test_the_background_is_explained(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["explain", "cornell-box", "--size", "32x32", "--device", DEVICE, "--method", "none", "--frames", "1"]
    assert main([*words, "--pixel", "0,0"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("It is black because nothing is there") and "surface" not in text


@pytest.mark.parametrize(
    ("pixel", "says"),
    [("5", "not X,Y"), ("a,b", "not X,Y"), ("-1,3", "not X,Y"), ("32,0", "outside the image of 32x32")],
)
def test_bad_pixels_are_refused(pixel: str, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "cornell-box", "--size", "32x32", f"--pixel={pixel}"]) == 2
    assert says in capsys.readouterr().err


CLUSTERS = ["render", "cornell-box", "--method", "lightmap", "--size", "48x48", "--frames", "4", "--device", DEVICE]
TINY = ["texel_target=600", "surfel_target=120", "rays_per_texel=64", "probe_target=27"]


def test_the_clusters_of_two_pixels_are_two_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The ring stands around the pixel that was asked for."""
    drawn = []
    for x, y in ((24, 44), (5, 20)):
        place = tmp_path / f"{x}.png"
        settings = [word for text in TINY for word in ("--set", text)]
        assert main([*CLUSTERS, *settings, "-o", str(place), "--look", "clusters", "--pixel", f"{x},{y}"]) == 0
        with Image.open(tmp_path / f"{x}_clusters.png") as picture:
            drawn.append(np.asarray(picture, np.float64)[:48])
        rows, columns = np.nonzero(drawn[-1].min(axis=2) > 250.0)
        assert abs(rows.mean() - y) < 1.5 and abs(columns.mean() - x) < 1.5
    assert np.abs(drawn[0] - drawn[1]).mean() > 5.0


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--method", "lightmap", "--pixel", "3,3"], "add --look clusters"),
        (["--method", "gibs", "--look", "surfels", "--pixel", "3,3"], "method 'gibs' has none"),
        (["--method", "lightmap", "--look", "clusters", "--pixel", "16,0"], "outside the image of 16x16"),
        (["--method", "lightmap", "--look", "clusters", "--pixel", "there"], "not X,Y"),
    ],
)
def test_a_pixel_that_says_nothing_is_refused(
    words: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["render", "cornell-box", "--size", "16x16", *words]) == 2
    error = capsys.readouterr().err
    assert says in error and len(error.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_the_help_names_every_method(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    from luxel.cli import options
    from luxel.methods import METHODS

    (option,) = options.Method.__metadata__  # pyright: ignore[reportAttributeAccessIssue]
    named = option.help.split(":")[1].removesuffix(", or a class of your own.").strip(" .").split(", ")
    assert sorted(named) == sorted(METHODS)
