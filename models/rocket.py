"""Random convolutions and a ridge classifier: MiniRocket and MultiRocket-Hydra of aeon."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax, softmax
from sklearn.base import TransformerMixin
from sklearn.preprocessing import StandardScaler
from sklearn.utils.validation import check_is_fitted

from bench.corpora.corpus import Corpus
from bench.errors import InputError, check_value
from bench.models.most_probable import MostProbable
from bench.models.search.inner_folds import split_subjects
from bench.models.series import CHANNELS, MIN_FRAMES, Series

PUBLISHED_KERNELS = {"minirocket": 10_000, "multirocket_hydra": 6_250}  # as published
MAX_SAMPLE_VALUES = 2**26  # of the sample of training captures that biases are drawn from
PENALTIES = np.logspace(0, 6, 13)
BLOCK_COLUMNS = 1024  # of the feature matrix, converted to double precision at a time


@dataclass(eq=False, repr=False)
class Rocket(MostProbable):
    """MiniRocket (Dempster et al. 2021) or MultiRocket-Hydra (2023) on the signals of a touch.

    aeon's transforms need captures of one length, so each is resampled linearly to the median
    length of the training captures. This loses its duration and, if it is longer, its fastest
    changes. Still, it is more accurate on generated captures than padding, whose constant values
    dominate the features (docs/notes/systems.md, rocket). Each channel is standardised over all
    training frames. Captures are transformed one by one, so they do not depend on each other.

    The features, standardised on the training captures, go to a ridge regression on targets of -1
    and 1. Its penalty, and the temperature of the softmax of its scores, are those with the lowest
    log loss on training subjects left out one at a time. (The papers leave out single captures.)
    Transform and scaling use no labels, and are fitted once to all training captures.

    It needs the extra ``rocket``. numba compiles it on first use, for about a minute, and caches
    the result on disk.

    Args:
        transform: ``minirocket`` or ``multirocket_hydra``.
        channels: ``signals`` for five (summed pressure, row and column of the centre of mass,
            maximum, share of taxels above 5 % of full scale), ``taxels`` for one per taxel, or
            ``both``.
        kernels: number of convolutions of MiniRocket, or of MultiRocket on a series and on its
            differences; None for the published 10 000 or 6250. Hydra always has 64 groups of 8.
        seed: random seed of convolutions, their channels and biases.

    Attributes:
        classes_: class names.
        series_: conversion of captures to series.
        penalty_: penalty of the ridge regression.
        temperature_: divisor of the scores before the softmax.
        fit_seconds_: wall and CPU seconds of the last fit, without compilation.
    """

    packages = ("aeon", "numba")

    transform: str = "minirocket"
    channels: str = "signals"
    kernels: int | None = None
    seed: int = 0

    def check(self) -> None:
        """Check the parameters, and that aeon is installed."""
        for name, values in (("transform", PUBLISHED_KERNELS), ("channels", CHANNELS)):
            value = getattr(self, name)
            check_value(f"model.{name}", value, value in values, " or ".join(values))
        is_valid = self.kernels is None or self.kernels >= 84
        check_value("model.kernels", self.kernels, is_valid, "at least 84, one of each kind")
        if find_spec("aeon") is None:
            install = "pip install 'touchbench[rocket]', or '.[rocket]' in a clone"
            raise InputError(f"model=rocket needs the package aeon: {install}")

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Check the training captures."""
        split_subjects(X.subjects.astype(str), "loso")

    def fit(self, X: Corpus, y: np.ndarray) -> Rocket:
        """Learn from captures and their class names."""
        self.check()
        left_out = [rows for _, rows in split_subjects(X.subjects.astype(str), "loso")]
        with preserved_random_state():
            channels = Series(self.channels).fit(X[:1]).channels_
            for transform in self._make_transforms(84):  # so that numba compiles before the timing
                transform.fit_transform(np.zeros((2, channels, MIN_FRAMES), dtype=np.float32))
            wall, cpu = time.perf_counter(), time.process_time()
            self.classes_, codes = np.unique(y, return_inverse=True)
            self.series_ = Series(self.channels).fit(X)
            self.transforms_ = self._make_transforms(
                self.kernels or PUBLISHED_KERNELS[self.transform]
            )
            sample = self._sample_series(X)
            for transform in self.transforms_:
                transform.fit(sample)
        features = self._compute_features(X)
        self.scaler_ = StandardScaler().fit(features)
        if self.transform == "multirocket_hydra":  # Hydra's guard against rare patterns
            width = self.transforms_[1].transform(sample[:1]).shape[1]
            self.scaler_.scale_[-width:] += (features[:, -width:] == 0).mean(axis=0) ** 4
        self._standardise(features)
        targets = np.where(np.eye(len(self.classes_), dtype=bool)[codes], 1.0, -1.0)
        ridge = Ridge(features, targets)
        losses = [
            _fit_log_temperature(ridge.predict_left_out(penalty, left_out), codes)
            for penalty in PENALTIES
        ]
        best = int(np.argmin([loss for loss, _ in losses]))
        self.penalty_, self.temperature_ = float(PENALTIES[best]), losses[best][1]
        self.coef_ = features.T @ ridge.dual_weights(self.penalty_).astype(np.float32)
        self.intercept_ = targets.mean(axis=0).astype(np.float32)
        self.fit_seconds_ = time.perf_counter() - wall, time.process_time() - cpu
        return self

    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Class probabilities [captures, classes]."""
        check_is_fitted(self, "coef_")
        features = self._compute_features(X)
        self._standardise(features)
        # row by row, as the rounding of a matrix product depends on the number of rows
        scores = np.stack([row @ self.coef_ for row in features]) + self.intercept_
        return softmax(scores / self.temperature_, axis=1)

    def _make_transforms(self, kernels: int) -> list[TransformerMixin]:
        """Make aeon's transforms, untrained, on one thread."""
        from aeon.transformations.collection.convolution_based import (
            HydraTransformer,
            MiniRocket,
            MultiRocket,
        )

        if self.transform == "minirocket":
            return [MiniRocket(kernels, random_state=self.seed)]
        hydra = HydraTransformer(random_state=self.seed, output_type="numpy")
        return [MultiRocket(kernels, random_state=self.seed), hydra]

    def _sample_series(self, X: Corpus) -> np.ndarray:
        """Series of the training captures, or of a sample of them that fits into memory."""
        size = max(MAX_SAMPLE_VALUES // (self.series_.channels_ * self.series_.length_), 2)
        rows = np.sort(np.random.default_rng(self.seed).permutation(len(X))[:size])
        return self.series_.transform(X[rows])

    def _compute_features(self, X: Corpus) -> np.ndarray:
        """Features of each capture, float32 [captures, n_features]."""
        for i, series in enumerate(self.series_.iter_series(X)):
            parts = [transform.transform(series[None])[0] for transform in self.transforms_]
            if len(parts) > 1:  # Hydra's authors take the square root of its counts
                parts[1] = np.sqrt(np.maximum(parts[1], 0))
            if i == 0:
                features = np.empty((len(X), sum(map(len, parts))), dtype=np.float32)
            features[i] = np.concatenate(parts)
        return features

    def _standardise(self, features: np.ndarray) -> None:
        """Standardise in place."""
        features -= self.scaler_.mean_.astype(np.float32)
        features /= self.scaler_.scale_.astype(np.float32)

    @property
    def parameters_(self) -> int:
        """Number of learnt or drawn values, without the 84 fixed kinds of convolutions."""
        check_is_fitted(self, "coef_")
        arrays = [a for transform in self.transforms_ for a in _drawn_arrays(transform)]
        drawn = sum(np.asarray(a).size for a in arrays)
        scales = 2 * (self.series_.channels_ + len(self.coef_))
        return drawn + scales + self.coef_.size + self.intercept_.size + 1

    @property
    def activations_(self) -> int:
        """Numbers in memory while aeon transforms one capture, and its features and scores."""
        check_is_fitted(self, "coef_")
        channels = self.series_.channels_
        # of each channel the series, its negative, its triple, a sum, nine shifted copies; then one
        # convolution
        numbers = 13 * channels + 1
        if len(self.transforms_) > 1:
            hydra = self.transforms_[1]
            group_channels = hydra._hydra.idx[0].shape[-1] if channels > 1 else 0
            # Hydra: the channels of each group, their sum, its responses; both transforms need the
            # differences
            of_hydra = hydra._hydra.h * (group_channels + 1 + hydra.n_kernels)
            numbers = max(numbers + channels, 2 * channels + of_hydra)
        return numbers * self.series_.length_ + sum(self.coef_.shape)


class Ridge:
    """Ridge regression with an intercept for any penalty, and its predictions of left-out captures.

    Predictions of a linear fit without some of its captures follow from the fit with them. With
    residuals r and hat matrix H, the residuals of a group g become (I - H_gg)^-1 r_g.

    Args:
        features: [captures, n_features], mean 0 in each column.
        targets: [captures, n_targets].
    """

    def __init__(self, features: np.ndarray, targets: np.ndarray) -> None:
        gram = np.zeros((len(features), len(features)))
        for start in range(0, features.shape[1], BLOCK_COLUMNS):
            part = features[:, start : start + BLOCK_COLUMNS].astype(np.float64)
            part -= part.mean(axis=0)  # 0 but for rounding
            gram += part @ part.T
        values, self.vectors = eigh(gram, overwrite_a=True, check_finite=False)
        self.values = np.maximum(values, 0)
        self.targets = targets
        self.rotated_targets = self.vectors.T @ (targets - targets.mean(axis=0))

    def dual_weights(self, penalty: float) -> np.ndarray:
        """Weights of the captures [captures, n_targets]; features.T @ weights are coefficients."""
        return self.vectors @ (self.rotated_targets / (self.values + penalty)[:, None])

    def predict_left_out(self, penalty: float, groups: list[np.ndarray]) -> np.ndarray:
        """Predictions for each group of captures by a fit to the others [captures, n_targets].

        Args:
            penalty: penalty on the squared coefficients; the intercept has none.
            groups: positions of the captures of each group; every capture is in one.
        """
        residuals = penalty * self.dual_weights(penalty)
        predicted = np.empty_like(self.targets)
        for group in groups:
            vectors = self.vectors[group]
            shrunk = vectors * (penalty / (self.values + penalty))
            remainder = shrunk @ vectors.T - 1 / len(self.targets)  # I - H_gg
            predicted[group] = self.targets[group] - np.linalg.solve(remainder, residuals[group])
        return predicted


def _fit_log_temperature(scores: np.ndarray, codes: np.ndarray) -> tuple[float, float]:
    """Lowest mean log loss of a softmax of scores over a temperature, and that temperature."""

    def log_loss(log_temperature: float) -> float:
        log_proba = log_softmax(scores / np.exp(log_temperature), axis=1)
        return float(-log_proba[np.arange(len(codes)), codes].mean())

    lowest = minimize_scalar(log_loss, bounds=(-5, 5), method="bounded")
    return float(lowest.fun), float(np.exp(lowest.x))


def _drawn_arrays(transform: TransformerMixin) -> list:
    """Arrays that a transform of aeon has drawn or learnt."""
    match type(transform).__name__:
        case "HydraTransformer":
            return [transform._hydra.W, *transform._hydra.idx]
        case "MiniRocket":
            return [*transform.parameters]
    return [*transform.parameter, *transform.parameter1]


@contextmanager
def preserved_random_state() -> Iterator[None]:
    """Restore what aeon sets for the process: numpy's and PyTorch's generators, threads."""
    import torch

    state, threads = np.random.get_state(), torch.get_num_threads()
    try:
        with torch.random.fork_rng(devices=[]):
            yield
    finally:
        np.random.set_state(state)
        torch.set_num_threads(threads)
