"""Learnt weights in few bits, as `bench export` stores them."""

from __future__ import annotations

from copy import copy

import numpy as np
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import Pipeline

from bench.errors import InputError
from bench.models.classic.bayes import GaussianBayes
from bench.models.classic.lda import Discriminants
from bench.models.classic.perceptron import Perceptron
from bench.models.out_of_distribution import GuardedDiscriminants

BITS = (32, 8)
QUANTISED = (Discriminants, GuardedDiscriminants, Perceptron, LogisticRegression, GaussianBayes)


def quantise_rows(weights: np.ndarray, bits: int) -> tuple[np.ndarray, np.ndarray]:
    """Stored form of weights [rows, n]: integers of 8 or 16 bits, or floats; steps [rows]."""
    if bits == 32:
        return weights.astype(np.float32), np.ones(len(weights), np.float32)
    dtype = np.dtype(f"int{bits}")
    step = np.abs(weights).max(axis=1) / np.iinfo(dtype).max
    step = np.where(step > 0, step, 1)
    return np.rint(weights / step[:, None]).astype(dtype), step.astype(np.float32)


def round_weights(weights: np.ndarray, bits: int) -> np.ndarray:
    """Weights as restored from their stored form."""
    integers, step = quantise_rows(weights, bits)
    return integers * step[:, None].astype(float)


def split_triangle(factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split a lower triangle [n, n] into the joined rows below its diagonal, and the diagonal.

    The rows are divided by the diagonal.
    """
    diagonal = np.diag(factor)
    return (factor / diagonal[:, None])[np.tril_indices(len(factor), -1)], diagonal


def _join_triangle(below: np.ndarray, diagonal: np.ndarray) -> np.ndarray:
    """Join what `split_triangle` splits."""
    factor = np.eye(len(diagonal))
    factor[np.tril_indices(len(diagonal), -1)] = below
    return factor * diagonal[:, None]


def can_quantise(classifier: object) -> bool:
    """True if the weights of a classifier can be stored in few bits."""
    return isinstance(classifier, QUANTISED)


def quantise_pipeline(system: Pipeline, bits: int) -> Pipeline:
    """Copy of a fitted pipeline that predicts with weights of a number of bits.

    Raises:
        InputError: its classifier cannot be stored in few bits.
    """
    *before, (name, classifier) = system.steps
    rounded, count = copy(classifier), np.size(getattr(classifier, "coef_", ()))
    if isinstance(classifier, GuardedDiscriminants):
        mean, sd = classifier.mean_.astype(float), classifier.sd_.astype(float)
        rounded.linear_ = _round_discriminants(classifier.linear_, mean, sd, bits)
        rounded.robust_, count = _round_network(classifier.robust_, bits)
        count += rounded.linear_.coef_.size
    elif isinstance(classifier, Perceptron):
        rounded, count = _round_network(classifier, bits)
    elif isinstance(classifier, Discriminants):
        learnt = classifier.learnt_
        rounded = _round_discriminants(classifier, learnt.mean, learnt.sd, bits)
    elif isinstance(classifier, LogisticRegression):
        rounded.coef_ = round_weights(classifier.coef_, bits)
    elif isinstance(classifier, GaussianBayes):
        triangles, diagonals = zip(*map(split_triangle, classifier.factors_), strict=True)
        rows = round_weights(np.stack(triangles), bits)
        rounded.factors_ = [*map(_join_triangle, rows, diagonals)]
        count = rows.size
    else:
        name = type(classifier).__name__
        raise InputError(f"model.bits={bits}: {name} cannot be stored in few bits; leave it out")
    rounded.bytes_saved_ = (4 - bits // 8) * count
    return Pipeline([*before, (name, rounded)])


def _round_network(network: Perceptron, bits: int) -> tuple[Perceptron, int]:
    """A network with rounded weights, and the count of these."""
    rounded = copy(network)
    layers = [round_weights(layer.T.astype(float), bits) for layer in network.coefs_]
    rounded.coefs_ = [layer.T.astype(np.float32) for layer in layers]
    return rounded, sum(layer.size for layer in layers)


def _round_discriminants(
    linear: Discriminants, mean: np.ndarray, sd: np.ndarray, bits: int
) -> Discriminants:
    """Discriminants with coefficients rounded in units of the SDs, infinite for constant features.

    The intercept is corrected, so that nothing changes at the mean of the features.
    """
    rounded = copy(linear)
    finite = np.where(np.isfinite(sd), sd, 0)
    rounded.coef_ = round_weights(linear.coef_ * finite, bits) / np.where(finite > 0, finite, 1)
    rounded.intercept_ = linear.intercept_ + (linear.coef_ - rounded.coef_) @ mean
    return rounded
