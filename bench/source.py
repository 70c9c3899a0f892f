"""The source code that a result depends on, as a hash: a change of code is never mistaken for the code before it."""

from __future__ import annotations

import hashlib
import inspect
import sys
from functools import lru_cache
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
        for value in vars(module).values():
            other = value.__name__ if inspect.ismodule(value) else getattr(value, "__module__", None)
            if isinstance(other, str) and other.split(".")[0] in own and other in sys.modules:
                todo.append(other)
    h = hashlib.sha256()
    for name in sorted(found):
        h.update(name.encode() + found[name])
    return h.hexdigest()


@lru_cache(maxsize=256)
def content(path: str, changed: int) -> bytes:
    """A file's bytes, read again when its time of change is another."""
    return Path(path).read_bytes()
