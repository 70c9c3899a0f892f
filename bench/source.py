"""The code that a result depends on: its hash, so that no change is mistaken for the code before it, and versions."""

from __future__ import annotations

import ast
import hashlib
import inspect
import shutil
import subprocess
import sys
from collections.abc import Iterable
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

ROOMS = {"bench", "features", "models", "protocols"}


def source_digest(part: object) -> str:
    """Hash of a module, or of the module that defines a class or function, and of every module it takes names from.

    Modules of other packages are left out; their versions identify them.
    """
    name = part.__name__ if inspect.ismodule(part) else part.__module__
    own = ROOMS | {name.split(".")[0]}
    todo, found = [name], {}
    while todo:
        name = todo.pop()
        if name in found:
            continue
        module = sys.modules[name]
        path = getattr(module, "__file__", None)
        found[name] = content(path, Path(path).stat().st_mtime_ns) if path else b""
        used = {value.__name__ if inspect.ismodule(value) else getattr(value, "__module__", None)
                for value in vars(module).values()}  # fmt: skip
        if path and path.endswith(".py"):
            used |= imported(found[name])  # a constant does not tell where it comes from
        todo += [o for o in used if isinstance(o, str) and o.split(".")[0] in own and o in sys.modules]
    h = hashlib.sha256()
    for name in sorted(found):
        h.update(name.encode() + found[name])
    return h.hexdigest()


@lru_cache(maxsize=256)
def content(path: str, changed: int) -> bytes:
    """A file's bytes, read again when its time of change is another."""
    return Path(path).read_bytes()


@lru_cache(maxsize=256)
def imported(source: bytes) -> frozenset[str]:
    """Modules that a source file imports names from when it is loaded itself, not later in a function."""
    return frozenset(node.module for node in ast.parse(source).body if isinstance(node, ast.ImportFrom) and node.module)


def versions(also: Iterable[str] = ()) -> dict[str, str]:
    """Versions of the packages that results depend on, and of those that one system needs besides."""
    found = {"python": ".".join(map(str, sys.version_info[:3]))}
    names = ("touchbench", "numpy", "pandas", "scipy", "scikit-learn", "optuna", "xgboost", "xgboost-cpu", "torch")
    for name in (*names, *also):
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # xgboost has two distributions, one of them is installed
            continue
    return found


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
