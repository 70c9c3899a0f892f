"""The systems of Ta, Johal, Portaz, Castelli and Vaufreydaz 2015 (ICMI challenge), 273 features.

The submissions trained on manually filtered captures cannot be repeated, as the left-out captures
are not published.
"""

from sklearn.pipeline import Pipeline

from bench.features.ta273 import Ta273
from bench.models.classic.rf import rf
from bench.models.classic.svm import svm
from bench.models.search.tuning import Search


def ta2015_svm(inner: str = "3") -> Search:
    """SVM with an RBF kernel on standardised features; its grid is our reading.

    Args:
        inner: groups of training subjects that choose penalty and width, or ``loso``.
    """
    grid = {
        "scaling": ["z"],
        "C": [2.0**k for k in range(-1, 12, 2)],
        "gamma": [2.0**k for k in range(-13, -2, 2)],
    }
    return Search({"svm": svm}, {"svm": grid}, {"ta273": Ta273()}, inner)


def ta2015_rf(seed: int = 0) -> Pipeline:
    """Random forest of 1000 trees; their number is our reading."""
    return rf(Ta273(), trees=1000, seed=seed)
