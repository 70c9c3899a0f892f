"""The code that a result depends on: hash of its files, versions, and whose code a file is."""

from __future__ import annotations

import ast
import hashlib
import importlib
import importlib.util
import inspect
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Iterable, Iterator
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType

from bench.errors import InputError
from bench.ground.registry import FILE_MODULE_PREFIX

Code = ModuleType | Callable | str  # a module or its name, a class, a function
# Packages of bench whose folders lie beside it
FOLDERS_BESIDE = ("features", "models", "protocols", "reports")
PACKAGES = "touchbench numpy pandas scipy scikit-learn optuna xgboost xgboost-cpu torch".split()
installed_version = cache(version)  # read from files


def source_digest(*parts: Code) -> str:
    """Hash the files of modules, classes or functions, and all files that these import.

    Comments, docstrings and layout do not count. Files of installed packages are left out: versions
    identify them. A module of the user's may name further files beside itself in a list
    ``depends``.

    Raises:
        InputError: a file in ``depends`` cannot be read.
    """
    code: dict[str, bytes] = {}
    pending = [*dict.fromkeys(map(_module_name, parts))]
    while pending:
        name = pending.pop()
        if name in code:
            continue
        path = getattr(sys.modules.get(name), "__file__", None) or module_file(name)
        if path is None or Path(path).suffix != ".py":  # typed into a notebook
            code[name] = _source_without_file(parts, name)
            continue
        tree, imports = _parse_file(str(path), Path(path).stat().st_mtime_ns)
        depends = getattr(sys.modules.get(name), "depends", ())
        code[name] = tree + b"".join(_hash_data_files(path, depends))
        package = name if Path(path).stem == "__init__" else name.rpartition(".")[0]
        is_ours = name.partition(".")[0] == "bench"
        find_modules = _modules_of_our_imports if is_ours else _imported_modules
        for module, names in imports:
            pending += find_modules(module, names, package)
    digest = hashlib.sha256()
    for name in sorted(code):
        # The module name of a user's file hashes its raw text, comments included: only the
        # prefix counts.
        is_file = name.startswith(FILE_MODULE_PREFIX)
        digest.update((FILE_MODULE_PREFIX if is_file else name).encode() + code[name])
    return digest.hexdigest()


# Code that is loaded does not change.
loaded_code_digest: Callable[..., str] = lru_cache(maxsize=64)(source_digest)


def _hash_data_files(path: str | Path, names: object) -> Iterator[bytes]:
    """Hash the files that a file of the user's names in ``depends``."""
    if not names or not isinstance(names, list | tuple) or not is_user_code(str(path)):
        return
    for name in names:
        try:
            yield hashlib.sha256(Path(path).with_name(str(name)).read_bytes()).digest()
        except (OSError, ValueError) as e:
            raise InputError(
                f"{path}: depends names {name!r}, which cannot be read ({e}); correct the name"
            ) from e


def _module_name(part: Code) -> str:
    if isinstance(part, str):
        return part
    return part.__name__ if inspect.ismodule(part) else part.__module__


