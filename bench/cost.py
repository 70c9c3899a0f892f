"""What a fitted system costs to keep: learnt numbers and bytes."""

from __future__ import annotations

from sklearn.base import ClassifierMixin

BYTES = {"": 4, "_int8": 1}  # of a number, by what follows the name of the metric


def sizes(estimator: ClassifierMixin, taxels: int, frames: int) -> dict[str, int]:
    """Learnt numbers, and bytes in flash and in memory with 32 and 8 bits a number, as far as they are known.

    Args:
        estimator: fitted.
        taxels: of a frame.
        frames: of the longest capture that it must label.
    """
    found = {}
    if (parameters := parameter_count(estimator)) is not None:
        kept = parameters + constants(estimator)
        found = {"parameters": parameters} | {f"flash_bytes{k}": kept * b for k, b in BYTES.items()}
    if (numbers := working_numbers(estimator, taxels, frames)) is not None:
        found |= {f"ram_bytes{k}": numbers * b for k, b in BYTES.items()}
    return found


def working_numbers(estimator: ClassifierMixin, taxels: int, frames: int) -> int | None:
    """Numbers in memory while the system decides once, None where the kind is not known.

    A network counts its input and the outputs of its layers (`models.training.activations`). A classifier on features
    counts what the features are computed from (`features.base.FeatureSet.keeps`; the whole capture where a set does not
    say), the features, and a score per class.
    """
    chosen = getattr(estimator, "best_", estimator)
    if hasattr(chosen, "members"):  # one after the other
        numbers = [working_numbers(member, taxels, frames) for member in chosen.members]
        return None if None in numbers else max(numbers)
    if hasattr(chosen, "activations_"):
        return int(chosen.activations_)
    if hasattr(chosen, "steps") and (features := getattr(chosen[-1], "n_features_in_", None)):
        kept = chosen[0].keeps(frames, taxels) if hasattr(chosen[0], "keeps") else frames * taxels
        return int(kept + features + len(chosen.classes_))
    return None


def constants(estimator: ClassifierMixin) -> int:
    """Numbers that must be kept besides the learnt ones: the scaling of features, what batch norms divide by."""
    chosen = getattr(estimator, "best_", estimator)
    if hasattr(chosen, "members"):
        return sum(constants(member) for member in chosen.members)
    if hasattr(chosen, "net_"):
        return sum(b.numel() for b in chosen.net_.buffers() if b.is_floating_point())
    if not hasattr(chosen, "steps"):
        return 0
    return sum(2 * step.n_features_in_ for step in chosen[1:-1] if hasattr(step, "scale_"))


def parameter_count(estimator: ClassifierMixin) -> int | None:
    """Learnt numbers that a device must hold to run the classifier, None where the kind is not known.

    A classifier may say it itself with ``parameters_``, as networks do; so does a feature set that learns many numbers,
    and they are added. An SVM counts its support vectors, their coefficients and its intercepts; a forest four numbers
    per split (feature, threshold, two children) and the class shares of its leaves. A search is as large as what it has
    chosen.
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
