"""The only place that picks a device, finds LLVM and sets the Mitsuba variant.

Importing this module is cheap: Mitsuba and Dr.Jit are imported inside the functions. Dr.Jit loads LLVM the moment it
is imported, and a libLLVM older than 17 aborts the process when a kernel is compiled, so `use_llvm` must have run
before the first `import mitsuba`; `import luxel` sees to that.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from luxel.errors import LuxelError

OLDEST_LLVM = 17
"""Dr.Jit 1.5 aborts the process with LLVM 14 to 16 (`Cannot select: fmaximum`)."""

VARIANTS = {"cpu": "llvm_ad_rgb", "cuda": "cuda_ad_rgb"}

_LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
_LLVM_FILES = ("libLLVM*.so*", "libLLVM*.dylib")
_LLVM_FOLDERS = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib/llvm-*/lib",
    "/usr/lib/llvm*/lib*",
    "/usr/lib64",
    "/usr/lib64/llvm*/lib*",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm*/lib",
    "/usr/local/opt/llvm*/lib",
)
_LLVM_MENDING = (
    "run `apt-get install libllvm19`, or on Python 3.12 or newer `pip install llvm-nanobind`, "
    f"or name a library of LLVM {OLDEST_LLVM} or newer in {_LLVM_VARIABLE}"
)
_OPTIX_MENDING = (
    "install the graphics part of the NVIDIA driver (libnvoptix.so.1), in a container by NVIDIA_DRIVER_CAPABILITIES=all"
)


class LlvmLibrary(NamedTuple):
    """A libLLVM that Dr.Jit can use."""

    path: Path
    version: tuple[int, ...]
    """(major, ...) as far as it is known, such as (19, 1)."""


class Device(NamedTuple):
    """What the process computes on."""

    name: str
    """`cpu` or `cuda`."""
    variant: str
    """The Mitsuba variant that is set."""
    reason: str
    """Why this one: one clause for people."""


_current: Device | None = None
_rejected = ""
"""Why the library that `DRJIT_LIBLLVM_PATH` named was passed over."""


# ----------------------------------------------------------------------------------------------------------------------
# LLVM


def find_llvm(folders: Sequence[str | Path] | None = None) -> LlvmLibrary | None:
    """Return the libLLVM to use, or None; Dr.Jit is not loaded.

    `DRJIT_LIBLLVM_PATH` wins where it names a usable library; else the highest version from 17 on in `folders`
    (default: the usual places of Linux and macOS and the wheel `llvm-nanobind`; glob patterns are followed).
    """
    named = os.environ.get(_LLVM_VARIABLE)
    if named and why_unusable(Path(named)) is None:
        return LlvmLibrary(Path(named), llvm_version(Path(named)) or ())
    if folders is not None:
        return _newest(_libraries_in(folders))
    return _newest(_libraries_in([*_LLVM_FOLDERS, *_wheel_folders()])) or _newest(_libraries_of_linker())


def why_unusable(path: Path) -> str | None:
    """Return why `path` cannot serve as libLLVM (a clause that starts with the path), or None if it can."""
    if not path.is_file():
        return f"{path} is not a file"
    if not os.access(path, os.R_OK):
        return f"{path} cannot be read"
    if _is_foreign(path):
        return f"{path} was built for another processor"
    version = llvm_version(path)
    if version is None:
        return f"{path} is not a libLLVM of version {OLDEST_LLVM} or newer"
    if version[0] < OLDEST_LLVM:
        return f"{path} is LLVM {version[0]}, older than {OLDEST_LLVM}"
    return None


def llvm_version(path: Path) -> tuple[int, ...] | None:
    """Return the version of a libLLVM by its file name or, where that does not tell, by asking it in a child process.

    None: the file is no loadable libLLVM.
    """
    return version_in_name(path.resolve().name) or version_in_name(path.name) or _ask_version(path)


def version_in_name(name: str) -> tuple[int, ...] | None:
    """Return the version in a file name such as `libLLVM.so.19.1`, `libLLVM-14.0.6.so.1`, `libLLVM-a6b168f6.so.21.1`.

    None where the name does not tell (`libLLVM.so`).
    """
    patterns = (
        r"libLLVM-(\d{1,2}(?:\.\d+)*)\.(?:so|dylib)",  # up to 17: the version stands before the suffix
        r"libLLVM(?:-[0-9a-f]{8})?\.so\.(\d{2}(?:\.\d+)*)",  # since 18: behind it; wheels add a hash
    )
    for pattern in patterns:
        found = re.match(pattern, name)
        if found:
            return tuple(int(part) for part in found[1].split("."))
    return None


def use_llvm() -> LlvmLibrary | None:
    """Point Dr.Jit to a usable libLLVM, which helps only before its first import. Cheap; safe to repeat."""
    global _rejected
    named = os.environ.get(_LLVM_VARIABLE)
    if named:
        _rejected = why_unusable(Path(named)) or _rejected
    library = find_llvm()
    if library is not None:
        os.environ[_LLVM_VARIABLE] = str(library.path)
    return library


def _is_foreign(path: Path) -> bool:
    """True where the ELF headers of the library and of this Python differ: 32-bit libraries beside 64-bit ones."""

    def target_of(file: str | Path) -> bytes:
        with open(file, "rb") as stream:
            header = stream.read(20)
        return header[4:6] + header[18:20] if header.startswith(b"\x7fELF") else b""

    wanted, built = target_of(sys.executable), target_of(path)
    return bool(wanted and built) and wanted != built


def _ask_version(path: Path) -> tuple[int, ...] | None:
    """Call `LLVMGetVersion` in a child process: loading a stray library here could not be undone."""
    import subprocess

    program = (
        "import ctypes, sys\n"
        "parts = [ctypes.c_uint() for _ in range(3)]\n"
        "ctypes.CDLL(sys.argv[1]).LLVMGetVersion(*map(ctypes.byref, parts))\n"
        "print(*(part.value for part in parts))\n"
    )
    command = [sys.executable, "-I", "-c", program, str(path)]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=20, check=True).stdout.split()
    except (OSError, subprocess.SubprocessError):
        return None
    return tuple(int(part) for part in answer) or None


def _libraries_in(folders: Iterable[str | Path]) -> list[Path]:
    found: list[Path] = []
    for folder in folders:
        # Path.glob wants a relative pattern, so an absolute one is taken from the root.
        anchor = Path(folder).anchor
        for place in Path(anchor).glob(str(folder)[len(anchor) :]):
            for files in _LLVM_FILES:
                found += place.glob(files)
    return found


def _wheel_folders() -> list[Path]:
    """Where `llvm-nanobind` keeps its libraries, for each place that packages are imported from."""
    inside = ("llvm_nanobind.libs", "llvm/.dylibs")
    return [
        Path(entry).absolute() / folder for entry in sys.path for folder in inside if (Path(entry) / folder).is_dir()
    ]


def _libraries_of_linker() -> list[Path]:
    """libLLVMs that the dynamic linker knows of: distributions with places of their own."""
    import subprocess

    for program in ("ldconfig", "/sbin/ldconfig"):
        try:
            listing = subprocess.run([program, "-p"], capture_output=True, text=True, timeout=10, check=True).stdout
        except (OSError, subprocess.SubprocessError):
            continue
        return [Path(path) for path in re.findall(r"=> (\S*/libLLVM\S*)", listing)]
    return []


def _newest(paths: Iterable[Path]) -> LlvmLibrary | None:
    best: LlvmLibrary | None = None
    # Several names lead to one file; the real files are asked once each.
    for path in sorted({path.resolve() for path in paths}):
        if why_unusable(path) is None:
            candidate = LlvmLibrary(path, llvm_version(path) or ())
            best = candidate if best is None or candidate.version > best.version else best
    return best


# ----------------------------------------------------------------------------------------------------------------------
# Device


def start(device: str = "auto") -> Device:
    """Pick the device and set the Mitsuba variant. Safe to repeat; another device may be asked for later.

    `device` is `cpu`, `cuda` or `auto`: the device already started, else the one in `LUXEL_DEVICE`, else CUDA where
    it works, else the CPU. Raises LuxelError where the device cannot be had, with what to install.
    """
    global _current
    wanted = device
    if wanted == "auto":
        wanted = _current.name if _current else os.environ.get("LUXEL_DEVICE", "").strip().lower() or "auto"
    if wanted not in ("auto", *VARIANTS):
        source = "The device" if device == wanted else "LUXEL_DEVICE"
        raise LuxelError(f"{source} is '{wanted}', which is none of auto, cpu and cuda.")
    use_llvm()
    if _current is None or wanted != _current.name:
        _current = _choose(wanted)
    _set_variant(_current.variant)
    return _current


def _choose(wanted: str) -> Device:
    if wanted == "cpu":
        _require_llvm()
        return Device("cpu", VARIANTS["cpu"], "asked for" + _llvm_note())
    obstacle = cuda_obstacle()
    if obstacle is None:
        reason = "asked for" if wanted == "cuda" else "CUDA and OptiX work here"
        return Device("cuda", VARIANTS["cuda"], reason)
    if wanted == "cuda":
        raise LuxelError(f"CUDA was asked for but cannot be used: {obstacle}; mend that or choose the device cpu.")
    try:
        _require_llvm()
    except LuxelError as error:
        raise LuxelError(f"{str(error).removesuffix('.')} (CUDA cannot serve instead: {obstacle}).") from None
    return Device("cpu", VARIANTS["cpu"], obstacle + _llvm_note())


def _llvm_note() -> str:
    return f" (not taken from {_LLVM_VARIABLE}: {_rejected})" if _rejected else ""


def _set_variant(variant: str) -> None:
    import mitsuba as mi

    if mi.variant() != variant:
        mi.set_variant(variant)


def _require_llvm() -> None:
    """Raise LuxelError unless Dr.Jit has loaded a libLLVM that will not abort the process."""
    library = find_llvm()
    if library is None:
        raise LuxelError(f"The CPU device found no LLVM {OLDEST_LLVM} or newer{_llvm_note()}: {_LLVM_MENDING}.")
    import drjit as dr

    if not dr.has_backend(dr.JitBackend.LLVM):
        raise LuxelError(f"Dr.Jit could not load {library.path}: {_LLVM_MENDING}.")
    loaded = dr.detail.llvm_version()
    if loaded[0] < OLDEST_LLVM:
        raise LuxelError(
            f"Dr.Jit was imported before luxel and took LLVM {loaded[0]}, which aborts it: "
            f"import luxel first, or set {_LLVM_VARIABLE}={library.path}."
        )


def cuda_obstacle() -> str | None:
    """Return why CUDA cannot be used, or None after a ray has been traced with it."""
    if not _loads("DRJIT_LIBCUDA_PATH", "libcuda.so.1"):
        return "this machine has no NVIDIA driver (libcuda.so.1)"
    if not _loads("DRJIT_LIBOPTIX_PATH", "libnvoptix.so.1"):
        return f"the NVIDIA driver lacks OptiX: {_OPTIX_MENDING}"
    import drjit as dr

    if not dr.has_backend(dr.JitBackend.CUDA):
        return "no NVIDIA GPU answers, or the driver is older than R535"
    import mitsuba as mi

    before = mi.variant()
    try:
        mi.set_variant(VARIANTS["cuda"])
        # OptiX starts with the first scene, so an unfit driver shows only now.
        scene: Any = mi.load_dict({"type": "scene", "shape": {"type": "rectangle"}})
        dr.eval(scene.ray_test(mi.Ray3f(mi.Point3f(0, 0, 1), mi.Vector3f(0, 0, -1))))
        dr.sync_thread()
    except Exception as error:  # Dr.Jit raises bare RuntimeErrors and ImportErrors here
        if before:
            mi.set_variant(before)
        return f"OptiX does not start ({' '.join(str(error).split())[:200]})"
    return None


def _loads(variable: str, library: str) -> bool:
    try:
        ctypes.CDLL(os.environ.get(variable) or library)
    except OSError:
        return False
    return True


# ----------------------------------------------------------------------------------------------------------------------
# What there is


def describe() -> dict[str, Any]:
    """Return what runs where, and why: the matter of `luxel doctor` and of benchmark records.

    Keys: device variant reason llvm_path llvm_version llvm optix gpu python platform threads versions. Never raises:
    where no device can be had, `device` and `variant` are None and `reason` says what to install.
    """
    name, variant = None, None
    try:
        device = start()
        name, variant, reason = device.name, device.variant, device.reason
    except LuxelError as error:
        reason = str(error)
    library = find_llvm()
    return {
        "device": name,
        "variant": variant,
        "reason": reason,
        "llvm_path": str(library.path) if library else None,
        "llvm_version": ".".join(map(str, library.version)) if library else None,
        "llvm": "found" if library else _LLVM_MENDING,
        "optix": _describe_optix(),
        "gpu": next(iter(_ask_driver("--query-gpu=name,driver_version")), None) if name == "cuda" else None,
        "python": sys.version.split()[0],
        "platform": _describe_platform(),
        "threads": os.cpu_count(),
        "versions": {package: _version_of(package) for package in ("luxel", "mitsuba", "drjit", "numpy", "scipy")},
    }


def memory_mb() -> float:
    """Return the memory in use, in MiB: of the GPU on CUDA, else the resident memory of this process.

    The GPU's figure is this process's where the driver tells, else the whole device's. 0.0: the system does not say.
    """
    return _gpu_memory_mb() if _current is not None and _current.name == "cuda" else _resident_mb()


def release_memory() -> None:
    """Give back to the system what Dr.Jit and the C library keep for arrays to come."""
    import drjit as dr

    dr.flush_malloc_cache()
    with contextlib.suppress(OSError, AttributeError):  # only glibc has it
        ctypes.CDLL(None).malloc_trim(0)


def free_bytes() -> int:
    """Return the bytes that are free on the device: GPU memory on CUDA, else main memory; 4 GiB where nobody says."""
    if _current is not None and _current.name == "cuda":
        for line in _ask_driver("--query-gpu=memory.free"):
            if line.strip().isdigit():
                return int(line.strip()) * 2**20
        return 4 * 2**30
    try:
        found = re.search(r"MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text())
    except OSError:
        found = None
    return int(found[1]) * 1024 if found else 4 * 2**30


def _resident_mb() -> float:
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        import resource

        # Off Linux only the peak is to be had; macOS counts it in bytes, the others in KiB.
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / 2**20 if sys.platform == "darwin" else peak / 2**10
    found = re.search(r"VmRSS:\s+(\d+) kB", status)
    return int(found[1]) / 1024 if found else 0.0


def _gpu_memory_mb() -> float:
    own = _ask_driver("--query-compute-apps=pid,used_memory")
    for line in own:
        process, _, used = line.partition(",")
        if process.strip() == str(os.getpid()) and used.strip().isdigit():
            return float(used)
    # In a container the driver knows other process ids.
    device = _ask_driver("--query-gpu=memory.used")
    return float(device[0]) if device and device[0].strip().isdigit() else 0.0


def _ask_driver(query: str) -> list[str]:
    import subprocess

    command = ["nvidia-smi", query, "--format=csv,noheader,nounits", "--id=0"]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=20, check=True).stdout.splitlines()
    except (OSError, subprocess.SubprocessError):
        return []


def _describe_optix() -> str:
    if not _loads("DRJIT_LIBCUDA_PATH", "libcuda.so.1"):
        return "not needed: this machine has no NVIDIA driver (libcuda.so.1)"
    return "found" if _loads("DRJIT_LIBOPTIX_PATH", "libnvoptix.so.1") else f"missing: {_OPTIX_MENDING}"


def _describe_platform() -> str:
    import platform

    return f"{platform.system()} {platform.machine()}"


def _version_of(package: str) -> str | None:
    from importlib import metadata

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        # A source checkout that was never installed still knows its own version.
        return getattr(sys.modules.get(package), "__version__", None)
