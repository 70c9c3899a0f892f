"""A system fitted in a fold, which circumstances have label the test captures again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bench import contract, scores
from bench.words import CLEAN
from bench.work.case import Case
from bench.work.fold import batch_effects, decisions

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold


@dataclass(frozen=True)
class Fitted:
    """A fitted system with all that it was fitted on.

    Attributes:
        cell: cell of the run.
        corpus: the captures that the fold is of.
        fold: names its training and test captures by position.
        system: fitted to the training captures.
        predictions: its decisions on the test captures as they are.
        threads: threads for computing.
    """

    cell: Cell
    corpus: Corpus
    fold: Fold
    system: contract.System
    predictions: pd.DataFrame
    threads: int

    @property
    def train(self) -> Corpus:
        """The training captures."""
        return self.corpus[self.fold.train]

    @property
    def train_subjects(self) -> int:
        """Number of subjects of the training captures."""
        return len(set(self.corpus.subjects[self.fold.train]))

    def refitted(self, positions: np.ndarray) -> contract.System:
        """A new system, fitted to some of the training captures."""
        return self.cell.estimator().fit(self.corpus[positions], self.corpus.gestures[positions])

    def labels(self, key: str, case: Case) -> pd.DataFrame:
        """The label of each test capture in a case, a row each, as `labelled` has them."""
        system, corpus = case.system or self.system, self.corpus if case.corpus is None else case.corpus
        predictions = decisions(system, corpus, self.fold.name, self.fold.test)
        subjects = self.train_subjects if case.train_subjects is None else case.train_subjects
        return self._rows(predictions, key, case, subjects)

    def clean(self) -> pd.DataFrame:
        """The same of the captures as they are."""
        return self._rows(self.predictions, "", Case(CLEAN), self.train_subjects)

    def effects(self, case: Case | None) -> list[str]:
        """Captures of a changed corpus whose prediction depends on the captures predicted together with them."""
        if case is None or case.corpus is None:
            return []
        return batch_effects(case.system or self.system, case.corpus, self.fold.test)

    def _rows(self, predictions: pd.DataFrame, key: str, case: Case, subjects: int) -> pd.DataFrame:
        about = {"length": self.corpus.lengths[self.fold.test], "circumstance": key, "case": case.case or key}
        about |= {"level": case.level, "amount": case.amount, "train_subjects": subjects}
        return labelled(predictions).assign(**about)


def labelled(predictions: pd.DataFrame) -> pd.DataFrame:
    """Captures, a row each, with the label of ``bench run`` and the probability of the true class, ``p_true``."""
    proba = [scores.PREFIX + c for c in scores.classes_of(predictions)]
    mean = predictions.groupby(["fold", "capture"], sort=False)[proba].mean().to_numpy()
    rows = scores.captures(predictions).drop(columns=["start", "frames"])
    true = pd.Index(scores.PREFIX + rows["true"].astype(str))
    p_true = mean[np.arange(len(rows)), pd.Index(proba).get_indexer(true)]
    return rows.assign(p_true=p_true)
