"""Classifiers as C: tables, and the code that uses them."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from sklearn.ensemble import ExtraTreesClassifier, RandomForestClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import Pipeline
from sklearn.tree import DecisionTreeClassifier

from bench.errors import InputError
from bench.models.classic.bayes import GaussianBayes
from bench.models.classic.lda import Discriminants
from bench.models.classic.perceptron import Perceptron
from bench.models.classic.scaling import RangeScaler, ZScaler
from bench.models.classic.svm import RankedSVC
from bench.models.classic.tree import PrunedTree
from bench.models.classic.xgb import BoostedTrees
from bench.models.out_of_distribution import UNUSUAL_SDS, GuardedDiscriminants
from bench.models.quantised import quantise_rows, split_triangle

SINGLE = np.float32
ROUNDING = 1e-6
EXPORTABLE = "reflex, lda, softmax, perceptron, bayes, svm, tree, rf, et or xgb"


@dataclass
class Decider:
    """A classifier on features as C: tables by name, and the body of the function that uses them.

    Attributes:
        arrays: tables by name; floats, or 8-bit integers.
        body: body of the function, with ``{name}`` for each of its tables and constants, and
            ``{CLASSES}``.
        comment: description of the classifier.
        buffers: lengths of the buffers of the body, by name.
        defines: constants by name.
        classes: number of classes, as C.
    """

    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    body: str = ""
    comment: str = ""
    buffers: dict[str, int] = field(default_factory=dict)
    defines: dict[str, str] = field(default_factory=dict)
    classes: str = "CLASSES"

    def render_body(self, function: str) -> str:
        """The body, for a function of a name."""
        names = {name: f"{function}_{name}" for name in self.arrays}
        names |= {name: f"{function.upper()}_{name}" for name in self.defines}
        return self.body.format(CLASSES=self.classes, **names)


def format_float(value: float) -> str:
    """A value in single precision as a C constant."""
    text = np.format_float_positional(SINGLE(value), unique=True, trim="0")
    if len(text) > 24:
        text = np.format_float_scientific(SINGLE(value), unique=True, trim="0")
    return f"{text}f"


Affine = tuple[np.ndarray, np.ndarray, np.ndarray]  # a, b and c of (x - a) b + c
Leaf = Callable[[int], int]  # from a node to the number of its leaf


def _invert_nonzero(values: np.ndarray) -> np.ndarray:
    """Reciprocals; 0 for values that are 0 or not finite."""
    return np.where(np.isfinite(values) & (values != 0), 1 / np.where(values == 0, 1, values), 0)


def _find_varying(mean: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Whether each feature varies by more than rounding, which differs in C."""
    return np.isfinite(sd) & (sd > ROUNDING * np.maximum(np.abs(mean), 1))


def _combine_scalers(steps: list, width: int) -> Affine:
    """Steps between features and classifier as (x - a) b + c."""
    scaling = np.zeros(width), np.ones(width), np.zeros(width)
    for step in steps:
        if hasattr(step, "shift_"):  # features of a person: touchbench_people.scaler
            next_scaling = step.mean_ + step.shift_, 1 / step.scale_, step.mean_
        elif isinstance(step, RangeScaler):
            lowest = np.full(width, float(step.feature_range[0]))
            next_scaling = step.data_min_, step.scale_, lowest
        elif isinstance(step, ZScaler):
            next_scaling = step.mean_, _invert_nonzero(step.scale_), np.zeros(width)
        elif isinstance(step, Pipeline):
            next_scaling = _combine_scalers([part for _, part in step.steps], width)
        else:
            raise InputError(
                f"{type(step).__name__} between features and classifier has no C; leave it out"
            )
        scaling = _chain_scalings(scaling, *next_scaling)
    return scaling


