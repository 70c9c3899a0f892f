"""Adapters that make systems of time series classifiers (aeon, sktime) and modules of PyTorch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from sklearn.base import BaseEstimator, ClassifierMixin, clone
from sklearn.utils.metaestimators import available_if

from bench import contract
from bench.corpora.corpus import Corpus
from bench.models.nets.window import WindowNet
from bench.models.series import Series

if TYPE_CHECKING:
    from torch import nn


@dataclass(eq=False, repr=False)
class FromSeries(ClassifierMixin, BaseEstimator):
    """A classifier of equally long series [captures, channels, frames], as of aeon and sktime.

    Args:
        classifier: untrained.
        channels: see `Series`.
        length: see `Series`.
    """

    classifier: BaseEstimator
    channels: str = "signals"
    length: int | None = None

    def fit(self, X: Corpus, y: np.ndarray) -> FromSeries:
        """Learn from captures and their class names."""
        self.series_ = Series(self.channels, self.length).fit(X)
        series = self.series_.transform(X).astype(np.float64)
        self.classifier_ = clone(self.classifier).fit(series, np.asarray(y, str))
        self.classes_ = np.asarray(self.classifier_.classes_)
        return self

    def predict(self, X: Corpus) -> np.ndarray:
        """Class name of each capture."""
        return np.asarray(self.classifier_.predict(self.series_.transform(X).astype(np.float64)))

    @available_if(lambda self: contract.has_probabilities(self.classifier))
    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Class probabilities [captures, classes], where the classifier has them."""
        return self.classifier_.predict_proba(self.series_.transform(X).astype(np.float64))


class FromTorch(WindowNet):
    """A module of PyTorch on windows of captures, trained by Adam.

    Args:
        module: function or class that is called with the frames of a window, rows, columns and
            classes, and returns an untrained module; input [batch, frames, rows, cols] scaled to
            0..1, output a logit per class.
        frames: length of a window; windows are consecutive.
        seconds: length of a window in seconds, instead of frames.
        epochs: passes over the training windows.
        batch: windows per step.
        rate: learning rate.
        seed: random seed of weights and shuffles.
        device: PyTorch device.
    """

    module: Callable[[int, int, int, int], nn.Module]
    frames: int = 50
    seconds: float = 0.0
    epochs: int = 20
    batch: int = 64
    rate: float = 1e-3

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """The module for a grid."""
        return self.module(self.window, rows, cols, classes)
