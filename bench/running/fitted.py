"""A fitted fold, whose test captures circumstances predict again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus
from bench.corpora.fault_names import NO_FAULT
from bench.running.fold import find_batch_effects, predict_to_table
from bench.values import scores

if TYPE_CHECKING:
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold


@dataclass(frozen=True)
class FittedFold:
    """A fitted system with the fold that it was fitted in."""

    cell: Cell
    corpus: Corpus
    fold: Fold
    system: contract.System  # fitted to the training captures
    predictions: pd.DataFrame  # of the unchanged test captures
    threads: int  # for computing

    @property
    def train(self) -> Corpus:
        """The training captures."""
        return self.corpus[self.fold.train]

    def fit_again(self, positions: np.ndarray) -> contract.System:
        """Fit a new system to some of the training captures."""
        part = self.corpus[positions]
        return contract.fit_system(self.cell.estimator(), part, part.gestures)

    def label_unchanged(self) -> pd.DataFrame:
        """Labels of the unchanged test captures, a row each, as in `label_case`."""
        return self._label_rows(self.predictions, "", NO_FAULT)

    def label_case(self, key: str, case: Any) -> pd.DataFrame:
        """Predict the test captures in a case; return a row each (`bench.values.stability`).

        Args:
            key: of the circumstance.
            case: a `bench.running.circumstances.base.Case`.
        """
        corpus = self.corpus if case.corpus is None else case.corpus
        system = case.system or self.system
        predictions = predict_to_table(system, corpus, self.fold.name, self.fold.test)
        about = case.name or key, case.level, case.amount, case.train_subjects
        return self._label_rows(predictions, key, *about)

    def _label_rows(
        self,
        predictions: pd.DataFrame,
        key: str,
        name: str,
        level: float = 0,
        amount: str = "",
        train_subjects: int | None = None,
    ) -> pd.DataFrame:
        if train_subjects is None:
            trained = self.corpus[self.fold.train]
            train_subjects = len(set(trained.subjects[~trained.is_added]))
        return labels_with_probability(predictions).assign(
            length=self.corpus.lengths[self.fold.test],
            circumstance=key,
            case=name,
            level=level,
            amount=amount,
            train_subjects=train_subjects,
        )

    def find_batch_effects(self, case: Any) -> list[str]:
        """Name changed captures whose prediction depends on others in the batch."""
        if case.corpus is None:
            return []
        return find_batch_effects(case.system or self.system, case.corpus, self.fold.test)


def labels_with_probability(predictions: pd.DataFrame) -> pd.DataFrame:
    """Captures, a row each, with their label and the probability of the true class, ``p_true``."""
    columns = [scores.PREFIX + name for name in scores.classes_of(predictions)]
    mean = predictions.groupby(["fold", "capture"], sort=False)[columns].mean().to_numpy()
    rows = scores.label_captures(predictions).drop(columns=["start", "frames"])
    true = pd.Index(columns).get_indexer(pd.Index(scores.PREFIX + rows["true"].astype(str)))
    return rows.assign(p_true=mean[np.arange(len(rows)), true])
