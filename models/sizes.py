"""What a fitted system costs to keep: learnt numbers and bytes, counted without the author's help."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np
from sklearn.base import BaseEstimator

from bench import contract

if TYPE_CHECKING:
    from torch import nn

BYTES = 4  # of a number
NOT_LEARNT = {"classes_", "n_features_in_", "feature_names_in_", "n_classes_", "n_outputs_"}


def sizes(estimator: contract.System, taxels: int, frames: int) -> dict[str, int]:
    """Learnt numbers, and bytes in flash and in memory, four for each number; of systems in 8 bits one for a weight.

    Args:
        estimator: fitted.
        taxels: of a frame.
        frames: of the longest capture that it must label.
    """
    learnt = parameter_count(estimator)
    flash = BYTES * (learnt + constants(estimator)) - _saved(estimator)
    return {
        "parameters": learnt,
        "flash_bytes": flash,
        "ram_bytes": BYTES * working_numbers(estimator, taxels, frames),
    }


def working_numbers(estimator: contract.System, taxels: int, frames: int) -> int:
    """Numbers in memory while the system decides once.

    A network counts its input and the outputs of its layers (`nets.training.activations`). A classifier on features
    counts what the features are computed from (`bench.contract.kept`), the features, what it works in, and a score per
    class; any other system the whole capture and a score per class. What a frame goes through first is added.
    """
    frames = contract.frames_at_once(estimator, frames)
    before = sum(contract.kept_before(part, taxels) for part in _layers(estimator))
    chosen = _layers(estimator)[-1]
    if together := contract.members(chosen):  # one after the other
        return before + max(working_numbers(member, taxels, frames) for member in together)
    if (told := contract.numbers_in_memory(chosen)) is not None:
        return before + int(told)
    classes = len(chosen.classes_)
    steps = _steps(chosen)
    width = getattr(steps[-1], "n_features_in_", None)
    if len(steps) > 1 and width:
        return int(before + contract.kept(steps[0], frames, taxels) + width + _beside(steps[-1]) + classes)
    return before + frames * taxels + classes


def _beside(classifier: BaseEstimator) -> int:
    """Numbers that a classifier works in besides features and scores: of an SVM, the kernel of each support vector."""
    if (told := contract.numbers_in_memory(classifier)) is not None:
        return told
    own = _own(classifier)
    return len(own["support_"]) if "support_" in own else 0


def _layers(estimator: contract.System) -> list[contract.System]:
    """A search or what has steps before it, what decides in its place, and so on."""
    found = [estimator]
    while (inner := contract.inside(found[-1])) is not found[-1]:
        found.append(inner)
    return found


def constants(estimator: contract.System) -> int:
    """Numbers that must be kept besides the learnt ones: the scaling of features, what batch norms divide by."""
    chosen = _layers(estimator)[-1]
    if together := contract.members(chosen):
        return sum(constants(member) for member in together)
    modules = [value for value in _own(chosen).values() if _is_network(value)]
    if modules:
        return sum(b.numel() for module in modules for b in module.buffers() if b.is_floating_point())
    *before, last = _steps(chosen)
    return contract.constants(last) + sum(2 * step.n_features_in_ for step in before[1:] if _scales(step))


def _saved(estimator: contract.System) -> int:
    """Bytes fewer than four for each number."""
    chosen = _layers(estimator)[-1]
    if together := contract.members(chosen):
        return sum(_saved(member) for member in together)
    return sum(contract.bytes_saved(step) for step in _steps(chosen))


def parameter_count(estimator: contract.System) -> int:
    """Learnt numbers that a device must hold to run the classifier.

    A system or feature set that tells them (`bench.contract.learnt_numbers`) is believed. An SVM counts its support
    vectors, their coefficients and its intercepts; a linear model its coefficients and intercepts; trees two numbers
    a node (a threshold, and in one the feature and where its other child or the leaf's values are), where each begins
    (and of boosted ones, its class), and the class shares (or the value) of their leaves, equal ones of a forest once;
    a network its parameters; anything else every number that its fitted attributes hold. A search is as large as what
    it has chosen.
    """
    chosen = _layers(estimator)[-1]
    if together := contract.members(chosen):
        return sum(parameter_count(member) for member in together)
    steps = _steps(chosen)
    between = sum(_learnt(step) for step in steps[1:-1] if not _scales(step))
    features = contract.learnt_numbers(steps[0]) or 0 if len(steps) > 1 else 0
    return int(features + between + _learnt(steps[-1]))


def _steps(estimator: contract.System) -> list[BaseEstimator]:
    """Of a pipeline, pipelines inside it included; else the estimator alone."""
    inner = _own(estimator).get("steps")
    return [step for _, part in inner for step in _steps(part)] if inner else [estimator]


def _own(part: object) -> dict[str, Any]:
    found = getattr(part, "__dict__", {})
    return found if isinstance(found, dict) else {}


def _scales(step: object) -> bool:
    return "scale_" in _own(step)


def _learnt(part: BaseEstimator) -> int:
    told = contract.learnt_numbers(part)
    if told is not None:
        return int(told)
    if _is_network(part):
        return sum(p.numel() for p in part.parameters())
    own = _own(part)
    if "support_" in own:  # support_vectors_ is a property of some versions
        return int(part.support_vectors_.size + part.dual_coef_.size + part.intercept_.size)
    if "coef_" in own:
        return int(np.size(part.coef_) + np.size(own.get("intercept_", ())))
    if "coefs_" in own:  # a perceptron, which keeps its optimiser as well
        return sum(a.size for a in (*part.coefs_, *part.intercepts_))
    if "tree_" in own:
        return _trees([part])
    if type(part).__module__.startswith("xgboost"):
        trees = part.get_booster().get_dump()  # a line per node; as a table it takes ten times as long
        return sum(2 * tree.count("\n") + tree.count("leaf=") + 2 for tree in trees)
    if "estimators_" in own:  # the members of an ensemble are all there is
        members: list = _flat(part.estimators_)
        last = [own["final_estimator_"]] if "final_estimator_" in own else []
        if not last and all("tree_" in _own(member) for member in members):
            return _trees(members)
        return sum(parameter_count(member) for member in [*members, *last])
    return sum(_numbers(value) for name, value in own.items() if _is_fitted(name, part))


def _trees(members: list) -> int:
    """Two numbers a node, one a tree, and what leaves hold, equal ones once."""
    trees = [getattr(member.tree_, "tree_", member.tree_) for member in members]  # of a tree that was pruned as well
    leaves = np.concatenate([tree.value[tree.children_left < 0].reshape(-1, tree.value[0].size) for tree in trees])
    return sum(2 * tree.node_count + 1 for tree in trees) + np.unique(leaves.astype(np.float32), axis=0).size


def _is_fitted(name: str, part: object) -> bool:
    """Whether an attribute was made by ``fit``; some estimators of scikit-learn keep their data behind a ``_``."""
    settings = part.get_params(deep=False) if isinstance(part, BaseEstimator) else {}
    return name not in settings and name not in NOT_LEARNT


def _numbers(value: object) -> int:
    """Numbers that a fitted attribute holds, whatever it is made of."""
    if isinstance(value, np.ndarray) and value.dtype.names and "is_leaf" in value.dtype.names:  # histogram boosting
        return 2 * len(value) + int(value["is_leaf"].sum())
    if isinstance(value, np.ndarray) and value.dtype != object:
        return value.size if value.dtype.kind in "iuf" else 0
    if isinstance(value, float | np.floating):
        return 1
    if isinstance(value, dict | list | tuple | np.ndarray):
        return sum(_numbers(each) for each in _flat(value))
    if isinstance(value, BaseEstimator):
        return parameter_count(value)
    return _learnt(value) if _is_network(value) or type(value).__module__.startswith("sklearn.") else 0


def _flat(value: dict | list | tuple | np.ndarray) -> list[object]:
    """What is in a container; arrays of objects are taken apart."""
    if isinstance(value, dict):
        return list(value.values())
    return list(value.ravel()) if isinstance(value, np.ndarray) else list(value)


def _is_network(value: object) -> TypeGuard[nn.Module]:
    """A module of PyTorch, without importing it."""
    return any(c.__module__ == "torch.nn.modules.module" and c.__name__ == "Module" for c in type(value).__mro__)
