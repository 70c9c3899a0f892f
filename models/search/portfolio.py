"""The search space of `bench.models.search.auto`: models, ranges, first trials, expected times.

A trial is a dict, as Optuna's are: ``model``, ``features``, what captures go through first
(``window``, ``repair``, ``faults``, ``scale`` of `bench.models.recipe.Recipe`), the share of
``columns`` that an F-test keeps, and parameters of the model as ``svm.C``.
"""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin, clone
from sklearn.feature_selection import f_classif
from sklearn.pipeline import Pipeline

from bench import contract
from bench.corpora.corpus import Corpus
from bench.corpora.windows import Windows
from bench.features.base import FeatureSet
from bench.features.jung54 import Jung54
from bench.features.touch import TouchFeatures
from bench.ground.registry import parameter_defaults
from bench.models import recipe
from bench.models.classic.lda import lda
from bench.models.classic.perceptron import perceptron
from bench.models.classic.rf import et, rf
from bench.models.classic.softmax import softmax
from bench.models.classic.svm import svm
from bench.models.classic.xgb import xgb
from bench.models.space import Range, Space, Trial

MODELS = {
    "lda": lda,
    "svm": svm,
    "softmax": softmax,
    "et": et,
    "rf": rf,
    "xgb": xgb,
    "perceptron": perceptron,
}
FEATURES: dict[str, FeatureSet] = {"touch": TouchFeatures(), "jung54": Jung54()}
COPIES = parameter_defaults(recipe.Recipe)["copies"]  # damaged, of each capture
MIN_FIT_S = 0.02  # of a fit, however small
STEP_SPACE: Space = {
    "window": [0.0, 0.5, 1.0, 2.0],
    "repair": ["", "stuck+dead"],
    "faults": ["", "all"],
    "scale": ["none", "peak"],
    "columns": [1.0, 0.5, 0.25],
}
SPACES: dict[str, Space] = {
    "lda": {"shrinkage": Range(0.02, 0.9, log=True), "windows": Range(1.0, 4.0, log=True)},
    "svm": {
        "scaling": ["z", "range"],
        "C": Range(0.5, 500.0, log=True),
        "gamma": Range(1e-4, 0.3, log=True),
    },
    "softmax": {"C": Range(1e-3, 10.0, log=True)},
    "et": {
        "trees": Range(30, 600, log=True),
        "leaf": Range(1, 8, log=True),
        "tried": Range(0.02, 0.5, log=True),
    },
    "rf": {
        "trees": Range(30, 600, log=True),
        "leaf": Range(1, 8, log=True),
        "tried": Range(0.02, 0.5, log=True),
    },
    "xgb": {
        "trees": Range(30, 600, log=True),
        "depth": Range(1, 6),
        "rate": Range(0.03, 0.3, log=True),
    },
    "perceptron": {"units": Range(8, 64, log=True), "updates": Range(300, 3000, log=True)},
}
# Cheap ones first. Chosen on generated captures in three calibrations and the training people of
# HAART's challenge split: docs/notes/systems.md, auto.
FIRST_TRIALS: list[Trial] = [
    {"model": "lda", "lda.shrinkage": 0.2},
    {"model": "lda", "window": 1.0, "lda.shrinkage": 0.2, "lda.windows": 2.0},
    {"model": "lda", "features": "jung54", "lda.shrinkage": 0.2},
    {"model": "svm", "svm.scaling": "z", "svm.C": 10.0, "svm.gamma": 0.001},
    {"model": "lda", "window": 2.0, "lda.shrinkage": 0.2, "lda.windows": 2.0},
    {"model": "softmax", "softmax.C": 0.1},
    {"model": "et", "et.trees": 200, "et.leaf": 1, "et.tried": 0.2},
    {"model": "et", "features": "jung54", "et.trees": 200, "et.leaf": 1, "et.tried": 0.2},
    {"model": "xgb", "features": "jung54", "xgb.trees": 100, "xgb.depth": 3, "xgb.rate": 0.15},
    {"model": "softmax", "window": 1.0, "softmax.C": 0.01},
    {"model": "xgb", "xgb.trees": 100, "xgb.depth": 3, "xgb.rate": 0.15},
    {"model": "perceptron", "window": 1.0, "perceptron.units": 18, "perceptron.updates": 3000},
    {"model": "xgb", "xgb.trees": 300, "xgb.depth": 4, "xgb.rate": 0.1},
]


