"""What a fitted system costs to keep: learnt numbers and bytes."""

from __future__ import annotations

from sklearn.base import ClassifierMixin

BYTES = 4  # every learnt number as a 32-bit value


def parameter_count(estimator: ClassifierMixin) -> int | None:
    """Learnt numbers that a device must hold to run the classifier, None where the kind is not known.

    A system may say it itself with ``parameters_``, as networks do. An SVM counts its support vectors, their
    coefficients and its intercepts; a forest four numbers per split (feature, threshold, two children) and the class
    shares of its leaves. A search is as large as what it has chosen.
    """
    chosen = getattr(estimator, "best_", estimator)
    last = chosen[-1] if hasattr(chosen, "steps") else chosen
    if hasattr(last, "parameters_"):
        return int(last.parameters_)
    if hasattr(last, "support_vectors_"):
        return int(last.support_vectors_.size + last.dual_coef_.size + last.intercept_.size)
    if hasattr(last, "coef_"):
        return int(last.coef_.size + last.intercept_.size)
    if hasattr(last, "estimators_"):
        leaves = sum(tree.get_n_leaves() for tree in last.estimators_)
        nodes = sum(tree.tree_.node_count for tree in last.estimators_)
        return int(4 * (nodes - leaves) + leaves * len(last.classes_))
    return None
