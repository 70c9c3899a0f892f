"""The code that a result depends on: its hash, so that no change is mistaken for the code before it, and versions."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType

from bench.errors import InputError
from bench.ground.registry import (
    FILE_MODULE_PREFIX,
    FOLDERS_BESIDE,
    is_library,
    is_user_code,
    package_folder,
)

Code = ModuleType | Callable | str  # a module or its name, a class, a function


def source_digest(*parts: Code) -> str:
    """Hash of the files of modules, classes or functions, and of every file that these import, late or not.

    Comments, docstrings and layout do not count. Files of installed packages are left out: versions identify them.
    Further files that a module of the user's reads are those that it names in its list ``depends``, beside itself.

    Raises:
        InputError: such a file cannot be read.
    """
    code: dict[str, bytes] = {}
    todo = [*dict.fromkeys(map(_module_name, parts))]
    while todo:
        name = todo.pop()
        if name in code:
            continue
        path = getattr(sys.modules.get(name), "__file__", None) or module_file(name)
        if path is None or Path(path).suffix != ".py":  # typed into a notebook
            code[name] = _source_without_file(parts, name)
            continue
        code[name], imported = _parse_file(str(path), Path(path).stat().st_mtime_ns)
        code[name] += b"".join(
            _hash_data_files(path, getattr(sys.modules.get(name), "depends", ()))
        )
        package = name if Path(path).stem == "__init__" else name.rpartition(".")[0]
        todo += {
            found
            for module, names in imported
            for found in _imported_modules(module, names, package)
        } - code.keys()
    h = hashlib.sha256()
    for name in sorted(code):
        # The rest of the name of a file's module tells the path and every letter.
        h.update(
            (FILE_MODULE_PREFIX if name.startswith(FILE_MODULE_PREFIX) else name).encode()
            + code[name]
        )
    return h.hexdigest()


def _hash_data_files(path: str | Path, names: object) -> Iterator[bytes]:
    """Hashes of the files that a file of the user's says that it reads."""
    for name in names if is_user_code(str(path)) and isinstance(names, list | tuple) else ():
        try:
            yield hashlib.sha256(Path(path).with_name(str(name)).read_bytes()).digest()
        except (OSError, ValueError) as e:
            raise InputError(
                f"{path}: depends names {name!r}, which cannot be read ({e}); correct the name"
            ) from e


def _module_name(part: Code) -> str:
    return (
        part
        if isinstance(part, str)
        else part.__name__
        if inspect.ismodule(part)
        else part.__module__
    )


@lru_cache(maxsize=1024)
def _parse_file(path: str, changed: int) -> tuple[bytes, list[tuple[str, tuple[str, ...]]]]:
    """The syntax tree of a file without docstrings, and its imports but those for types; read again once changed."""
    tree = ast.parse(Path(path).read_bytes())
    imported: list[tuple[str, tuple[str, ...]]] = []
    types: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = node.body[ast.get_docstring(node, clean=False) is not None :]
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            types |= {id(inner) for statement in node.body for inner in ast.walk(statement)}
        elif isinstance(node, ast.Import) and id(node) not in types:
            imported += [(part.name, ()) for part in node.names]
        elif isinstance(node, ast.ImportFrom) and id(node) not in types:
            names = tuple(part.name for part in node.names)
            imported.append(("." * node.level + (node.module or ""), names))
    return ast.dump(tree).encode(), imported


def _imported_modules(module: str, names: tuple[str, ...], package: str) -> Iterator[str]:
    """The modules with a file of ours that an import runs."""
    try:
        module = importlib.util.resolve_name(module, package)
    except ImportError:  # beyond the top of a package; it fails when it is run
        return
    own = [f"{module}.{name}" for name in names]
    within = [name for name in own if module_file(name)]
    yield from within
    if len(within) < len(own) or not own:
        yield from (name for name in [module] if module_file(name))
    if module.partition(".")[0] != "bench":  # packages of touchbench hold names alone
        parts = module.split(".")
        parents = (".".join(parts[:count]) for count in range(1, len(parts) + 1))
        yield from (name for name in parents if module_file(name))


def module_file(name: str) -> Path | None:
    """The Python file of a module that is no part of an installed package, found without importing it."""
    top, *rest = name.split(".")
    if top == "bench":
        place = (
            package_folder(f"bench.{rest.pop(0)}")
            if rest and rest[0] in FOLDERS_BESIDE
            else package_folder("bench")
        )
    elif (found := _find_top_level(top, tuple(sys.path))) is None:
        return None
    else:
        place = found
    if place.is_file():
        return None if rest else place
    place = place.joinpath(*rest)
    return next(
        (file for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file()), None
    )


@lru_cache(maxsize=1024)
def _find_top_level(top: str, paths: tuple[str, ...]) -> Path | None:
    """The folder of a package, or the file of a module, of the user's; None for any other."""
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None
    places = [*(spec.submodule_search_locations or ()), spec.origin] if spec else []
    place = next(iter(places), None)
    return (
        None if not place or place in ("built-in", "frozen") or is_library(place) else Path(place)
    )


def _source_without_file(parts: tuple[Code, ...], module: str) -> bytes:
    """Source of the classes and functions themselves, where their module is no file."""
    text = []
    for part in parts:
        if not isinstance(part, str) and not inspect.ismodule(part) and part.__module__ == module:
            try:
                text.append(inspect.getsource(part))
            except (OSError, TypeError):  # nobody remembers it, so that no two are the same
                text.append(f"{part!r} {id(part)}")
    return "\n".join(text).encode()


def package_versions(also: Iterable[str] = ()) -> dict[str, str]:
    """Versions of the packages that results depend on, and of those that one system needs besides."""
    installed = {"python": ".".join(map(str, sys.version_info[:3]))}
    names = (
        "touchbench",
        "numpy",
        "pandas",
        "scipy",
        "scikit-learn",
        "optuna",
        "xgboost",
        "xgboost-cpu",
        "torch",
    )
    for name in (*names, *also):
        try:
            installed[name] = _version(name)
        except PackageNotFoundError:  # xgboost has two distributions, one of them is installed
            continue
    return installed


@cache
def _version(name: str) -> str:
    """Version of an installed package, which is read from its files once."""
    return version(name)


@cache
def git_revision() -> str:
    """Revision of the checkout that touchbench runs from, with ``+changes`` if it has any; empty without git."""
    words = "describe --always --exclude=* --abbrev=12 --dirty=+changes"
    try:
        done = subprocess.run(
            ["git", "-C", Path(__file__).parent, *words.split()], capture_output=True, text=True
        )
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
