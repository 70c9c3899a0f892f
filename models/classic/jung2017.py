"""The five systems of Jung et al. 2017 (J Multimodal User Interfaces 11:81-96), 54 features.

Penalties, widths and pruning levels are the paper's grids. It chooses by leaving one of the 30
training subjects out, which is ``inner=loso`` here; three groups of subjects choose as well in a
fraction of the time (docs/notes/systems.md), so ``inner``, the number of groups of training
subjects that choose, is 3 in each.
"""

from sklearn.pipeline import Pipeline

from bench.features.jung54 import Jung54
from bench.models.classic.bayes import bayes
from bench.models.classic.mlp import mlp
from bench.models.classic.svm import PENALTIES, svm
from bench.models.classic.tree import tree
from bench.models.search.tuning import Search

WIDTHS = [2.0**k for k in range(-15, 4, 2)]


def jung2017_bayes(ridge: float = 1e-2) -> Pipeline:
    """Gaussian Bayes with full covariances; the ridge is ours (`bench.models.classic.bayes.bayes`).

    Args:
        ridge: number added to the diagonal of every class covariance. Default: that of bayes.
    """
    return bayes(Jung54(), ridge)


def jung2017_tree(inner: str = "3", seed: int = 0) -> Search:
    """Pruned decision tree, its pruning level searched.

    Args:
        inner: groups of training subjects that choose it, or ``loso``.
        seed: random seed of the order in which equal splits are tried.
    """
    return Search({"tree": tree}, {"tree": tree.space}, {"jung54": Jung54()}, inner, seed=seed)


def jung2017_svm_linear(inner: str = "3") -> Search:
    """Linear SVM on features scaled to 0..1, its penalty searched.

    Args:
        inner: groups of training subjects that choose it, or ``loso``.
    """
    return Search(
        {"svm": svm}, {"svm": {"kernel": ["linear"], "C": PENALTIES}}, {"jung54": Jung54()}, inner
    )


def jung2017_svm_rbf(inner: str = "3") -> Search:
    """SVM with an RBF kernel on features scaled to 0..1, penalty and width searched.

    Args:
        inner: groups of training subjects that choose them, or ``loso``.
    """
    return Search(
        {"svm": svm}, {"svm": {"C": PENALTIES, "gamma": WIDTHS}}, {"jung54": Jung54()}, inner
    )


def jung2017_nn(seed: int = 0) -> Pipeline:
    """Network of 54 and 27 units on -1..1, best of five runs, stopped on 30 % of the captures.

    Adam stands in for the paper's Levenberg-Marquardt.
    """
    return mlp(Jung54(), seed=seed)
