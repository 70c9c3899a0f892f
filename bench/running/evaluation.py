"""Evaluation of a fold, and measures of a run: fit, predict test captures, then circumstances."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus
from bench.plan.splits import SystemToTest
from bench.running.fitted import FittedFold
from bench.running.fold import (
    FittedSystem,
    check_agreement,
    find_batch_effects,
    fit_timed,
    fit_together_timed,
    limit_threads,
    measure_latency,
    memory_metrics,
    predict_to_table,
)
from bench.running.results import (
    FoldResult,
    combine_costs,
    concat_fold_tables,
    format_traceback,
    score_run,
)
from bench.values import scores
from bench.values.result import LABELS_TABLE, Result
from bench.values.stability import clean_labels, find_failing_slices

if TYPE_CHECKING:  # a change to plans must not change the key of a run
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan

ALL_FOLDS = "all"  # of windows that a protocol splits: a label needs all windows of a capture


def evaluate_fold(
    cell: Cell, corpus: Corpus, fold: Fold, threads: int, fitted_system: FittedSystem | None = None
) -> FoldResult:
    """Evaluate one fold and its circumstances; a circumstance that fails leaves the rest.

    Args:
        cell: the system, and how it is tested.
        corpus: all captures of the run.
        fold: positions of captures.
        threads: for computing.
        fitted_system: its system, if it was fitted with other folds (`fit_folds`).
    """
    corpus = captures_of_fold(cell, corpus, fold)
    if cell.run_kind:
        return cell.run_kind.evaluate_fold(cell, corpus, fold, threads)
    system, result = fit_and_predict(cell, corpus, fold, threads, fitted_system)
    fitted = FittedFold(cell, corpus, fold, system, result.table, threads)
    if cell.circumstances:
        result.tables = {LABELS_TABLE: fitted.label_unchanged()}
    for circumstance in cell.circumstances:
        try:
            case_result = circumstance.evaluate_fold(fitted)
        except (Exception, SystemExit):  # a system may raise anything
            result.failed[circumstance.key] = format_traceback()
            continue
        metrics = circumstance.fold_metrics(case_result.tables, corpus.rate_hz)
        result.metrics |= case_result.metrics
        result.times |= case_result.times
        result.batch_effects += case_result.batch_effects
        result.tables = concat_fold_tables([result, case_result])
        result.tracked_metrics |= metrics
    result.tracked_metrics |= scores.fold_accuracies(result.table) | combine_costs([result])
    return result


def captures_of_fold(cell: Cell, corpus: Corpus, fold: Fold) -> Corpus:
    """The captures of a run, as a skin reads them whose range is learned in the fold."""
    return cell.design.fit_range(corpus, fold.train) if cell.design else corpus


def fits_folds_together(cell: Cell) -> bool:
    """True if the systems of all folds are fitted at once in less time."""
    if cell.run_kind or getattr(cell.splitter, "systems", None):
        return False
    return contract.trains_together(cell.untrained_system)


def fit_folds(
    cell: Cell, corpus: Corpus, folds: Sequence[Fold], threads: int
) -> list[FittedSystem | Exception]:
    """Fit the systems of several folds at once; return each, or why it failed."""
    parts = [captures_of_fold(cell, corpus, fold)[fold.train] for fold in folds]
    with limit_threads(threads):
        return fit_together_timed([cell.estimator() for _ in folds], parts)


def fitted_systems(
    cell: Cell, corpus: Corpus, fold: Fold, fitted_system: FittedSystem | None = None
) -> Iterable[SystemToTest]:
    """Fit the systems of a fold: one, if the protocol has no others."""
    if own_systems := getattr(cell.splitter, "systems", None):
        return own_systems(cell, corpus, fold)
    if fitted_system:
        system, seconds = fitted_system
    else:
        system = cell.estimator()
        seconds = fit_timed(system, corpus[fold.train])
    name = ALL_FOLDS if corpus.steps else fold.name
    pairs = fold.pairs or [(fold.train, fold.test)]
    return [SystemToTest(name, system, tested, seconds) for _, tested in pairs]


def fit_and_predict(
    cell: Cell, corpus: Corpus, fold: Fold, threads: int, fitted_system: FittedSystem | None = None
) -> tuple[contract.System, FoldResult]:
    """Fit the systems of a fold, predict its test captures, and measure costs.

    Returns:
        The system, the last of several, and the result of the fold.
    """
    tables, effects, parts = [], [], len(fold.pairs) or 1
    with limit_threads(threads):
        for part in fitted_systems(cell, corpus, fold, fitted_system):
            system, test, metrics = part.estimator, part.tested, part.metrics
            tables.append(predict_to_table(system, corpus, part.name, test))
            effects += find_batch_effects(system, corpus, test, tables[-1], parts)
        if not effects:  # else labels differ in each batch
            check_agreement(system, corpus, test)
    predictions = pd.concat(tables, ignore_index=True)
    with limit_threads(1):
        longest = int(predictions["frames"].max())
        times, pace = measure_latency(system, corpus[fold.test], longest)
    metrics |= memory_metrics(system, corpus) | pace
    if (seconds := contract.search_seconds(system)) is not None:
        metrics["search_seconds"] = seconds
    return system, FoldResult(
        fold.name,
        predictions,
        metrics,
        contract.history(system),
        contract.chosen_values(system),
        contract.trials(system),
        effects,
        times=times,
    )


def measure_run(plan: Plan, about: Mapping[str, str], folds: list[FoldResult]) -> Result:
    """Return the run of the folds that went well, at least one, in the protocol's order.

    It has scores and costs; tables of confusions, subjects and classes; and the numbers and tables
    of each circumstance that failed in no fold. Its tags and parameters are ``about``.
    """
    if plan.cell.run_kind:
        return plan.cell.run_kind.measure_run(plan, about, folds)
    rate_hz, circumstances = plan.corpus.rate_hz, plan.cell.circumstances
    seconds = [name for each in circumstances for name in each.timing_metrics]
    scored, tables, unit = score_run(folds, rate_hz, seconds)
    fold_tables = concat_fold_tables(folds)
    numbers: dict[str, float] = {}
    failed = {key for fold in folds for key in fold.failed}
    if complete := [each for each in circumstances if each.key not in failed]:
        inputs = {"predictions": tables["predictions"], **fold_tables}
        labels, nouns = [clean_labels(fold_tables[LABELS_TABLE])], {}
        for circumstance in complete:
            own_numbers, own_tables = circumstance.measure_run(inputs, folds, rate_hz)
            numbers, tables = numbers | own_numbers, tables | own_tables
            if circumstance.has_slices:
                labels.append(circumstance.own_label_rows(inputs, rate_hz))
                nouns[circumstance.key] = circumstance.case_noun
        all_labels = pd.concat(labels, ignore_index=True)
        own_numbers, own_tables = find_failing_slices(all_labels, nouns, about["target"])
        numbers, tables = numbers | own_numbers, tables | own_tables
    return Result({**about, "unit": unit}, numbers | scored, tables | fold_tables)
