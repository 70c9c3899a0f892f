"""Softmax regression (Hughes et al. 2015)."""

from sklearn.base import TransformerMixin
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import Pipeline

from bench.errors import check_value
from bench.models.classic.scaling import ZScaler
from bench.models.space import Range


def softmax(features: TransformerMixin, C: float = 1.0) -> Pipeline:
    """Softmax regression: a linear layer on standardised features, cross-entropy, L2 penalty.

    L-BFGS trains it, with at most 2000 iterations.

    Args:
        features: transformer from captures to a table.
        C: inverse strength of the penalty. Default: that of scikit-learn.
    """
    check_value("model.C", C, C > 0, "a value above 0")
    layer = LogisticRegression(C=C, max_iter=2000)
    return Pipeline([("features", features), ("scaler", ZScaler()), ("classifier", layer)])


softmax.space = {"C": Range(1e-3, 1e2, log=True)}
