"""A network that decides once per window of a capture."""

from __future__ import annotations

import numpy as np
import pandas as pd
import torch
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.utils.validation import check_is_fitted
from torch import nn

from bench.corpus import Corpus, InputError
from models.training import Windows, probabilities


class WindowNet(ClassifierMixin, BaseEstimator):
    """Cuts captures into windows, decides on each, and labels a capture by the mean of its probabilities.

    A system gives ``network(rows, cols, classes)`` and ``learn(net, windows, target)``, and has ``frames``, ``hop``
    (None: windows do not overlap), ``epochs``, ``batch`` and ``seed`` among its parameters.

    Attributes:
        classes_: class names.
        net_: the trained network.
        history_: per epoch what the training loop reports.
    """

    def network(self, rows: int, cols: int, classes: int) -> nn.Module:
        """The untrained network for one grid."""
        raise NotImplementedError

    def learn(self, net: nn.Module, windows: Windows, target: np.ndarray) -> list[dict[str, float]]:
        """Train the network in place and return its history."""
        raise NotImplementedError

    def windows(self, corpus: Corpus) -> Windows:
        """The windows that captures are cut into."""
        return Windows(corpus, self.frames, self.hop or self.frames)

    def check(self) -> None:
        """Refuse parameters that cannot be, before anything is run.

        Raises:
            InputError: a count below 1.
        """
        for name in ("frames", "hop", "epochs", "batch"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise InputError(f"model.{name}={value}: give at least 1")

    def fit(self, X: Corpus, y: np.ndarray) -> WindowNet:
        """Train on captures and their class names."""
        self.check()
        self.classes_, codes = np.unique(y, return_inverse=True)
        windows = self.windows(X)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed)
            net = self.network(*X.grid, len(self.classes_))
            with torch.no_grad():  # gives lazy layers their size before an optimiser asks for parameters
                net(windows.batch(np.arange(1)))
            self.history_ = self.learn(net, windows, codes[windows.capture])
        self.net_ = net
        return self

    def decide(self, X: Corpus) -> tuple[pd.DataFrame, np.ndarray]:
        """One decision per window.

        Returns:
            A table with ``capture`` (position in X), ``start`` and ``frames`` (first frame and frames seen), and
            probabilities [decisions, classes].
        """
        check_is_fitted(self, "net_")
        windows = self.windows(X)
        table = pd.DataFrame({"capture": windows.capture, "start": windows.start, "frames": windows.seen})
        return table, probabilities(self.net_, windows, self.batch)

    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Mean probability over the windows of each capture [captures, classes]."""
        table, proba = self.decide(X)
        capture = table["capture"].to_numpy()
        return np.add.reduceat(proba, np.flatnonzero(np.diff(capture, prepend=-1))) / np.bincount(capture)[:, None]

    def predict(self, X: Corpus) -> np.ndarray:
        """Class name of each capture."""
        return self.classes_[self.predict_proba(X).argmax(axis=1)]

    @property
    def parameters_(self) -> int:
        """Learnt numbers in the network."""
        check_is_fitted(self, "net_")
        return sum(p.numel() for p in self.net_.parameters())
