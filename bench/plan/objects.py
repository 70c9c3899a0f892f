"""Objects in place of names: what identifies an estimator, a feature set or a splitter that Python code gives."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.pipeline import Pipeline

from bench.contract import is_code, parts_of


def settings_text(part: object) -> str:
    """Parameters of an object and of estimators inside it, in full; of a splitter, its attributes."""
    values = part.get_params() if isinstance(part, BaseEstimator) else vars(part)
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        return repr(
            {k: f"{v.__module__}.{v.__qualname__}" if is_code(v) else v for k, v in values.items()}
        )


def display_name(part: object) -> str:
    """An object in one line: ``SVC(C=10)``; the steps of a pipeline one behind the other."""
    if isinstance(part, Pipeline):
        return " > ".join(display_name(step) for _, step in part.steps)
    return " ".join(repr(part).split()) if isinstance(part, BaseEstimator) else type(part).__name__


def own_code(part: object) -> list[Callable]:
    """Classes and functions of an object and its parts, without installed libraries."""
    mine = (
        c
        for c in _classes_inside(part)
        if not _distribution_of(c) and c.__module__.split(".")[0] not in sys.stdlib_module_names
    )
    return sorted(mine, key=lambda c: (c.__module__, c.__qualname__))


def distributions(part: object) -> tuple[str, ...]:
    """Distributions that the classes of an object come from."""
    return tuple(
        sorted({name for kind in _classes_inside(part) if (name := _distribution_of(kind))})
    )


def _classes_inside(part: object) -> set[Callable]:
    """Functions and classes among an object and what is inside it, and the classes of the others."""
    return {each if is_code(each) else type(each) for each in parts_of(part)}


def _distribution_of(kind: Any) -> str | None:
    """The installed distribution that a class is of, by its package's name; None for touchbench's and one's own."""
    name = kind.__module__.split(".")[0]
    if name in ("bench", "__main__") or name not in sys.modules:
        return None
    name = {"sklearn": "scikit-learn"}.get(name, name)
    try:
        version(name)
    except PackageNotFoundError:
        return None
    return name
