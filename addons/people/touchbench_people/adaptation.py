"""Adaptation of fitted systems to one person, from some captures of this person.

The given system does not change. A user's own system has a method ``adapt(X, y)``, which returns
the adapted system; ``y`` is None without labels. Each built-in system that can adapt has a function
here.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy, deepcopy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline
from sklearn.utils.validation import check_is_fitted

from bench import contract
from bench.errors import InputError
from bench.features.base import capture_of_rows
from bench.models.classic.row_summaries import weighted_scatter
from bench.models.quantised import quantise_pipeline
from bench.models.recipe import Recipe, apply_steps
from touchbench_people.last_layer import relearn_layer, relearn_network

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.models.classic.lda import Discriminants
    from bench.models.classic.perceptron import Perceptron
    from bench.models.classic.row_summaries import TrainingStatistics
    from bench.models.nets.window import WindowNet
    from bench.models.out_of_distribution import GuardedDiscriminants
    from bench.models.reflex import Reflex

SHOT_WEIGHT = 10  # of a row of the person, relative to one of training; docs/notes/numbers.md
PRIOR_CAPTURES = 5.0  # weight of the training mean, in captures of the person
ADAPT_METHOD = contract.Method("adapt", ("X", "y"), lambda X, y: None)


def can_adapt(system: Any) -> bool:
    """Return True if a system, fitted or not, can adapt.

    Of weights in few bits, only those can that have kept what they were computed from.
    """
    if ADAPT_METHOD.find_method(system):
        return True
    if isinstance(system, Pipeline):
        return can_adapt(system.steps[-1][1])
    adapter = _find_adapter(system)
    if adapter is adapt_recipe:
        return can_adapt(system.system)
    if adapter is adapt_network and getattr(system, "bits", 32) != 32:
        return False
    return adapter is not None


def adapt_system(system: Any, X: Corpus | pd.DataFrame, y: np.ndarray | None) -> Any:
    """Adapt a fitted system to one person.

    Args:
        system: fitted; a part of a pipeline is given features.
        X: captures of the person, or their features.
        y: class names; None if unlabelled.
    """
    X = contract.blind_captures(system, X) if y is None else X
    if ADAPT_METHOD.find_method(system):
        # A system that changes itself would carry the captures into other tests.
        return deepcopy(system).adapt(X, y)
    if isinstance(system, Pipeline):
        *before, (name, last) = system.steps
        table = Pipeline(before).transform(X) if before else X
        return Pipeline([*before, (name, adapt_system(last, table, y))])
    adapter = _find_adapter(system)
    if adapter is None:
        raise InputError(f"{type(system).__name__} cannot adapt to a person")
    return adapter(system, X, y)


def adapt_recipe(recipe: Recipe, X: Corpus, y: np.ndarray | None) -> Recipe:
    """Adapt the system inside to captures after the steps; its weights keep their bits."""
    pieces, row = apply_steps(X, recipe.prediction_steps())
    labels = None if y is None else np.asarray(y)[row]
    adapted = copy(recipe)
    system = adapt_system(recipe.system_, pieces, labels)
    adapted.system_ = system if recipe.bits == 32 else quantise_pipeline(system, recipe.bits)
    return adapted


def adapt_reflex(reflex: Reflex, X: Corpus, y: np.ndarray | None) -> Reflex:
    """Adapt both discriminants and, with labels, the last layer of the network."""
    adapted = copy(reflex)
    adapted.whole_ = adapt_system(reflex.whole_, X, y)
    adapted.early_ = adapt_system(reflex.early_, X, y)
    return adapted


def adapt_discriminants(
    general: Discriminants,
    X: pd.DataFrame | np.ndarray,
    y: np.ndarray | None,
    weight: float = float(SHOT_WEIGHT),
) -> Discriminants:
    """Move the mean to that of the person; with labels, also learn the person's rows.

    The training mean moves towards that of the person's rows by `mean_weight`. If labelled captures
    are not spread equally over the classes, class means are removed from the rows first. Labelled
    rows then join those of training with a weight, in closed form from the learned statistics.

    Args:
        general: fitted; it does not change.
        X: features [rows, n_features] of some captures of the person.
        y: class names [rows], all from training; None if unlabelled.
        weight: weight of a labelled row relative to one of training.
    """
    adapted = copy(general)
    old = general.learnt_
    Z = (np.asarray(X, dtype=np.float64) - old.mean) / old.sd
    captures = capture_of_rows(X)
    codes = None if y is None else class_codes(y, general.classes_)
    own_weight, is_unbalanced = mean_weight(captures, codes, len(general.classes_))
    shift = own_weight * (Z - old.class_means[codes] if is_unbalanced else Z).mean(axis=0)
    total = old.weights.sum()
    sd = np.where(np.isfinite(old.sd), old.sd, 0)
    adapted.learnt_ = replace(old, mean=old.mean + sd * shift)
    if codes is not None:
        weights = np.full(len(Z), weight)
        adapted.learnt_ = _join_rows(adapted, Z - shift, codes, captures, weights)
        total += weight * len(Z)
    adapted.solve_coefficients(total)
    return adapted


def _join_rows(
    linear: Discriminants,
    Z: np.ndarray,
    codes: np.ndarray,
    captures: np.ndarray,
    weight: np.ndarray,
) -> TrainingStatistics:
    """Statistics of the training rows and of more rows together."""
    old = linear.learnt_
    new_weights = np.bincount(codes, weight, len(linear.classes_))
    means = np.zeros_like(old.class_means)
    np.add.at(means, codes, Z * weight[:, None])
    means /= np.where(new_weights > 0, new_weights, 1)[:, None]
    total = old.weights + new_weights
    between_weight = np.sqrt(linear.windows_ * old.weights * new_weights / total)[:, None]
    between = between_weight * (means - old.class_means)
    within = weighted_scatter(Z - means[codes], captures, weight, linear.windows_)
    scatter = old.scatter + within + between.T @ between
    summed = old.weights[:, None] * old.class_means + new_weights[:, None] * means
    return replace(old, class_means=summed / total[:, None], weights=total, scatter=scatter)


def adapt_guarded(
    general: GuardedDiscriminants, X: pd.DataFrame, y: np.ndarray | None
) -> GuardedDiscriminants:
    """Adapt the discriminants and the network, and move the usual range with the mean."""
    adapted = copy(general)
    adapted.linear_ = adapt_discriminants(general.linear_, X, y)
    shift = (adapted.linear_.learnt_.mean - general.linear_.learnt_.mean).astype(np.float32)
    adapted.mean_ = general.mean_ + shift
    network = copy(general.robust_)
    network.mean_ = network.mean_ + shift
    adapted.robust_ = adapt_perceptron(network, X, y)
    return adapted


def adapt_perceptron(
    general: Perceptron, X: pd.DataFrame | np.ndarray, y: np.ndarray | None
) -> Perceptron:
    """Train the last layer with the person's captures; without labels nothing changes."""
    if y is None:
        return general
    adapted = copy(general)
    old = np.column_stack([general.coefs_[1].T, general.intercepts_[1]])
    codes, hidden = class_codes(y, general.classes_), general.hidden_activations(X)
    new = relearn_layer(old, hidden, codes, capture_of_rows(X)).astype(np.float32)
    adapted.coefs_ = [general.coefs_[0], new[:, :-1].T.copy()]
    adapted.intercepts_ = [general.intercepts_[0], new[:, -1]]
    return adapted


