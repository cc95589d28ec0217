"""The page as text: complete, self-contained, safe, and redrawn from the folder alone."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from luxel.cli import main
from luxel.errors import LuxelError
from luxel.report.figures import FIGURES, MISSING, round_figure, write_figure, write_spread, write_time
from luxel.report.page import write_report
from luxel.report.plots import Line, log_ticks, plot_error, spread_apart
from luxel.report.results import read_results


def draw(folder: Path) -> str:
    path, _ = write_report(folder)
    return path.read_text()


def without_pictures(html: str) -> str:
    return re.sub(r"<script type=\"application/octet-stream\".*?</script>", "", html, flags=re.DOTALL)


def test_the_page_has_every_part(comparison: Any) -> None:
    html = draw(comparison())
    for words in (
        "gibs on both scenes", "Path tracer at equal time", "Error over frames", "Error over time", "truth’s noise",
        "path + oidn in gibs’s time", "16 paths a pixel", "rays_per_surfel", "surfel_count", "shadow", "A processor",
        "there is no GPU", "luxel compare box two-rooms:wall=0.05 -o out/report/", "baseline", "± 0",
    ):  # fmt: skip
        assert words in html, words
    assert html.count('class="viewer"') == 2
    assert html.count('class="plot"') == 4
    assert html.count('<script type="application/octet-stream"') == 2 * 10 + 6


def test_the_page_asks_the_network_for_nothing(comparison: Any) -> None:
    html = without_pictures(draw(comparison()))
    # Addresses inside the page (#, data:) are its own.
    assert not re.findall(r"(?:src|href)=\"(?!#|data:)[^\"]*\"", html)
    assert not re.findall(r"@import|url\((?!data:)", html)
    assert "http://" not in html and "https://" not in html


def test_names_cannot_break_out_of_the_page(comparison: Any) -> None:
    folder = comparison()
    results = json.loads((folder / "results.json").read_text())
    evil = "</script><img src=x onerror=alert(1)>"
    scene = {**results["scenes"]["box"], "folder": "box"}
    scene["methods"] = {**scene["methods"], evil: {**scene["methods"]["gibs"], "file": "gibs"}}
    (folder / "results.json").write_text(json.dumps({"command": evil, "scenes": {evil: scene}}))
    html = draw(folder)
    assert "<img src=x" not in html and "&lt;img src=x" in html


def test_old_results_give_a_smaller_page(comparison: Any) -> None:
    folder = comparison()
    results = json.loads((folder / "results.json").read_text())
    scene = results["scenes"]["box"]
    for part in ("peers", "path_series"):
        del scene[part]
    for figures in scene["methods"].values():
        for part in ("spread", "params"):
            figures.pop(part, None)
    (folder / "results.json").write_text(json.dumps({"scenes": {"box": scene}}))
    html = draw(folder)
    assert "not run" in html and 'id="command"' not in html and "Parameters of" not in html
    assert "Error over time" in html


def test_presets_and_settings_of_a_method_differ_by_their_dashes(comparison: Any) -> None:
    folder = comparison()
    results = json.loads((folder / "results.json").read_text())
    methods = results["scenes"]["box"]["methods"]
    methods["gibs:ekberg"] = methods["gibs"]
    methods["gibs, 1 ray"] = {**methods["gibs"], "method": "gibs"}
    (folder / "results.json").write_text(json.dumps(results))
    html = draw(folder)
    assert "curve variant-1" in html and "curve variant-2" in html and "curve variant-0" not in html
    assert html.count("--c:var(--c-gibs)") > 6 and "--c-spare-0: var" not in html


def test_times_of_several_machines_are_not_compared(comparison: Any) -> None:
    folder = comparison()
    results = json.loads((folder / "results.json").read_text())
    results["machines"] = [results["machine"], {**results["machine"], "cpu": "Another processor"}]
    (folder / "results.json").write_text(json.dumps(results))
    html = draw(folder)
    assert "2 different machines took part" in html and "A processor" in html and "Another processor" in html


def test_compare_draws_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from luxel.report import compare

    monkeypatch.setenv("LUXEL_CACHE", str(tmp_path / "cache"))
    compare(["furnace"], ["path"], reference_spp=4, size=(16, 16), frames=2, out=tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count('class="viewer"') == 1 and "missing or damaged" not in page


def test_without_pictures_the_figures_still_stand(comparison: Any, capsys: pytest.CaptureFixture[str]) -> None:
    folder = comparison()
    for path in [*folder.rglob("*.exr"), *folder.rglob("*.png")]:
        path.unlink()
    assert main(["report", str(folder)]) == 0
    told = capsys.readouterr()
    assert "luxel: warning: 37 pictures are missing or damaged and left out: box/truth.exr" in told.err
    html = (folder / "report.html").read_text()
    assert 'class="viewer"' not in html and "37 pictures are missing" in html and "Error over frames" in html


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "there is no"),
        ("{", "is damaged"),
        ("[]", "does not hold"),
        ("{}", "does not hold"),
        ('{"scenes": {}}', "holds no scene"),
        ('{"scenes": {"a": {"reference": {}, "methods": {}}}}', "does not hold"),
        ('{"scenes": {"a": {"reference": [1], "methods": {"gibs": {}}}}}', "does not hold"),
        ('{"scenes": {"a": {"reference": {}, "methods": {"gibs": {"stages": [1]}}}}}', "does not hold"),
        ('{"scenes": {"a": {"reference": {}, "methods": {"gibs": {}}, "peers": [{"of": "gibs"}]}}}', "does not hold"),
    ],
)
def test_bad_results_are_one_sentence_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str | None, words: str
) -> None:
    if text is not None:
        (tmp_path / "results.json").write_text(text)
    assert main(["report", str(tmp_path)]) == 2
    told = capsys.readouterr().err
    assert words in told and told.count("\n") == 1
    assert not (tmp_path / "report.html").exists()
    with pytest.raises(LuxelError):
        read_results(tmp_path)


def test_the_barest_results_are_drawn(tmp_path: Path) -> None:
    (tmp_path / "results.json").write_text('{"scenes": {"a": {"reference": {}, "methods": {"gibs": {}}}}}')
    assert "gibs" in draw(tmp_path)


def test_redrawing_starts_no_device(comparison: Any) -> None:
    program = "import sys; from luxel.cli import main; main(sys.argv[1:]); print(*sys.modules, file=sys.stderr)"
    command = [sys.executable, "-c", program, "report", str(comparison())]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert "wrote" in ran.stdout
    assert not {"mitsuba", "drjit", "flip_evaluator", "matplotlib"} & set(ran.stderr.split())


# ---------- Figures as texts ----------


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.02354, "0.0235"), (1.3287, "1.33"), (-0.919, "−0.919"), (50.756, "50.8"), (12.0, "12"), (0.0, "0"),
        (123456.7, "123,457"), (0.00002, "2.0e−05"), (999.96, "1,000"), (None, MISSING), (float("nan"), MISSING),
    ],
)  # fmt: skip
def test_numbers_are_written_for_people(value: float | None, text: str) -> None:
    assert round_figure(value) == text


def test_figures_carry_their_unit() -> None:
    assert write_figure("bias", -0.0091879, with_unit=True) == "−0.919 %"
    assert write_figure("bias", 1e-8) == "<0.001"
    assert write_figure("leak", 0.001057, with_unit=True) == "0.106 %"
    assert write_figure("frame_ms", 47.3, with_unit=True) == "47.3 ms"
    assert write_spread("bias", 0.0012) == "± 0.12"
    assert write_spread("regional", None) == ""
    assert [write_time(ms) for ms in (12.34, 1600.0, 150_000.0, None)] == ["12.3 ms", "1.60 s", "2.50 min", MISSING]
    assert FIGURES["bias"].sort_key(-0.5) == 0.5


# ---------- Plots ----------


def test_a_plot_leaves_out_what_a_logarithm_cannot_show() -> None:
    svg = plot_error([Line("a", "gibs", ((0.0, 1.0), (1.0, 0.0), (2.0, 0.5), (4.0, 0.25)))], "frames", "error")
    assert svg.count("<circle") == 2
    assert plot_error([Line("a", "gibs", ((0.0, 1.0),))], "frames", "error") == ""
    assert plot_error([Line("ambient", "ambient", ((1.0, 0.5),), "level")], "frames", "error") == ""


def test_ticks_are_round_and_few() -> None:
    assert log_ticks(0.9, 60.0) == [1.0, 2.0, 5.0, 10.0, 20.0, 50.0]
    assert log_ticks(1e-4, 1e3) == pytest.approx([1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1000.0])


def test_labels_keep_their_distance_inside_the_frame() -> None:
    assert spread_apart([10.0, 50.0], 15.0, 0.0, 100.0) == [10.0, 50.0]
    assert spread_apart([10.0, 12.0, 14.0], 15.0, 0.0, 100.0) == [10.0, 25.0, 40.0]
    assert spread_apart([95.0, 99.0], 15.0, 0.0, 100.0) == [85.0, 100.0]
