"""Learnt weights in few bits, as `bench export` stores them."""

from __future__ import annotations

from copy import copy

import numpy as np
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import Pipeline

from bench.errors import InputError
from bench.models.classic.bayes import GaussianBayes
from bench.models.classic.lda import Discriminants
from bench.models.out_of_distribution import GuardedDiscriminants

BITS = (32, 8)


def quantise_rows(weights: np.ndarray, bits: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights [rows, n], in 8 or 16 bits as whole numbers, and the step of each row."""
    if bits == 32:
        return weights.astype(np.float32), np.ones(len(weights), np.float32)
    kind = np.dtype(f"int{bits}")
    step = np.abs(weights).max(axis=1) / np.iinfo(kind).max
    step = np.where(step > 0, step, 1)
    return np.rint(weights / step[:, None]).astype(kind), step.astype(np.float32)


def split_triangle(factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A triangle [n, n] as its rows below the diagonal, divided by it, one behind the other, and the diagonal."""
    diagonal = np.diag(factor)
    below = np.tril(factor) / diagonal[:, None]
    return np.concatenate([below[i, :i] for i in range(len(below))]), diagonal


def can_quantise(classifier: object) -> bool:
    """Return True if its weights can be stored in few bits."""
    return isinstance(
        classifier, Discriminants | GuardedDiscriminants | LogisticRegression | GaussianBayes
    )


def quantise_pipeline(system: Pipeline, bits: int) -> Pipeline:
    """A fitted pipeline that decides with weights of so many bits; it stays as it is itself."""
    *before, (name, classifier) = system.steps
    few, weights = copy(classifier), np.size(getattr(classifier, "coef_", ()))
    if isinstance(classifier, GuardedDiscriminants):
        few.linear_ = _round_discriminants(
            classifier.linear_, classifier.mean_.astype(float), classifier.sd_.astype(float), bits
        )
        few.robust_ = copy(classifier.robust_)
        few.robust_.coefs_ = [
            round_weights(w.T.astype(float), bits).T.astype(np.float32)
            for w in classifier.robust_.coefs_
        ]
        weights = few.linear_.coef_.size + sum(w.size for w in few.robust_.coefs_)
    elif isinstance(classifier, Discriminants):
        few = _round_discriminants(classifier, classifier.learnt_.mean, classifier.learnt_.sd, bits)
    elif isinstance(classifier, LogisticRegression):
        few.coef_ = round_weights(classifier.coef_, bits)
    elif isinstance(classifier, GaussianBayes):
        triangles, diagonals = zip(*map(split_triangle, classifier.factors_), strict=True)
        rows = round_weights(np.stack(triangles), bits)
        few.factors_ = [
            _join_triangle(row, diagonal) for row, diagonal in zip(rows, diagonals, strict=True)
        ]
        weights = rows.size
    else:
        raise InputError(
            f"model.bits={bits}: {type(classifier).__name__} is not measured in few bits; leave it out"
        )
    few.bytes_saved_ = (4 - bits // 8) * weights
    return Pipeline([*before, (name, few)])


def round_weights(weights: np.ndarray, bits: int) -> np.ndarray:
    """Weights restored from their stored form."""
    numbers, step = quantise_rows(weights, bits)
    return numbers * step[:, None].astype(float)


def _round_discriminants(
    linear: Discriminants, mean: np.ndarray, sd: np.ndarray, bits: int
) -> Discriminants:
    """Discriminants with coefficients rounded in units of an SD of each feature, endless for what never varies.

    They weigh what lies between a feature and its mean, so that at the mean nothing is rounded.
    """
    few = copy(linear)
    finite = np.where(np.isfinite(sd), sd, 0)
    few.coef_ = round_weights(linear.coef_ * finite, bits) / np.where(finite > 0, finite, 1)
    few.intercept_ = linear.intercept_ + (linear.coef_ - few.coef_) @ mean
    return few


def _join_triangle(row: np.ndarray, diagonal: np.ndarray) -> np.ndarray:
    """The triangle of which `split_triangle` makes these."""
    factor = np.eye(len(diagonal))
    factor[np.tril_indices(len(diagonal), -1)] = row
    return factor * diagonal[:, None]
