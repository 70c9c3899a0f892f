"""What a fitted system costs to keep: learnt numbers and bytes."""

from __future__ import annotations

from sklearn.base import ClassifierMixin

BYTES = 4  # every learnt number as a 32-bit value


def parameter_count(estimator: ClassifierMixin) -> int | None:
    """Learnt numbers that a device must hold to run the classifier, None where the kind is not known.

    A classifier may say it itself with ``parameters_``, as networks do; a feature set that learns many numbers does,
    and they are added. An SVM counts its support vectors, their
    coefficients and its intercepts; a forest four numbers per split (feature, threshold, two children) and the class
    shares of its leaves. A search is as large as what it has chosen.
    """
    chosen = getattr(estimator, "best_", estimator)
    if hasattr(chosen, "members"):
        counts = [parameter_count(member) for member in chosen.members]
        return None if None in counts else sum(counts)
    if hasattr(chosen, "steps"):
        features, last = getattr(chosen[0], "parameters_", 0), _classifier_parameters(chosen[-1])
        return None if last is None else features + last
    return _classifier_parameters(chosen)


def _classifier_parameters(last: ClassifierMixin) -> int | None:
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
