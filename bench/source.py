"""The code that a result depends on: its hash, so that no change is mistaken for the code before it, and versions."""

from __future__ import annotations

import ast
import hashlib
import inspect
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType

from bench.registry import FILE_MODULE

Code = ModuleType | Callable  # a module, class or function
ROOMS = {"bench", "features", "models", "protocols"}
# Modules that find, move and keep things and change no number; a change in them is no other result.
INDIFFERENT = {
    "bench.corpora.duplicates",
    "bench.corpora.folder",
    "bench.corpora.library",
    "bench.errors",
    "bench.memory",
    "bench.comparable",
    "bench.measures",
    "bench.result",
    "bench.progress",
    "bench.registry",
    "bench.scratch",
    "bench.source",
    "bench.work.experiment",
    "features.cache",
}


def source_digest(*parts: Code) -> str:
    """Hash of modules, or those that define classes or functions, and of every module these take names from.

    Comments, docstrings and layout are left out, and so are modules that change no number (`INDIFFERENT`). Modules of
    other packages are left out too; their versions identify them.
    """
    todo = [part.__name__ if inspect.ismodule(part) else part.__module__ for part in parts]
    packages = ROOMS | {name.split(".")[0] for name in todo}
    beside = {Path(str(sys.modules[name].__file__)).parent for name in todo if name.startswith(FILE_MODULE)}
    code: dict[str, bytes] = {}
    while todo:
        name = todo.pop()
        if name in code or name in INDIFFERENT:
            continue
        module = sys.modules[name]
        path = getattr(module, "__file__", None)
        used = set() if hasattr(module, "__path__") else _names(module)  # a package holds whatever was imported of it
        if path and path.endswith(".py"):
            code[name], imported = meaning(path, Path(path).stat().st_mtime_ns)
            # A constant does not tell where it comes from; a package says nothing that its module does not.
            used |= {f"{name}.{part}" if f"{name}.{part}" in sys.modules else name for name, part in imported}
        else:  # typed into a notebook
            code[name] = _typed_in(parts, name)
        todo += [o for o in used if isinstance(o, str) and (o.split(".")[0] in packages or _lies_in(o, beside))]
        todo = [o for o in todo if o in sys.modules]
    h = hashlib.sha256()
    for name in sorted(code):
        stem = FILE_MODULE if name.startswith(FILE_MODULE) else name  # whose rest tells the path and every letter
        h.update(stem.encode() + code[name])
    return h.hexdigest()


def _lies_in(name: str, folders: set[Path]) -> bool:
    """Whether a module is a file in one of some folders: what a user's file imports from beside it."""
    path = getattr(sys.modules.get(name), "__file__", None)
    return path is not None and Path(path).parent in folders


def _names(module: ModuleType) -> set[str | None]:
    """Modules that a module's values are, or come from."""
    return {
        value.__name__ if inspect.ismodule(value) else getattr(value, "__module__", None)
        for value in vars(module).values()
    }


@lru_cache(maxsize=512)
def meaning(path: str, changed: int) -> tuple[bytes, frozenset[tuple[str, str]]]:
    """The syntax tree of a file without docstrings, and its imports at module level.

    Read again when its time of change is another.
    """
    tree = ast.parse(Path(path).read_bytes())
    froms = [(node.module, node.names) for node in tree.body if isinstance(node, ast.ImportFrom) and node.module]
    imported = {(module, part.name) for module, parts in froms for part in parts}
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and _documented(node):
            node.body = node.body[1:]
    return ast.dump(tree).encode(), frozenset(imported)


def _documented(node: ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    first = node.body[0] if node.body else None
    return isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str)


def _typed_in(parts: tuple[Code, ...], module: str) -> bytes:
    """Source of the classes and functions themselves, where their module is no file."""
    text = []
    for part in parts:
        if not inspect.ismodule(part) and part.__module__ == module:
            try:
                text.append(inspect.getsource(part))
            except (OSError, TypeError):  # nobody remembers it, so that no two are the same
                text.append(f"{part!r} {id(part)}")
    return "\n".join(text).encode()


def versions(also: Iterable[str] = ()) -> dict[str, str]:
    """Versions of the packages that results depend on, and of those that one system needs besides."""
    installed = {"python": ".".join(map(str, sys.version_info[:3]))}
    names = ("touchbench", "numpy", "pandas", "scipy", "scikit-learn", "optuna", "xgboost", "xgboost-cpu", "torch")
    for name in (*names, *also):
        try:
            installed[name] = version(name)
        except PackageNotFoundError:  # xgboost has two distributions, one of them is installed
            continue
    return installed


def git_revision() -> str:
    """Revision of the checkout that touchbench runs from, with ``+changes`` if it has any; empty without git."""
    if not shutil.which("git"):
        return ""
    here = Path(__file__).parent

    def git(*arguments: str) -> str:
        done = subprocess.run(["git", "-C", here, *arguments], capture_output=True, text=True, check=False)
        return done.stdout.strip() if done.returncode == 0 else ""

    revision = git("rev-parse", "--short=12", "HEAD")
    return revision + "+changes" if revision and git("status", "--porcelain", "--untracked-files=no") else revision