class BestColumns(TransformerMixin, BaseEstimator):
    """Keeps the share of the columns of a table, at least one, with the largest F statistics."""

    parameters_ = 0  # features that are not kept need not be computed: nothing is stored

    def __init__(self, share: float = 0.5) -> None:
        self.share = share

    def fit(self, X: pd.DataFrame, y: np.ndarray) -> BestColumns:
        """Rank the columns [rows, n_features] by class names [rows]."""
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # of constant columns
            ratio, _ = f_classif(np.asarray(X, dtype=np.float64), y)
        ratio = np.nan_to_num(ratio, nan=-1.0, posinf=np.inf)
        count = max(1, round(self.share * X.shape[1]))
        self.kept_ = np.sort(np.argsort(-ratio, kind="stable")[:count])
        return self

    def transform(self, X: pd.DataFrame) -> pd.DataFrame:
        """The kept columns, with the index of the rows."""
        return X.iloc[:, self.kept_]


def _first_steps() -> Trial:
    """The first value of each step, which is its default."""
    return {name: list(values)[0] for name, values in STEP_SPACE.items()}


def _own_values(trial: Trial) -> Trial:
    """Parameters of a trial's model, by name."""
    prefix = f"{trial['model']}."
    return {k.removeprefix(prefix): v for k, v in trial.items() if k.startswith(prefix)}


def with_defaults(trial: Trial) -> Trial:
    """Complete a trial with the defaults of features, steps and its model."""
    model = trial["model"]
    defaults = parameter_defaults(MODELS[model])
    own = {f"{model}.{name}": defaults[name] for name in SPACES[model]}
    return {"model": model, "features": "touch"} | _first_steps() | own | trial


def make_system(trial: Trial, seed: int) -> contract.System:
    """Make the untrained system of a complete trial."""
    factory, values = MODELS[trial["model"]], _own_values(trial)
    if "seed" in parameter_defaults(factory):
        values["seed"] = seed
    classifier_steps = contract.build_system(factory, "passthrough", **values).steps[1:]
    steps = [("features", clone(FEATURES[trial["features"]]))]
    if trial["columns"] != 1:
        steps.append(("columns", BestColumns(trial["columns"])))
    pipeline = Pipeline([*steps, *classifier_steps])
    options = {name: trial[name] for name in ("window", "repair", "faults", "scale")}
    return recipe.build_recipe(lambda: pipeline, None, **options)


def expected_fit_seconds(trial: Trial, X: Corpus, width: int, classes: int) -> float:
    """Seconds that a fit of a complete trial should take on one core of 2024.

    Args:
        trial: the trial.
        X: captures.
        width: number of features.
        classes: number of classes.
    """
    width = max(1, round(width * trial["columns"]))
    window, copies = trial["window"], COPIES if trial["faults"] else 0
    rows = len(Windows(window).source_rows(X) if window else X) * (1 + copies)
    own = _own_values(trial)
    match trial["model"]:
        case "lda":
            seconds = 1e-10 * (rows + width) * width**2
        case "svm":
            seconds = 4e-10 * rows**2 * width
        case "softmax":
            seconds = 5e-8 * rows * width * classes
        case "et" | "rf" as model:
            tried = own["tried"] * width if own["tried"] else width**0.5
            factor = 1e-8 if model == "et" else 2.2e-8
            seconds = factor * own["trees"] * rows * np.log2(rows + 2) * tried
        case "xgb":
            seconds = 3.2e-9 * own["trees"] * classes * width * (rows + 1200)
        case _:  # perceptron
            seconds = own["updates"] / 3000 * (3 + 6.6e-5 * width * own["units"])
    return MIN_FIT_S + seconds


def describe_trial(trial: Trial) -> str:
    """Describe a trial, without default steps: ``lda · touch, window 1, shrinkage 0.2``."""
    steps = {k: trial[k] for k, first in _first_steps().items() if trial[k] != first}
    values = (steps | _own_values(trial)).items()
    words = [trial["features"], *(f"{name} {_format_value(value)}" for name, value in values)]
    return f"{trial['model']} · {', '.join(words)}"


def _format_value(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
