"""The evaluation of a system in a fold: fit, decide on the test captures, measure what that takes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd

from bench import contract
from bench.work.fold import ALONE, batch_effects, check_agreement, computing, decisions, footprint, latency
from bench.work.personal import met
from bench.work.results import FoldResult

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold


def evaluated(cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> tuple[contract.System, FoldResult]:
    """The fitted system of a fold, the last of several draws; predictions of the test captures, and their costs."""
    parts, effects = [], []
    share = -(-ALONE // (sum(map(len, fold.known.draws)) if fold.known else 1))
    with computing(threads):
        for one in met(cell, corpus, fold):
            parts.append(decisions(one.estimator, corpus, one.name, one.tested))
            effects += batch_effects(one.estimator, corpus, one.tested, parts[-1], share)
        if not effects:  # of other predictions in each batch
            check_agreement(one.estimator, corpus, one.tested)
        estimator, metrics, predictions = one.estimator, one.metrics, pd.concat(parts, ignore_index=True)
    with computing(1):
        spent = latency(estimator, corpus[fold.test], int(predictions["frames"].max()))
    predict_ms, decide_ms, walls, pace = spent
    metrics |= footprint(estimator, corpus) | pace
    if (searched := contract.search_seconds(estimator)) is not None:
        metrics["search_seconds"] = searched
    return estimator, FoldResult(
        fold.name,
        predictions,
        metrics,
        predict_ms,
        decide_ms,
        contract.history(estimator),
        contract.chosen(estimator),
        contract.trials(estimator),
        effects,
        times=walls,
    )
