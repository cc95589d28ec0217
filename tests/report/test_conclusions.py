"""The summary's sentences: who wins, what is a tie, what is called out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from luxel.report.conclusions import (
    beaten_by_ambient,
    below_noise,
    best_at_equal_time,
    describe_all,
    describe_scene,
    equal_time,
    fastest,
    join,
    leaking,
    nearest,
    warn_all,
)
from luxel.report.results import SceneResults, read_results


def method(regional: float | None, frame_ms: float = 50.0, spread: dict[str, float] | None = None, **more: Any) -> Any:
    return {
        "regional": regional,
        "flip": 0.1,
        "frame_ms": frame_ms,
        "truth_noise": 0.001,
        "spread": spread or {},
    } | more


def peer(of: str, regional: float, denoised: str | None = None) -> dict[str, Any]:
    return {"label": "path", "of": of, "denoised": denoised, "file": "x", "ms": 900.0, "of_ms": 1000.0,
            "regional": regional}  # fmt: skip


def read(tmp_path: Path, *scenes: dict[str, Any]) -> tuple[SceneResults, ...]:
    """Return scenes `scene-0`, `scene-1` … of methods (and `peers`), read as the report reads them."""
    given = {
        f"scene-{number}": {
            "reference": {},
            "peers": scene.pop("peers", []),
            "methods": {"none": method(1.2, 1.0), "ambient": method(0.5, 1.0), **scene},
        }
        for number, scene in enumerate(scenes)
    }
    (tmp_path / "results.json").write_text(json.dumps({"scenes": given}))
    return read_results(tmp_path).scenes


def test_the_nearest_is_the_one_with_the_least_error_and_never_a_baseline(tmp_path: Path) -> None:
    (scene,) = read(tmp_path, {"gibs": method(0.02), "ddgi": method(0.06)})
    ranking = nearest(scene)
    assert ranking is not None
    assert [entry.label for entry in ranking.best] == ["gibs"]
    assert dict(describe_scene(scene))["Nearest"] == (
        "gibs, regional 0.0200; ambient, the best single constant, is 25 times as far off."
    )
    speed = fastest(scene)
    assert speed is not None and "none" not in [entry.label for entry in (*speed.best, *speed.others)]


@pytest.mark.parametrize(
    ("first", "second", "is_tie"),
    [
        (method(0.0200), method(0.0209), True),  # the truth's noise is 0.001
        (method(0.0200), method(0.0212), False),
        (method(0.0200, spread={"regional": 0.003}), method(0.0245, spread={"regional": 0.004}), True),
        (method(0.0200, spread={"regional": 0.003}), method(0.0255, spread={"regional": 0.004}), False),
    ],
)
def test_errors_within_noise_or_spread_tie(tmp_path: Path, first: Any, second: Any, is_tie: bool) -> None:
    (scene,) = read(tmp_path, {"gibs": first, "ddgi": second})
    ranking = nearest(scene)
    assert ranking is not None and ranking.is_tie == is_tie
    assert ("tie" in dict(describe_scene(scene))["Nearest"]) == is_tie
    assert ("tie" in dict(describe_all([scene]))["Nearest to the truth"]) == is_tie


def test_times_within_five_percent_tie(tmp_path: Path) -> None:
    (close,) = read(tmp_path, {"gibs": method(0.1, 50.0), "ddgi": method(0.1, 52.0)})
    (apart,) = read(tmp_path, {"gibs": method(0.1, 50.0), "ddgi": method(0.1, 53.0)})
    assert (
        dict(describe_scene(close))["Fastest"]
        == "gibs and ddgi tie, 50 and 52 ms a frame: no further apart than the measurement wavers."
    )
    assert dict(describe_scene(apart))["Fastest"] == "gibs, 50 ms a frame; ddgi takes 1.1 times as long."


def test_leaks_are_named_with_their_share(tmp_path: Path) -> None:
    (scene,) = read(tmp_path, {"gibs": method(0.1, leak=0.02), "ddgi": method(0.1, leak=0.0002)})
    found = leaking(scene)
    assert found is not None and [entry.label for entry in found] == ["gibs"]
    said = dict(describe_scene(scene))["Leaks"]
    assert said == "gibs lets 2 % of the lit room’s light into the sealed one; ddgi stays at or below 0.1 %."
    assert dict(describe_all([scene]))["Leaks"] == "gibs on scene-0 (2 %)"


def test_no_sealed_room_is_no_clean_record(tmp_path: Path) -> None:
    (scene,) = read(tmp_path, {"gibs": method(0.1, leak=None)})
    assert leaking(scene) is None
    assert "Leaks" not in dict(describe_scene(scene))
    assert dict(describe_all([scene]))["Leaks"] == "not measured: no scene has a sealed room"
    (tight,) = read(tmp_path, {"gibs": method(0.1, leak=0.0)})
    assert dict(describe_all([tight]))["Leaks"] == "none above 0.1 %"


def test_the_path_tracer_at_equal_time_wins_ties_and_loses(tmp_path: Path) -> None:
    peers = [peer("a", 0.01), peer("b", 0.0505), peer("c", 0.2)]
    (scene,) = read(tmp_path, {"a": method(0.05), "b": method(0.05), "c": method(0.05), "peers": peers})
    assert [comparison.outcome for comparison in equal_time(scene)] == ["wins", "ties", "loses"]
    assert dict(describe_all([scene]))["Path tracer at equal time"] == "beats a on scene-0; ties with b on scene-0"
    said = dict(describe_scene(scene))["Equal time"]
    assert said.startswith("Given a’s 1 s, the path tracer beats it: bare 0.0100 against 0.0500. Given b’s")


def test_a_denoiser_that_was_needed_is_named(tmp_path: Path) -> None:
    peers = [peer("a", 0.08), peer("a", 0.02, "oidn"), peer("b", 0.02), peer("b", 0.01, "oidn")]
    (scene,) = read(tmp_path, {"a": method(0.05), "b": method(0.05), "peers": peers})
    assert [(v.method.label, v.verb, v.how) for v in best_at_equal_time(equal_time(scene))] == [
        ("a", "beats", "only with oidn"),
        ("b", "beats", ""),
    ]
    assert (
        "Given a’s 1 s, the path tracer beats it only with oidn: bare 0.0800 and with oidn 0.0200 against 0.0500."
        in (dict(describe_scene(scene))["Equal time"])
    )


def test_losing_everywhere_is_said_too_and_no_peer_says_nothing(tmp_path: Path) -> None:
    (scene,) = read(tmp_path, {"a": method(0.05), "peers": [peer("a", 0.5)]})
    assert dict(describe_all([scene]))["Path tracer at equal time"] == "loses to every method on scene-0"
    (without,) = read(tmp_path, {"a": method(0.05)})
    assert "Path tracer at equal time" not in dict(describe_all([without]))
    (stranger,) = read(tmp_path, {"a": method(0.05), "peers": [peer("gone", 0.5)]})
    assert equal_time(stranger) == []


def test_a_method_that_does_not_beat_ambient_is_called_out(tmp_path: Path) -> None:
    (scene,) = read(tmp_path, {"good": method(0.4), "bad": method(0.7), "same": method(0.4995)})
    assert [entry.label for entry in beaten_by_ambient(scene)] == ["bad", "same"]
    warnings = " ".join(warn_all([scene]))
    assert "bad does not beat ambient" in warnings and "good does not" not in warnings


def test_one_warning_tells_all_its_scenes(tmp_path: Path) -> None:
    scenes = read(tmp_path, {"bad": method(0.7)}, {"bad": method(0.1)}, {"bad": method(0.6)})
    assert warn_all(scenes) == ["bad does not beat ambient, one constant light everywhere, on scene-0 and scene-2."]


def test_a_frame_that_does_nothing_useful_is_not_called_the_fastest(tmp_path: Path) -> None:
    (scene,) = read(tmp_path, {"gibs": method(0.02, 50.0), "ddgi": method(0.04, 60.0), "idle": method(0.9, 3.0)})
    ranking = fastest(scene)
    assert ranking is not None and ranking.best[0].label == "gibs"
    assert dict(describe_scene(scene))["Fastest"].endswith(
        "; idle is quicker, but no nearer to the truth than ambient."
    )
    (only,) = read(tmp_path, {"idle": method(0.9, 3.0)})
    ranking = fastest(only)
    assert ranking is not None and ranking.best[0].label == "idle"


def test_methods_that_fare_alike_share_a_sentence(tmp_path: Path) -> None:
    one = {"a": method(0.05), "b": method(0.05), "peers": [peer("a", 0.01), peer("b", 0.01)]}
    scenes = read(tmp_path, dict(one), dict(one))
    assert dict(describe_all(scenes))["Path tracer at equal time"] == "beats a and b on both scenes"


def test_an_error_near_the_truths_noise_is_called_out(tmp_path: Path) -> None:
    (scene,) = read(tmp_path, {"gibs": method(0.0029), "ddgi": method(0.0031)})
    assert [entry.label for entry in below_noise(scene)] == ["gibs"]
    assert any("--reference-spp" in text for text in warn_all([scene]))


def test_scenes_are_counted_and_ties_among_them(tmp_path: Path) -> None:
    wins = {"gibs": method(0.02, 50.0), "ddgi": method(0.06, 40.0)}
    ties = {"gibs": method(0.02, 50.0), "ddgi": method(0.02, 40.0)}
    both = read(tmp_path, dict(wins), dict(wins))
    assert dict(describe_all(both))["Nearest to the truth"] == "gibs on both scenes"
    four = read(tmp_path, dict(wins), dict(wins), dict(wins), dict(ties))
    said = dict(describe_all(four))
    assert said["Nearest to the truth"] == "gibs on all 4 scenes (a tie); ddgi on scene-3 (a tie)"
    assert said["Fastest"] == "ddgi on all 4 scenes"
    always = read(tmp_path, dict(ties), dict(ties))
    assert dict(describe_all(always))["Nearest to the truth"] == "gibs and ddgi tie on both scenes"


def test_full_materials_are_judged_by_flip(tmp_path: Path) -> None:
    first, second = method(None) | {"flip": 0.3}, method(None) | {"flip": 0.2}
    (scene,) = read(tmp_path, {"gibs": first, "ddgi": second, "ambient": method(None), "none": method(None)})
    ranking = nearest(scene)
    assert ranking is not None and ranking.figure == "flip" and ranking.best[0].label == "ddgi"


def test_a_truth_of_full_materials_says_who_shows_them(tmp_path: Path) -> None:
    entries = {name: method(None) | {"materials": "diffuse"} for name in ("gibs", "ambient", "none")}
    (scene,) = read(tmp_path, {"path": method(None) | {"materials": "full"}} | entries)
    assert "Truth" not in dict(describe_scene(scene))
    scene.reference["kind"] = "full"
    said = dict(describe_scene(scene))["Truth"]
    assert "path shows all of it" in said and "gibs, none and ambient light its diffuse part alone" in said


def test_names_are_joined() -> None:
    assert (join([]), join(["a"]), join(["a", "b"]), join(["a", "b", "c"])) == ("", "a", "a and b", "a, b and c")
