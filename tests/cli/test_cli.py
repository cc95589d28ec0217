"""The command line: what it prints, what it refuses, how fast it answers."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from luxel.cli import app as cli
from luxel.cli import main, options
from luxel.errors import LuxelError
from luxel.render.exposure import Exposure

HEAVY = {"mitsuba", "drjit", "scipy", "PIL", "matplotlib", "pygltflib"}
RENDER_KEYS = {
    "scene", "method", "device", "size", "frames", "image", "frame_ms", "stages", "rays_per_frame", "cache",
    "compilations_after_warmup", "materials", "warnings",
}  # fmt: skip
DEVICE = os.environ.get("LUXEL_TEST_DEVICE", "cpu")


def read_png(path: Path) -> np.ndarray:
    """Return (H, W, 3) int64."""
    with Image.open(path) as picture:
        return np.asarray(picture).astype(int)


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LUXEL_CACHE", str(tmp_path_factory.mktemp("cache")))


def run_luxel(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "luxel", *words], capture_output=True, text=True, timeout=120)


# ---------- Quick answers ----------


@pytest.mark.parametrize("words", [("--help",), ("scenes",), ("render", "--help")])
def test_nothing_heavy_is_imported_for_a_quick_answer(words: tuple[str, ...]) -> None:
    program = "import sys; from luxel.cli import main; main(sys.argv[1:]); print(*sys.modules, file=sys.stderr)"
    ran = subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True, timeout=60)
    assert ran.stdout
    assert not HEAVY & set(ran.stderr.split())


def test_help_and_scenes_cost_little_more_than_python_itself() -> None:
    def take(*command: str) -> float:
        times = []
        for _ in range(3):
            start = time.perf_counter()
            subprocess.run([sys.executable, *command], capture_output=True, timeout=60, check=True)
            times.append(time.perf_counter() - start)
        return min(times)

    # A ratio, as bare times depend on the machine: numpy's import is the measure of what "light" means.
    plain = take("-c", "import numpy, typer")
    for word in ("--help", "scenes"):
        assert take("-m", "luxel", word) < 4.0 * plain


def test_scenes_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes"]) == 0
    text = capsys.readouterr().out
    for name in ("cornell-box", "furnace", "two-rooms", "wall=0.05"):
        assert name in text
    assert main(["scenes", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["two-rooms"]["dials"]["wall"] == 0.05


# ---------- Rendering ----------


def test_render_writes_an_image_and_prints_one_object(tmp_path: Path) -> None:
    # In a process of its own: what libraries print on stdout must not get among the JSON.
    path = tmp_path / "new" / "image.png"
    words = ["furnace", "--method", "path", "--size", "24x16", "--frames", "10", "--device", DEVICE]
    ran = run_luxel("render", *words, "-o", str(path), "--json")
    assert ran.returncode == 0, ran.stderr
    result = json.loads(ran.stdout)
    assert result.keys() == RENDER_KEYS | {"gpu_memory_mb" if DEVICE == "cuda" else "memory_mb"}
    assert result["scene"] == "furnace" and result["method"] == "path" and result["device"] == DEVICE
    assert result["size"] == [24, 16] and result["frames"] == 10 and result["image"] == str(path)
    assert result["frame_ms"] > 0.0 and result["stages"]["gbuffer"] >= 0.0
    assert result["compilations_after_warmup"] == 0
    assert read_png(path).shape == (16, 24, 3)
    # The walls shine and reflect as much: what they reflect is shown at 0.18, both at 0.36.
    assert read_png(path).mean() / 255.0 == pytest.approx(0.637, abs=0.02)


def test_truth_adds_the_error_beside_the_trivial_ones(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["render", "two-rooms", "--method", "path", "--size", "32x32", "--frames", "16", "--device", DEVICE]
    words += ["-o", str(tmp_path / "image.exr"), "--truth", "16"]
    assert main([*words, "--json"]) == 0
    error = json.loads(capsys.readouterr().out)["error"]
    assert error["spp"] == 16
    assert error["baselines"]["none"]["bias"] == -1.0
    assert error["regional"] < error["baselines"]["ambient"]["regional"] < error["baselines"]["none"]["regional"]
    assert main(words) == 0
    text = capsys.readouterr().out
    for word in ("device", "regional", "error of ambient", "image.exr"):
        assert word in text


def test_a_sequence_of_a_moving_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "run"
    words = [
        "render",
        "moving",
        "--method",
        "none",
        "--size",
        "32x24",
        "--frames",
        "3",
        "--fps",
        "1",
        "-o",
        f"{folder}/",
    ]
    assert main([*words, "--device", DEVICE, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["compilations_after_warmup"] == 0
    files = sorted(folder.iterdir())
    assert [file.name for file in files] == ["frame_0000.png", "frame_0001.png", "frame_0002.png"]
    first, second, _ = (read_png(file) for file in files)
    assert np.abs(first - second).max() > 10


def test_time_and_exposure_change_the_image(tmp_path: Path) -> None:
    def render(*extra: str) -> np.ndarray:
        path = tmp_path / "image.png"
        words = ["render", "moving", "--method", "none", "--size", "32x24", "--frames", "1", "--device", DEVICE]
        assert main([*words, "-o", str(path), *extra]) == 0
        return read_png(path)

    start = render("--exposure", "1")
    assert np.abs(render("--exposure", "1", "--time", "1") - start).max() > 10
    assert render("--exposure", "0.25").mean() < 0.8 * start.mean()


def test_one_pixel_is_an_image(tmp_path: Path) -> None:
    path = tmp_path / "dot.png"
    words = ["render", "furnace", "--method", "path", "--size", "1x1", "--frames", "1", "--device", DEVICE]
    assert main([*words, "-o", str(path)]) == 0
    assert read_png(path).shape == (1, 1, 3)


@pytest.mark.parametrize("command", ["render", "bench"])
def test_rays_left_to_chance_are_left_out(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The rays of 'path' have no count: no label without a figure."""
    monkeypatch.chdir(tmp_path)
    scene = ["furnace"] if command == "render" else []
    more = ["-o", "a.png"] if command == "render" else ["--scene", "furnace"]
    for method, counted in (("path", False), ("none", True)):
        head = [command, *([method] if command == "bench" else scene)]
        words = [*head, *(["--method", method] if command == "render" else []), *more]
        words += ["--size", "16x16", "--frames", "2", "--device", DEVICE]
        assert main(words) == 0
        lines = capsys.readouterr().out.splitlines()
        assert any(line.startswith("rays") for line in lines) is counted
        assert all(line.split()[1:2] != ["a"] and len(line.split()) > 1 for line in lines)
        assert main([*words, "--json"]) == 0
        # Programs find the field in any case: null says that there is no count.
        rays = json.loads(capsys.readouterr().out)["rays_per_frame"]
        assert (rays is not None and rays["closest"] > 0) if counted else rays is None


