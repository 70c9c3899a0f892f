"""The whole interface between harness and systems, built-in ones and others alike.

A system is a scikit-learn classifier whose ``X`` is a `Corpus`; ``fit``, ``predict`` and
``classes_`` are all it needs. Its *factory*, a class or a function, makes it; keyword arguments of
the factory are its parameters. An argument without a default receives the feature set. If a factory
returns a plain scikit-learn, XGBoost, LightGBM or CatBoost estimator, this becomes the last step of
a pipeline after the feature set.

A system may offer further attributes and methods. Each has a function here, which returns its value
or result, or the default for a system without it. Nothing else is looked up by name.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import FunctionType
from typing import Any, Generic, Protocol, TypeGuard, TypeVar

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, clone
from sklearn.pipeline import Pipeline

from bench.corpora.corpus import Corpus
from bench.errors import InputError, PredictionError, suggest_names
from bench.features.base import FeatureSet
from bench.ground.registry import required_parameters
from bench.models.space import Space

# Probabilities of a capture may miss a sum of 1 by this much: they may be float32, or rounded text.
SUM_TOLERANCE = 1e-3
# Packages whose estimators learn from tables
TABLE_PACKAGES = {"sklearn", "xgboost", "lightgbm", "catboost", "imblearn"}
STARRED = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
Value = TypeVar("Value")
Estimator = TypeVar("Estimator", bound="System")


class System(Protocol):
    """The required interface of a system."""

    classes_: np.ndarray

    def fit(self, X: Corpus, y: np.ndarray) -> object:
        """Learn from captures and their class names; what it returns is not used."""

    def predict(self, X: Corpus) -> np.ndarray:
        """Class name of each capture."""


class Features(Protocol):
    """The required interface of a feature set: a transformer from captures to a table."""

    def fit(self, X: Corpus, y: np.ndarray) -> Features:
        """Learn from captures and their class names, if there is anything to learn."""

    def transform(self, X: Corpus) -> pd.DataFrame:
        """Features of each capture [captures, features]."""

    def fit_transform(self, X: Corpus, y: np.ndarray) -> pd.DataFrame:
        """Fit, then transform the same captures."""


@dataclass(frozen=True)
class Method(Generic[Value]):
    """A method that a system or feature set may have, and what happens without it.

    A method counts if its name and the names of its parameters agree; further parameters need a
    default. Anything else of this name is the author's own: a number, a set, or another method.
    """

    name: str
    parameters: tuple[str, ...]
    default: Callable[..., Value]

    def __call__(self, part: object, *values: object) -> Value:
        """Call the method of a part, or the default."""
        return (self.find_method(part) or self.default)(*values)

    def find_method(self, part: object) -> Callable[..., Value] | None:
        """The method of a part; None for a part without it."""
        method = getattr(part, self.name, None)
        if not callable(method):
            return None
        try:
            parameters = [*inspect.signature(method).parameters.values()]
        except (TypeError, ValueError):  # a callable without a signature
            return None
        count = len(self.parameters)
        if tuple(p.name for p in parameters[:count]) != self.parameters:
            return None
        further = parameters[count:]
        return (
            method if all(p.default is not p.empty or p.kind in STARRED for p in further) else None
        )


# Attributes of a factory


def packages(factory: Callable) -> tuple[str, ...]:
    """``packages``: distributions that this system alone needs; their versions identify a run."""
    return getattr(factory, "packages", ())


def search_space(factory: Callable) -> Space | None:
    """``space``: values of each parameter that `bench tune` searches if it is given no lists."""
    return getattr(factory, "space", None)


# Attributes of a system


def searches_itself(estimator: System) -> bool:
    """``searches``: True if it tunes itself; `bench tune` refuses it."""
    return getattr(estimator, "searches", False)


def trained_faults(estimator: System) -> tuple[str, ...]:
    """``trained_faults``: names of the faults in copies of its training captures."""
    return getattr(estimator, "trained_faults", ())


# Attributes of a fitted system


def search_seconds(estimator: System) -> float | None:
    """``search_seconds_``: duration of its search, including parts that were stored before."""
    return getattr(estimator, "search_seconds_", None)


def history(estimator: System) -> list[dict[str, float]]:
    """``history_``: numbers by epoch, tracked as metrics with steps."""
    return getattr(estimator, "history_", [])


def chosen_values(estimator: System) -> dict[str, object]:
    """``chosen_``: parameters that it chose on its training part, by name."""
    part = estimator.steps[-1][1] if isinstance(estimator, Pipeline) else estimator
    return getattr(part, "chosen_", {})


def trials(estimator: System) -> pd.DataFrame | None:
    """``trials_``: a row for each candidate of its search."""
    return getattr(estimator, "trials_", None)


def members(estimator: System) -> list[System]:
    """``members``: fitted systems whose predictions it combines."""
    return getattr(estimator, "members", [])


def learnt_numbers(part: object) -> int | None:
    """``parameters_``: how many numbers it learnt; None if `bench.models.sizes` counts them."""
    return getattr(part, "parameters_", None)


def constants(part: object) -> int:
    """``constants_``: how many numbers it must store besides those that it learnt."""
    return getattr(part, "constants_", 0)


def bytes_saved(part: object) -> int:
    """``bytes_saved_``: bytes below four for each number, of a part with weights of fewer bits."""
    return getattr(part, "bytes_saved_", 0)


def numbers_in_memory(part: object) -> int | None:
    """``activations_``: numbers in memory during one prediction.

    Those of a classifier on features do not include the features and the scores.
    """
    return getattr(part, "activations_", None)


def learns(feature_set: object) -> bool:
    """``learns``: False if the values of a feature set do not depend on training captures."""
    return getattr(feature_set, "learns", True)


# Before a run


check_parameters: Method[None] = Method("check", (), lambda: None)
"""Raises an `InputError` for invalid parameters of a system or a feature set."""
check_training: Method[None] = Method("check_training", ("X", "y"), lambda X, y: None)
"""Raises an `InputError` for training captures from which it cannot learn."""
input_of_features: Method[list[Corpus]] = Method("seen", ("X",), lambda X: [X])
"""What its feature sets receive in training and prediction; by default the captures."""
memory_before: Method[int] = Method("keeps_before", ("taxels",), lambda taxels: 0)
"""Numbers in memory for the steps before the system."""
memory_of_features: Method[int] = Method(
    "keeps", ("frames", "taxels"), lambda frames, taxels: frames * taxels
)
"""Numbers in memory while a feature set is computed; by default the capture."""
FIT_TOGETHER_METHOD: Method[Any] = Method("fit_together", ("systems", "parts"), lambda *_: None)
LENGTH_METHOD: Method[Any] = Method("length", ("rate_hz",), lambda rate_hz: None)
DECIDE_METHOD: Method[Any] = Method("decide", ("X",), lambda X: None)


def window_frames(estimator: System, rate_hz: float) -> int | None:
    """``length(rate_hz)``, or parameter ``frames``: frames of a window; None without windows."""
    if length := LENGTH_METHOD.find_method(estimator):
        try:
            frames = length(rate_hz)
        except InputError:
            raise
        except Exception as e:  # a system of the user's may raise anything
            raise InputError(
                f"length({rate_hz:g}) of the system raises {type(e).__name__}: {e}"
            ) from e
        if not isinstance(frames, int | np.integer | None):
            raise InputError(
                f"length({rate_hz:g}) of the system gives {frames!r}; give a number of frames, or "
                "None"
            )
        return None if frames is None else int(frames)
    if not isinstance(estimator, BaseEstimator):
        return None
    frames = estimator.get_params(deep=False).get("frames")
    return frames if isinstance(frames, int) else None


def frames_at_once(estimator: System, frames: int) -> int:
    """``window_``: how many frames of a capture a fitted system needs at once; by default all."""
    return min(frames, getattr(estimator, "window_", None) or frames)


def feature_sets(estimator: System) -> dict[str, Features]:
    """Feature sets of a system: the step ``features`` of a pipeline, or the attribute of a search.

    In a pipeline without such a step, it is the first step if that is a built-in feature set.
    """
    if isinstance(estimator, Pipeline):
        first = estimator.steps[0][1]
        default = first if isinstance(first, FeatureSet) else None
        step = estimator.named_steps.get("features", default)
        return {type(step).__name__.lower(): step} if isinstance(step, BaseEstimator) else {}
    sets = getattr(estimator, "features", None)
    return dict(sets) if isinstance(sets, dict) else {}


def required_conditions(estimator: System) -> tuple[str, ...]:
    """``conditions``: columns of captures that it, or a part of it, needs to predict.

    An example is the substrate under the skin, if a robot knows it. Runs are tagged with them.

    Raises:
        InputError: they are given as text.
    """
    names = set()
    for part in parts_of(estimator):
        if isinstance(declared := getattr(part, "conditions", ()), str):
            raise InputError(
                f"conditions = {declared!r}: give a tuple of names, such as ({declared!r},)"
            )
        names |= {*declared}
    return tuple(sorted(names))


def check_conditions(estimator: System, corpus: Corpus) -> None:
    """Refuse conditions of a system that are missing, or that reveal the class or the subject."""
    secret = {"subject", "gesture", *corpus.target.split("+")}
    for name in required_conditions(estimator):
        if name in secret:
            raise InputError(
                f"conditions: the system declares {name!r}, which a prediction must not use; "
                "remove it"
            )
        if name not in corpus.captures:
            others = [str(column) for column in corpus.captures if column not in secret]
            raise InputError(
                f"conditions: {corpus.name} has no column {name!r}; {suggest_names(name, others)}"
            )
        values = corpus.captures[name]
        for secret_name, labels in (("class", corpus.gestures), ("subject", corpus.subjects)):
            labels_by_value = pd.Series(labels).groupby(values.to_numpy(), dropna=False)
            if values.nunique() > 1 and labels_by_value.nunique().max() == 1:
                raise InputError(
                    f"conditions: each value of {name!r} has one {secret_name}, so it tells the "
                    f"{secret_name}; remove it"
                )


def blind_captures(estimator: System, X: Any) -> Any:
    """Hide from a system what it must not see in prediction (`Corpus.blind`); a table stays."""
    if not isinstance(X, Corpus) or X.is_blind:
        return X
    return X.blind(required_conditions(estimator))


# Decisions of a fitted system


def decides_often(estimator: System) -> bool:
    """Return True if it has ``decide``, and so may decide more than once per capture."""
    return DECIDE_METHOD.find_method(estimator) is not None


def abstention_label(estimator: System) -> str | None:
    """``abstains``: its label for captures without a class; None if it always predicts one.

    The probabilities of such a capture are a row of NaN.
    """
    for system in (estimator, inner_system(estimator)):
        for part in parts_of(system):
            if isinstance(label := getattr(part, "abstains", None), str):
                return label
    return None


def predict_decisions(estimator: System, X: Corpus) -> tuple[pd.DataFrame, np.ndarray]:
    """``decide(X)``: every decision that it makes; by default one per capture, on all frames.

    Returns:
        A table with ``capture`` (position in X), ``start`` and ``frames`` (first frame and frames
        seen), and probabilities [decisions, classes], zeros if it abstains.

    Raises:
        PredictionError: a label is no class, or probabilities are invalid.
    """
    X = blind_captures(estimator, X)
    if method := DECIDE_METHOD.find_method(estimator):
        table, proba = method(X)
        return table, check_probabilities(estimator, proba, len(table), "decide")
    table = pd.DataFrame({"capture": np.arange(len(X)), "start": 0, "frames": X.lengths})
    return table, predict_probabilities(estimator, X)


def has_probabilities(estimator: System) -> bool:
    """Return True if it has ``predict_proba``."""
    return getattr(estimator, "predict_proba", None) is not None


def predict_probabilities(estimator: System, X: Corpus) -> np.ndarray:
    """``predict_proba(X)`` [captures, classes], zeros if it abstains; or 1 for its label."""
    X = blind_captures(estimator, X)
    if has_probabilities(estimator):
        proba = estimator.predict_proba(X)  # type: ignore[attr-defined]
        return check_probabilities(estimator, proba, len(X), "predict_proba")
    return predict_labels(estimator, X)[:, None] == np.asarray(estimator.classes_).astype(str)


def predict_labels(estimator: System, X: Corpus) -> np.ndarray:
    """``predict(X)``: the label of each capture as text, a class or its `abstention_label`.

    Raises:
        PredictionError: a label is missing, or is neither.
    """
    predicted = estimator.predict(blind_captures(estimator, X))
    labels = np.asarray(predicted, dtype=object)
    is_column = isinstance(predicted, np.ndarray) and labels.shape == (len(X), 1)  # of CatBoost
    if labels.ndim > 1 and not is_column:
        raise PredictionError(
            f"predict gives labels of shape {labels.shape} for {len(X)} captures; "
            "give one list of labels, not lists in it"
        )
    labels = labels.ravel()
    if len(labels) != len(X):
        raise PredictionError(
            f"predict gives {len(labels)} labels for {len(X)} captures; give one each"
        )
    is_unknown = ~np.isin(labels, np.asarray(estimator.classes_, dtype=object))
    if is_unknown.any() and (label := abstention_label(estimator)) is not None:
        is_unknown &= labels != label
    if is_unknown.any():
        advice = (
            "a system that abstains declares the label that it then gives, such as "
            "abstains = 'unknown'"
        )
        if isinstance(label := labels[is_unknown.argmax()], int | np.integer):
            advice = "give names: self.classes_[numbers]"
        raise PredictionError(
            f"predict gives {label!r}, which is not one of the trained gestures; {advice}"
        )
    return labels.astype(str)


def check_probabilities(estimator: System, proba: Any, rows: int, method: str) -> np.ndarray:
    """Return the probabilities [rows, classes] of a method, zeros for an abstention's row of NaN.

    Raises:
        PredictionError: they are no probabilities; the message says what to do.
    """
    proba = np.asarray(proba)
    if proba.shape != (shape := (rows, len(estimator.classes_))):
        raise PredictionError(
            f"{method} gives probabilities of shape {proba.shape} for {shape} decisions and "
            "classes_"
        )
    total = proba.sum(axis=1)
    is_valid = (proba.min(axis=1) >= -SUM_TOLERANCE) & (np.abs(total - 1) <= SUM_TOLERANCE)
    if is_valid.all():
        return proba
    if abstention_label(estimator) is not None:  # a capture with some abstentions sums to less
        proba = np.where(np.isnan(proba).all(axis=1, keepdims=True), 0, proba)
        total = proba.sum(axis=1)
        is_valid = (proba.min(axis=1) >= -SUM_TOLERANCE) & (total <= 1 + SUM_TOLERANCE)
    if is_valid.all():
        return proba
    if not np.isfinite(proba[~is_valid]).all():
        raise PredictionError(
            f"{method} gives {int((~np.isfinite(proba)).sum())} probabilities that are not "
            "finite; a system that abstains by a row of NaN declares its label for that, such as "
            "abstains = 'unknown'"
        )
    row = int(is_valid.argmin())
    raise PredictionError(
        f"{method} gives values from {proba[row].min():.3g} to {proba[row].max():.3g} with a sum "
        f"of {total[row]:.3g}, not probabilities; convert scores with "
        f"scipy.special.softmax(scores, axis=1), or leave {method} out"
    )


# Fit a system, and what happened meanwhile


def check_methods(name: str, estimator: System) -> None:
    """Refuse a model without ``fit(X, y)`` and ``predict(X)``."""
    for method, arguments in (("fit", ("X", "y")), ("predict", ("X",))):
        words = f"{method}({', '.join(arguments)})"
        if not callable(call := getattr(estimator, method, None)):
            raise InputError(f"model={name}: it has no {words}; write one")
        try:
            inspect.signature(call).bind(*arguments)
        except TypeError as e:
            raise InputError(f"model={name}: {method} cannot be called as {words}: {e}") from e
        except ValueError:  # it has no signature
            continue


def check_sklearn_values(name: str, estimator: System) -> None:
    """Refuse parameter values that an estimator of scikit-learn inside a system would refuse."""
    for part in parts_of(estimator):
        if hasattr(part, "_validate_params") and hasattr(part, "_parameter_constraints"):
            try:
                part._validate_params()
            except ValueError as e:
                raise InputError(f"model={name}: {e}") from e


def fit_system(estimator: Estimator, X: Corpus, y: np.ndarray) -> Estimator:
    """Fit a system, whatever its ``fit`` returns, and check its ``classes_``; return it.

    Raises:
        PredictionError: ``classes_`` is missing, or has another name than training.
    """
    estimator.fit(X, y)
    advice = "write self.classes_ = np.unique(y) in fit"
    if (classes := getattr(estimator, "classes_", None)) is None:
        raise PredictionError(f"fit sets no classes_; {advice}")
    known = set(y)
    if unknown := [name for name in np.asarray(classes, dtype=object) if name not in known]:
        raise PredictionError(
            f"classes_ has {unknown[0]!r}, which is no class of training, such as {y[0]!r}; "
            f"{advice}"
        )
    return estimator


def trains_together(estimator: System) -> bool:
    """``trains_together``: True if several of it are fitted at once in less time."""
    return getattr(estimator, "trains_together", False)


def fit_together(systems: Sequence[System], parts: Sequence[Corpus]) -> list[Exception | None]:
    """``fit_together(systems, parts)``: fit each to captures of its own; return why each failed."""
    return FIT_TOGETHER_METHOD(systems[0], systems, parts)


def reported_fit_seconds(estimator: System, wall: float, cpu: float) -> tuple[float, float]:
    """``fit_seconds_``: (wall, CPU) seconds of the last fit, or the wall alone; else the given."""
    seconds = getattr(estimator, "fit_seconds_", (wall, cpu))
    return (seconds, cpu) if isinstance(seconds, int | float) else seconds


def inner_system(estimator: System) -> System:
    """``best_``: the fitted system inside a search; by default itself."""
    return getattr(estimator, "best_", estimator)


# From a factory or an object to a system


def build_system(factory: Callable, feature_set: Features | None, **parameters: object) -> System:
    """Make a system by its factory, with the feature set if it takes one."""
    names = required_parameters(factory)
    if names and feature_set is not None:
        return factory(**{names[0]: feature_set}, **parameters)
    return as_pipeline(factory(**parameters), feature_set)


def as_pipeline(estimator: System, feature_set: Features | None) -> System:
    """Put an estimator that learns from tables after a feature set; any other stays."""
    if feature_set is None or not reads_tables(estimator):
        return estimator
    return Pipeline([("features", feature_set), ("classifier", estimator)])


def reads_tables(system: object) -> bool:
    """Return True if an estimator, class or factory without required arguments reads tables.

    The first step of a pipeline, all members of a union or an ensemble, and the estimator of a
    search decide. An own class reads tables if it is derived from one that does.

    Raises:
        InputError: the factory fails.
    """
    if inspect.isclass(system):
        return not issubclass(system, Pipeline) and _is_tabular(system)
    if not isinstance(system, BaseEstimator) and callable(system):
        try:
            system = system()
        except InputError:
            raise
        except Exception as e:  # a factory of the user's may raise anything
            name, reason = getattr(system, "__name__", type(system).__name__), type(e).__name__
            raise InputError(f"model={name}: it cannot be made: {reason}: {e}") from e
    if isinstance(system, Pipeline):
        return reads_tables(system.steps[0][1])
    values = system.get_params(deep=False) if isinstance(system, BaseEstimator) else {}
    parts = [values.get("estimator")]
    for key in ("transformer_list", "estimators", "transformers"):
        parts += [member[1] for member in values.get(key) or []]
    inner = (part for part in parts if isinstance(part, BaseEstimator))
    return _is_tabular(type(system)) and all(map(reads_tables, inner))


def _is_tabular(kind: type) -> bool:
    """Test if a class, or one of its bases, is from a package whose estimators read tables."""
    modules = [base.__module__ for base in kind.__mro__]
    modules = [m for m in modules if not m.startswith(("sklearn.base", "sklearn.utils"))]
    return any(module.split(".")[0] in TABLE_PACKAGES for module in modules)


def untrained_copy(part: Value) -> Value:
    """Copy an estimator without what it learnt; a splitter is returned itself."""
    return clone(part) if isinstance(part, BaseEstimator) else part


def parts_of(part: object) -> Iterator[object]:
    """Yield an object, and the estimators, classes and functions among its parameters."""
    yield part
    values = part.get_params().values() if isinstance(part, BaseEstimator) else ()
    yield from (value for value in values if isinstance(value, BaseEstimator) or is_code(value))


def is_code(value: object) -> TypeGuard[type | FunctionType]:
    """Return True for a class or a function, which a key identifies by name and source."""
    return inspect.isclass(value) or inspect.isfunction(value)
