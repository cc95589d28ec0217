"""Methods from outside the package: a class in a file, or one that an installed package offers as an entry point.

Both end in `METHODS` under the `name` of their class. A file is named as FILE.py:Class; entry points stand in the group
`luxel.methods`, under the name of the method, and are imported when the method is first asked for.
"""

from __future__ import annotations

import functools
import hashlib
import re
import sys
import traceback
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from types import ModuleType

import mitsuba as mi

from luxel import runtime
from luxel.errors import LuxelError
from luxel.methods.base import Method
from luxel.methods.check import check_method
from luxel.methods.table import METHODS

GROUP = "luxel.methods"
"""The group of entry points."""
FILE_FORM = re.compile(r"(?P<file>.+\.py):(?P<kind>[^:]*)(?::(?P<preset>[^:]*))?", re.DOTALL)
"""FILE.py:Class[:PRESET], read from the right: the path may hold colons."""
SOURCES: dict[str, MethodFile] = {}
"""Where the methods of `METHODS` that came from a file came from, by their names."""


@dataclass(frozen=True)
class MethodFile:
    """A class in a file, such that another process can load the same one."""

    path: str
    """Absolute."""
    kind: str
    """The class."""
    digest: str
    """SHA-256 of the file when it was loaded."""

    def __str__(self) -> str:
        return f"{self.path}:{self.kind}"

    def load(self) -> Method:
        """Load the class here. Raises LuxelError where the file is missing or is another one than it was."""
        if _digest(Path(self.path)) != self.digest:
            raise LuxelError(f"'{self.path}' differs from the file that was asked for; all machines need the same one")
        return load_method(str(self))


# ---------- Names ----------


def split_method(text: str) -> tuple[str, str | None]:
    """Return the method and the preset of `gibs`, `gibs:ekberg`, `FILE.py:Class` or `FILE.py:Class:PRESET`."""
    found = FILE_FORM.fullmatch(text)
    if found is not None:
        return f"{found['file']}:{found['kind']}", found["preset"] or None
    if text.endswith(".py"):
        return text, None
    method, _, preset = text.partition(":")
    return method, preset or None


def split_list(text: str) -> list[str]:
    """Return the entries of a comma list of methods, the empty ones left out; a file's path may hold commas itself."""
    parts, found = text.split(","), []
    while parts:
        count = 1
        if is_file(parts[-1]):
            ends = range(1, len(parts) + 1)
            count = next((n for n in ends if Path(_path_of(",".join(parts[-n:]).strip())).is_file()), 1)
        found.append(",".join(parts[-count:]).strip())
        del parts[-count:]
    return [entry for entry in reversed(found) if entry]


def is_file(text: str) -> bool:
    """Return whether a method is named by its file."""
    return FILE_FORM.fullmatch(text) is not None or text.endswith(".py")


def list_names() -> list[str]:
    """Return the names of all methods: those of the table, then installed ones that have not been asked for yet."""
    return [*METHODS, *(name for name in installed_methods() if name not in METHODS)]


def _path_of(text: str) -> str:
    found = FILE_FORM.fullmatch(text)
    return text if found is None else found["file"]


# ---------- Files ----------


def load_method(text: str, folder: str | Path = ".") -> Method:
    """Return the method `FILE.py:Class`, entered in `METHODS`; a relative path counts from `folder`.

    Raises LuxelError where there is no such file or class, where the file cannot be imported, where the class is no
    method that can run, and where its name is taken.
    """
    found = FILE_FORM.fullmatch(text)
    if found is None or not found["kind"]:
        raise LuxelError(f"'{text}' names a file, but no class of it: write FILE.py:Class")
    path = (Path(folder) / found["file"]).resolve()
    origin = MethodFile(str(path), found["kind"], _digest(path))
    for name, source in SOURCES.items():
        if source == origin and name in METHODS:
            return METHODS[name]
    if mi.variant() is None:
        # A file may use Mitsuba's types while it is imported.
        runtime.start()
    kind = _find_class(_import_file(path), origin)
    method = check_method(kind, str(origin))
    _require_free(method, origin)
    METHODS[method.name], SOURCES[method.name] = method, origin
    return method


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except FileNotFoundError:
        raise LuxelError(f"there is no file '{path}' that a method could be in; check the path") from None
    except OSError as error:
        raise LuxelError(f"'{path}' cannot be read: {error.strerror or error}") from None


