"""The search over everything: feature sets, classifiers and their parameters, inside each training part."""

from __future__ import annotations

from features.balli import Balli
from features.gaus import Gaus
from features.jung54 import Jung54
from features.ta273 import Ta273
from features.touch import TouchFeatures
from models.lda import lda
from models.recipe import SEARCHED
from models.rf import et, rf
from models.softmax import softmax
from models.svm import svm
from models.tuning import Search
from models.xgb import xgb

MODELS = {"lda": lda, "svm": svm, "softmax": softmax, "rf": rf, "et": et, "xgb": xgb}


def auto(
    budget: float = 300.0,
    trials: int | None = None,
    inner: str = "3",
    objective: str = "accuracy",
    members: int = 3,
    seed: int = 0,
) -> Search:
    """The best of the classifiers on the best of the feature sets, or a few of them together.

    Whole captures or windows of a second, with or without repair and training under faults (`models.recipe.Recipe`).

    Args:
        budget: seconds of search in each fold. How far it gets depends on the machine; for a run that can be repeated
            give ``trials`` and a budget that is not reached.
        trials: combinations to try; None for as many as the budget allows.
        inner: groups of training subjects that judge, or ``loso``.
        objective: ``accuracy``, or ``accuracy+time`` for the fastest that is good enough, alone (see `Search`).
        members: how many of the best pairs of classifier and feature set decide together.
        seed: of the search and of the classifiers.
    """
    features = {"touch": TouchFeatures(), "jung54": Jung54(), "ta273": Ta273(), "balli": Balli(0), "gaus": Gaus()}
    spaces = {name: model.space | SEARCHED for name, model in MODELS.items()}
    members = members if objective == "accuracy" else min(members, 1)
    return Search(MODELS, spaces, features, inner, trials, budget, objective, seed, members)
