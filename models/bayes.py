"""Gaussian Bayes with one full covariance per class (Jung et al. 2014; Jung et al. 2017, section 4.2)."""

from sklearn.base import TransformerMixin
from sklearn.discriminant_analysis import QuadraticDiscriminantAnalysis
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler


def bayes(features: TransformerMixin, ridge: float = 1e-3) -> Pipeline:
    """Maximum posterior under a multivariate normal per class.

    Several of the 54 features are linear combinations of others, so a class covariance is singular and the papers do
    not say what was done about it. Here a ridge is declared: covariance = (1 - ridge) S + ridge trace(S) / d I, on
    standardised features (docs/systems.md, bayes).

    Args:
        features: transformer from captures to a table.
        ridge: share of the mean variance that is put on the diagonal.
    """
    gaussian = QuadraticDiscriminantAnalysis(solver="eigen", shrinkage=ridge)
    return Pipeline([("features", features), ("scaler", StandardScaler()), ("classifier", gaussian)])
