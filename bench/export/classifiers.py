"""What each classifier becomes: tables, and the lines of C that use them."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from sklearn.ensemble import ExtraTreesClassifier, RandomForestClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import Pipeline
from sklearn.tree import DecisionTreeClassifier

from bench.errors import InputError
from models.classic.bayes import GaussianBayes
from models.classic.lda import Discriminants
from models.classic.scaling import RangeScaler, ZScaler
from models.classic.svm import RankedSVC
from models.classic.tree import PrunedTree
from models.classic.xgb import BoostedTrees
from models.out_of_distribution import UNUSUAL, Guarded
from models.person import PersonScaler
from models.quantised import lower, rounded

SINGLE = np.float32
ROUNDING = 1e-6
HAVE = "reflex, lda, softmax, bayes, svm, tree, rf, et and xgb"


@dataclass
class Decider:
    """A classifier on features as C: tables by name, and the body of the function that uses them.

    Attributes:
        arrays: by name, floats, or whole numbers of 8 bits.
        body: of ``decide``, with ``{name}`` for a table.
        about: what it is, in a comment.
        buffers: numbers in memory that the body works in, by name.
        defines: by name.
    """

    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    body: str = ""
    about: str = ""
    buffers: dict[str, int] = field(default_factory=dict)
    defines: dict[str, str] = field(default_factory=dict)


def number(value: float) -> str:
    """A C constant of a value in single precision."""
    text = np.format_float_positional(SINGLE(value), unique=True, trim="0")
    if len(text) > 24:
        text = np.format_float_scientific(SINGLE(value), unique=True, trim="0")
    return f"{text}f"


def has_c(classifier: object) -> bool:
    """Whether a classifier, fitted or not, can become C."""
    own = (Guarded, Discriminants, LogisticRegression, GaussianBayes, RankedSVC, PrunedTree, BoostedTrees)
    return isinstance(classifier, (*own, RandomForestClassifier, ExtraTreesClassifier, DecisionTreeClassifier))


def decider(system: Pipeline, width: int, bits: int) -> Decider:
    """A classifier and the scaling before it.

    Raises:
        InputError: one of them has no C.
    """
    classifier = system.steps[-1][1]
    classifier = classifier.tree_ if isinstance(classifier, PrunedTree) else classifier
    scaling = _affine([step for _, step in system.steps[1:-1]], width)
    if isinstance(classifier, Guarded):
        return _guarded(classifier, bits)
    if isinstance(classifier, Discriminants):
        known = classifier.learnt_
        varies = _varies(known.mean, known.sd)
        whole = _then(scaling, known.mean, np.where(varies, _inverse(known.sd), 0), np.zeros(width))
        weights = classifier.coef_ * np.where(varies, known.sd, 0)
        return _linear(whole, weights, classifier.intercept_ + classifier.coef_ @ known.mean, bits)
    if isinstance(classifier, LogisticRegression):
        weights, bias = classifier.coef_, classifier.intercept_
        if len(weights) == 1:
            weights, bias = np.concatenate([0 * weights, weights]), np.concatenate([0 * bias, bias])
        return _linear(scaling, weights, bias, bits)
    if isinstance(classifier, GaussianBayes):
        return _bayes(scaling, classifier, bits)
    if isinstance(classifier, RankedSVC):
        return _svm(scaling, classifier, bits)
    if isinstance(classifier, RandomForestClassifier | ExtraTreesClassifier | DecisionTreeClassifier):
        return _forest(scaling, getattr(classifier, "estimators_", [classifier]), bits)
    if isinstance(classifier, BoostedTrees):
        return _boosted(scaling, classifier, bits)
    raise InputError(f"{type(classifier).__name__} has no C: {HAVE} have")


Affine = tuple[np.ndarray, np.ndarray, np.ndarray]


def _inverse(values: np.ndarray) -> np.ndarray:
    """One by each; nothing for what never varied."""
    return np.where(np.isfinite(values) & (values != 0), 1 / np.where(values == 0, 1, values), 0)


def _varies(mean: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Which features vary by more than the rounding of single precision, which is another in C."""
    return np.isfinite(sd) & (sd > ROUNDING * np.maximum(np.abs(mean), 1))


