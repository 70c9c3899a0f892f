"""What a fitted system costs to keep: learnt numbers and bytes."""

from __future__ import annotations

from sklearn.base import ClassifierMixin

BYTES = 4  # every learnt number as a 32-bit value


def parameter_count(estimator: ClassifierMixin) -> int | None:
    """Learnt numbers that a device must hold to run the classifier, None where the kind is not known.

    Networks count their weights; an SVM its support vectors, their coefficients and its intercepts; a Gaussian its
    means, covariances (upper triangle) and priors; a forest four numbers per split (feature, threshold, two children)
    and the class shares of its leaves; boosted trees four numbers per split and one per leaf.
    """
    if hasattr(estimator, "parameters_"):
        return int(estimator.parameters_)
    last = estimator[-1] if hasattr(estimator, "steps") else estimator
    if hasattr(last, "support_vectors_"):
        return int(last.support_vectors_.size + last.dual_coef_.size + last.intercept_.size)
    if hasattr(last, "means_") and hasattr(last, "scalings_"):
        classes, features = last.means_.shape
        return int(classes * (features + features * (features + 1) // 2 + 1))
    if hasattr(last, "estimators_"):
        leaves = sum(tree.get_n_leaves() for tree in last.estimators_)
        nodes = sum(tree.tree_.node_count for tree in last.estimators_)
        return int(4 * (nodes - leaves) + leaves * len(last.classes_))
    if hasattr(last, "booster_"):
        table = last.booster_.get_booster().trees_to_dataframe()
        leaves = int((table["Feature"] == "Leaf").sum())
        return 4 * (len(table) - leaves) + leaves
    return None
