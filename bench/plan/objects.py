"""What identifies an estimator, a feature set or a splitter that Python code gives as an object."""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.pipeline import Pipeline

from bench.contract import is_code, parts_of
from bench.ground.registry import parameter_defaults


def settings_text(part: object) -> str:
    """All parameters of an object and of estimators inside it; of a splitter, its attributes."""
    values = part.get_params() if isinstance(part, BaseEstimator) else vars(part)
    values = {k: f"{v.__module__}.{v.__qualname__}" if is_code(v) else v for k, v in values.items()}
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        return repr(values)


def changed_arguments(part: object) -> dict[str, object]:
    """Constructor arguments of an object that differ from their defaults, for labels.

    Only those that it keeps under the same names are known.
    """
    names = inspect.signature(type(part)).parameters
    defaults = parameter_defaults(type(part))
    arguments = {name: value for name, value in vars(part).items() if name in names}
    return {
        name: _short_value(value)
        for name, value in arguments.items()
        if name not in defaults or repr(value) != repr(defaults[name])
    }


def _short_value(value: object) -> object:
    """A number or a text as it is; a digest of anything else."""
    if value is None or isinstance(value, int | float | str):
        return value
    with np.printoptions(threshold=sys.maxsize):
        return hashlib.sha256(repr(value).encode()).hexdigest()[:8]


def display_name(part: object) -> str:
    """An object in one line, ``SVC(C=10)``, or the steps of a pipeline, separated by ``>``."""
    if isinstance(part, Pipeline):
        return " > ".join(display_name(step) for _, step in part.steps)
    return " ".join(repr(part).split()) if isinstance(part, BaseEstimator) else type(part).__name__


def own_code(part: object) -> list[Callable]:
    """Classes and functions of an object and its parts that no installed library has."""
    code = [
        each
        for each in _classes_inside(part)
        if not _distribution_of(each)
        and each.__module__.split(".")[0] not in sys.stdlib_module_names
    ]
    return sorted(code, key=lambda each: (each.__module__, each.__qualname__))


def distributions(part: object) -> tuple[str, ...]:
    """Names of the installed distributions that the classes of an object come from."""
    names = {_distribution_of(each) for each in _classes_inside(part)}
    return tuple(sorted(name for name in names if name))


def _classes_inside(part: object) -> set[Callable]:
    """The functions and classes inside an object, and the classes of the objects inside it."""
    return {each if is_code(each) else type(each) for each in parts_of(part)}


def _distribution_of(code: Any) -> str | None:
    """Installed distribution of a class; None for touchbench's and the user's."""
    name = code.__module__.split(".")[0]
    if name in ("bench", "__main__") or name not in sys.modules:
        return None
    name = {"sklearn": "scikit-learn"}.get(name, name)
    try:
        version(name)
    except PackageNotFoundError:
        return None
    return name
