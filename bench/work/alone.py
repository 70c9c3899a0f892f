"""Captures that are predicted alone, for the check of independence: a call for each, or one where that is the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeGuard

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from bench import contract
from bench.corpora.corpus import Corpus

FORESTS = {("sklearn.ensemble._forest", f"{kind}Classifier") for kind in ("RandomForest", "ExtraTrees")}  # by row


def decide_alone(estimator: contract.System, ones: Sequence[Corpus]) -> list[tuple[pd.DataFrame, np.ndarray]]:
    """`bench.contract.decide` for each of several captures alone.

    A forest of scikit-learn predicts each row of a table by itself, and a call takes as long for many rows as for one.
    What stands before it is computed for each capture alone; the forest predicts these rows in one call.

    Args:
        estimator: fitted.
        ones: captures, each in a corpus of its own.

    Raises:
        PredictionError: a label is no class, or probabilities are none.
    """
    if not _is_forest(estimator):
        return [contract.decide(estimator, one) for one in ones]
    tables = [_before_forest(estimator, one) for one in ones]
    first = tables[0]
    if any(len(one) != 1 or not _same_columns(one, first) for one in tables):
        return [contract.decide(estimator, one) for one in ones]
    rows = pd.concat(tables) if isinstance(first, pd.DataFrame) else np.concatenate(tables)
    proba = contract.probable(estimator, estimator[-1].predict_proba(rows), len(ones), "predict_proba")
    about = ({"capture": [0], "start": 0, "frames": one.lengths} for one in ones)
    return [(pd.DataFrame(each), row[None]) for each, row in zip(about, proba, strict=True)]


def _is_forest(estimator: contract.System) -> TypeGuard[Pipeline]:
    """Whether it is a pipeline that ends in a forest, both scikit-learn's own and not derived from it."""
    last = type(estimator[-1]) if isinstance(estimator, Pipeline) else type(None)
    return type(estimator) is Pipeline and (last.__module__, last.__name__) in FORESTS


def _before_forest(estimator: Pipeline, X: Corpus) -> Any:
    """The table that the last step of a pipeline predicts."""
    table: Any = contract.blinded(estimator, X)
    for _, step in estimator.steps[:-1]:
        if step not in (None, "passthrough"):
            table = step.transform(table)
    return table


def _same_columns(one: object, other: object) -> bool:
    """Whether two tables can stand below each other."""
    names = [list(t) if isinstance(t, pd.DataFrame) else None for t in (one, other)]
    return type(one) is type(other) and names[0] == names[1]
