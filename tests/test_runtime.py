"""Which libLLVM and which device are picked; no test here hands Dr.Jit another library."""

from __future__ import annotations

import mmap
import os
import subprocess
import sys
from pathlib import Path

import pytest

from luxel import runtime
from luxel.errors import LuxelError


@pytest.fixture(autouse=True)
def clean(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the caller's variables nor this process's device take part."""
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "unset by the next line, and restored after the test")
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH")
    monkeypatch.delenv("LUXEL_DEVICE", raising=False)
    monkeypatch.setattr(runtime, "_rejected", "")


def make_libraries(folder: Path, *names: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_bytes(b"")
    return folder


def hide_libraries(monkeypatch: pytest.MonkeyPatch, *folders: Path) -> None:
    monkeypatch.setattr(runtime, "_LLVM_FOLDERS", tuple(map(str, folders)))
    monkeypatch.setattr(runtime, "_wheel_folders", list)
    monkeypatch.setattr(runtime, "_libraries_of_linker", list)


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM.so.19.1", (19, 1)),
        ("libLLVM.so.21.1.6", (21, 1, 6)),
        ("libLLVM-19.so", (19,)),
        ("libLLVM-17.so.1", (17,)),
        ("libLLVM-14.0.6.so.1", (14, 0, 6)),
        ("libLLVM-a6b168f6.so.21.1", (21, 1)),
        ("libLLVM-12345678.so.18.1", (18, 1)),
        ("libLLVM-18.dylib", (18,)),
        ("libLLVM.so", None),
        ("libLLVM.so.1", None),
        ("libLLVM.dylib", None),
        ("libclang.so.19", None),
    ],
)
def test_version_is_read_from_the_file_name(name: str, version: tuple[int, ...] | None) -> None:
    assert runtime.version_in_name(name) == version


def test_highest_version_wins(tmp_path: Path) -> None:
    first = make_libraries(tmp_path / "a", "libLLVM-14.so.1", "libLLVM-17.so.1", "libLLVM.so.9.1")
    second = make_libraries(tmp_path / "b", "libLLVM.so.19.1", "libLLVM-15.so.1", "libLLVM.so.18.1")
    found = runtime.find_llvm([first, second])
    assert found == (second / "libLLVM.so.19.1", (19, 1))


def test_folders_may_be_patterns(tmp_path: Path) -> None:
    place = make_libraries(tmp_path / "llvm-18" / "lib", "libLLVM-18.so.1")
    found = runtime.find_llvm([f"{tmp_path}/llvm-*/lib", f"{tmp_path}/missing"])
    assert found is not None and found.path == place / "libLLVM-18.so.1"


def test_old_libraries_are_never_taken(tmp_path: Path) -> None:
    old = make_libraries(tmp_path, "libLLVM-14.so.1", "libLLVM-15.so.1", "libLLVM-16.so.1")
    assert runtime.find_llvm([old]) is None


def test_a_link_is_known_by_its_target(tmp_path: Path) -> None:
    make_libraries(tmp_path, "libLLVM.so.19.1")
    (tmp_path / "libLLVM.so").symlink_to("libLLVM.so.19.1")
    assert runtime.llvm_version(tmp_path / "libLLVM.so") == (19, 1)


def test_a_link_cannot_make_an_old_library_new(tmp_path: Path) -> None:
    make_libraries(tmp_path / "old", "libLLVM-14.so.1")
    (tmp_path / "libLLVM.so.19.1").symlink_to(tmp_path / "old" / "libLLVM-14.so.1")
    assert runtime.find_llvm([tmp_path]) is None


def test_a_nameless_library_is_asked_in_a_child_process(tmp_path: Path) -> None:
    real = runtime.find_llvm()
    if real is None:
        pytest.skip("no libLLVM on this machine to ask")
    # The copy is a hard link or a whole copy under a name that tells nothing.
    nameless = tmp_path / "libLLVM.so"
    try:
        os.link(real.path, nameless)
    except OSError:
        pytest.skip("the temporary folder is on another file system")
    version = runtime.llvm_version(nameless)
    assert version is not None and version[: len(real.version)] == real.version


def test_a_file_that_is_no_library_is_rejected(tmp_path: Path) -> None:
    stray = make_libraries(tmp_path, "libLLVM.so") / "libLLVM.so"
    assert runtime.find_llvm([tmp_path]) is None
    assert "not a libLLVM" in (runtime.why_unusable(stray) or "")


def test_a_library_for_another_processor_is_rejected(tmp_path: Path) -> None:
    with open(sys.executable, "rb") as stream:
        header = bytearray(stream.read(20))
    if not header.startswith(b"\x7fELF"):
        pytest.skip("this system's programs are not ELF files")
    foreign = tmp_path / "libLLVM.so.19.1"
    header[4] ^= 3
    foreign.write_bytes(header)
    assert "another processor" in (runtime.why_unusable(foreign) or "")


def test_variable_wins_over_higher_versions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    named = make_libraries(tmp_path / "named", "libLLVM.so.18.1") / "libLLVM.so.18.1"
    usual = make_libraries(tmp_path / "usual", "libLLVM.so.21.1")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(named))
    assert runtime.find_llvm([usual]) == (named, (18, 1))


@pytest.mark.parametrize(("name", "reason"), [("libLLVM-14.so.1", "is LLVM 14"), ("missing.so", "is not a file")])
def test_bad_variable_is_passed_over_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, reason: str
) -> None:
    make_libraries(tmp_path / "named", "libLLVM-14.so.1")
    usual = make_libraries(tmp_path / "usual", "libLLVM.so.19.1")
    hide_libraries(monkeypatch, usual)
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "named" / name))
    found = runtime.use_llvm()
    assert found is not None and found.path.parent == usual
    assert os.environ["DRJIT_LIBLLVM_PATH"] == str(usual / "libLLVM.so.19.1")
    assert reason in runtime._llvm_note()


def test_missing_llvm_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hide_libraries(monkeypatch, make_libraries(tmp_path, "libLLVM-15.so.1"))
    monkeypatch.setattr(runtime, "_current", None)
    with pytest.raises(LuxelError, match=r"apt-get install libllvm19.*pip install llvm-nanobind") as caught:
        runtime.start("cpu")
    assert "\n" not in str(caught.value)


def test_unknown_devices_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(LuxelError, match="'gpu'"):
        runtime.start("gpu")
    monkeypatch.setattr(runtime, "_current", None)
    monkeypatch.setenv("LUXEL_DEVICE", "abacus")
    with pytest.raises(LuxelError, match="LUXEL_DEVICE is 'abacus'"):
        runtime.start()


def test_cuda_without_a_driver_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "_current", None)
    monkeypatch.setattr(runtime, "_loads", lambda variable, library: False)
    with pytest.raises(LuxelError, match=r"libcuda\.so\.1") as caught:
        runtime.start("cuda")
    assert "\n" not in str(caught.value)


def test_auto_falls_back_to_the_cpu_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "_current", None)
    monkeypatch.setattr(runtime, "_loads", lambda variable, library: library == "libcuda.so.1")
    monkeypatch.setattr(runtime, "_set_variant", lambda variant: None)
    device = runtime.start("auto")
    assert device.name == "cpu" and "OptiX" in device.reason


def test_start_is_idempotent_and_auto_keeps_the_device() -> None:
    first = runtime.start("auto")
    assert runtime.start("auto") == first == runtime.start(first.name)


def test_start_mends_a_variant_set_by_others() -> None:
    import mitsuba as mi

    device = runtime.start("auto")
    mi.set_variant("scalar_rgb")
    runtime.start("auto")
    assert mi.variant() == device.variant


def test_description_is_complete() -> None:
    description = runtime.describe()
    assert description["device"] in ("cpu", "cuda")
    assert description["versions"]["mitsuba"]
    assert {"variant", "reason", "llvm_path", "llvm_version", "optix", "python", "threads"} <= description.keys()


def test_memory_is_positive_and_follows_allocations() -> None:
    assert runtime._resident_mb() > 20.0
    # Pages of its own: a heap allocation may reuse memory that earlier tests gave back.
    size = 64 * 2**20
    before = runtime._resident_mb()
    with mmap.mmap(-1, size) as held:
        held[:: mmap.PAGESIZE] = b"\1" * (size // mmap.PAGESIZE)
        assert runtime._resident_mb() > before + 48.0


def test_dr_jit_imported_first_with_an_old_llvm_does_not_abort(tmp_path: Path) -> None:
    old = [path for major in (15, 16) for path in Path("/usr/lib").glob(f"*/libLLVM-{major}.so*")]
    if not old:
        pytest.skip("no libLLVM 15 or 16 on this machine")
    program = "import drjit\nfrom luxel import runtime\nruntime.start('cpu')\n"
    environment = {**os.environ, "DRJIT_LIBLLVM_PATH": str(old[0])}
    ran = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=60)
    assert ran.returncode == 1, ran.stderr
    assert "LuxelError" in ran.stderr and "import luxel first" in ran.stderr


def test_importing_luxel_replaces_an_old_llvm_before_dr_jit_is_imported(tmp_path: Path) -> None:
    if runtime.find_llvm() is None:
        pytest.skip("no libLLVM on this machine to put in its place")
    old = make_libraries(tmp_path, "libLLVM-14.so.1") / "libLLVM-14.so.1"
    program = "import luxel, os; print(os.environ['DRJIT_LIBLLVM_PATH'])"
    environment = {**os.environ, "DRJIT_LIBLLVM_PATH": str(old)}
    command = [sys.executable, "-c", program]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=True)
    assert runtime.why_unusable(Path(ran.stdout.strip())) is None


def test_importing_the_runtime_is_light() -> None:
    program = "import sys, luxel.runtime; print(*sys.modules)"
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert not {"mitsuba", "drjit", "numpy", "subprocess"} & set(ran.stdout.split())


def test_memory_is_given_back() -> None:
    """What is released cannot be measured exactly; it must not fail, and must leave arrays alone."""
    import drjit as dr
    import mitsuba as mi

    kept = dr.arange(mi.Float, 1000)
    dr.eval(kept)
    runtime.release_memory()
    assert float(dr.sum(kept)[0]) == 499500.0
