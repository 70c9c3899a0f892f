"""Find and load parts by name: built-in ones, those of installed packages, and those of files.

A part is a model, a feature set, a protocol, a format of corpora, a circumstance, a command, or a
key that a package adds to a command (`bench.grammar.options.options_of_packages`). Parts of one
kind form a group: a package of touchbench that lists them in ``PARTS``, and entry points
``touchbench.<group>``.

A group lists its parts as text (``bench.models.classic.svm:svm``). So nothing is imported before it
is used, and this module imports no group.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Iterable
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from bench.errors import InputError, suggest_names
from bench.ground.closed import close_corpora

# Groups of the parts of a run, by the key that names them
PART_GROUPS = {"protocol": "protocols", "features": "features", "model": "models"}
CAPTURES_VIEW = "bench.reports.views.captures:Captures"
FILE_MODULE_PREFIX = "touchbench_file_"  # of the names of modules that are loaded from files
PACKAGES = {  # of groups that lie deeper
    "circumstances": "bench.running.circumstances",
    "sources": "bench.corpora.sources",
    "skins": "bench.corpora.skin",
}
KEYS = {"corpora": "format"} | {group: key for key, group in PART_GROUPS.items()}


@cache
def _entry_points() -> Any:
    return entry_points()  # of all groups at once, as each look takes long


@cache
def registered_parts(group: str) -> dict[str, str]:
    """Each part of a group by name, as ``module:object``, those of packages last.

    The name of a group may also be that of a package that lists its ``PARTS``.
    """
    own = _import_group(group).PARTS
    added = _entry_points().select(group=f"touchbench.{group}")
    return own | {point.name: point.value for point in added if point.name not in own}


def _import_group(group: str) -> Any:
    name = PACKAGES.get(group, group if "." in group else f"bench.{group}")
    return importlib.import_module(name)


def notes_by_design(group: str) -> dict[str, tuple[str, str]]:
    """Built-in parts that were designed on a corpus: the corpus, and a note for results on it."""
    return getattr(_import_group(group), "DESIGNED_ON", {})


def load_part(group: str, name: str) -> Any:
    """Import one part by name, or from ``file.py:Name``.

    Raises:
        InputError: there is no such part, or it cannot be imported.
    """
    key = KEYS.get(group, group.rpartition(".")[2].removesuffix("s"))
    file, _, attribute = name.rpartition(":")
    if file.endswith(".py"):
        return _load_from_file(f"{key}={name}", Path(file), attribute)
    if name.endswith(".py"):
        raise InputError(f"{key}={name}: give what it defines, too, as {key}={name}:Name")
    registered = registered_parts(group)
    if name not in registered:
        raise InputError(f"{key}={name}: unknown; {suggest_names(name, registered)}")
    return _import_part(registered[name], f"{key}={name}")


@cache
def load_parts(group: str) -> dict[str, Any]:
    """Import all parts of a group of light modules; warn of those that cannot be imported."""
    return _load_each(lambda name: load_part(group, name), registered_parts(group))


@cache
def load_view(key: str) -> Any:
    """Make the view of captures (``run``), or of a circumstance or kind of run."""
    if key == "run":
        return import_object(CAPTURES_VIEW)(key, (), "cell")
    part = load_part("circumstances", key)
    make_view = _import_part(part.view, f"circumstance={key}")
    if part.is_run_kind:
        options = tuple(f"{key}.{name}" for name in part.options_by_key())
        return make_view(key, part.tracked or options, key)
    return make_view(key, part.tracked or (key,), "")


@cache
def load_views() -> dict[str, Any]:
    """The views of captures, and of each circumstance and kind of run, by key."""
    return _load_each(load_view, ["run", *registered_parts("circumstances")])


def views_of_runs() -> dict[str, Any]:
    """The views of whole runs by the tag of these runs: of captures, and of kinds of run."""
    return {view.tag: view for view in load_views().values() if view.tag}


def views_of_circumstances() -> list[Any]:
    """The views of circumstances, in the order of the registry."""
    return [view for view in load_views().values() if not view.tag]


def _load_each(load: Callable[[str], Any], names: Iterable[str]) -> dict[str, Any]:
    loaded = {}
    for name in names:
        try:
            loaded[name] = load(name)
        except InputError as e:
            _warn_once(str(e))
    return loaded


@cache
def _warn_once(line: str) -> None:
    print(f"warning: {line}", file=sys.stderr)


def import_object(path: str) -> Any:
    """Import the object that ``module:object`` names."""
    module, _, attribute = path.partition(":")
    return getattr(importlib.import_module(module), attribute)


def _import_part(path: str, argument: str) -> Any:
    """Import a registered part; an `InputError` if that fails."""
    try:
        return import_object(path)
    except Exception as e:  # a module of another author may raise anything
        raise InputError(
            f"{argument} cannot be loaded from {path}: {type(e).__name__}: {e}; repair or remove "
            "the package"
        ) from e


def _load_from_file(argument: str, path: Path, attribute: str) -> Callable:
    """Load a class or function of a file, which is imported again once its content changed."""
    path = path.resolve()
    try:
        content = path.read_bytes()
    except OSError as e:
        raise InputError(
            f"{argument}: {path} cannot be read ({e.strerror}); give file.py:Name"
        ) from e
    digest = hashlib.sha256(str(path).encode() + content).hexdigest()
    module_name = FILE_MODULE_PREFIX + digest[:16]
    if module_name not in sys.modules:
        _import_file(argument, path, module_name)
    module = sys.modules[module_name]
    if callable(part := getattr(module, attribute, None)):
        return part
    objects = {name: value for name, value in vars(module).items() if callable(value)}
    own = [n for n, value in objects.items() if getattr(value, "__module__", "") == module_name]
    raise InputError(
        f"{argument}: {path.name} has no {attribute!r}; {suggest_names(attribute, own)}"
    )


def _import_file(argument: str, path: Path, module_name: str) -> None:
    spec = importlib.util.spec_from_file_location(module_name, path)
    if spec is None or spec.loader is None:  # a link to a file with another ending
        raise InputError(f"{argument}: {path} is no Python file; give file.py:Name")
    sys.modules[module_name] = module = importlib.util.module_from_spec(spec)
    if str(path.parent) not in sys.path:  # as Python does for a script
        sys.path.insert(0, str(path.parent))
    try:
        with close_corpora():
            spec.loader.exec_module(module)
    except InputError as e:
        del sys.modules[module_name]
        raise InputError(f"{argument}: {path.name} cannot be imported: {e}") from e
    except Exception as e:  # a file of the user's may raise anything
        del sys.modules[module_name]
        raise InputError(
            f"{argument}: {path.name} cannot be imported: {type(e).__name__}: {e}"
        ) from e


def parameter_defaults(part: Callable) -> dict[str, object]:
    """The default of each parameter of a part that has one."""
    parameters = inspect.signature(part).parameters.values()
    return {p.name: p.default for p in parameters if p.default is not p.empty}


def required_parameters(part: Callable) -> list[str]:
    """Names of the parameters of a part without a default, for which the harness has values."""
    starred = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    parameters = inspect.signature(part).parameters.values()
    return [p.name for p in parameters if p.default is p.empty and p.kind not in starred]
