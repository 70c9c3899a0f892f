"""The size of a fitted system: learnt numbers and bytes, counted without the author's help."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from bench import contract

if TYPE_CHECKING:
    from torch import nn

BYTES_PER_NUMBER = 4  # of a number
NOT_LEARNT = {"classes_", "n_features_in_", "feature_names_in_", "n_classes_", "n_outputs_"}


def measure_sizes(estimator: contract.System, taxels: int, frames: int) -> dict[str, int]:
    """Learnt numbers, and bytes in flash and in memory, four for each number; of systems in 8 bits one for a weight.

    ``frames`` is the length of the longest capture to label.
    """
    learnt = count_parameters(estimator)
    constants = sum(map(_count_constants, _deciding_systems(estimator)))
    saved = sum(
        contract.bytes_saved(step)
        for part in _deciding_systems(estimator)
        for step in _flatten_pipeline(part)
    )
    return {
        "parameters": learnt,
        "flash_bytes": BYTES_PER_NUMBER * (learnt + constants) - saved,
        "ram_bytes": BYTES_PER_NUMBER * count_working_numbers(estimator, taxels, frames),
    }


def count_working_numbers(estimator: contract.System, taxels: int, frames: int) -> int:
    """Numbers in memory while the system decides once.

    A network counts its input and the outputs of its layers (`nets.training.activations`). A classifier on features
    counts what the features are computed from (`bench.contract.memory_of_features`), the features, what it works in, and a score per
    class; any other system the whole capture and a score per class. What a frame goes through first is added.
    """
    frames = contract.frames_at_once(estimator, frames)
    *around, chosen = _unwrap_system(estimator)
    before = sum(contract.memory_before(part, taxels) for part in (*around, chosen))
    if together := contract.members(chosen):  # one after the other
        return before + max(count_working_numbers(member, taxels, frames) for member in together)
    if (numbers := contract.numbers_in_memory(chosen)) is not None:
        return before + int(numbers)
    classes, steps = len(chosen.classes_), _flatten_pipeline(chosen)
    width = getattr(steps[-1], "n_features_in_", None)
    if len(steps) > 1 and width:
        return int(
            before
            + contract.memory_of_features(steps[0], frames, taxels)
            + width
            + _count_classifier_work(steps[-1])
            + classes
        )
    return before + frames * taxels + classes


def _count_classifier_work(classifier: BaseEstimator) -> int:
    """Numbers that a classifier works in besides features and scores: of an SVM, the kernel of each support vector."""
    if (numbers := contract.numbers_in_memory(classifier)) is not None:
        return numbers
    return len(_instance_attributes(classifier).get("support_", ()))


def _unwrap_system(estimator: contract.System) -> list[contract.System]:
    """A search or what has steps before it, what decides in its place, and so on."""
    inner = contract.inner_system(estimator)
    return [estimator, *([] if inner is estimator else _unwrap_system(inner))]


def _deciding_systems(estimator: contract.System) -> list[contract.System]:
    """What decides in the place of a system: itself, what a search has chosen, all who decide together."""
    chosen = _unwrap_system(estimator)[-1]
    return [part for member in contract.members(chosen) for part in _deciding_systems(member)] or [
        chosen
    ]


def _count_constants(part: contract.System) -> int:
    """Numbers that must be kept besides the learnt ones: the scaling of features, what batch norms divide by."""
    if modules := [value for value in _instance_attributes(part).values() if _is_network(value)]:
        return sum(
            b.numel() for module in modules for b in module.buffers() if b.is_floating_point()
        )
    *before, last = _flatten_pipeline(part)
    return contract.constants(last) + sum(
        2 * step.n_features_in_ for step in before[1:] if _is_scaler(step)
    )


def count_parameters(estimator: contract.System) -> int:
    """Learnt numbers that a device must hold to run the classifier.

    A system or feature set that tells them (`bench.contract.learnt_numbers`) is believed. An SVM counts its support
    vectors, their coefficients and its intercepts; a linear model its coefficients and intercepts; trees two numbers
    a node (a threshold, and in one the feature and where its other child or the leaf's values are), where each begins
    (and of boosted ones, its class), and the class shares (or the value) of their leaves, equal ones of a forest once;
    a network its parameters; anything else every number that its fitted attributes hold. A search is as large as what
    it has chosen.
    """
    return sum(_count_system(part) for part in _deciding_systems(estimator))


def _count_system(part: contract.System) -> int:
    *before, last = _flatten_pipeline(part)
    features = contract.learnt_numbers(before[0]) or 0 if before else 0
    return int(
        features
        + sum(_count_learnt(step) for step in before[1:] if not _is_scaler(step))
        + _count_learnt(last)
    )


def _flatten_pipeline(estimator: contract.System) -> list[BaseEstimator]:
    """Of a pipeline, pipelines inside it included; else the estimator alone."""
    inner = _instance_attributes(estimator).get("steps")
    return [step for _, part in inner for step in _flatten_pipeline(part)] if inner else [estimator]


def _instance_attributes(part: object) -> dict[str, Any]:
    values = getattr(part, "__dict__", {})
    return values if isinstance(values, dict) else {}


def _is_scaler(step: object) -> bool:
    return "scale_" in _instance_attributes(step)


def _count_learnt(part: BaseEstimator) -> int:
    if (numbers := contract.learnt_numbers(part)) is not None:
        return int(numbers)
    if _is_network(part):
        return sum(p.numel() for p in part.parameters())
    values = _instance_attributes(part)
    if "support_" in values:  # support_vectors_ is a property of some versions
        return int(part.support_vectors_.size + part.dual_coef_.size + part.intercept_.size)
    if "coef_" in values:
        return int(np.size(part.coef_) + np.size(values.get("intercept_", ())))
    if "coefs_" in values:  # a perceptron, which keeps its optimiser as well
        return sum(a.size for a in (*part.coefs_, *part.intercepts_))
    if "tree_" in values:
        return _count_trees([part])
    if type(part).__module__.startswith("xgboost"):
        trees = (
            part.get_booster().get_dump()
        )  # a line per node; as a table it takes ten times as long
        return sum(2 * tree.count("\n") + tree.count("leaf=") + 2 for tree in trees)
    if "estimators_" in values:  # the members of an ensemble are all there is
        members = (
            [*part.estimators_.ravel()]
            if isinstance(part.estimators_, np.ndarray)
            else part.estimators_
        )
        last = [values["final_estimator_"]] if "final_estimator_" in values else []
        if not last and all("tree_" in _instance_attributes(member) for member in members):
            return _count_trees(members)
        return sum(count_parameters(member) for member in [*members, *last])
    settings = part.get_params(deep=False) if isinstance(part, BaseEstimator) else {}
    return sum(
        _count_numbers(value)
        for name, value in values.items()
        if name not in {*settings, *NOT_LEARNT}
    )


def _count_trees(members: list) -> int:
    """Two numbers a node, one a tree, and what leaves hold, equal ones once."""
    trees = [
        getattr(member.tree_, "tree_", member.tree_) for member in members
    ]  # of a tree that was pruned as well
    leaves = np.concatenate(
        [tree.value[tree.children_left < 0].reshape(-1, tree.value[0].size) for tree in trees]
    )
    distinct = ~pd.DataFrame(
        leaves.astype(np.float32)
    ).duplicated()  # by hashes: sorting rows takes ten times as long
    return sum(2 * tree.node_count + 1 for tree in trees) + int(distinct.sum()) * leaves.shape[1]


def _count_numbers(value: object) -> int:
    """Numbers that a fitted attribute holds, whatever it is made of."""
    if (
        isinstance(value, np.ndarray) and value.dtype.names and "is_leaf" in value.dtype.names
    ):  # histogram boosting
        return 2 * len(value) + int(value["is_leaf"].sum())
    if isinstance(value, np.ndarray) and value.dtype != object:
        return value.size if value.dtype.kind in "iuf" else 0
    if isinstance(value, float | np.floating):
        return 1
    if isinstance(value, np.ndarray):
        return sum(map(_count_numbers, value.ravel()))
    if isinstance(value, dict | list | tuple):
        return sum(map(_count_numbers, value.values() if isinstance(value, dict) else value))
    if isinstance(value, BaseEstimator):
        return count_parameters(value)
    return (
        _count_learnt(value)
        if _is_network(value) or type(value).__module__.startswith("sklearn.")
        else 0
    )


def _is_network(value: object) -> TypeGuard[nn.Module]:
    """A module of PyTorch, without importing it."""
    return any(
        c.__module__ == "torch.nn.modules.module" and c.__name__ == "Module"
        for c in type(value).__mro__
    )
