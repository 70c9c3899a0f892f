"""Adaptation makes a fitted system for one person, from some captures of this person; the given system does not change.

A user's own system has a method ``adapt(X, y)``, which returns the adapted system; y is None without labels. Here is a
function for each system of touchbench that can adapt.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy, deepcopy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.optimize import minimize
from scipy.special import log_softmax, softmax
from sklearn.pipeline import Pipeline
from sklearn.utils.validation import check_is_fitted

from bench import contract
from bench.errors import InputError
from bench.features.base import capture_of_rows
from bench.models.recipe import Recipe, apply_steps

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.models.classic.lda import Discriminants, TrainingStatistics
    from bench.models.classic.perceptron import Perceptron
    from bench.models.nets.window import WindowNet
    from bench.models.out_of_distribution import GuardedDiscriminants
    from bench.models.reflex import Reflex

WEIGHT = 10  # of a row of the person beside one of training; docs/notes/numbers.md
PRIOR = 5.0  # weight of the mean of training beside the captures of a person, in captures
STIFF = 0.3  # of a network's last layer
ROUNDS = 200  # at most, until it has learnt
OWN = contract.Method("adapt", ("X", "y"), lambda X, y: None)


def adapts(system: Any) -> bool:
    """Whether a system, fitted or not, adapts to a person; one with weights in few bits does not."""
    if OWN.find_method(system):
        return True
    if isinstance(system, Pipeline):
        return adapts(system.steps[-1][1])
    if getattr(system, "bits", 32) != 32:
        return False
    return adapts(system.system) if isinstance(system, Recipe) else _way_of(system) is not None


def adapted(system: Any, X: Corpus | pd.DataFrame, y: np.ndarray | None) -> Any:
    """A fitted system that `adapts`, for one person.

    Args:
        system: fitted; a part of a pipeline is given features.
        X: captures of the person, or their features.
        y: class names; None if unlabelled.
    """
    X = contract.blind_captures(system, X) if y is None else X
    if OWN.find_method(system):
        return deepcopy(system).adapt(
            X, y
        )  # one that changes itself would carry the captures into other tests
    if isinstance(system, Pipeline):
        *before, (name, last) = system.steps
        table = Pipeline(before).transform(X) if before else X
        return Pipeline([*before, (name, adapted(last, table, y))])
    way = _way_of(system)
    if way is None:
        raise InputError(f"{type(system).__name__} does not adapt to a person")
    return way(system, X, y)


def behind_steps(recipe: Recipe, X: Corpus, y: np.ndarray | None) -> Recipe:
    """The system inside adapts to captures after the steps."""
    seen, row = apply_steps(X, recipe.steps())
    mine = copy(recipe)
    mine.system_ = adapted(recipe.system_, seen, None if y is None else np.asarray(y)[row])
    return mine


def both_windows(reflex: Reflex, X: Corpus, y: np.ndarray | None) -> Reflex:
    """Both discriminants learn what has labels, and so does the last layer of the network."""
    mine = copy(reflex)
    mine.whole_, mine.early_ = adapted(reflex.whole_, X, y), adapted(reflex.early_, X, y)
    return mine


def discriminants(
    general: Discriminants,
    X: pd.DataFrame | np.ndarray,
    y: np.ndarray | None,
    weight: float = float(WEIGHT),
) -> Discriminants:
    """Features are measured from the person's own mean, and with labels their captures are learnt, too.

    The mean of the person's rows takes the place of that of training, as far as `share` goes; where captures with
    labels are not of all classes alike, rows are measured from their classes for that. Rows with labels then join those
    of training with a weight, in closed form: the statistics that were learnt are all that is needed.

    Args:
        general: fitted.
        X: features [rows, n_features] of some captures of the person.
        y: class names [rows], all from training; None if unlabelled.
        weight: weight of a labelled row relative to one of training.
    """
    mine = copy(general)
    old = general.learnt_
    Z = (np.asarray(X, dtype=np.float64) - old.mean) / old.sd
    captures = capture_of_rows(X)
    codes = None if y is None else codes_of(y, general.classes_)
    believed, apart = share(captures, codes, len(general.classes_))
    shift = believed * (Z - old.class_means[codes] if apart else Z).mean(axis=0)
    total = old.weights.sum()
    mine.learnt_ = replace(old, mean=old.mean + np.where(np.isfinite(old.sd), old.sd, 0) * shift)
    if codes is not None:
        mine.learnt_ = _joined(mine, Z - shift, codes, captures, np.full(len(Z), weight))
        total += weight * len(Z)
    mine.solve_coefficients(total)
    return mine


def _joined(
    linear: Discriminants,
    Z: np.ndarray,
    codes: np.ndarray,
    captures: np.ndarray,
    weight: np.ndarray,
) -> TrainingStatistics:
    """What was learnt, and more rows."""
    old = linear.learnt_
    heavy = np.bincount(codes, weight, len(linear.classes_))
    centres = np.zeros_like(old.class_means)
    np.add.at(centres, codes, Z * weight[:, None])
    centres /= np.where(heavy > 0, heavy, 1)[:, None]
    both = old.weights + heavy
    apart = np.sqrt(linear.windows * old.weights * heavy / both)[:, None] * (
        centres - old.class_means
    )
    scatter = (
        old.scatter
        + linear.weighted_scatter(Z - centres[codes], captures, weight)
        + apart.T @ apart
    )
    mixed = (old.weights[:, None] * old.class_means + heavy[:, None] * centres) / both[:, None]
    return replace(old, class_means=mixed, weights=both, scatter=scatter)


def guarded(
    general: GuardedDiscriminants, X: pd.DataFrame, y: np.ndarray | None
) -> GuardedDiscriminants:
    """As `discriminants`; the usual range moves with their mean, and so does the network, whose last layer learns."""
    mine = copy(general)
    mine.linear_ = discriminants(general.linear_, X, y)
    moved = (mine.linear_.learnt_.mean - general.linear_.learnt_.mean).astype(np.float32)
    mine.mean_ = general.mean_ + moved
    network = copy(general.robust_)
    network.mean_ = network.mean_ + moved
    mine.robust_ = perceptron(network, X, y)
    return mine


def perceptron(
    general: Perceptron, X: pd.DataFrame | np.ndarray, y: np.ndarray | None
) -> Perceptron:
    """The last layer learns the person's captures; without labels nothing changes."""
    if y is None:
        return general
    mine = copy(general)
    old = np.column_stack([general.coefs_[1].T, general.intercepts_[1]])
    new = relearnt(
        old, general.hidden_activations(X), codes_of(y, general.classes_), capture_of_rows(X)
    ).astype(np.float32)
    mine.coefs_ = [general.coefs_[0], new[:, :-1].T.copy()]
    mine.intercepts_ = [general.intercepts_[0], new[:, -1]]
    return mine


