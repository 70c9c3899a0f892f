"""One hidden layer on a feature set, for captures or windows and their damaged copies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.special import softmax
from sklearn.base import TransformerMixin
from sklearn.pipeline import Pipeline

from bench.errors import check_value
from bench.features.base import added_rows, is_constant, source_of_rows, undamaged_rows
from bench.models.by_source import SourceScaler, weigh_added
from bench.models.most_probable import MostProbable
from bench.models.space import Range

BATCH_ROWS = 256
MAX_RATE = 2e-3  # reached after a third of the updates (one cycle, Smith and Topin 2019)
WEIGHT_DECAY = 0.1  # decoupled (Loshchilov and Hutter 2019)
DROPOUT = 0.5  # of the hidden units
COLUMNS = 64  # that are summed at once, in double precision


@dataclass(eq=False, repr=False)
class Perceptron(MostProbable):
    """Standardised and clipped features, one layer of rectified units, a softmax.

    Batches are drawn with the weights of the rows as probabilities, so their number does not grow
    with the copies. Features of joined corpora are scaled by source (`bench.models.by_source`).

    Args:
        units: number of units in the hidden layer.
        updates: number of training batches of 256 rows.
        smoothing: share of a label that is spread over all classes, 0 to below 1.
        clip: number of SDs at which features are clipped, so that broken sensors have bounded
            effects.
        damaged: weight of a row of a damaged copy (``copy`` of the index is above 0); others count
            1.
        seed: random seed of weights, draws and dropped units.

    Attributes:
        classes_: class names.
        coefs_: [features, units] and [units, classes], float32.
        intercepts_: [units] and [classes], float32.
        scales_: scales by source.
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
        import torch  # here, as a saved system predicts without it
        from torch import nn
        from torch.optim import AdamW
        from torch.optim.lr_scheduler import OneCycleLR

        self.classes_, codes = np.unique(y, return_inverse=True)
        Z = np.asarray(X, dtype=np.float32)
        self.n_features_in_ = Z.shape[1]
        if infinite := int((~np.isfinite(Z)).sum()):
            raise ValueError(f"{infinite} values of training features are not finite")
        self.scales_ = SourceScaler().fit(X).scales_
        Z = self.scales_.apply(Z, source_of_rows(X))
        row_weights = np.where(undamaged_rows(X), 1.0, self.damaged)
        row_weights = weigh_added(row_weights, added_rows(X))
        shares = row_weights / row_weights.sum()
        self.mean_ = _weighted_sum(shares, Z).astype(np.float32)
        squares = Z - self.mean_
        np.square(squares, out=squares)
        self.scale_ = np.sqrt(_weighted_sum(shares, squares)).astype(np.float32)
        del squares
        self.scale_[is_constant(Z) | (self.scale_ == 0)] = np.inf
        inputs, target = torch.from_numpy(self._standardise(Z)), torch.from_numpy(codes)
        cumulative = np.cumsum(shares)
        threads = torch.get_num_threads()
        # more threads are slower on so small a batch, and sum in another order
        torch.set_num_threads(1)
        try:
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(self.seed)
                generator = np.random.default_rng(self.seed)
                net = nn.Sequential(
                    nn.Linear(Z.shape[1], self.units),
                    nn.ReLU(),
                    nn.Dropout(DROPOUT),
                    nn.Linear(self.units, len(self.classes_)),
                )
                optimiser = AdamW(net.parameters(), lr=MAX_RATE, weight_decay=WEIGHT_DECAY)
                cycle = OneCycleLR(optimiser, MAX_RATE, total_steps=self.updates)
                loss = nn.CrossEntropyLoss(label_smoothing=self.smoothing)
                for _ in range(self.updates):
                    draws = cumulative[-1] * generator.random(BATCH_ROWS)
                    rows = np.searchsorted(cumulative, draws, side="right")
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
        """Standardise, replace NaN by the mean, clip [rows, features]."""
        units = Z - self.mean_
        units /= self.scale_
        np.nan_to_num(units, copy=False, nan=0.0)
        return np.clip(units, -self.clip, self.clip, out=units)

    def hidden_activations(self, X: pd.DataFrame | np.ndarray) -> np.ndarray:
        """Rectified units [rows, units], in double precision so that other rows do not matter."""
        Z = self.scales_.apply(np.asarray(X, dtype=np.float32), source_of_rows(X))
        inputs = self._standardise(Z).astype(np.float64)
        return np.maximum(inputs @ self.coefs_[0] + self.intercepts_[0], 0)

    def predict_proba(self, X: pd.DataFrame | np.ndarray) -> np.ndarray:
        """Class probabilities [rows, classes]."""
        logits = self.hidden_activations(X) @ self.coefs_[1] + self.intercepts_[1]
        return softmax(logits, axis=1)

    @property
    def activations_(self) -> int:
        """Number of inputs and units."""
        return self.n_features_in_ + self.units

    @property
    def parameters_(self) -> int:
        """Number of weights, biases, means and scales."""
        return sum(a.size for a in (*self.coefs_, *self.intercepts_, self.mean_, self.scale_))


def _weighted_sum(weights: np.ndarray, values: np.ndarray) -> np.ndarray:
    """``weights @ values`` in double precision [n], without a copy of all values in it."""
    starts = range(0, values.shape[1], COLUMNS)
    return np.concatenate([weights @ values[:, i : i + COLUMNS] for i in starts])


def perceptron(
    features: TransformerMixin,
    units: int = 20,
    updates: int = 3000,
    smoothing: float = 0.3,
    clip: float = 2.5,
    damaged: float = 1.0,
    seed: int = 0,
) -> Pipeline:
    """One hidden layer of rectified units and a softmax, on standardised and clipped features.

    It is trained on a fixed number of batches of 256 rows (AdamW, learning rate up to 0.002, weight
    decay 0.1, dropout 0.5).

    Args:
        features: transformer from captures to a table.
        units: number of units in the hidden layer. Default: ours, from the design of reflex on
            seven of HAART's people.
        updates: number of batches. Default: ours, from the design of reflex on seven of HAART's
            people.
        smoothing: share of a label that is spread over all classes, 0 to below 1. Default: ours,
            from the design of reflex on seven of HAART's people.
        clip: number of SDs at which features are clipped. Default: ours, from the design of reflex
            on seven of HAART's people.
        damaged: weight of a damaged copy of a capture (model.faults=). Default: each copy counts as
            its capture.
        seed: random seed of weights, draws and dropped units.

    Raises:
        InputError: a parameter is out of its range.
    """
    check_value("model.units", units, 1 <= units <= 4096, "1 to 4096")
    check_value("model.updates", updates, 1 <= updates <= 10_000_000, "1 to 10000000")
    check_value("model.smoothing", smoothing, 0 <= smoothing < 1, "0 to below 1")
    check_value("model.clip", clip, 0 < clip < float("inf"), "a number of SDs above 0")
    check_value("model.damaged", damaged, 0 < damaged < float("inf"), "a number above 0")
    network = Perceptron(units, updates, smoothing, clip, damaged, seed)
    return Pipeline([("features", features), ("classifier", network)])


perceptron.space = {
    "units": [10, 20, 40, 80],
    "smoothing": [0.0, 0.1, 0.3],
    "clip": Range(1.5, 6, log=True),
}