def _chain_scalings(first: Affine, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Affine:
    """One scaling after another: ((x - A) B + C - a) b + c."""
    A, B, C = first
    safe = np.where(B == 0, 1, B)
    return np.where(B == 0, A, A - (C - a) / safe), B * b, np.where(B == 0, (C - a) * b + c, c)


def _write_scaling(scaling: Affine) -> tuple[dict[str, np.ndarray], str]:
    """Tables of a scaling, and its line of C; both empty if it changes nothing."""
    a, b, c = scaling
    if not a.any() and not c.any() and (b == 1).all():
        return {}, ""
    arrays, added = {"a": a.astype(SINGLE), "b": b.astype(SINGLE)}, "0"
    if c.any():
        arrays["c"], added = c.astype(SINGLE), "{c}"
    return arrays, f"    measured(t->features, {{a}}, {{b}}, {added}, t->features);\n"


def _convert_scores(scaling: Affine, weights: np.ndarray, bias: np.ndarray, bits: int) -> Decider:
    integers, step = quantise_rows(weights, bits)
    arrays, body = _write_scaling(scaling)
    body += "    layer({weights}, {step}, {bias}, {CLASSES}, FEATURES, t->features, proba);\n"
    arrays |= {"weights": integers, "step": step, "bias": bias.astype(SINGLE)}
    return Decider(arrays, body, "weighed, class by class")


def _convert_linear(scaling: Affine, weights: np.ndarray, bias: np.ndarray, bits: int) -> Decider:
    scores = _convert_scores(scaling, weights, bias, bits)
    return replace(scores, body=scores.body + "    softmax(proba, {CLASSES});\n")


def _standardise_discriminants(
    scaling: Affine, classifier: Discriminants
) -> tuple[Affine, np.ndarray, np.ndarray]:
    """A scaling to mean 0 and SD 1, and the weights and bias after it."""
    learnt = classifier.learnt_
    varies = _find_varying(learnt.mean, learnt.sd)
    factor = np.where(varies, _invert_nonzero(learnt.sd), 0)
    standard = _chain_scalings(scaling, learnt.mean, factor, np.zeros(len(learnt.mean)))
    weights = classifier.coef_ * np.where(varies, learnt.sd, 0)
    return standard, weights, classifier.intercept_ + classifier.coef_ @ learnt.mean


def _convert_discriminants(scaling: Affine, classifier: Discriminants, bits: int) -> Decider:
    return _convert_linear(*_standardise_discriminants(scaling, classifier), bits)


def _convert_logistic(scaling: Affine, classifier: LogisticRegression, bits: int) -> Decider:
    weights, bias = classifier.coef_, classifier.intercept_
    if len(weights) == 1:  # two classes; the first one scores 0
        weights, bias = np.concatenate([0 * weights, weights]), np.concatenate([0 * bias, bias])
    return _convert_linear(scaling, weights, bias, bits)


def _convert_guarded(_: Affine, classifier: GuardedDiscriminants, bits: int) -> Decider:
    """The linear part uses the mean of undamaged rows; the network has its own."""
    linear, network = classifier.linear_, classifier.robust_
    width = classifier.n_features_in_
    mean, sd = classifier.mean_.astype(float), classifier.sd_.astype(float)
    varies = _find_varying(mean, sd)
    weights, step = quantise_rows(linear.coef_ * np.where(varies, sd, 0), bits)
    arrays = {
        "a": mean.astype(SINGLE),
        "b": np.where(varies, _invert_nonzero(sd), 0).astype(SINGLE),
        "weights": weights,
        "step": step,
        "bias": (linear.intercept_ + linear.coef_ @ mean).astype(SINGLE),
    } | _network_tables(network, bits)
    body = f"""    float *z = t->measured, network[{{CLASSES}}], unusual = 0;
    measured(t->features, {{a}}, {{b}}, 0, z);
    for (int i = 0; i < FEATURES; i++)
        unusual += !(fabsf(z[i]) <= {format_float(UNUSUAL_SDS)});
    float doubt = fminf(unusual / FEATURES / {format_float(classifier.doubt)}, 1); \
/* how much the network counts */
    layer({{weights}}, {{step}}, {{bias}}, {{CLASSES}}, FEATURES, z, proba);
    softmax(proba, {{CLASSES}});
    if (doubt > 0) {{{{
{textwrap.indent(_network_body(network, "network"), " " * 8)}\
        for (int c = 0; c < {{CLASSES}}; c++)
            proba[c] = (1 - doubt) * proba[c] + doubt * network[c];
    }}}}
"""
    units = len(network.intercepts_[0])
    comment = "linear discriminants, and a network as far as features are unusual"
    return Decider(
        arrays, body, comment, {"measured": width, "units": units}, {"UNITS": str(units)}
    )


def _network_tables(network: Perceptron, bits: int) -> dict[str, np.ndarray]:
    """Tables of a network with one hidden layer."""
    varies = _find_varying(network.mean_, network.scale_)
    scale = np.where(varies, _invert_nonzero(network.scale_), 0)
    hidden, hidden_step = quantise_rows(network.coefs_[0].T.astype(float), bits)
    last, last_step = quantise_rows(network.coefs_[1].T.astype(float), bits)
    return {
        "net_a": network.mean_,
        "net_b": scale.astype(SINGLE),
        "hidden": hidden,
        "hidden_step": hidden_step,
        "hidden_bias": network.intercepts_[0],
        "last": last,
        "last_step": last_step,
        "last_bias": network.intercepts_[1],
    }


def _network_body(network: Perceptron, proba: str) -> str:
    """C that computes the probabilities of a network into ``proba``, in the work space ``z``."""
    clip = format_float(network.clip)
    return f"""measured(t->features, {{net_a}}, {{net_b}}, 0, z);
for (int i = 0; i < FEATURES; i++)
    z[i] = fminf(fmaxf(z[i], -{clip}), {clip});
layer({{hidden}}, {{hidden_step}}, {{hidden_bias}}, {{UNITS}}, FEATURES, z, t->units);
for (int i = 0; i < {{UNITS}}; i++)
    t->units[i] = fmaxf(t->units[i], 0);
layer({{last}}, {{last_step}}, {{last_bias}}, {{CLASSES}}, {{UNITS}}, t->units, {proba});
softmax({proba}, {{CLASSES}});
"""


def _convert_perceptron(scaling: Affine, network: Perceptron, bits: int) -> Decider:
    """The scaling before it joins its own."""
    tables, units = _network_tables(network, bits), len(network.intercepts_[0])
    own = tables["net_a"].astype(float), tables["net_b"].astype(float), np.zeros(len(scaling[0]))
    a, b, _ = _chain_scalings(scaling, *own)
    tables |= {"net_a": a.astype(SINGLE), "net_b": b.astype(SINGLE)}
    body = textwrap.indent("float *z = t->measured;\n" + _network_body(network, "proba"), "    ")
    buffers = {"measured": network.n_features_in_, "units": units}
    comment = "a network with one hidden layer"
    return Decider(tables, body, comment, buffers, {"UNITS": str(units)})


def _convert_bayes(scaling: Affine, classifier: GaussianBayes, bits: int) -> Decider:
    """Whiten by forward substitution: rows of the triangle are divided by their diagonal."""
    rows, inverse, bias = [], [], []
    for prior, factor in zip(classifier.priors_, classifier.factors_, strict=True):
        row, diagonal = split_triangle(factor)
        rows.append(row)
        inverse.append(1 / diagonal)
        bias.append(np.log(prior) - np.log(diagonal).sum())
    triangle, step = quantise_rows(np.stack(rows), bits)
    arrays, body = _write_scaling(scaling)
    arrays |= {
        "triangle": triangle,
        "step": step,
        "inverse": np.concatenate(inverse).astype(SINGLE),
        "means": classifier.means_.ravel().astype(SINGLE),
        "bias": np.array(bias, SINGLE),
    }
    body += """    float *white = t->measured;
    for (int c = 0; c < {CLASSES}; c++) {{
        const touch_weight_t *row = {triangle} + c * (FEATURES * (FEATURES - 1) / 2);
        float square = 0;
        for (int i = 0; i < FEATURES; row += i++) {{
            float sum = 0;
            for (int j = 0; j < i; j++)
                sum += (float)row[j] * white[j];
            white[i] = (t->features[i] - {means}[c * FEATURES + i]) \
* {inverse}[c * FEATURES + i] - sum * {step}[c];
            square += white[i] * white[i];
        }}
        proba[c] = {bias}[c] - 0.5f * square;
    }}
    softmax(proba, {CLASSES});
"""
    buffers = {"measured": len(scaling[0])}
    return Decider(arrays, body, "a normal distribution for each class", buffers)


def _convert_svm(scaling: Affine, classifier: RankedSVC, bits: int) -> Decider:
    support = np.asarray(classifier.support_vectors_)
    width = support.shape[1]
    if classifier.kernel == "rbf":  # distances stay the same, and quantisation steps get smallest
        middle = (support.min(axis=0) + support.max(axis=0)) / 2
        support = support - middle
        scaling = _chain_scalings(scaling, middle, np.ones(width), np.zeros(width))
    # 8 bits would change one label in six on HAART: the kernels of the published grid are narrow
    vectors, step = quantise_rows(support.T, 16 if bits == 8 else bits)
    first = np.concatenate([[0], np.cumsum(classifier.n_support_)])
    arrays, body = _write_scaling(scaling)
    arrays |= {
        "vectors": vectors.T,
        "step": step,
        "dual": np.asarray(classifier._dual_coef_).ravel().astype(SINGLE),
        "intercept": np.asarray(classifier._intercept_, SINGLE),
        "first": first.astype(np.int32),
    }
    body += "    machine({CLASSES}, {LINEAR}, {GAMMA}, t->features, {vectors}, {step}, {dual}, "
    body += "{intercept}, {first}, t->measured, proba);\n"
    body += "    softmax(proba, {CLASSES});\n"
    buffers = {"measured": int(first[-1])}
    defines = {
        "LINEAR": str(int(classifier.kernel == "linear")),
        "GAMMA": format_float(classifier._gamma),
    }
    return Decider(arrays, body, "support vectors, one class against another", buffers, defines)


@dataclass
class Nodes:
    """Trees in depth-first order.

    Attributes:
        feature: feature of each node; -1 for a leaf.
        threshold: threshold of each node.
        right: distance to the right child; the number of a leaf.
        roots: first node of each tree.
    """

    feature: list[int] = field(default_factory=list)
    threshold: list[float] = field(default_factory=list)
    right: list[int] = field(default_factory=list)
    roots: list[int] = field(default_factory=list)

    def add(
        self,
        sides: tuple[np.ndarray, np.ndarray],
        feature: np.ndarray,
        threshold: np.ndarray,
        leaf: Leaf,
    ) -> None:
        """Add a tree; ``sides`` are the left and right children, ``leaf`` numbers the leaves."""
        left, right = sides
        self.roots.append(len(self.feature))
        stack: list[tuple[int, int]] = [(0, -1)]  # node, and its parent if it is a right child
        while stack:
            node, parent = stack.pop()
            position = len(self.feature)
            if parent >= 0:
                self.right[parent] = position - parent
            if left[node] >= 0:
                self.feature.append(int(feature[node]))
                self.threshold.append(float(threshold[node]))
                self.right.append(0)
                stack += [(int(right[node]), position), (int(left[node]), -1)]
            else:
                self.feature.append(-1)
                self.threshold.append(0.0)
                self.right.append(leaf(node))

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Tables of all trees."""
        if max(self.right) >= 2**16 or max(self.feature) >= 2**15:
            raise InputError("a tree or its leaves are too many for 16 bits; fit smaller trees")
        fields = [("feature", np.int16), ("right", np.uint16), ("threshold", SINGLE)]
        nodes = np.zeros(len(self.feature), dtype=fields)
        for name, _ in fields:
            nodes[name] = getattr(self, name)
        return {"nodes": nodes, "roots": np.array(self.roots, np.int32)}


def _strict_thresholds(threshold: np.ndarray) -> np.ndarray:
    """The least singles above thresholds, so that x <= t becomes x < single for single x."""
    single = threshold.astype(SINGLE)
    low = np.where(single > threshold, np.nextafter(single, SINGLE(-np.inf)), single)
    return np.nextafter(low, SINGLE(np.inf))


def _convert_forest(scaling: Affine, classifier: Any, bits: int) -> Decider:
    """Store class shares of leaves; equal ones, of which a forest has many, only once."""
    trees = getattr(classifier, "estimators_", [classifier])
    numbers: dict[bytes, int] = {}  # of leaves, by their shares
    nodes = Nodes()
    for member in trees:
        tree = member.tree_
        shares = tree.value[:, 0, :] / tree.value[:, 0, :].sum(axis=1, keepdims=True)
        shares = np.rint(shares * 127).astype(np.int8) if bits == 8 else shares.astype(SINGLE)

        def number_leaf(node: int, shares: np.ndarray = shares) -> int:
            return numbers.setdefault(shares[node].tobytes(), len(numbers))

        sides = tree.children_left, tree.children_right
        nodes.add(sides, tree.feature, _strict_thresholds(tree.threshold), number_leaf)
    arrays, body = _write_scaling(scaling)
    arrays |= nodes.to_arrays()
    arrays["shares"] = np.frombuffer(b"".join(numbers), np.int8 if bits == 8 else SINGLE)
    body += """    float sum = 0;
    for (int c = 0; c < {CLASSES}; c++)
        proba[c] = 0;
    for (int tree = 0; tree < {TREES}; tree++) {{
        int at = leaf({nodes}, {roots}[tree], t->features);
        for (int c = 0; c < {CLASSES}; c++)
            proba[c] += (float){shares}[at * {CLASSES} + c];
    }}
    for (int c = 0; c < {CLASSES}; c++)
        sum += proba[c];
    for (int c = 0; c < {CLASSES}; c++)
        proba[c] /= sum;
"""
    defines = {"TREES": str(len(trees))}
    return Decider(arrays, body, "class shares of the leaves of trees", defines=defines)


def _convert_boosted(scaling: Affine, classifier: BoostedTrees, bits: int) -> Decider:
    """Store in each leaf its share of the score of one class."""
    booster = classifier.booster_.get_booster()
    model = json.loads(bytes(booster.save_raw("json")))["learner"]["gradient_booster"]["model"]
    nodes = Nodes()
    scores: list[float] = []
    width, classes = classifier.n_features_in_, len(classifier.classes_)
    for tree in model["trees"]:
        value = np.array(tree["split_conditions"], SINGLE)

        def number_leaf(node: int, value: np.ndarray = value) -> int:
            scores.append(float(value[node]))
            return len(scores) - 1

        left, right, feature = (
            np.array(tree[k]) for k in ("left_children", "right_children", "split_indices")
        )
        nodes.add((left, right), feature, value, number_leaf)
    if len(scores) >= 2**16:
        raise InputError(
            "the trees have more leaves than 16 bits can count; fit fewer or smaller ones"
        )
    group = np.array(model["tree_info"], np.int32) + (1 if classes == 2 else 0)
    leaves, step = quantise_rows(np.array(scores, float)[None], bits)
    arrays, body = _write_scaling(scaling)
    arrays |= nodes.to_arrays() | {"scores": leaves[0], "step": step, "group": group}
    # The base score: the booster's prediction for a row of zeros, less the scores of the trees.
    zeros = np.zeros((1, width))
    margin = classifier.booster_.predict(zeros, output_margin=True).astype(float).ravel()
    if classes == 2:
        margin = np.array([0.0, margin[0]])
    sums = np.zeros(classes)
    for tree, root in enumerate(nodes.roots):
        at = root
        while nodes.feature[at] >= 0:
            at = at + 1 if nodes.threshold[at] > 0 else at + nodes.right[at]
        sums[group[tree]] += scores[nodes.right[at]]
    arrays["bias"] = (margin - sums).astype(SINGLE)
    body += """    for (int c = 0; c < {CLASSES}; c++)
        proba[c] = {bias}[c];
    for (int tree = 0; tree < {TREES}; tree++)
        proba[{group}[tree]] += \
(float){scores}[leaf({nodes}, {roots}[tree], t->features)] * {step}[0];
    softmax(proba, {CLASSES});
"""
    return Decider(arrays, body, "boosted trees", defines={"TREES": str(len(nodes.roots))})


TREES = (RandomForestClassifier, ExtraTreesClassifier, DecisionTreeClassifier)
CONVERTERS: dict[Any, Callable[[Affine, Any, int], Decider]] = {
    GuardedDiscriminants: _convert_guarded,
    Perceptron: _convert_perceptron,
    Discriminants: _convert_discriminants,
    LogisticRegression: _convert_logistic,
    GaussianBayes: _convert_bayes,
    RankedSVC: _convert_svm,
    PrunedTree: lambda scaling, classifier, bits: _convert_forest(scaling, classifier.tree_, bits),
    **dict.fromkeys(TREES, _convert_forest),
    BoostedTrees: _convert_boosted,
}


def has_c(classifier: object) -> bool:
    """Return True if a classifier, fitted or not, can become C."""
    return isinstance(classifier, tuple(CONVERTERS))


def convert_classifier(system: Pipeline, width: int, bits: int) -> Decider:
    """Convert the classifier of a fitted pipeline and the scaling before it.

    Args:
        system: features, scalers and classifier.
        width: number of features.
        bits: bits per weight, 32 or 8.
    """
    classifier = system.steps[-1][1]
    scaling = _combine_scalers([step for _, step in system.steps[1:-1]], width)
    for kind, convert in CONVERTERS.items():
        if isinstance(classifier, kind):
            return convert(scaling, classifier, bits)
    raise InputError(f"{type(classifier).__name__} has no C; use {EXPORTABLE}")
