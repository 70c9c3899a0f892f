"""Feed-forward networks on a feature set (van Wingerden et al. 2014; Jung et al. 2017)."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from sklearn.base import TransformerMixin
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import Pipeline

from bench.errors import check_value
from bench.models.by_source import SourceScaler
from bench.models.classic.scaling import RangeScaler, ZScaler
from bench.models.most_probable import MostProbable

BATCH_ROWS = 32


@dataclass(eq=False, repr=False)
class EarlyStoppedNet(MostProbable):
    """Tanh layers and a softmax, trained by Adam with early stopping on held-out captures.

    The papers train with Levenberg-Marquardt (2017) or do not say how (2014); Adam replaces both.
    Parameters are those of `mlp`.
    """

    layers: tuple[int, ...] = (54, 27)
    held: float = 0.3
    patience: int = 6
    runs: int = 5
    seed: int = 0

    def fit(self, X: np.ndarray, y: np.ndarray) -> EarlyStoppedNet:
        """Train on features [captures, n_features] and class names [captures]."""
        self.n_features_in_ = np.shape(X)[1]
        trained_rows = int(len(X) * (1 - self.held))
        networks = []
        with warnings.catch_warnings():
            # 1000 epochs are the paper's limit, not a fault
            warnings.simplefilter("ignore", ConvergenceWarning)
            for run in range(self.runs):
                network = MLPClassifier(
                    self.layers,
                    activation="tanh",
                    batch_size=min(BATCH_ROWS, trained_rows),
                    max_iter=1000,
                    early_stopping=True,
                    validation_fraction=self.held,
                    n_iter_no_change=self.patience,
                    tol=0.0,
                    random_state=self.seed * self.runs + run,
                )
                networks.append(network.fit(X, y))
        self.net_ = max(networks, key=lambda network: network.best_validation_score_)
        self.classes_ = self.net_.classes_
        return self

    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        """Class probabilities [captures, classes]."""
        return self.net_.predict_proba(X)

    @property
    def parameters_(self) -> int:
        """Number of weights and biases."""
        return sum(a.size for a in (*self.net_.coefs_, *self.net_.intercepts_))


def mlp(
    features: TransformerMixin,
    layers: str = "54+27",
    held: float = 0.3,
    patience: int = 6,
    runs: int = 5,
    scaling: str = "range",
    seed: int = 0,
) -> Pipeline:
    """Feed-forward network of tanh layers and a softmax on scaled features, with early stopping.

    Adam, in place of the Levenberg-Marquardt of Jung et al. 2017, trains it on batches of 32 for at
    most 1000 epochs.

    Args:
        features: transformer from captures to a table.
        layers: units of each hidden layer, joined by ``+``. Default: Jung et al. 2017.
        held: share of the training captures, drawn at random within each class, that decides when
            to stop. Default: Jung et al. 2017.
        patience: epochs without a better accuracy on these before training stops; the best epoch is
            kept. Default: our reading.
        runs: networks trained from different starts; the best on its held captures is kept.
            Default: Jung et al. 2017.
        scaling: ``range`` to -1..1, or ``z`` to mean 0 and SD 1, of the training captures. Default:
            Jung et al. 2017.
        seed: random seed of weights, batches and draws.
    """
    units = tuple(int(n) if n.isdecimal() else 0 for n in layers.split("+"))
    check_value("model.layers", layers, min(units) >= 1, "numbers from 1 on, joined by +")
    check_value("model.patience", patience, patience >= 1, "at least 1")
    check_value("model.runs", runs, runs >= 1, "at least 1")
    check_value("model.held", held, 0 < held < 1, "a share between 0 and 1")
    check_value("model.scaling", scaling, scaling in ("range", "z"), "range or z")
    scaler = RangeScaler((-1, 1)) if scaling == "range" else ZScaler()
    network = EarlyStoppedNet(units, held, patience, runs, seed)
    return Pipeline(
        [
            ("features", features),
            ("sources", SourceScaler()),
            ("scaler", scaler),
            ("classifier", network),
        ]
    )


mlp.space = {"layers": ["27", "54", "54+27", "108+54"], "scaling": ["range", "z"]}
