"""The parts by name: built-in ones, those of installed packages (entry points ``touchbench.<room>``), and files.

An entry point is a model, a feature set, a protocol, a format of corpora, a circumstance, a command, or a key of
another command (`bench.grammar.options.options_of_packages`).

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

from bench.errors import InputError, suggest_names

# Groups of the parts of a run, by the key that names them
PART_GROUPS = {"protocol": "protocols", "features": "features", "model": "models"}
CAPTURES = "bench.reports.views.captures:Captures"  # what is shown of captures
FILE_MODULE_PREFIX = "touchbench_file_"  # what modules of files are called
FOLDERS_BESIDE = (
    "features",
    "models",
    "protocols",
    "reports",
)  # folders of the package bench that stand beside it
PACKAGES = {"circumstances": "bench.running.circumstances"}  # of rooms that lie in another
KEYS = {"corpora": "format"} | {
    room: key for key, room in PART_GROUPS.items()
}  # of parts of a cell


def package_folder(package: str) -> Path:
    """The folder of one of touchbench's own packages."""
    return Path(str(importlib.import_module(package).__file__)).parent


@cache
def _entry_points() -> Any:
    return entry_points()  # of all groups at once, as each look takes a while


def forget() -> None:
    """Look for installed packages again."""
    for found in (_entry_points, registered_parts, load_parts, load_view, load_views, _warn_once):
        found.cache_clear()


@cache
def registered_parts(room: str) -> dict[str, str]:
    """Every part of a room and the ``module:object`` that makes it, those of packages last; nothing is imported.

    A room is a group of entry points, or a package that lists its ``PARTS``.
    """
    own = importlib.import_module(
        PACKAGES.get(room, room if "." in room else f"bench.{room}")
    ).PARTS
    return own | {
        e.name: e.value
        for e in _entry_points().select(group=f"touchbench.{room}")
        if e.name not in own
    }


def load_part(room: str, name: str) -> Any:
    """Import one part by name, or from ``file.py:Name``."""
    registered, key = (
        registered_parts(room),
        KEYS.get(room, room.rpartition(".")[2].removesuffix("s")),
    )
    file, _, attribute = name.rpartition(":")
    if file.endswith(".py"):
        return _load_from_file(f"{key}={name}", Path(file), attribute)
    if name not in registered:
        raise InputError(f"{key}={name}: unknown; {suggest_names(name, registered)}")
    return _import_plugin(registered[name], f"{key}={name}")


@cache
def load_parts(room: str) -> dict[str, Any]:
    """All parts of a room of light modules, but those of packages that cannot be loaded."""
    return _load_each(lambda name: load_part(room, name), registered_parts(room))


@cache
def load_view(key: str) -> Any:
    """What is shown of captures (``run``), or of a circumstance or study."""
    if key == "run":
        return import_object(CAPTURES)(key, (), "cell")
    one = load_part("circumstances", key)
    usual = tuple(f"{key}.{name}" for name in one.options_by_key()) if one.is_run_kind else (key,)
    return _import_plugin(one.view, f"circumstance={key}")(
        key, one.tracked or usual, key if one.is_run_kind else ""
    )


@cache
def load_views() -> dict[str, Any]:
    """What is shown of captures, and of each circumstance and study, by its key."""
    return _load_each(load_view, ["run", *registered_parts("circumstances")])


def views_of_runs() -> dict[str, Any]:
    """The views of whole runs, by the tag of these: of captures, and of studies."""
    return {view.tag: view for view in load_views().values() if view.tag}


def views_of_circumstances() -> list[Any]:
    """The views of circumstances, in the order of the registry."""
    return [view for view in load_views().values() if not view.tag]


def _load_each(made: Callable[[str], Any], among: Iterable[str]) -> dict[str, Any]:
    found = {}
    for name in among:
        try:
            found[name] = made(name)
        except InputError as e:
            _warn_once(str(e))
    return found


@cache
def _warn_once(line: str) -> None:
    print(f"warning: {line}", file=sys.stderr)


def import_object(place: str) -> Any:
    """What ``module:object`` names."""
    module, _, attribute = place.partition(":")
    return getattr(importlib.import_module(module), attribute)


def _import_plugin(place: str, part: str) -> Any:
    """What an entry point names, or one line that says why it cannot be loaded."""
    try:
        return import_object(place)
    except Exception as e:  # a module of somebody else's may raise anything
        reason = f"{type(e).__name__}: {e}; repair or remove the package"
        raise InputError(f"{part} cannot be loaded from {place}: {reason}") from e


def _load_from_file(argument: str, path: Path, attribute: str) -> Callable:
    """A class or function of a file, imported once for each state of the file."""
    path = path.resolve()
    try:
        content = path.read_bytes()
    except OSError as e:
        raise InputError(
            f"{argument}: {path} cannot be read ({e.strerror}); give file.py:Name"
        ) from e
    module_name = (
        f"{FILE_MODULE_PREFIX}{hashlib.sha256(str(path).encode() + content).hexdigest()[:16]}"
    )
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
            f"{argument}: {path.name} has no {attribute!r}; {suggest_names(attribute, here)}"
        )
    return getattr(module, attribute)


def lies_in(path: str | None, folders: Iterable[Path]) -> bool:
    """Whether a file lies in one of the folders, or below; Python and installed packages do not count."""
    return not is_library(path or "") and any(
        folder in Path(path or "").parents for folder in folders
    )


def is_library(path: str) -> bool:
    """Whether a file belongs to Python or to an installed package."""
    place = Path(path)
    return bool({"site-packages", "dist-packages"} & {*place.parts}) or any(
        p in place.parents for p in _library_folders()
    )


def is_user_code(path: str) -> bool:
    """Whether a file is code of the user's."""
    ours = (
        package_folder(package)
        for package in ("bench", *(f"bench.{folder}" for folder in FOLDERS_BESIDE))
    )
    return Path(path).is_file() and not is_library(path) and not lies_in(path, ours)


@cache
def _library_folders() -> set[Path]:
    """Folders of Python's own modules and of installed packages."""
    return {Path(path) for name, path in sysconfig.get_paths().items() if "lib" in name}


def parameter_defaults(part: Callable) -> dict[str, object]:
    """Keyword parameters of a part and their defaults; the harness passes those without a default."""
    signature = inspect.signature(part).parameters.values()
    return {p.name: p.default for p in signature if p.default is not inspect.Parameter.empty}


def required_parameters(part: Callable) -> list[str]:
    """Parameters of a part that have no default: the harness passes them, whatever their names."""
    kinds = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    signature = inspect.signature(part).parameters.values()
    return [
        p.name for p in signature if p.default is inspect.Parameter.empty and p.kind not in kinds
    ]