def _import_file(path: Path) -> ModuleType:
    """Return the module made from `path`, which is run anew."""
    name = f"luxel_own_{re.sub(r'[^0-9A-Za-z_]', '_', path.stem)}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    module = ModuleType(name)
    module.__file__ = str(path)
    before = sys.modules.get(name)
    # Dataclasses and the docs of parameters look their module up.
    sys.modules[name] = module
    if str(path.parent) not in sys.path:
        # At the end: what is installed is not hidden by the file's neighbours.
        sys.path.append(str(path.parent))
    try:
        # Compiled here, as kept bytecode tells files of one second and one size apart by nothing.
        exec(compile(path.read_bytes(), str(path), "exec"), vars(module))
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        sys.modules.pop(name)
        if before is not None:
            sys.modules[name] = before
        raise LuxelError(f"'{path}' cannot be imported: {_describe(error, path)}") from error
    return module


def _find_class(module: ModuleType, origin: MethodFile) -> object:
    kind = getattr(module, origin.kind, None)
    if kind is None:
        own = (each for each in vars(module).values() if isinstance(each, type) and issubclass(each, Method))
        known = ", ".join(each.__name__ for each in own if each.__module__ == module.__name__)
        raise LuxelError(f"'{origin.path}' has no class '{origin.kind}' (its methods: {known or 'none'})")
    return kind


def _require_free(method: Method, origin: MethodFile) -> None:
    """Raise LuxelError where another method has the name; the same class of a file that was edited takes its place."""
    source = SOURCES.get(method.name)
    taken = method.name in METHODS and type(METHODS[method.name]) is not type(method)
    if taken and source is not None and (source.path, source.kind) == (origin.path, origin.kind):
        return
    if taken or (method.name not in METHODS and method.name in installed_methods()):
        raise LuxelError(
            f"{origin} calls itself '{method.name}', and a method of that name is there already; "
            "give the class another `name`"
        )


def describe_fault(error: BaseException) -> str | None:
    """Return one line on an error that the file of a method raised while it ran; None for any other error."""
    for source in SOURCES.values():
        if any(frame.filename == source.path for frame in traceback.extract_tb(error.__traceback__)):
            return f"'{source.path}' fails: {_describe(error, Path(source.path))}"
    return None


def _describe(error: BaseException, path: Path) -> str:
    """Return one line on an error, with the line of the file that it came from."""
    text = " ".join(f"{type(error).__name__}: {error}".split())
    if isinstance(error, SyntaxError):
        where = "" if error.filename in (None, str(path)) else f" of '{error.filename}'"
        return f"{type(error).__name__} in line {error.lineno}{where}: {error.msg}"
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    return f"{text} (line {lines[-1]})" if lines else text


# ---------- Installed packages ----------


@functools.cache
def installed_methods() -> dict[str, metadata.EntryPoint]:
    """Return the entry points by name; of two with one name the first package's, none whose name is in the table."""
    found: dict[str, metadata.EntryPoint] = {}
    for entry in _sorted_entries():
        if entry.name not in METHODS:
            found.setdefault(entry.name, entry)
    return found


def hidden_methods() -> list[str]:
    """Return a sentence on each entry point that cannot be reached, as its name is another method's."""
    shown = installed_methods().values()
    return [
        f"{_package_of(entry)} offers a method '{entry.name}', but another one has that name; it is left out"
        for entry in _sorted_entries()
        if entry not in shown
    ]


def load_installed(name: str) -> Method:
    """Return the method of entry point `name`, entered in `METHODS`.

    Raises LuxelError, which names the package, where it cannot be imported or is no method of that name.
    """
    entry = installed_methods()[name]
    where = f"method '{name}' of {_package_of(entry)}"
    try:
        kind = entry.load()
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        text = " ".join(f"{type(error).__name__}: {error}".split())
        raise LuxelError(f"{where} cannot be loaded: {text}") from error
    method = check_method(kind, where)
    if method.name != name:
        raise LuxelError(f"{where} calls itself '{method.name}'; entry point and class must have one name")
    METHODS[name] = method
    return method


def try_installed() -> Iterable[tuple[str, str]]:
    """Load every installed method; yield its name and what is wrong with it, empty where nothing is."""
    for name in installed_methods():
        try:
            load_installed(name)
        except LuxelError as error:
            yield name, str(error)
        else:
            yield name, ""


def _sorted_entries() -> list[metadata.EntryPoint]:
    return sorted(metadata.entry_points(group=GROUP), key=lambda entry: (entry.name, _package_of(entry)))


def _package_of(entry: metadata.EntryPoint) -> str:
    return f"package '{entry.dist.name}'" if entry.dist is not None else f"entry point '{entry.value}'"
