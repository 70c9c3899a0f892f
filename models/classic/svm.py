"""Support vector machine, LIBSVM one against one (Jung et al. 2014 and 2017)."""

import numpy as np
from scipy.special import softmax
from sklearn.base import TransformerMixin
from sklearn.pipeline import Pipeline
from sklearn.svm import SVC

from bench.errors import check_value
from bench.models.classic.scaling import RangeScaler, ZScaler
from bench.models.space import Range

PENALTIES = [2.0**k for k in range(-5, 16, 2)]  # of the published grids


class RankedSVC(SVC):
    """An SVC whose probabilities are a softmax of its decision values.

    They rank the classes as the decision values do. scikit-learn's own probabilities come from
    inner folds that mix subjects.
    """

    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        """Softmax of the decision values [captures, classes]."""
        decision = self.decision_function(X)
        if decision.ndim == 1:
            decision = np.column_stack([-decision, decision])
        return softmax(decision, axis=1)


def svm(
    features: TransformerMixin,
    C: float = 512.0,
    gamma: float = 0.125,
    kernel: str = "rbf",
    scaling: str = "range",
) -> Pipeline:
    """Support vector machine on scaled features, LIBSVM, one against one.

    Probabilities are a softmax of the decision values; they are not calibrated.

    Args:
        features: transformer from captures to a table.
        C: penalty. Default: a point of the grid 2^-5, 2^-3, ..., 2^15 of Jung et al. 2017, chosen
            on generated captures, without test subjects.
        gamma: width of the RBF kernel; unused by ``kernel=linear``. Default: a point of the grid
            2^-15, 2^-13, ..., 2^3 of Jung et al. 2017, chosen on generated captures, without test
            subjects.
        kernel: ``rbf`` or ``linear``. Default: one of the two of Jung et al. 2017.
        scaling: ``range`` to 0..1, or ``z`` to mean 0 and SD 1, of the training captures. Default:
            Jung et al. 2017.
    """
    check_value("model.kernel", kernel, kernel in ("rbf", "linear"), "rbf or linear")
    check_value("model.scaling", scaling, scaling in ("range", "z"), "range or z")
    check_value("model.C", C, C > 0, "a value above 0")
    check_value("model.gamma", gamma, gamma > 0, "a value above 0")
    machine = RankedSVC(C=C, gamma=gamma, kernel=kernel, break_ties=True)
    scaler = RangeScaler() if scaling == "range" else ZScaler()
    return Pipeline([("features", features), ("scaler", scaler), ("classifier", machine)])


svm.space = {"C": Range(2.0**-5, 2.0**15, log=True), "gamma": Range(2.0**-15, 2.0**3, log=True)}
