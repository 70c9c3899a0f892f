"""The evaluation of a system, as ``bench run``, ``bench tune`` and ``bench choose over=`` make it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import pandas as pd

from bench import contract
from bench.measures import Measure, columns, run_columns
from bench.outcomes import scores
from bench.outcomes.results import FoldResult, costs, measure, table_of
from bench.result import Result
from bench.work.experiment import Experiment
from bench.work.fold import ALONE, batch_effects, computing, decisions, footprint, latency
from bench.work.personal import met

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan


@dataclass(frozen=True)
class Evaluation(Experiment):
    """Fit on the training captures, decide on the test captures, measure accuracy and costs."""

    kind: ClassVar[str] = "cell"
    fold_kind: ClassVar[str] = "fold"
    heading: ClassVar[str] = "Accuracy in percent; SD over subjects"
    ranked: ClassVar[bool] = True
    searches: ClassVar[bool] = True
    adapts: ClassVar[bool] = True

    @classmethod
    def measures(cls) -> list[Measure]:
        """The columns of runs that a terminal shows."""
        return columns(run_columns(), "terminal")

    def command(self, cell: Cell) -> str:
        """``run``, ``tune`` or ``choose``, as the cell is searched or not."""
        return "run" if not cell.tuning else "choose" if "over" in cell.tuning else "tune"

    def fold(self, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
        """Predictions of the test captures, and their costs."""
        parts, effects = [], []
        share = -(-ALONE // (sum(map(len, fold.known.draws)) if fold.known else 1))
        with computing(threads):
            for one in met(cell, corpus, fold):
                parts.append(decisions(one.estimator, corpus, one.name, one.tested))
                effects += batch_effects(one.estimator, corpus, one.tested, parts[-1], share)
            estimator, metrics, predictions = one.estimator, one.metrics, pd.concat(parts, ignore_index=True)
        with computing(1):
            spent = latency(estimator, corpus[fold.test], int(predictions["frames"].max()))
        predict_ms, decide_ms, relative = spent
        metrics |= footprint(estimator, corpus) | relative
        if (searched := contract.search_seconds(estimator)) is not None:
            metrics["search_seconds"] = searched
        return FoldResult(
            fold.name,
            predictions,
            metrics,
            predict_ms,
            decide_ms,
            contract.history(estimator),
            contract.chosen(estimator),
            contract.trials(estimator),
            effects,
        )

    def fold_metrics(self, result: FoldResult, rate_hz: float) -> dict[str, float]:
        """Scores and costs of one fold."""
        return scores.accuracies(result.table) | costs([result])

    def result(self, plan: Plan, about: Mapping[str, str], folds: list[FoldResult]) -> Result:
        """Scores and costs of the whole run; confusions, subjects and classes."""
        predictions = table_of(folds)
        labelled, classes = scores.captures(predictions), scores.classes_of(predictions)
        tables = {
            "predictions": predictions,
            "confusion": scores.confusion(labelled, classes).rename_axis("true").reset_index(),
            "per_subject": scores.per_subject(labelled),
            "per_class": scores.per_class(labelled, classes),
        }
        unit = "window" if len(predictions) > len(labelled) else "capture"
        return Result({**about, "unit": unit}, measure(predictions, folds, plan.corpus.rate_hz), tables)
