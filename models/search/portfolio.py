"""The search space of `bench.models.search.auto`: systems and their ranges, first trials, and expected costs.

A trial is a dict, as Optuna's are: ``model``, ``features``, what captures go through first (``window``, ``repair``,
``faults``, ``scale`` of `bench.models.recipe.Recipe`), the share of ``columns`` that an F-test keeps, and parameters of
the model as ``svm.C``.
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
# Cheap ones first. Chosen on generated captures in three calibrations and the training people of HAART's challenge
# split: docs/notes/systems.md, auto.
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
    """The share of the columns of a table, at least one, in which classes differ most by an F-test."""

    parameters_ = 0  # features that are not kept need not be computed: nothing is stored

    def __init__(self, share: float = 0.5) -> None:
        self.share = share

    def fit(self, X: pd.DataFrame, y: np.ndarray) -> BestColumns:
        """Judge the columns [rows, n_features] by class names [rows]."""
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # of columns that do not vary
            ratio = np.nan_to_num(
                f_classif(np.asarray(X, dtype=np.float64), y)[0], nan=-1.0, posinf=np.inf
            )
        count = max(1, round(self.share * X.shape[1]))
        self.kept_ = np.sort(np.argsort(-ratio, kind="stable")[:count])
        return self

    def transform(self, X: pd.DataFrame) -> pd.DataFrame:
        """The kept columns; the labels of the rows stay."""
        return X.iloc[:, self.kept_]


def with_defaults(trial: Trial) -> Trial:
    """A trial completed with the sampler's defaults."""
    usual = {"model": trial["model"], "features": "touch"} | {
        k: list(values)[0] for k, values in STEP_SPACE.items()
    }
    defaults = parameter_defaults(MODELS[str(trial["model"])])
    return (
        usual | {f"{trial['model']}.{k}": defaults[k] for k in SPACES[str(trial["model"])]} | trial
    )


def make_system(trial: Trial, seed: int) -> contract.System:
    """The untrained system of a trial."""
    name = str(trial["model"])
    values: dict[str, object] = {
        k.partition(".")[2]: v for k, v in trial.items() if k.startswith(f"{name}.")
    }
    values |= {"seed": seed} if "seed" in parameter_defaults(MODELS[name]) else {}
    steps = contract.build_system(MODELS[name], "passthrough", **values).steps[1:]
    columns = (
        [("columns", BestColumns(float(str(trial["columns"]))))] if trial["columns"] != 1 else []
    )
    pipeline = Pipeline([("features", clone(FEATURES[str(trial["features"])])), *columns, *steps])
    return recipe.build_recipe(
        lambda: pipeline, None, **{k: trial[k] for k in ("window", "repair", "faults", "scale")}
    )


def expected_fit_seconds(trial: Trial, X: Corpus, width: int, classes: int) -> float:
    """Seconds that a fit of a complete trial should take on one core of 2024, by how its work grows."""
    width = max(1, round(width * float(str(trial["columns"]))))
    window = float(str(trial["window"]))
    rows = len(Windows(window).source_rows(X) if window else X) * (
        1 + COPIES * bool(trial["faults"])
    )
    return MIN_FIT_S + _expected_classifier_seconds(trial, rows, width, classes)


def _expected_classifier_seconds(trial: Trial, rows: int, width: int, classes: int) -> float:
    def value(name: str) -> float:
        return float(str(trial[f"{trial['model']}.{name}"]))

    match trial["model"]:
        case "lda":
            return 1e-10 * (rows + width) * width**2
        case "svm":
            return 4e-10 * rows**2 * width
        case "softmax":
            return 5e-8 * rows * width * classes
        case "et" | "rf":
            tried = value("tried") * width if value("tried") else width**0.5
            return (
                (1e-8 if trial["model"] == "et" else 2.2e-8)
                * value("trees")
                * rows
                * np.log2(rows + 2)
                * tried
            )
        case "xgb":
            return 3.2e-9 * value("trees") * classes * width * (rows + 1200)
        case _:  # perceptron
            return value("updates") / 3000 * (3 + 6.6e-5 * width * value("units"))


def describe_trial(trial: Trial) -> str:
    """A trial in words: ``lda · touch, window 1, shrinkage 0.2``; default steps and columns are left out."""
    first = {k: list(values)[0] for k, values in STEP_SPACE.items()}
    parts = [f"{k} {_format_value(trial[k])}" for k in first if trial[k] != first[k]]
    parts += [f"{k.partition('.')[2]} {_format_value(v)}" for k, v in trial.items() if "." in k]
    return f"{trial['model']} · {', '.join([str(trial['features']), *parts])}"


def _format_value(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
