"""Adaptation of a classifier on features to one person by some of their captures."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.optimize import minimize
from scipy.special import log_softmax, softmax
from sklearn.base import BaseEstimator, TransformerMixin, clone
from sklearn.pipeline import Pipeline

from bench.errors import InputError
from bench.features.base import constant
from bench.models.feature_rows import captures_of, undamaged

WAYS = ("centre", "scale", "pool")
WEIGHT = 10  # of a row of the person beside one of training; docs/notes/numbers.md
PRIOR = 5.0  # captures that the mean of training counts beside those of a person
SPREAD_PRIOR = 20.0  # and its spread
STIFF = 0.3  # of a network's last layer
ROUNDS = 200  # at most, until it has learnt


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


def relearnt(old: np.ndarray, inputs: np.ndarray, codes: np.ndarray, captures: np.ndarray) -> np.ndarray:
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
    return minimize(loss, begin.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": ROUNDS}).x.reshape(old.shape)


@dataclass(eq=False, repr=False)
class PersonScaler(TransformerMixin, BaseEstimator):
    """Features of a person as they would be of the average person; the identity until it is adapted.

    - ``centre``: features are measured from the person's own mean, as far as `share` goes;
    - ``scale``: and by their own spread about it, of n captures n / (n + 20) of the way, on a logarithmic scale.

    What never varied in training stays as it is.

    Args:
        ways: adaptations, from the list above; others have no effect here.

    Attributes:
        classes_: class names.
        mean_, sd_, within_: mean and SD of the undamaged training rows, and the spread within classes [features].
        centres_: means of the classes, relative to the overall mean [classes, features].
        shift_, scale_: subtracted shift, then divisor [features].
    """

    ways: tuple[str, ...] = WAYS[:2]

    def fit(self, X: pd.DataFrame, y: np.ndarray) -> PersonScaler:
        """Learn the usual range of features [rows, n_features] and class names [rows]."""
        rows = undamaged(X)
        values = np.asarray(X, dtype=np.float64)[rows]
        self.classes_, codes = np.unique(np.asarray(y)[rows], return_inverse=True)
        self.n_features_in_ = values.shape[1]
        self.mean_ = values.mean(axis=0)
        self.centres_ = np.stack([values[codes == c].mean(axis=0) for c in range(len(self.classes_))]) - self.mean_
        still = constant(values)
        self.sd_ = np.where(still, 0, values.std(axis=0))
        self.within_ = np.where(still, 0, (values - self.mean_ - self.centres_[codes]).std(axis=0))
        self.shift_, self.scale_ = np.zeros(len(self.mean_)), np.ones(len(self.mean_))
        return self

    def adapt(self, X: pd.DataFrame, y: np.ndarray | None) -> PersonScaler:
        """The same for one person.

        Args:
            X: features [rows, n_features] of some of their captures.
            y: class names [rows], all from training; None if unlabelled.
        """
        adapted = copy(self)
        captures = captures_of(X)
        codes = None if y is None else codes_of(y, self.classes_)
        values = np.asarray(X, dtype=np.float64) - self.mean_
        within = values if codes is None else values - self.centres_[codes]
        if "centre" in self.ways:
            believed, apart = share(captures, codes, len(self.classes_))
            adapted.shift_ = np.where(self.sd_ > 0, believed * (within if apart else values).mean(axis=0), 0)
        if "scale" in self.ways:
            count = captures.max() + 1
            spread, usual = within.std(axis=0), self.sd_ if codes is None else self.within_
            both = (spread > 0) & (usual > 0)
            ratio = np.log(np.where(both, spread, 1)) - np.log(np.where(both, usual, 1))
            adapted.scale_ = np.exp(count / (count + SPREAD_PRIOR) * ratio)
        return adapted

    def transform(self, X: pd.DataFrame) -> pd.DataFrame:
        """Features [rows, n_features], the same object where nothing was adapted."""
        if not self.shift_.any() and (self.scale_ == 1).all():
            return X
        return self.mean_ + (X - self.mean_ - self.shift_) / self.scale_


def pooled(
    classifier: Pipeline, training: tuple[pd.DataFrame, np.ndarray], person: tuple[pd.DataFrame, np.ndarray]
) -> Pipeline:
    """A classifier fitted anew to rows of training and those of a person, each of which counts `WEIGHT` times.

    Args:
        classifier: fitted or not; it stays as it is.
        training: rows and class names.
        person: rows and class names of the person.
    """
    tables, labels = zip(training, *[person] * WEIGHT, strict=True)
    return clone(classifier).fit(pd.concat(tables), np.concatenate(labels))
