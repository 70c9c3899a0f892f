"""A system fitted in a fold, which circumstances have label the test captures again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bench import contract
from bench.ground.words import CLEAN
from bench.running.fold import batch_effects, decisions
from bench.values import scores

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold


@dataclass(frozen=True)
class Fitted:
    """A fitted system with all that it was fitted on."""

    cell: Cell
    corpus: Corpus
    fold: Fold
    system: contract.System  # fitted to the training captures
    predictions: pd.DataFrame  # its decisions on the test captures as they are
    threads: int  # for computing

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

    def labels(self, key: str, case: Any) -> pd.DataFrame:
        """The label of each test capture in a `bench.running.circumstances.base.Case`, a row each, as `labelled` has them."""
        system, corpus = (
            case.system or self.system,
            self.corpus if case.corpus is None else case.corpus,
        )
        predictions = decisions(system, corpus, self.fold.name, self.fold.test)
        subjects = self.train_subjects if case.train_subjects is None else case.train_subjects
        return self._rows(predictions, key, case.case or key, case.level, case.amount, subjects)

    def clean(self) -> pd.DataFrame:
        """The same of the captures as they are."""
        return self._rows(self.predictions, "", CLEAN, 0, "", self.train_subjects)

    def _rows(self, predictions: pd.DataFrame, *about: Any) -> pd.DataFrame:
        names = ("circumstance", "case", "level", "amount", "train_subjects")
        rows = labelled(predictions).assign(length=self.corpus.lengths[self.fold.test])
        return rows.assign(**dict(zip(names, about, strict=True)))

    def effects(self, case: Any) -> list[str]:
        """Captures of a changed corpus whose prediction depends on the captures predicted together with them."""
        if case is None or case.corpus is None:
            return []
        return batch_effects(case.system or self.system, case.corpus, self.fold.test)


def labelled(predictions: pd.DataFrame) -> pd.DataFrame:
    """Captures, a row each, with the label of ``bench run`` and the probability of the true class, ``p_true``."""
    proba = [scores.PREFIX + c for c in scores.classes_of(predictions)]
    mean = predictions.groupby(["fold", "capture"], sort=False)[proba].mean().to_numpy()
    rows = scores.captures(predictions).drop(columns=["start", "frames"])
    true = pd.Index(scores.PREFIX + rows["true"].astype(str))
    p_true = mean[np.arange(len(rows)), pd.Index(proba).get_indexer(true)]
    return rows.assign(p_true=p_true)
