"""The parts by name: built-in ones and those of installed packages (entry points ``touchbench.<room>``)."""

from __future__ import annotations

import difflib
import importlib
import inspect
from collections.abc import Callable, Iterable
from functools import cache
from importlib.metadata import entry_points

from bench.corpora import READERS
from bench.errors import InputError
from features import FEATURES
from models import MODELS
from protocols import PROTOCOLS

ROOMS = {"corpora": READERS, "features": FEATURES, "models": MODELS, "protocols": PROTOCOLS}
KEYS = {"corpora": "format", "features": "features", "models": "model", "protocols": "protocol"}


@cache
def names(room: str) -> dict[str, str]:
    """Every known part of a room and the ``module:object`` that makes it; nothing of it is imported."""
    plugins = {e.name: e.value for e in entry_points(group=f"touchbench.{room}")}
    return plugins | ROOMS[room]


def load(room: str, name: str) -> Callable:
    """Import one part: a class or a function whose keyword arguments are its parameters.

    Raises:
        InputError: no part has that name, or its package cannot be imported.
    """
    known = names(room)
    if name not in known:
        raise InputError(f"{KEYS[room]}={name}: not known; {nearest(name, known)}")
    module, _, attribute = known[name].partition(":")
    try:
        return getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as e:
        raise InputError(f"{KEYS[room]}={name} cannot be loaded from {known[name]}: {e}") from e


def parameters(part: Callable) -> dict[str, object]:
    """Keyword parameters of a part and their defaults; ``features`` is handed over by the harness."""
    found = inspect.signature(part).parameters.values()
    return {p.name: p.default for p in found if p.default is not inspect.Parameter.empty}


def nearest(word: str, known: Iterable[str]) -> str:
    """The end of an error message: the likeliest names first, then all of them."""
    known = sorted(known)
    close = difflib.get_close_matches(word, known, n=3, cutoff=0.6)
    hint = f"did you mean {' or '.join(close)}? " if close else ""
    return f"{hint}known: {', '.join(known) or 'none'}"
