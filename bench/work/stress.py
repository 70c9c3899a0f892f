"""Systems under stress: fitted once on the training captures as they are, tested under every fault and severity.

The table of a fold has one row per tested capture and circumstance: ``fold``, ``capture``, ``length`` (frames, clean),
``fault`` (``none`` for clean captures), ``severity`` (0 to 5), ``amount`` (what that is in the fault's unit),
``train_subjects`` (how many subjects the system was fitted on), ``true``, ``predicted``, ``p_true`` (probability of the
true class), and the columns of the corpus's captures (``subject`` and conditions).
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus
from bench.corpora.faults import SEVERITIES, Fault, all_faults, as_shares, damaged
from bench.errors import InputError
from bench.measures import Cell as Shown
from bench.measures import Measure, Row, percent, text
from bench.outcomes import scores, stability
from bench.outcomes.results import FoldResult, table_of
from bench.result import Result
from bench.usual import CLEAN
from bench.work.experiment import Experiment
from bench.work.fold import SOME, batch_effects, computing, decisions, fitted

if TYPE_CHECKING:
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan
    from bench.source import Code


Columns = dict[str, np.ndarray | str | int]  # of every row the same, or a value each


@dataclass(frozen=True)
class Stress(Experiment):
    """Accuracy under faults, and with fewer training subjects.

    Attributes:
        faults: faults applied to the test captures, each at every severity.
        train_subjects: numbers of training subjects that the system is fitted on besides, for clean test captures.
    """

    kind: ClassVar[str] = "stress"
    fold_kind: ClassVar[str] = "stress_fold"
    heading: ClassVar[str] = "Accuracy in percent of clean captures, and mean loss in points over all faults"
    columns: ClassVar[frozenset[str]] = stability.COLUMNS

    faults: tuple[Fault, ...] = ()
    train_subjects: tuple[int, ...] = ()

    def options(self) -> dict[str, object]:
        """Names of the faults, numbers of subjects."""
        return {
            "faults": ", ".join(f.name for f in self.faults) or CLEAN,
            "train_subjects": ", ".join(map(str, self.train_subjects)) or "all",
        }

    def identity(self) -> object:
        """Names, units and amounts of the faults, numbers of subjects."""
        return [(f.name, f.unit, f.amounts, f.sensor) for f in self.faults], self.train_subjects

    def arguments(self) -> dict[str, str]:
        """Faults if they are not all, numbers of subjects if there are any."""
        names = ",".join(f.name for f in self.faults) or CLEAN
        faults = {} if self.faults == tuple(all_faults().values()) else {"faults": names}
        counts = ",".join(map(str, self.train_subjects))
        return faults | ({"train_subjects": counts} if counts else {})

    def depends(self) -> list[Code]:
        """The code of the faults, too."""
        return [Stress, *(f.damage for f in self.faults)]

    def refuse(self, plan: Plan) -> None:
        """Refuse numbers of training subjects that a fold has not, or that the system cannot learn from.

        Raises:
            InputError: one of them.
        """
        estimator, corpus = plan.cell.untrained, plan.corpus
        for fold in plan.folds:
            subjects = len(set(corpus.subjects[fold.train]))
            for count in self.train_subjects:
                if count >= subjects:
                    raise InputError(
                        f"train_subjects={count}: fold {fold.name} of protocol={plan.cell.protocol} has {subjects} "
                        f"training subjects; give fewer than that (all of them are always used too)"
                    )
                part = subset(corpus, fold.train, fold.test, count, plan.cell.seed or 0)
                contract.check_training(estimator, corpus[part], corpus.gestures[part])

    def fold(self, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
        """Fit on the clean training captures, decide on the test captures as they are and under every fault."""
        name, train, test = fold.name, fold.train, fold.test
        estimator = cell.estimator()
        with computing(threads):
            fit_seconds = fitted(estimator, corpus[train])["fit_seconds"]
            begun, cpu = time.perf_counter(), time.process_time()
            every: Columns = {"length": corpus.lengths[test], "train_subjects": len(set(corpus.subjects[train]))}
            clean: Columns = every | {"fault": CLEAN, "severity": 0, "amount": ""}
            parts = [labelled(estimator, corpus, name, test, clean)]
            shares = as_shares(corpus, test)
            for fault in self.faults:
                for severity in range(1, SEVERITIES + 1):
                    worse = damaged(corpus, test, shares, fault, severity)
                    harm: Columns = {"fault": fault.name, "severity": severity, "amount": fault.describe(severity)}
                    parts.append(labelled(estimator, worse, name, test, every | harm))
            tested, cpu = time.perf_counter(), time.process_time() - cpu
            effects = batch_effects(estimator, corpus, test)
            effects += batch_effects(estimator, worse, test, most=SOME) if self.faults else []
            trained = set(contract.trained_faults(estimator))  # of a search by what it has chosen
            for count in self.train_subjects:
                part = subset(corpus, train, test, count, cell.seed or 0)
                estimator = cell.estimator().fit(corpus[part], corpus.gestures[part])
                parts.append(labelled(estimator, corpus, name, test, clean | {"train_subjects": count}))
        metrics = {
            "fit_seconds": fit_seconds,
            "fault_seconds": tested - begun,
            "fault_cpu_seconds": cpu,
            "refit_seconds": time.perf_counter() - tested,
            "faults_trained": sum(fault.name in trained for fault in self.faults),
        }
        return FoldResult(name, pd.concat(parts, ignore_index=True), metrics, batch_effects=effects)

    def fold_metrics(self, result: FoldResult, rate_hz: float) -> dict[str, float]:
        """Accuracy of clean captures, and under each fault and severity; seconds."""
        table = result.table
        accuracy = (table["true"] == table["predicted"]).groupby([table["fault"], table["severity"]]).mean()
        by_fault = zip(accuracy.index, accuracy, strict=True)
        named = {f"accuracy.{fault}.{severity}": value for (fault, severity), value in by_fault}
        clean = stability.unharmed(table)
        return {"accuracy": float((clean["true"] == clean["predicted"]).mean())} | named | result.metrics

    def result(self, plan: Plan, about: Mapping[str, str], folds: list[FoldResult]) -> Result:
        """Failures of the system (`bench.outcomes.stability`), and mean seconds of a fold."""
        table = table_of(folds)
        tables = stability.analysed(table, about["target"])
        means = {k: sum(r.metrics[k] for r in folds) / len(folds) for k in folds[0].metrics}
        trained = max(r.metrics["faults_trained"] for r in folds)
        metrics = stability.metrics(tables) | means | {"faults_tested": len(self.faults), "faults_trained": trained}
        return Result(about, metrics, tables)


def losses(row: Row) -> dict[str, float]:
    """Mean loss of accuracy under each fault, of a result."""
    return {k.removeprefix("loss."): v for k, v in row.items() if k.startswith("loss.")}


def _mean_loss(row: Row) -> Shown:
    return 100 * float(np.mean([*losses(row).values()])) if losses(row) else None


def _worst_fault(row: Row) -> Shown:
    worst = max(losses(row), key=losses(row).__getitem__, default="")
    return f"{worst.replace('_', ' ')} {100 * losses(row)[worst]:.1f}" if worst else None


def _of(part: str, whole: str) -> Callable[[Row], Shown]:
    """A number of a number."""
    return lambda row: f"{row[part]:.0f} of {row[whole]:.0f}" if part in row else None


Stress.shown = (
    percent("accuracy", "clean"),
    Measure("mean_loss", "mean loss", _mean_loss),
    Measure("trained", "faults trained on", _of("faults_trained", "faults_tested"), spare=2),
    text("worst_fault", "worst fault", _worst_fault),
    Measure("failing", "failing groups", _of("failing_slices", "tested_slices")),
)


def labelled(estimator: contract.System, corpus: Corpus, fold: str, test: np.ndarray, columns: Columns) -> pd.DataFrame:
    """Test captures, a row each, with the label of ``bench run``."""
    predictions = decisions(estimator, corpus, fold, test)
    proba = [scores.PREFIX + c for c in scores.classes_of(predictions)]
    mean = predictions.groupby(["fold", "capture"], sort=False)[proba].mean().to_numpy()
    rows = scores.captures(predictions).drop(columns=["start", "frames"])
    true = pd.Index(scores.PREFIX + rows["true"].astype(str))
    p_true = mean[np.arange(len(rows)), pd.Index(proba).get_indexer(true)]
    return rows.assign(p_true=p_true, **columns)


def subset(corpus: Corpus, train: np.ndarray, test: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Positions of the training captures of ``count`` training subjects.

    The subjects come in one random order per seed and test subjects, so that fewer are among more, and every system
    learns from the same ones.
    """
    subjects = sorted(set(corpus.subjects[train]))
    drawn = hashlib.sha256(repr((seed, sorted(set(corpus.subjects[test])))).encode()).digest()
    order = np.random.default_rng(int.from_bytes(drawn[:16], "little")).permutation(len(subjects))
    return train[np.isin(corpus.subjects[train], [subjects[i] for i in order[:count]])]