def _affine(steps: list, width: int) -> Affine:
    """Steps between features and classifier as (x - a) b + c.

    Raises:
        InputError: one of them is no scaling.
    """
    found = np.zeros(width), np.ones(width), np.zeros(width)
    for step in steps:
        if isinstance(step, PersonScaler):
            found = _then(found, step.mean_ + step.shift_, 1 / step.scale_, step.mean_)
        elif isinstance(step, RangeScaler):
            found = _then(found, step.data_min_, step.scale_, np.full(width, float(step.feature_range[0])))
        elif isinstance(step, ZScaler):
            found = _then(found, step.mean_, _inverse(step.scale_), np.zeros(width))
        elif isinstance(step, Pipeline):
            found = _then(found, *_affine([part for _, part in step.steps], width))
        else:
            raise InputError(f"{type(step).__name__} between features and classifier has no C")
    return found


def _then(before: Affine, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Affine:
    """One scaling after another: ((x - A) B + C - a) b + c."""
    A, B, C = before
    safe = np.where(B == 0, 1, B)
    return np.where(B == 0, A, A - (C - a) / safe), B * b, np.where(B == 0, (C - a) * b + c, c)


def _measured(scaling: Affine) -> tuple[dict[str, np.ndarray], str]:
    """Tables of a scaling, and the line that does it; nothing for one that changes nothing."""
    a, b, c = scaling
    if not a.any() and not c.any() and (b == 1).all():
        return {}, ""
    arrays = {"a": a.astype(SINGLE), "b": b.astype(SINGLE)} | ({"c": c.astype(SINGLE)} if c.any() else {})
    return arrays, f"    measured(t->features, {{a}}, {{b}}, {'{c}' if c.any() else '0'}, t->features);\n"


def _linear(scaling: Affine, weights: np.ndarray, bias: np.ndarray, bits: int) -> Decider:
    w, step = rounded(weights, bits)
    arrays, measured = _measured(scaling)
    body = (
        measured + "    layer({weights}, {step}, {bias}, CLASSES, FEATURES, t->features, proba);\n    softmax(proba);\n"
    )
    return Decider(arrays | {"weights": w, "step": step, "bias": bias.astype(SINGLE)}, body, "weighed, class by class")


def _guarded(classifier: Guarded, bits: int) -> Decider:
    """Both classifiers measure from the same mean, that of undamaged rows; the network has its own besides."""
    linear, network = classifier.linear_, classifier.robust_
    width = classifier.n_features_in_
    mean, sd = classifier.mean_.astype(float), classifier.sd_.astype(float)
    varies = _varies(mean, sd)
    weights, step = rounded(linear.coef_ * np.where(varies, sd, 0), bits)
    hidden, hidden_step = rounded(network.coefs_[0].T.astype(float), bits)
    last, last_step = rounded(network.coefs_[1].T.astype(float), bits)
    arrays = {
        "a": mean.astype(SINGLE),
        "b": np.where(varies, _inverse(sd), 0).astype(SINGLE),
        "weights": weights,
        "step": step,
        "bias": (linear.intercept_ + linear.coef_ @ mean).astype(SINGLE),
        "net_a": network.mean_,
        "net_b": np.where(_varies(network.mean_, network.scale_), _inverse(network.scale_), 0).astype(SINGLE),
        "hidden": hidden,
        "hidden_step": hidden_step,
        "hidden_bias": network.intercepts_[0],
        "last": last,
        "last_step": last_step,
        "last_bias": network.intercepts_[1],
    }
    body = f"""    float *z = t->measured, network[CLASSES], unusual = 0;
    measured(t->features, {{a}}, {{b}}, 0, z);
    for (int i = 0; i < FEATURES; i++)
        unusual += !(fabsf(z[i]) <= {number(UNUSUAL)});
    float doubt = fminf(unusual / FEATURES / {number(classifier.doubt)}, 1); /* how much the network counts */
    layer({{weights}}, {{step}}, {{bias}}, CLASSES, FEATURES, z, proba);
    softmax(proba);
    if (doubt > 0) {{{{
        measured(t->features, {{net_a}}, {{net_b}}, 0, z);
        for (int i = 0; i < FEATURES; i++)
            z[i] = fminf(fmaxf(z[i], -{number(network.clip)}), {number(network.clip)});
        layer({{hidden}}, {{hidden_step}}, {{hidden_bias}}, UNITS, FEATURES, z, t->units);
        for (int i = 0; i < UNITS; i++)
            t->units[i] = fmaxf(t->units[i], 0);
        layer({{last}}, {{last_step}}, {{last_bias}}, CLASSES, UNITS, t->units, network);
        softmax(network);
        for (int c = 0; c < CLASSES; c++)
            proba[c] = (1 - doubt) * proba[c] + doubt * network[c];
    }}}}
"""
    units = len(network.intercepts_[0])
    about = "linear discriminants, and a network as far as features are unusual"
    return Decider(arrays, body, about, {"measured": width, "units": units}, {"UNITS": str(units)})


def _bayes(scaling: Affine, classifier: GaussianBayes, bits: int) -> Decider:
    """Whitening by forward substitution: rows of the triangle divided by their diagonal."""
    rows, inverse, bias = [], [], []
    for prior, factor in zip(classifier.priors_, classifier.factors_, strict=True):
        row, diagonal = lower(factor)
        rows.append(row)
        inverse.append(1 / diagonal)
        bias.append(np.log(prior) - np.log(diagonal).sum())
    triangle, step = rounded(np.stack(rows), bits)
    scaled, measured = _measured(scaling)
    arrays = scaled | {
        "triangle": triangle,
        "step": step,
        "inverse": np.concatenate(inverse).astype(SINGLE),
        "means": classifier.means_.ravel().astype(SINGLE),
        "bias": np.array(bias, SINGLE),
    }
    body = (
        measured
        + """    float *white = t->measured;
    for (int c = 0; c < CLASSES; c++) {{
        const weight_t *row = {triangle} + c * (FEATURES * (FEATURES - 1) / 2);
        float square = 0;
        for (int i = 0; i < FEATURES; row += i++) {{
            float sum = 0;
            for (int j = 0; j < i; j++)
                sum += (float)row[j] * white[j];
            white[i] = (t->features[i] - {means}[c * FEATURES + i]) * {inverse}[c * FEATURES + i] - sum * {step}[c];
            square += white[i] * white[i];
        }}
        proba[c] = {bias}[c] - 0.5f * square;
    }}
    softmax(proba);
"""
    )
    return Decider(arrays, body, "a normal distribution for each class", {"measured": len(scaling[0])})


def _svm(scaling: Affine, classifier: RankedSVC, bits: int) -> Decider:
    given = np.asarray(classifier.support_vectors_)
    if classifier.kernel == "rbf":  # distances stay the same, and a step for each feature is as small as can be
        middle = (given.min(axis=0) + given.max(axis=0)) / 2
        given, scaling = given - middle, _then(scaling, middle, np.ones(given.shape[1]), np.zeros(given.shape[1]))
    # 8 bits would change one label in six on HAART: the kernels of the published grid are narrow
    vectors, step = rounded(given.T, 16 if bits == 8 else bits)
    first = np.concatenate([[0], np.cumsum(classifier.n_support_)])
    scaled, measured = _measured(scaling)
    arrays = scaled | {
        "vectors": vectors.T,
        "step": step,
        "dual": np.asarray(classifier._dual_coef_).ravel().astype(SINGLE),
        "intercept": np.asarray(classifier._intercept_, SINGLE),
        "first": first.astype(np.int32),
    }
    given = "{vectors}, {step}, {dual}, {intercept}, {first}"
    body = f"{measured}    machine(t->features, {given}, t->measured, proba);\n"
    body += "    softmax(proba);\n"
    buffers = {"measured": int(first[-1])}
    defines = {"LINEAR_KERNEL": str(int(classifier.kernel == "linear")), "GAMMA": number(classifier._gamma)}
    return Decider(arrays, body, "support vectors, one class against another", buffers, defines)


@dataclass
class Nodes:
    """Trees in depth-first order: feature (-1 of a leaf), threshold, and how far the right child is (or which leaf)."""

    feature: list[int] = field(default_factory=list)
    threshold: list[float] = field(default_factory=list)
    right: list[int] = field(default_factory=list)
    roots: list[int] = field(default_factory=list)

    def add(self, left: np.ndarray, right: np.ndarray, feature: np.ndarray, threshold: np.ndarray, leaf: Any) -> None:
        """One tree; ``leaf(node)`` says which leaf a node is."""
        self.roots.append(len(self.feature))
        waiting: list[tuple[int, int]] = [(0, -1)]
        while waiting:
            node, parent = waiting.pop()
            if parent >= 0:
                self.right[parent] = len(self.feature) - parent
            place = len(self.feature)
            split = left[node] >= 0
            self.feature.append(int(feature[node]) if split else -1)
            self.threshold.append(float(threshold[node]) if split else 0.0)
            self.right.append(0 if split else leaf(node))
            if split:
                waiting += [(int(right[node]), place), (int(left[node]), -1)]

    def arrays(self) -> dict[str, np.ndarray]:
        """Tables of all trees.

        Raises:
            InputError: a tree or a table of leaves is too large for 16 bits.
        """
        if max(self.right) >= 2**16 or max(self.feature) >= 2**15:
            raise InputError("a tree or its leaves are too many for 16 bits; fit smaller trees")
        kind = [("feature", np.int16), ("right", np.uint16), ("threshold", SINGLE)]
        nodes = np.zeros(len(self.feature), dtype=kind)
        nodes["feature"], nodes["right"], nodes["threshold"] = self.feature, self.right, self.threshold
        return {"nodes": nodes, "roots": np.array(self.roots, np.int32)}


def _at_most(threshold: np.ndarray) -> np.ndarray:
    """Least single that is above a threshold: x <= t is x < that, for every single x."""
    single = threshold.astype(SINGLE)
    low = np.where(single > threshold, np.nextafter(single, SINGLE(-np.inf)), single)
    return np.nextafter(low, SINGLE(np.inf))


def _forest(scaling: Affine, trees: list, bits: int) -> Decider:
    """Class shares of leaves, each once, which many leaves of a forest have in common."""
    known: dict[bytes, int] = {}
    shares: list[np.ndarray] = []
    nodes = Nodes()
    for member in trees:
        tree = member.tree_
        values = tree.value[:, 0, :] / tree.value[:, 0, :].sum(axis=1, keepdims=True)

        def leaf(node: int, values: np.ndarray = values) -> int:
            value = np.rint(values[node] * 127) if bits == 8 else values[node].astype(SINGLE)
            if value.tobytes() not in known:
                known[value.tobytes()] = len(shares)
                shares.append(value)
            return known[value.tobytes()]

        nodes.add(tree.children_left, tree.children_right, tree.feature, _at_most(tree.threshold), leaf)
    table = np.stack(shares).astype(np.int8 if bits == 8 else SINGLE)
    scaled, measured = _measured(scaling)
    body = (
        measured
        + """    float sum = 0;
    for (int c = 0; c < CLASSES; c++)
        proba[c] = 0;
    for (int tree = 0; tree < TREES; tree++) {{
        int at = leaf({nodes}, {roots}[tree], t->features);
        for (int c = 0; c < CLASSES; c++)
            proba[c] += (float){shares}[at * CLASSES + c];
    }}
    for (int c = 0; c < CLASSES; c++)
        sum += proba[c];
    for (int c = 0; c < CLASSES; c++)
        proba[c] /= sum;
"""
    )
    arrays = scaled | nodes.arrays() | {"shares": table.ravel()}
    return Decider(arrays, body, "class shares of the leaves of trees", defines={"TREES": str(len(trees))})


def _boosted(scaling: Affine, classifier: BoostedTrees, bits: int) -> Decider:
    """Leaves hold a share of the score of one class."""
    booster = classifier.booster_.get_booster()
    model = json.loads(bytes(booster.save_raw("json")))["learner"]["gradient_booster"]["model"]
    nodes, scores = Nodes(), []
    width, classes = classifier.n_features_in_, len(classifier.classes_)
    for tree in model["trees"]:
        value = np.array(tree["split_conditions"], SINGLE)

        def leaf(node: int, value: np.ndarray = value) -> int:
            scores.append(value[node])
            return len(scores) - 1

        nodes.add(*(np.array(tree[k]) for k in ("left_children", "right_children", "split_indices")), value, leaf)
    if len(scores) >= 2**16:
        raise InputError("the trees have more leaves than 16 bits can count; fit fewer or smaller ones")
    group = np.array(model["tree_info"], np.int32) + (1 if classes == 2 else 0)
    scaled, measured = _measured(scaling)
    leaves, step = rounded(np.array(scores, float)[None], bits)
    arrays = scaled | nodes.arrays() | {"scores": leaves[0], "step": step, "group": group}
    told = np.atleast_2d(classifier.booster_.predict(np.zeros((1, width)), output_margin=True).astype(float))
    told = told.reshape(1, -1)
    sums = np.zeros(classes)
    for tree, root in enumerate(nodes.roots):
        at = root
        while nodes.feature[at] >= 0:
            at = at + 1 if nodes.threshold[at] > 0 else at + nodes.right[at]
        sums[group[tree]] += float(scores[nodes.right[at]])
    arrays["bias"] = (np.array([0.0, told[0, 0]]) - sums if classes == 2 else told[0] - sums).astype(SINGLE)
    body = (
        measured
        + """    for (int c = 0; c < CLASSES; c++)
        proba[c] = {bias}[c];
    for (int tree = 0; tree < TREES; tree++)
        proba[{group}[tree]] += (float){scores}[leaf({nodes}, {roots}[tree], t->features)] * {step}[0];
    softmax(proba);
"""
    )
    return Decider(arrays, body, "boosted trees", defines={"TREES": str(len(nodes.roots))})