def test_bench_records_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["bench", "none", "--scene", "furnace", "--size", "16x16", "--frames", "2", "--device", DEVICE]
    assert main([*words, "--json", "--record"]) == 0
    result = json.loads(capsys.readouterr().out)
    (file,) = (tmp_path / "benchmarks" / "results").iterdir()
    assert json.loads(file.read_text()) == result
    assert main(words) == 0
    assert "floor" in capsys.readouterr().out


def test_compare_prints_what_it_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["compare", "furnace", "--methods", "none", "--reference-spp", "4", "--size", "16x16", "--frames", "2"]
    words += ["--device", DEVICE, "-o", str(tmp_path)]
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads((tmp_path / "results.json").read_text())
    assert main(words) == 0
    assert "ambient" in capsys.readouterr().out


def test_doctor_says_what_computes(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("luxel.bench.rays.ray_benchmark", lambda: {"rays_per_second": 2e6, "triangles": 125_000})
    assert main(["doctor", "--device", DEVICE, "--json"]) == 0
    about = json.loads(capsys.readouterr().out)
    assert about["device"] == DEVICE and about["reason"] and about["rays"]["rays_per_second"] == 2e6
    assert main(["doctor", "--device", DEVICE]) == 0
    text = capsys.readouterr().out
    for word in ("LLVM", "OptiX", "mitsuba", "2.0 million"):
        assert word in text


# ---------- Bad input ----------


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["render"], "SCENE"),
        (["render", "cornell-box", "--nonsense"], "--nonsense"),
        (["nonsense"], "nonsense"),
        (["render", "cornell-box", "--filter"], "requires a value: box|gaussian|none (see luxel render"),
        (["render", "cornell-box", "--filter", "-o", "image.png"], "'--filter' requires a value"),
        (["render", "--set", "--json", "cornell-box"], "'--set' requires a value: KEY=VALUE"),
        (["compare", "cornell-box", "-o", "--no-peers"], "'-o' requires a value: DIR (see luxel compare --help)"),
        (["bench", "--frames"], "'--frames' requires a value (see luxel bench --help)"),
        (["render", "cornell-box", "--frames", "0"], "frames"),
        (["render", "cornell-box", "--seed", "-1"], "seed"),
        (["render", "cornell-box", "--truth", "0"], "truth"),
        (["render", "cornell-box", "--size", "abc"], "WIDTHxHEIGHT"),
        (["render", "cornell-box", "--size", "0x0"], "no pixels"),
        (["render", "cornell-box", "--size", "100000x100000"], "too large"),
        (["render", "cornell-box", "--set", "samples"], "KEY=VALUE"),
        (["render", "cornell-box", "--exposure", "dim"], "exposure"),
        (["render", "cornell-box", "--exposure", "+1.5"], "write +1.5ev for stops from auto, 1.5 for a factor"),
        (["view", "cornell-box", "--sky", "1e30"], "between 0 and 1e+09"),
        (["render", "cornell-box", "-o", "image.bmp"], "image.bmp"),
        (["render", "cornell-box", "--device", "tpu"], "tpu"),
        (["render", "cornell-box", "--method", "magic"], "magic"),
        (["render", "cornell-box", "--method", "path", "--set", "magic=1"], "magic"),
        (["render", "cornell-box", "--method", "path", "--preset", "magic"], "magic"),
        (["render", "cornell-bax", "--method", "path"], "cornell-box"),
        (["render", "missing.glb", "--method", "path"], "missing.glb"),
        (["render", "cornell-box", "--method", "path", "--camera", "nowhere"], "nowhere"),
        (["render", "cornell-box", "--method", "path", "--sun", "up"], "sun"),
        (["render", "cornell-box", "--method", "path", "--sun", "1e30,45"], "azimuth must lie between -1e+06 and"),
        (["render", "cornell-box", "--method", "path", "--sun", "0,45,8,91"], "between 0 and 90 degrees, not 91"),
        (["render", "cornell-box", "--method", "path", "--sun", "0,45,8,-0.5"], "between 0 and 90 degrees"),
        (["render", "cornell-box", "--method", "path", "--sun", "0,45,8,nan"], "DIAMETER"),
        (["render", "cornell-box", "--method", "path", "--sun", "0,45,8,1,1"], "DIAMETER"),
        (["render", "cornell-box", "--method", "path", "--sun", "0,45,1e30"], "between 0 and 1e+09 W/m^2, not 1e+30"),
        (["render", "cornell-box", "--method", "path", "--sun", "0,45,-3"], "between 0 and 1e+09 W/m^2, not -3"),
        (["render", "cornell-box", "--method", "path", "--sky", "-1"], "sky"),
        (["render", "cornell-box", "--method", "path", "--sky", "nan"], "sky"),
        (["render", "cornell-box", "--method", "path", "--sky", "1,1e30,1"], "between 0 and 1e+09, not '1,1e30,1'"),
        (["render", "cornell-box", "--method", "path", "--envmap", "missing.exr"], "missing.exr"),
        (["render", "cornell-box", "--method", "path", "--time", "nan"], "time"),
        (["compare", "cornell-box", "-o", "report", "--seeds", "one"], "seeds"),
        (["bench", "magic"], "magic"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(
    words: list[str], hint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    (line,) = shown.err.strip().splitlines()
    assert line.startswith("luxel: ") and hint in line
    assert not list(tmp_path.iterdir())


def test_cuda_where_there_is_none(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("luxel.runtime.cuda_obstacle", lambda: "this machine has no NVIDIA driver")
    monkeypatch.setattr("luxel.runtime._current", None)
    assert main(["render", "cornell-box", "--device", "cuda"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "no NVIDIA driver" in line


def test_a_place_that_cannot_be_written_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise AssertionError("nothing may be rendered")

    monkeypatch.setattr("luxel.render.renderer.Renderer.step", fail)
    (tmp_path / "file").write_text("old")
    words = ["render", "furnace", "--method", "path", "--size", "8x8", "--device", DEVICE, "-o"]
    assert main([*words, str(tmp_path / "file" / "image.png")]) == 2
    assert "cannot write" in capsys.readouterr().err
    assert (tmp_path / "file").read_text() == "old"


def test_debug_shows_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", "cornell-box", "--size", "abc", "--debug"]) == 2
    shown = capsys.readouterr().err
    assert "Traceback" in shown and shown.strip().splitlines()[-1].startswith("luxel: ")


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (LuxelError("a sentence"), 2, "luxel: a sentence\n"),
        (KeyboardInterrupt(), 130, ""),
        (ValueError("two\nlines"), 1, "luxel: internal error: ValueError: two lines (run again with --debug)\n"),
    ],
)
def test_what_errors_become(
    error: BaseException, code: int, text: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> None:
        raise error

    monkeypatch.setattr("luxel.scene.list_scenes", fail)
    assert main(["scenes"]) == code
    assert capsys.readouterr().err == text


def test_a_closed_pipe_is_no_error() -> None:
    program = f"{sys.executable} -m luxel scenes | true"
    ran = subprocess.run(["sh", "-c", program], capture_output=True, text=True, timeout=60, env={**os.environ})
    assert ran.stderr == ""


# ---------- Texts ----------


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["a", "--truth"], ["a", "--truth", "256"]),
        (["a", "--truth", "-o", "b"], ["a", "--truth", "256", "-o", "b"]),
        (["a", "--truth", "64", "-o", "b"], ["a", "--truth", "64", "-o", "b"]),
        (["a", "--truth=64"], ["a", "--truth=64"]),
    ],
)
def test_truth_may_stand_alone(words: list[str], expected: list[str]) -> None:
    assert cli.fill_in_spp(words) == expected


def test_texts_are_read() -> None:
    assert options.parse_size("640x480") == (640, 480)
    assert options.parse_size(" 1X2 ") == (1, 2)
    assert options.parse_settings(["a=1", "b = x=y"]) == {"a": "1", "b": "x=y"}
    assert options.parse_settings(None) == {}
    assert options.parse_exposure("auto") == Exposure()
    assert options.parse_exposure("0.5") == Exposure(0.5)
    assert options.parse_seeds("3,1,3") == [3, 1]
    assert options.parse_exposure("+1.5EV") == options.parse_exposure("1.5ev") == Exposure(stops=1.5)
    assert options.parse_exposure("-2ev") == Exposure(stops=-2.0) and options.parse_exposure("1e-3") == Exposure(1e-3)
    for text in ("0", "-1", "+1.5", "+0", "inf", "-inf", "+nan", "nan", "", "+", "ev", "1e30", "1e-40", "+33ev"):
        with pytest.raises(LuxelError):
            options.parse_exposure(text)


def test_a_chosen_camera_comes_first_and_the_name_is_that_of_the_report() -> None:
    data = options.load_scene("two-rooms:wall=0.1", camera="dark", sun="0,90,5")
    assert data.name == "two-rooms:wall=0.1"
    assert data.cameras[0].name == "dark"
    (sun,) = (light for light in data.lights if light.kind == "directional")
    assert sun.direction == pytest.approx((0.0, -1.0, 0.0), abs=1e-9)
    assert max(sun.color) == 5.0