def adapt_network(general: WindowNet, X: Corpus, y: np.ndarray | None) -> WindowNet:
    """Train the last layer with the person's captures; without labels nothing changes."""
    check_is_fitted(general, "net_")
    if y is None:
        return general
    adapted = copy(general)
    codes = class_codes(np.asarray(y), general.classes_)
    adapted.net_ = relearn_network(general, general.samples(X), codes)
    return adapted


# By name of the class, so that none is imported; the first in the order of inheritance counts.
ADAPTERS: dict[str, Callable | None] = {
    "bench.models.adapters.FromTorch": None,  # a module may end in any layer
    "bench.models.classic.lda.Discriminants": adapt_discriminants,
    "bench.models.classic.perceptron.Perceptron": adapt_perceptron,
    "bench.models.nets.window.WindowNet": adapt_network,
    "bench.models.out_of_distribution.GuardedDiscriminants": adapt_guarded,
    "bench.models.recipe.Recipe": adapt_recipe,
    "bench.models.reflex.Reflex": adapt_reflex,
}


def _find_adapter(system: object) -> Callable | None:
    names = [f"{kind.__module__}.{kind.__qualname__}" for kind in type(system).__mro__]
    return next((ADAPTERS[name] for name in names if name in ADAPTERS), None)


def mean_weight(captures: np.ndarray, codes: np.ndarray | None, classes: int) -> tuple[float, bool]:
    """Weight of the person's own mean, 0 to 1, and True if class means must be removed first.

    With equally many labelled captures of each class the weight is 1. Otherwise n captures have n /
    (n + 5), as few captures may be of few classes.

    Args:
        captures: capture of each row, numbered from 0.
        codes: class of each row; None if unknown.
        classes: number of classes.
    """
    count = captures.max() + 1
    if codes is None:
        return count / (count + PRIOR_CAPTURES), False
    per_class = np.bincount(codes[np.unique(captures, return_index=True)[1]], minlength=classes)
    if (per_class == per_class[0]).all():
        return 1.0, False
    return count / (count + PRIOR_CAPTURES), True


def class_codes(y: np.ndarray, classes: np.ndarray) -> np.ndarray:
    """Positions of class names.

    Raises:
        InputError: a class is unknown.
    """
    if not np.isin(y, classes).all():
        unknown = sorted(set(map(str, y)) - set(map(str, classes)))
        raise InputError(f"{unknown[0]!r} is not a class of the trained system")
    return np.searchsorted(classes, y)
