"""Gaussian Bayes with a full covariance per class (Jung et al. 2014; 2017, section 4.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, solve_triangular
from scipy.special import softmax
from sklearn.base import TransformerMixin
from sklearn.pipeline import Pipeline

from bench.errors import check_value
from bench.models.classic.scaling import ZScaler
from bench.models.most_probable import MostProbable
from bench.models.space import Range


@dataclass(eq=False, repr=False)
class GaussianBayes(MostProbable):
    """Maximum posterior under a multivariate normal per class; priors are shares of training.

    scikit-learn's `QuadraticDiscriminantAnalysis` refuses the nearly singular covariances that
    these features have.
    """

    ridge: float = 1e-2

    def fit(self, X: np.ndarray, y: np.ndarray) -> GaussianBayes:
        """Estimate means, covariances and priors from features [captures, n_features]."""
        X = np.asarray(X, dtype=np.float64)
        self.n_features_in_ = X.shape[1]
        self.classes_, codes = np.unique(y, return_inverse=True)
        self.priors_ = np.bincount(codes) / len(codes)
        self.means_ = np.stack([X[codes == c].mean(axis=0) for c in range(len(self.classes_))])
        self.factors_ = []
        for c, mean in enumerate(self.means_):
            centred = X[codes == c] - mean
            covariance = centred.T @ centred / max(len(centred) - 1, 1)
            covariance += self.ridge * np.eye(X.shape[1])
            self.factors_.append(cho_factor(covariance, lower=True)[0])
        return self

    def predict_log_proba(self, X: np.ndarray) -> np.ndarray:
        """Logarithm of prior times likelihood, up to a constant per capture [captures, classes]."""
        X = np.asarray(X, dtype=np.float64)
        scores = []
        for prior, mean, factor in zip(self.priors_, self.means_, self.factors_, strict=True):
            whitened = solve_triangular(factor, (X - mean).T, lower=True)
            distance = 0.5 * (whitened**2).sum(axis=0)
            scores.append(np.log(prior) - distance - np.log(np.diag(factor)).sum())
        return np.stack(scores, axis=1)

    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        """Posterior [captures, classes]."""
        return softmax(self.predict_log_proba(X), axis=1)

    @property
    def parameters_(self) -> int:
        """Number of learnt values: means, the triangle of each covariance, priors."""
        classes, features = self.means_.shape
        return classes * (features + features * (features + 1) // 2 + 1)

    @property
    def activations_(self) -> int:
        """Number of whitened features, which are kept for one class at a time."""
        return self.n_features_in_


def bayes(features: TransformerMixin, ridge: float = 1e-2) -> Pipeline:
    """Gaussian with covariance and prior for each class, on features standardised in training.

    Several of the 54 features of Jung et al. 2017 are linear combinations of others, so a class
    covariance is singular. The papers do not say how they dealt with this; a ridge is our reading.

    Args:
        features: transformer from captures to a table.
        ridge: number added to the diagonal of every class covariance. Default: chosen on generated
            captures, without test subjects.
    """
    check_value("model.ridge", ridge, ridge > 0, "a value above 0, such as 0.01")
    classifier = GaussianBayes(ridge)
    return Pipeline([("features", features), ("scaler", ZScaler()), ("classifier", classifier)])


bayes.space = {"ridge": Range(1e-6, 1.0, log=True)}
