"""The size of a fitted system: learnt numbers and bytes, counted without the author's help."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from bench import contract

if TYPE_CHECKING:
    from torch import nn

BYTES_PER_NUMBER = 4
NOT_LEARNT = {"classes_", "n_features_in_", "feature_names_in_", "n_classes_", "n_outputs_"}


def measure_sizes(estimator: contract.System, taxels: int, frames: int) -> dict[str, int]:
    """Count learnt numbers, and bytes in flash and memory: four per number, one per 8-bit weight.

    Args:
        estimator: the fitted system.
        taxels: number of taxels.
        frames: length of the longest capture to predict.
    """
    learnt = count_parameters(estimator)
    systems = _deciding_systems(estimator)
    constants = sum(map(_count_constants, systems))
    steps = [step for system in systems for step in _flatten_pipeline(system)]
    saved = sum(map(contract.bytes_saved, steps))
    return {
        "parameters": learnt,
        "flash_bytes": BYTES_PER_NUMBER * (learnt + constants) - saved,
        "ram_bytes": BYTES_PER_NUMBER * count_working_numbers(estimator, taxels, frames),
    }


def count_working_numbers(estimator: contract.System, taxels: int, frames: int) -> int:
    """Count the numbers in memory during one decision.

    A network counts its input and the outputs of its layers (`nets.training.count_activations`). A
    classifier on features counts what the features need (`bench.contract.memory_of_features`), the
    features, its working memory, and a score per class; any other system the whole capture and a
    score per class. Steps before the system are added.
    """
    frames = contract.frames_at_once(estimator, frames)
    layers = _unwrap_system(estimator)
    chosen = layers[-1]
    before = sum(contract.memory_before(layer, taxels) for layer in layers)
    if members := contract.members(chosen):  # one after another
        return before + max(count_working_numbers(member, taxels, frames) for member in members)
    if (numbers := contract.numbers_in_memory(chosen)) is not None:
        return before + int(numbers)
    classes, steps = len(chosen.classes_), _flatten_pipeline(chosen)
    features, classifier = steps[0], steps[-1]
    width = getattr(classifier, "n_features_in_", None)
    if len(steps) == 1 or not width:
        return before + frames * taxels + classes
    needed = contract.memory_of_features(features, frames, taxels)
    work = contract.numbers_in_memory(classifier)
    if work is None:  # of an SVM the kernel of each support vector
        work = len(_instance_attributes(classifier).get("support_", ()))
    return int(before + needed + width + work + classes)


def _unwrap_system(estimator: contract.System) -> list[contract.System]:
    """The system, the one inside it (of a search, or after steps), and so on."""
    inner = contract.inner_system(estimator)
    return [estimator, *([] if inner is estimator else _unwrap_system(inner))]


def _deciding_systems(estimator: contract.System) -> list[contract.System]:
    """The fitted systems that predict: the innermost one, or its members."""
    innermost = _unwrap_system(estimator)[-1]
    systems = [_deciding_systems(member) for member in contract.members(innermost)]
    return sum(systems, []) or [innermost]


def _count_constants(system: contract.System) -> int:
    """Count stored numbers that are not learnt: scales of features, statistics of batch norms."""
    networks = [value for value in _instance_attributes(system).values() if _is_network(value)]
    if networks:
        buffers = [buffer for network in networks for buffer in network.buffers()]
        return sum(buffer.numel() for buffer in buffers if buffer.is_floating_point())
    *before, last = _flatten_pipeline(system)
    scalers = [step for step in before[1:] if _is_scaler(step)]
    return contract.constants(last) + sum(2 * scaler.n_features_in_ for scaler in scalers)


def count_parameters(estimator: contract.System) -> int:
    """Count the learnt numbers that a device must store to run the classifier.

    The number of a system or feature set that states it (`bench.contract.learnt_numbers`) is used.
    An SVM counts its support vectors, their coefficients and its intercepts; a linear model its
    coefficients and intercepts; a network its parameters. Trees count two numbers a node (a
    threshold; the feature, and where its other child or the leaf's values are), one for the root
    (of boosted ones two, with the class), and the class shares or the value of each leaf, equal
    ones of a forest once. Anything else counts every number that its fitted attributes hold. A
    search counts what it has chosen.
    """
    return sum(_count_pipeline(system) for system in _deciding_systems(estimator))


def _count_pipeline(system: contract.System) -> int:
    """Count the learnt numbers of a feature set and of the steps after it but scalers."""
    *before, classifier = _flatten_pipeline(system)
    counted = [step for step in before[1:] if not _is_scaler(step)] + [classifier]
    features = contract.learnt_numbers(before[0]) or 0 if before else 0
    return int(features + sum(map(_count_learnt, counted)))


def _flatten_pipeline(estimator: contract.System) -> list[BaseEstimator]:
    """The steps of a pipeline and of pipelines inside it; else the estimator alone."""
    steps = _instance_attributes(estimator).get("steps")
    if not steps:
        return [estimator]
    return [part for _, step in steps for part in _flatten_pipeline(step)]


def _instance_attributes(part: object) -> dict[str, Any]:
    attributes = getattr(part, "__dict__", {})
    return attributes if isinstance(attributes, dict) else {}


def _is_scaler(step: object) -> bool:
    return "scale_" in _instance_attributes(step)


def _count_learnt(part: BaseEstimator) -> int:
    """Count the learnt numbers of one estimator or network, by its kind."""
    if (numbers := contract.learnt_numbers(part)) is not None:
        return int(numbers)
    if _is_network(part):
        return sum(p.numel() for p in part.parameters())
    attributes = _instance_attributes(part)
    if "support_" in attributes:  # support_vectors_ is a property in some versions
        return int(part.support_vectors_.size + part.dual_coef_.size + part.intercept_.size)
    if "coef_" in attributes:
        return int(np.size(part.coef_) + np.size(attributes.get("intercept_", ())))
    if "coefs_" in attributes:  # a perceptron, which also keeps its optimiser
        return sum(a.size for a in (*part.coefs_, *part.intercepts_))
    if "tree_" in attributes:
        return _count_trees([part])
    if type(part).__module__.startswith("xgboost"):
        trees = part.get_booster().get_dump()  # a line per node, ten times as fast as a table
        return sum(2 * tree.count("\n") + tree.count("leaf=") + 2 for tree in trees)
    if "estimators_" in attributes:
        members = part.estimators_
        members = [*(members.ravel() if isinstance(members, np.ndarray) else members)]
        if "final_estimator_" in attributes:
            members.append(part.final_estimator_)
        elif all("tree_" in _instance_attributes(member) for member in members):
            return _count_trees(members)
        return sum(map(count_parameters, members))
    parameters = part.get_params(deep=False) if isinstance(part, BaseEstimator) else {}
    not_learnt = {*parameters, *NOT_LEARNT}
    return sum(_count_numbers(v) for name, v in attributes.items() if name not in not_learnt)


def _count_trees(members: list) -> int:
    """Count two numbers a node, one a tree, and the values of leaves, equal ones once."""
    trees = [getattr(member.tree_, "tree_", member.tree_) for member in members]  # or a PrunedTree
    leaves = [tree.value[tree.children_left < 0].reshape(-1, tree.value[0].size) for tree in trees]
    values = np.concatenate(leaves).astype(np.float32)
    is_repeated = pd.DataFrame(values).duplicated()  # by hashes: sorting takes ten times as long
    return sum(2 * tree.node_count + 1 for tree in trees) + values[~is_repeated].size


def _count_numbers(value: object) -> int:
    """Count the numbers in a fitted attribute of any type."""
    if isinstance(value, np.ndarray):
        if value.dtype.names and "is_leaf" in value.dtype.names:  # histogram boosting
            return 2 * len(value) + int(value["is_leaf"].sum())
        if value.dtype == object:
            return sum(map(_count_numbers, value.ravel()))
        return value.size if value.dtype.kind in "iuf" else 0
    if isinstance(value, float | np.floating):
        return 1
    if isinstance(value, dict):
        return sum(map(_count_numbers, value.values()))
    if isinstance(value, list | tuple):
        return sum(map(_count_numbers, value))
    if isinstance(value, BaseEstimator):
        return count_parameters(value)
    is_counted = _is_network(value) or type(value).__module__.startswith("sklearn.")
    return _count_learnt(value) if is_counted else 0


def _is_network(value: object) -> TypeGuard[nn.Module]:
    """A module of PyTorch, without importing it."""
    return any(
        c.__module__ == "torch.nn.modules.module" and c.__name__ == "Module"
        for c in type(value).__mro__
    )
