"""What is done in a fold, and what is measured of a run: fit, decide on the test captures, and each circumstance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import pandas as pd

from bench import contract
from bench.ground.words import LABELS
from bench.plan.splits import Tested
from bench.running.fold import (
    batch_effects,
    check_agreement,
    computing,
    decisions,
    fitted,
    footprint,
    latency,
)
from bench.running.results import FoldResult, costs, failure, measured, tables_of
from bench.values import scores
from bench.values.result import Result

ALL_FOLDS = "all"  # of predictions of windows that a protocol deals to folds: a capture's label needs all its windows

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan


def folded(cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
    """One fold with its tracked numbers; a circumstance that fails leaves the rest."""
    if cell.study:
        result = cell.study.fold(cell, corpus, fold, threads)
        result.scored = cell.study.fold_metrics(result, corpus.rate_hz)
        return result
    system, result = evaluated(cell, corpus, fold, threads)
    if cell.circumstances:
        from bench.running.fitted import Fitted

        at = Fitted(cell, corpus, fold, system, result.table, threads)
        result.tables = {LABELS: at.clean()}
    for circumstance in cell.circumstances:
        try:
            done = circumstance.fold(at)
        except (Exception, SystemExit):  # a system may raise anything
            result.failed[circumstance.key] = failure()
            continue
        result.metrics |= done.metrics
        result.times |= done.times
        result.batch_effects += done.batch_effects
        for name, table in done.tables.items():
            before = [result.tables[name]] if name in result.tables else []
            result.tables[name] = pd.concat([*before, table], ignore_index=True)
        result.scored |= circumstance.fold_metrics(result, corpus.rate_hz)
    result.scored |= scores.accuracies(result.table) | costs([result])
    return result


def systems(cell: Cell, corpus: Corpus, fold: Fold) -> Iterable[Tested]:
    """The fitted systems of a fold: one, if the protocol has no others."""
    if own := getattr(cell.splitter, "systems", None):
        return own(cell, corpus, fold)
    estimator = cell.estimator()
    seconds = fitted(estimator, corpus[fold.train])
    name = ALL_FOLDS if corpus.steps else fold.name
    return [
        Tested(name, estimator, tested, seconds)
        for _, tested in fold.pairs or [(fold.train, fold.test)]
    ]


def evaluated(
    cell: Cell, corpus: Corpus, fold: Fold, threads: int
) -> tuple[contract.System, FoldResult]:
    """The fitted system of a fold, the last of several; predictions of the test captures, and their costs."""
    parts, effects = [], []
    with computing(threads):
        for one in systems(cell, corpus, fold):
            parts.append(decisions(one.estimator, corpus, one.name, one.tested))
            effects += batch_effects(
                one.estimator, corpus, one.tested, parts[-1], len(fold.pairs) or 1
            )
        if not effects:  # of other predictions in each batch
            check_agreement(one.estimator, corpus, one.tested, parts[-1])
        estimator, metrics, predictions = (
            one.estimator,
            one.metrics,
            pd.concat(parts, ignore_index=True),
        )
    with computing(1):
        predict_ms, decide_ms, walls, pace = latency(
            estimator, corpus[fold.test], int(predictions["frames"].max())
        )
    metrics |= footprint(estimator, corpus) | pace
    if (searched := contract.search_seconds(estimator)) is not None:
        metrics["search_seconds"] = searched
    told = contract.history(estimator), contract.chosen(estimator), contract.trials(estimator)
    return estimator, FoldResult(
        fold.name,
        predictions,
        metrics,
        predict_ms,
        decide_ms,
        *told,
        batch_effects=effects,
        times=walls,
    )


def run_of(plan: Plan, about: Mapping[str, str], folds: list[FoldResult]) -> Result:
    """The run from the folds that went well, at least one, in the order of the protocol.

    Scores and costs; confusions, subjects and classes; what each circumstance changes, where it failed in no fold.
    """
    if plan.cell.study:
        return plan.cell.study.result(plan, about, folds)
    rate_hz = plan.corpus.rate_hz
    numbers, tables, unit = measured(
        folds, rate_hz, [name for c in plan.cell.circumstances for name in c.spent]
    )
    stored = tables_of(folds)
    more: dict[str, float] = {}
    whole = [c for c in plan.cell.circumstances if not any(c.key in fold.failed for fold in folds)]
    if whole:
        from bench.values.stability import sliced, unharmed

        every = {"predictions": tables["predictions"], **stored}
        for circumstance in whole:
            own, made = circumstance.result(every, folds, rate_hz)
            more, tables = more | own, tables | made
        tested = [c for c in whole if c.sliced]
        labels = pd.concat(
            [unharmed(stored[LABELS]), *(c.labels(every, rate_hz) for c in tested)],
            ignore_index=True,
        )
        own, made = sliced(labels, {c.key: c.word for c in tested}, about["target"])
        more, tables = more | own, tables | made
    return Result({**about, "unit": unit}, more | numbers, tables | stored)