@lru_cache(maxsize=1024)
def _parse_file(path: str, changed: int) -> tuple[bytes, list[tuple[str, tuple[str, ...]]]]:
    """Read the syntax tree of a file without docstrings, and its imports except those for types.

    ``changed`` is the time of its last change, for the cache.
    """
    tree = ast.parse(Path(path).read_bytes())
    imports: list[tuple[str, tuple[str, ...]]] = []
    for_types: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = node.body[ast.get_docstring(node, clean=False) is not None :]
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            for_types |= {id(inner) for statement in node.body for inner in ast.walk(statement)}
        elif isinstance(node, ast.Import) and id(node) not in for_types:
            imports += [(alias.name, ()) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and id(node) not in for_types:
            names = tuple(alias.name for alias in node.names)
            imports.append(("." * node.level + (node.module or ""), names))
    return ast.dump(tree).encode(), imports


def _imported_modules(module: str, names: tuple[str, ...], package: str) -> Iterator[str]:
    """Yield the modules, of touchbench or the user, that an import runs."""
    try:
        module = importlib.util.resolve_name(module, package)
    except ImportError:  # beyond the top of a package; it fails when it is run
        return
    submodules = [f"{module}.{name}" for name in names if module_file(f"{module}.{name}")]
    yield from submodules
    if (not names or len(submodules) < len(names)) and module_file(module):
        yield module
    if module.partition(".")[0] != "bench":  # whose packages hold names alone
        parts = module.split(".")
        parents = (".".join(parts[:count]) for count in range(1, len(parts) + 1))
        yield from filter(module_file, parents)


def module_file(name: str) -> Path | None:
    """Find the Python file of a module without importing it; None for one of a library."""
    top, *names = name.split(".")
    if top == "bench":
        beside = names and names[0] in FOLDERS_BESIDE
        place = package_folder(f"bench.{names.pop(0)}" if beside else "bench")
    elif (found := _find_top_level(top, tuple(sys.path))) is None:
        return None
    else:
        place = found
    if place.is_file():
        return None if names else place
    place = place.joinpath(*names)
    files = (place.with_suffix(".py"), place / "__init__.py")
    return next((file for file in files if file.is_file()), None)


# Our own code has the same imports as long as this process runs; the user's may gain a module.
_modules_of_our_imports = lru_cache(maxsize=8192)(lambda *import_: [*_imported_modules(*import_)])


@lru_cache(maxsize=1024)
def _find_top_level(name: str, paths: tuple[str, ...]) -> Path | None:
    """Find the folder of a user's package, or the file of a module; None for any other."""
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        return None
    places = [*(spec.submodule_search_locations or ()), spec.origin] if spec else []
    place = next(iter(places), None)
    if not place or place in ("built-in", "frozen") or is_library(place):
        return None
    return Path(place)


def _source_without_file(parts: tuple[Code, ...], module: str) -> bytes:
    """The source of the classes and functions themselves, whose module is no file."""
    texts = []
    for part in parts:
        if not isinstance(part, str) and not inspect.ismodule(part) and part.__module__ == module:
            try:
                texts.append(inspect.getsource(part))
            except (OSError, TypeError):  # unknown source: equal to no other
                texts.append(f"{part!r} {id(part)}")
    return "\n".join(texts).encode()


def package_folder(package: str) -> Path:
    """The folder of one of touchbench's own packages."""
    return Path(str(importlib.import_module(package).__file__)).parent


def lies_in(path: str | None, folders: Iterable[Path]) -> bool:
    """Return True for a file in one of the folders, or below, that belongs to no library."""
    parents = Path(path or "").parents
    return not is_library(path or "") and any(folder in parents for folder in folders)


def is_library(path: str) -> bool:
    """Return True for a file of Python or of an installed package."""
    parents = Path(path).parents
    installed = {"site-packages", "dist-packages"} & {*Path(path).parts}
    return bool(installed) or any(folder in parents for folder in _library_folders())


def is_user_code(path: str) -> bool:
    """Return True for a file of the user's own code."""
    packages = ("bench", *(f"bench.{folder}" for folder in FOLDERS_BESIDE))
    ours = map(package_folder, packages)
    return Path(path).is_file() and not is_library(path) and not lies_in(path, ours)


@cache
def _library_folders() -> set[Path]:
    return {Path(path) for name, path in sysconfig.get_paths().items() if "lib" in name}


def package_versions(further: Iterable[str] = ()) -> dict[str, str]:
    """Versions of Python, of the packages that results depend on, and of further ones."""
    versions = {"python": ".".join(map(str, sys.version_info[:3]))}
    for name in (*PACKAGES, *further):
        try:
            versions[name] = installed_version(name)
        except PackageNotFoundError:  # one of the two distributions of xgboost
            continue
    return versions


@cache
def git_revisions(*files: str) -> str:
    """Revisions of this checkout and of those that hold some files, with their folders' names.

    Each has ``+changes`` if the checkout has any. Without git there is none.
    """
    words = "describe --always --exclude=* --abbrev=12 --dirty=+changes"
    revisions: list[str] = []
    for folder in dict.fromkeys([Path(__file__).parent, *(Path(file).parent for file in files)]):
        name = f"{folder.name} " * bool(revisions)
        command = ["git", "-C", str(folder), *words.split()]
        try:
            done = subprocess.run(command, capture_output=True, text=True)
        except OSError:
            return ""
        revisions.append(name + done.stdout.strip() if done.returncode == 0 else "")
    return ", ".join(filter(None, revisions))


def own_files(module_name: str) -> dict[str, Path]:
    """The files of the user's that a loaded module consists of, by their places below its folder.

    These are its own, those that it imports, and those that they name in ``depends``.
    """
    files: dict[str, Path] = {}
    pending = [module_name]
    while pending:
        name = pending.pop()
        path = getattr(sys.modules.get(name), "__file__", None) or module_file(name)
        if path is None or not is_user_code(str(path)):
            continue
        path, is_package = Path(path), Path(path).stem == "__init__"
        place = name.replace(".", "/") + ("/__init__.py" if is_package else ".py")
        place = path.name if name == module_name else place
        if place in files:
            continue
        files[place] = path
        for each in getattr(sys.modules.get(name), "depends", ()):
            files[Path(place).with_name(each).as_posix()] = path.with_name(each)
        _, imports = _parse_file(str(path), path.stat().st_mtime_ns)
        package = name if is_package else name.rpartition(".")[0]
        for module, names in imports:
            pending += _imported_modules(module, names, package)
    return files
