"""The parts by name: built-in ones, those of installed packages (entry points ``touchbench.<room>``), and files.

An entry point is a model, a feature set, a protocol, a format of corpora, a circumstance, or a command or a key of
other commands (`bench.options`).

A room names its parts as text (``bench.models.classic.svm:svm``), so nothing of it is imported before it is used, and
this module knows no room but by name.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import sys
import sysconfig
from collections.abc import Callable, Iterable
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from bench.errors import InputError, nearest

LIGHT = ("circumstances", "commands")  # whose parts load nothing heavy, so that help knows them all
CAPTURES = "bench.reports.views.captures:Captures"  # what is shown of captures
FILE_MODULE = "touchbench_file_"  # what modules of files are called
KEYS = {"corpora": "format", "features": "features", "models": "model", "protocols": "protocol"}  # of parts of a cell


def place_of(package: str) -> Path:
    """The folder of one of touchbench's own packages."""
    return Path(str(importlib.import_module(package).__file__)).parent


@cache
def _installed() -> Any:
    return entry_points()  # of all groups at once, as each look takes a while


def forget() -> None:
    """Look for installed packages again."""
    for found in (_installed, names, _loaded, views):
        found.cache_clear()


@cache
def _own(room: str) -> dict[str, str]:
    """The built-in parts of a room, those of a package that lists them in ``PARTS``."""
    return importlib.import_module(room if "." in room else f"bench.{room}").PARTS


@cache
def names(room: str) -> dict[str, str]:
    """Every registered part of a room and the ``module:object`` that makes it; nothing of it is imported."""
    return {e.name: e.value for e in _installed().select(group=f"touchbench.{room}")} | _own(room)


def load(room: str, name: str) -> Callable:
    """Import one part by name, or from ``file.py:Name``; a room is a group, or a package that lists its ``PARTS``."""
    registered, key = names(room), KEYS.get(room, room.rpartition(".")[2].removesuffix("s"))
    file, _, attribute = name.rpartition(":")
    if file.endswith(".py"):
        return _from_file(f"{key}={name}", Path(file), attribute)
    if name not in registered:
        raise InputError(f"{key}={name}: unknown; {nearest(name, registered)}")
    try:
        return imported(registered[name])
    except (ImportError, AttributeError) as e:
        raise InputError(f"{key}={name} cannot be loaded from {registered[name]}: {e}") from e


def classes(room: str) -> dict[str, Any]:
    """All parts of one of `LIGHT` by name, in the order of the registry, those of packages last.

    Without those of packages that cannot be loaded (`broken`).
    """
    return _loaded(room)[0]


@cache
def views() -> dict[str, Any]:
    """What is shown of captures (``run``), and of each circumstance and study, by its key."""
    made = {"run": imported(CAPTURES)("run", (), "cell")}
    for one in classes("circumstances").values():
        usual = tuple(f"{one.key}.{name}" for name in one.fields()) if one.study else (one.key,)
        made[one.key] = imported(one.view)(one.key, one.tracked or usual, one.key if one.study else "")
    return made


def run_views() -> dict[str, Any]:
    """The views of whole runs, by the tag of these: of captures, and of studies."""
    return {view.tag: view for view in views().values() if view.tag}


def circumstance_views() -> list[Any]:
    """The views of circumstances, in the order of the registry."""
    return [view for view in views().values() if not view.tag]


def broken() -> list[str]:
    """A line for each part of `LIGHT` of a package that cannot be loaded."""
    return [line for room in LIGHT for line in _loaded(room)[1]]


def check_loaded() -> None:
    """Refuse to make runs without a part of `LIGHT` of a package."""
    for line in broken():
        raise InputError(line)


@cache
def _loaded(room: str) -> tuple[dict[str, Any], list[str]]:
    """The parts of a room, and a line for each that cannot be loaded."""
    own, loaded, lines = _own(room), {}, []
    for name in [*own, *(name for name in names(room) if name not in own)]:
        try:
            loaded[name] = _plugged(names(room)[name], name, room)
            if room == "circumstances" and name not in own:
                _plugged(loaded[name].view, name, room)
        except InputError as e:
            loaded.pop(name, None)
            if name in own:
                raise
            lines.append(str(e))
    return loaded, lines


def _plugged(place: str, name: str, room: str) -> Any:
    """What an entry point names, or one line that says why it cannot be loaded."""
    try:
        return imported(place)
    except Exception as e:  # a module of somebody else's may raise anything
        raise InputError(
            f"the entry point {name} in touchbench.{room} cannot be loaded from {place}: {type(e).__name__}: {e}; "
            "repair or remove the package"
        ) from e


def imported(place: str) -> Any:
    """What ``module:object`` names."""
    module, _, attribute = place.partition(":")
    return getattr(importlib.import_module(module), attribute)


def _from_file(argument: str, path: Path, attribute: str) -> Callable:
    """A class or function of a file, imported once for each state of the file."""
    path = path.resolve()
    try:
        content = path.read_bytes()
    except OSError as e:
        raise InputError(f"{argument}: {path} cannot be read ({e.strerror}); give file.py:Name") from e
    module_name = f"{FILE_MODULE}{hashlib.sha256(str(path).encode() + content).hexdigest()[:16]}"
    if module_name not in sys.modules:
        spec = importlib.util.spec_from_file_location(module_name, path)
        if spec is None or spec.loader is None:  # a link to a file that is called otherwise
            raise InputError(f"{argument}: {path} is no Python file; give file.py:Name")
        module = importlib.util.module_from_spec(spec)
        sys.modules[module_name] = module
        if str(path.parent) not in sys.path:  # as Python has it for a script
            sys.path.insert(0, str(path.parent))
        try:
            spec.loader.exec_module(module)
        except Exception as e:  # a file of the user's may raise anything
            del sys.modules[module_name]
            raise InputError(f"{argument}: {path.name} cannot be imported: {type(e).__name__}: {e}") from e
    module = sys.modules[module_name]
    if not callable(getattr(module, attribute, None)):
        here = [n for n, v in vars(module).items() if callable(v) and getattr(v, "__module__", "") == module_name]
        raise InputError(f"{argument}: {path.name} has no {attribute!r}; {nearest(attribute, here)}")
    return getattr(module, attribute)


def lies_beside(path: str | None, folders: Iterable[Path]) -> bool:
    """Whether a file lies in one of the folders, or below; Python and installed packages do not count."""
    return not is_library(path or "") and any(folder in Path(path or "").parents for folder in folders)


def is_library(path: str) -> bool:
    """Whether a file belongs to Python or to an installed package."""
    place = Path(path)
    return bool({"site-packages", "dist-packages"} & {*place.parts}) or any(p in place.parents for p in _libraries())


@cache
def _libraries() -> set[Path]:
    """Folders of Python's own modules and of installed packages."""
    return {Path(path) for name, path in sysconfig.get_paths().items() if "lib" in name}


def parameters(part: Callable) -> dict[str, object]:
    """Keyword parameters of a part and their defaults; the harness passes those without a default."""
    signature = inspect.signature(part).parameters.values()
    return {p.name: p.default for p in signature if p.default is not inspect.Parameter.empty}


def required(part: Callable) -> list[str]:
    """Parameters of a part that have no default: the harness passes them, whatever their names."""
    kinds = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    signature = inspect.signature(part).parameters.values()
    return [p.name for p in signature if p.default is inspect.Parameter.empty and p.kind not in kinds]