def network(general: WindowNet, X: Corpus, y: np.ndarray | None) -> WindowNet:
    """The last layer learns the person's captures; without labels nothing changes."""
    from touchbench_people.last_layer import relearnt as in_network

    check_is_fitted(general, "net_")
    if y is None:
        return general
    mine = copy(general)
    codes = codes_of(np.asarray(y), general.classes_)
    mine.net_ = in_network(
        general.net_, general.samples(X), codes, general.batch, general.compute_logits
    )
    return mine


WAYS: dict[
    str, Callable | None
] = {  # by class, so that none is imported; the first in the order of inheritance counts
    "bench.models.adapters.FromTorch": None,  # a module may end in anything
    "bench.models.classic.lda.Discriminants": discriminants,
    "bench.models.classic.perceptron.Perceptron": perceptron,
    "bench.models.nets.window.WindowNet": network,
    "bench.models.out_of_distribution.GuardedDiscriminants": guarded,
    "bench.models.recipe.Recipe": behind_steps,
    "bench.models.reflex.Reflex": both_windows,
}


def _way_of(system: object) -> Callable | None:
    found = (f"{kind.__module__}.{kind.__qualname__}" for kind in type(system).__mro__)
    return next((WAYS[name] for name in found if name in WAYS), None)


def share(captures: np.ndarray, codes: np.ndarray | None, classes: int) -> tuple[float, bool]:
    """Weight of the person's own mean, 0 to 1, and True if class means must be removed from it first.

    With as many labelled captures of each class it is the whole way, of anything else n captures go n / (n + 5) of it:
    a few captures may be of a few classes.

    Args:
        captures: capture of each row, numbered from 0.
        codes: class of each row; None if unknown.
        classes: number of classes.
    """
    count = captures.max() + 1
    if codes is None:
        return count / (count + PRIOR), False
    each = np.bincount(codes[np.unique(captures, return_index=True)[1]], minlength=classes)
    return (1.0, False) if (each == each[0]).all() else (count / (count + PRIOR), True)


def codes_of(y: np.ndarray, classes: np.ndarray) -> np.ndarray:
    """Positions of class names.

    Raises:
        InputError: one of them was never learnt.
    """
    if not np.isin(y, classes).all():
        unknown = sorted(set(map(str, y)) - set(map(str, classes)))
        raise InputError(f"{unknown[0]!r} is none of the classes that were learnt")
    return np.searchsorted(classes, y)


def relearnt(
    old: np.ndarray, inputs: np.ndarray, codes: np.ndarray, captures: np.ndarray
) -> np.ndarray:
    """The last layer of a network after it has learnt some captures of a person, too.

    It minimises the cross-entropy of their captures, a mean over the rows of each, while its weights stay near those
    that it had: the squared distance costs half of `STIFF` times the mean square length of a row.

    Args:
        old: weights, and the intercept as the last column [classes, inputs + 1].
        inputs: inputs of the layer [rows, inputs].
        codes: class of each row.
        captures: capture of each row.
    """
    inputs = np.column_stack([inputs, np.ones(len(inputs))]).astype(np.float64)
    share = (1 / np.bincount(captures)[captures])[:, None]
    wanted = np.eye(len(old))[codes]
    price = STIFF * np.mean((inputs**2).sum(axis=1))

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        away = flat.reshape(old.shape) - old
        logits = inputs @ (away + old).T
        wrong = (softmax(logits, axis=1) - wanted) * share
        cost = -(wanted * log_softmax(logits, axis=1) * share).sum() + price / 2 * (away**2).sum()
        return cost, (wrong.T @ inputs + price * away).ravel()

    begin = old.astype(np.float64)
    return minimize(
        loss, begin.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": ROUNDS}
    ).x.reshape(old.shape)
