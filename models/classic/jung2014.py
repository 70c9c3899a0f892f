"""The systems of Jung 2014 (ICMI doctoral consortium) and Jung et al. 2014 (ICMI), 28 features."""

from sklearn.pipeline import Pipeline

from bench.features.jung28 import Jung28
from bench.models.classic.bayes import bayes
from bench.models.classic.svm import PENALTIES, svm
from bench.models.search.tuning import Search


def jung2014_bayes(ridge: float = 1e-2) -> Pipeline:
    """Gaussian Bayes with full covariances; the ridge is ours (`bench.models.classic.bayes.bayes`).

    Args:
        ridge: number added to the diagonal of every class covariance. Default: that of bayes.
    """
    return bayes(Jung28(), ridge)


def jung2014_svm(inner: str = "3") -> Search:
    """Linear SVM on features scaled to 0..1; its penalty, missing from the papers, is searched.

    Args:
        inner: groups of training subjects that choose it, or ``loso``.
    """
    return Search(
        {"svm": svm}, {"svm": {"kernel": ["linear"], "C": PENALTIES}}, {"jung28": Jung28()}, inner
    )
