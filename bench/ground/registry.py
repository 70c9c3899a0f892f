"""The parts by name: built-in ones, those of installed packages (entry points ``touchbench.<room>``), and files.

An entry point is a model, a feature set, a protocol, a format of corpora, a circumstance, a command, or a key of
another command (`bench.grammar.options.added`).

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
from bench.ground.words import PARTS

CAPTURES = "bench.reports.views.captures:Captures"  # what is shown of captures
FILE_MODULE = "touchbench_file_"  # what modules of files are called
APART = (
    "features",
    "models",
    "protocols",
    "reports",
)  # folders of the package bench that stand beside it
PACKAGES = {"circumstances": "bench.running.circumstances"}  # of rooms that lie in another
KEYS = {"corpora": "format"} | {room: key for key, room in PARTS.items()}  # of parts of a cell


def place_of(package: str) -> Path:
    """The folder of one of touchbench's own packages."""
    return Path(str(importlib.import_module(package).__file__)).parent


@cache
def _installed() -> Any:
    return entry_points()  # of all groups at once, as each look takes a while


def forget() -> None:
    """Look for installed packages again."""
    for found in (_installed, names, loaded, view, views, _warn):
        found.cache_clear()


@cache
def names(room: str) -> dict[str, str]:
    """Every part of a room and the ``module:object`` that makes it, those of packages last; nothing is imported.

    A room is a group of entry points, or a package that lists its ``PARTS``.
    """
    own = importlib.import_module(
        PACKAGES.get(room, room if "." in room else f"bench.{room}")
    ).PARTS
    return own | {
        e.name: e.value
        for e in _installed().select(group=f"touchbench.{room}")
        if e.name not in own
    }


def load(room: str, name: str) -> Any:
    """Import one part by name, or from ``file.py:Name``."""
    registered, key = names(room), KEYS.get(room, room.rpartition(".")[2].removesuffix("s"))
    file, _, attribute = name.rpartition(":")
    if file.endswith(".py"):
        return _from_file(f"{key}={name}", Path(file), attribute)
    if name not in registered:
        raise InputError(f"{key}={name}: unknown; {nearest(name, registered)}")
    return _plugged(registered[name], f"{key}={name}")


@cache
def loaded(room: str) -> dict[str, Any]:
    """All parts of a room of light modules, but those of packages that cannot be loaded."""
    return _sound(lambda name: load(room, name), names(room))


@cache
def view(key: str) -> Any:
    """What is shown of captures (``run``), or of a circumstance or study."""
    if key == "run":
        return imported(CAPTURES)(key, (), "cell")
    one = load("circumstances", key)
    usual = tuple(f"{key}.{name}" for name in one.fields()) if one.study else (key,)
    return _plugged(one.view, f"circumstance={key}")(
        key, one.tracked or usual, key if one.study else ""
    )


@cache
def views() -> dict[str, Any]:
    """What is shown of captures, and of each circumstance and study, by its key."""
    return _sound(view, ["run", *names("circumstances")])


def run_views() -> dict[str, Any]:
    """The views of whole runs, by the tag of these: of captures, and of studies."""
    return {view.tag: view for view in views().values() if view.tag}


def circumstance_views() -> list[Any]:
    """The views of circumstances, in the order of the registry."""
    return [view for view in views().values() if not view.tag]


def _sound(made: Callable[[str], Any], among: Iterable[str]) -> dict[str, Any]:
    found = {}
    for name in among:
        try:
            found[name] = made(name)
        except InputError as e:
            _warn(str(e))
    return found


@cache
def _warn(line: str) -> None:
    print(f"warning: {line}", file=sys.stderr)


def imported(place: str) -> Any:
    """What ``module:object`` names."""
    module, _, attribute = place.partition(":")
    return getattr(importlib.import_module(module), attribute)


def _plugged(place: str, part: str) -> Any:
    """What an entry point names, or one line that says why it cannot be loaded."""
    try:
        return imported(place)
    except Exception as e:  # a module of somebody else's may raise anything
        reason = f"{type(e).__name__}: {e}; repair or remove the package"
        raise InputError(f"{part} cannot be loaded from {place}: {reason}") from e


def _from_file(argument: str, path: Path, attribute: str) -> Callable:
    """A class or function of a file, imported once for each state of the file."""
    path = path.resolve()
    try:
        content = path.read_bytes()
    except OSError as e:
        raise InputError(
            f"{argument}: {path} cannot be read ({e.strerror}); give file.py:Name"
        ) from e
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
            raise InputError(
                f"{argument}: {path.name} cannot be imported: {type(e).__name__}: {e}"
            ) from e
    module = sys.modules[module_name]
    if not callable(getattr(module, attribute, None)):
        here = [
            n
            for n, v in vars(module).items()
            if callable(v) and getattr(v, "__module__", "") == module_name
        ]
        raise InputError(
            f"{argument}: {path.name} has no {attribute!r}; {nearest(attribute, here)}"
        )
    return getattr(module, attribute)


def lies_beside(path: str | None, folders: Iterable[Path]) -> bool:
    """Whether a file lies in one of the folders, or below; Python and installed packages do not count."""
    return not is_library(path or "") and any(
        folder in Path(path or "").parents for folder in folders
    )


def is_library(path: str) -> bool:
    """Whether a file belongs to Python or to an installed package."""
    place = Path(path)
    return bool({"site-packages", "dist-packages"} & {*place.parts}) or any(
        p in place.parents for p in _libraries()
    )


def is_own(path: str) -> bool:
    """Whether a file is code of the user's."""
    ours = (place_of(package) for package in ("bench", *(f"bench.{folder}" for folder in APART)))
    return Path(path).is_file() and not is_library(path) and not lies_beside(path, ours)


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
    return [
        p.name for p in signature if p.default is inspect.Parameter.empty and p.kind not in kinds
    ]
