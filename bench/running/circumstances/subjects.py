"""Fewer training subjects: the learning curve of a system."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bench.errors import InputError
from bench.running.circumstances.base import LABELS, Case, Circumstance, option

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd

    from bench.corpora.corpus import Corpus
    from bench.plan.plan import Plan
    from bench.running.fitted import Fitted
    from bench.running.results import FoldResult


@dataclass(frozen=True)
class Subjects(Circumstance):
    """The system is fitted on fewer training subjects, and labels the test captures as they are."""

    key: ClassVar[str] = "train_subjects"
    view: ClassVar[str] = "bench.reports.views.subjects:Subjects"
    sliced: ClassVar[bool] = (
        False  # a slice is compared with the system itself, and every system is worse with less
    )

    train_subjects: tuple[int, ...] = option(
        (), "numbers of training subjects for a learning curve", type="counts"
    )

    def __post_init__(self) -> None:
        """Put the numbers in order."""
        object.__setattr__(self, "train_subjects", tuple(sorted({*self.train_subjects})))

    def params(self) -> dict[str, object]:
        """Numbers of subjects."""
        return {self.key: ", ".join(map(str, self.train_subjects))}

    def refuse(self, plan: Plan) -> None:
        """Refuse numbers of training subjects that a fold has not, or that the system cannot learn from."""
        from bench import contract
        from bench.corpora.corpus import untrained

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
                if lacking := untrained(corpus.gestures, part, fold.test):
                    raise InputError(
                        f"train_subjects={count}: in fold {fold.name} of protocol={plan.cell.protocol} nobody is left "
                        f"who shows {lacking[0]}; give larger numbers"
                    )
                contract.check_training(estimator, corpus[part], corpus.gestures[part])

    @property
    def spent(self) -> tuple[str, ...]:
        """Wall time of the fits."""
        return ("refit_seconds",)

    def cases(self, at: Fitted) -> Iterator[Case]:
        """A system fitted on each number of training subjects."""
        for count in self.train_subjects:
            part = subset(at.corpus, at.fold.train, at.fold.test, count, at.cell.seed or 0)
            yield Case(level=count, system=at.refitted(part), train_subjects=count)

    def result(
        self, tables: Mapping[str, pd.DataFrame], folds: Sequence[FoldResult], rate_hz: float
    ) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
        """The learning curve, which ends with all training subjects."""
        from bench.values.stability import learning

        curve = learning(tables[LABELS])
        numbers = {
            f"accuracy.train_subjects.{r.train_subjects:g}": r.accuracy for r in curve.itertuples()
        }
        return numbers, {"learning": curve}


def subset(
    corpus: Corpus, train: np.ndarray, test: np.ndarray, count: int, seed: int
) -> np.ndarray:
    """Positions of the training captures of ``count`` training subjects.

    The subjects come in one random order per seed and test subjects, so that fewer are among more, and every system
    learns from the same ones.
    """
    import numpy as np

    subjects = sorted(set(corpus.subjects[train]))
    drawn = hashlib.sha256(repr((seed, sorted(set(corpus.subjects[test])))).encode()).digest()
    order = np.random.default_rng(int.from_bytes(drawn[:16], "little")).permutation(len(subjects))
    return train[np.isin(corpus.subjects[train], [subjects[i] for i in order[:count]])]
