"""One hidden layer on a feature set, for captures or for windows of captures and their damaged copies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import softmax
from sklearn.base import TransformerMixin
from sklearn.pipeline import Pipeline

from bench.errors import InputError
from bench.features.base import is_constant, undamaged_rows
from bench.models.most_probable import MostProbable
from bench.models.space import Range

BATCH_ROWS = 256
MAX_RATE = 2e-3  # at its highest, a third of the way (one cycle, Smith and Topin 2019)
WEIGHT_DECAY = 0.1  # of the weights, decoupled (Loshchilov and Hutter 2019)
DROPOUT = 0.5  # of the hidden units, while it learns


@dataclass(eq=False, repr=False)
class Perceptron(MostProbable):
    """Features in SDs of the training rows, cut off at ``clip``; rectified units; a softmax.

    Rows are drawn at random as often as they count, so the updates that it learns in do not grow with the copies.

    Args:
        units: number of units in the hidden layer.
        updates: batches of 256 rows that it learns from.
        smoothing: share of a label that is spread over all classes, 0 to below 1.
        clip: number of SDs at which features are clipped, so that broken sensors have bounded effects.
        damaged: weight of a row of a damaged copy (``copy`` of the index is above 0); others count 1.
        seed: random seed of weights, draws and dropped units.

    Attributes:
        classes_: class names.
        coefs_: [features, units] and [units, classes], float32.
        intercepts_: [units] and [classes], float32.
        mean_, scale_: mean and scale of the features, float32 [features].
    """

    units: int = 20
    updates: int = 3000
    smoothing: float = 0.3
    clip: float = 2.5
    damaged: float = 1.0
    seed: int = 0

    def fit(self, X: pd.DataFrame | np.ndarray, y: np.ndarray) -> Perceptron:
        """Learn from features [rows, n_features] and class names [rows]."""
        import torch  # which a system that is stored decides without
        from torch import nn

        self.classes_, codes = np.unique(y, return_inverse=True)
        Z = np.asarray(X, dtype=np.float32)
        self.n_features_in_ = Z.shape[1]
        if not np.isfinite(Z).all():
            raise ValueError(
                f"{int((~np.isfinite(Z)).sum())} values of training features are not finite"
            )
        weight = np.where(undamaged_rows(X), 1.0, self.damaged)
        share = weight / weight.sum()
        self.mean_ = (share @ Z).astype(np.float32)
        self.scale_ = np.sqrt(share @ (Z - self.mean_) ** 2).astype(np.float32)
        self.scale_[is_constant(Z) | (self.scale_ == 0)] = np.inf
        inputs, target = torch.from_numpy(self._standardise(Z)), torch.from_numpy(codes)
        until = np.cumsum(share)
        threads = torch.get_num_threads()
        torch.set_num_threads(1)  # so small a batch is slower with more, and sums in another order
        try:
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(self.seed)
                drawn = np.random.default_rng(self.seed)
                net = nn.Sequential(
                    nn.Linear(Z.shape[1], self.units),
                    nn.ReLU(),
                    nn.Dropout(DROPOUT),
                    nn.Linear(self.units, len(self.classes_)),
                )
                optimiser = torch.optim.AdamW(
                    net.parameters(), lr=MAX_RATE, weight_decay=WEIGHT_DECAY
                )
                cycle = torch.optim.lr_scheduler.OneCycleLR(
                    optimiser, MAX_RATE, total_steps=self.updates
                )
                loss = nn.CrossEntropyLoss(label_smoothing=self.smoothing)
                for _ in range(self.updates):
                    rows = np.searchsorted(
                        until, until[-1] * drawn.random(BATCH_ROWS), side="right"
                    )
                    rows = torch.from_numpy(np.minimum(rows, len(Z) - 1))
                    optimiser.zero_grad()
                    loss(net(inputs[rows]), target[rows]).backward()
                    optimiser.step()
                    cycle.step()
        finally:
            torch.set_num_threads(threads)
        layers = [layer for layer in net if isinstance(layer, nn.Linear)]
        self.coefs_ = [layer.weight.detach().numpy().T.copy() for layer in layers]
        self.intercepts_ = [layer.bias.detach().numpy().copy() for layer in layers]
        return self

    def _standardise(self, Z: np.ndarray) -> np.ndarray:
        """In SDs, cut off; what is not a number is taken for the mean."""
        return np.nan_to_num((Z - self.mean_) / self.scale_, nan=0.0).clip(-self.clip, self.clip)

    def hidden_activations(self, X: pd.DataFrame | np.ndarray) -> np.ndarray:
        """Rectified units [rows, units]; in double precision they do not depend on the rows beside them."""
        scaled = self._standardise(np.asarray(X, dtype=np.float32)).astype(np.float64)
        hidden = scaled @ self.coefs_[0] + self.intercepts_[0]
        return np.maximum(hidden, 0)

    def predict_proba(self, X: pd.DataFrame | np.ndarray) -> np.ndarray:
        """Class probabilities [rows, classes]."""
        logits = self.hidden_activations(X) @ self.coefs_[1] + self.intercepts_[1]
        return softmax(logits, axis=1)

    @property
    def parameters_(self) -> int:
        """Weights, biases, and the scaling of features."""
        return sum(a.size for a in (*self.coefs_, *self.intercepts_, self.mean_, self.scale_))


def perceptron(
    features: TransformerMixin,
    units: int = 20,
    updates: int = 3000,
    smoothing: float = 0.3,
    clip: float = 2.5,
    damaged: float = 1.0,
    seed: int = 0,
) -> Pipeline:
    """Network with one hidden layer of rectified units and a softmax, on standardised and clipped features.

    It learns from a fixed number of batches of 256 rows (AdamW, learning rate up to 0.002, weight decay 0.1, dropout
    0.5).

    Args:
        features: transformer from captures to a table.
        units: number of units in the hidden layer. Default: ours, from the design of reflex on seven of HAART's people.
        updates: number of batches. Default: ours, from the design of reflex on seven of HAART's people.
        smoothing: share of a label that is spread over all classes, 0 to below 1. Default: ours, from the design of
            reflex on seven of HAART's people.
        clip: number of SDs at which features are clipped. Default: ours, from the design of reflex on seven of HAART's
            people.
        damaged: weight of a damaged copy of a capture (model.faults=). Default: each copy counts as its capture.
        seed: random seed of weights, draws and dropped units.

    Raises:
        InputError: a parameter that cannot be.
    """
    if not (1 <= units <= 4096 and 1 <= updates <= 10_000_000):
        raise InputError(
            f"model.units={units}, model.updates={updates}: give at least 1, at most 4096 and 10000000"
        )
    if not 0 <= smoothing < 1:
        raise InputError(f"model.smoothing={smoothing:g}: give 0 to below 1")
    if not 0 < clip < float("inf"):
        raise InputError(f"model.clip={clip:g}: give a number of SDs above 0")
    if not 0 < damaged < float("inf"):
        raise InputError(f"model.damaged={damaged:g}: give a number above 0")
    net = Perceptron(units, updates, smoothing, clip, damaged, seed)
    return Pipeline([("features", features), ("classifier", net)])


perceptron.space = {
    "units": [10, 20, 40, 80],
    "smoothing": [0.0, 0.1, 0.3],
    "clip": Range(1.5, 6, log=True),
}
