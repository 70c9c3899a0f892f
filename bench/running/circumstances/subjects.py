"""Fewer training subjects: the learning curve of a system."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bench.errors import InputError
from bench.running.circumstances.base import LABELS_TABLE, Case, Circumstance, option

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd

    from bench.corpora.corpus import Corpus
    from bench.plan.plan import Plan
    from bench.running.fitted import FittedFold
    from bench.running.results import FoldResult


@dataclass(frozen=True)
class Subjects(Circumstance):
    """Fits the system on fewer training subjects, and predicts the unchanged test captures."""

    key: ClassVar[str] = "train_subjects"
    view: ClassVar[str] = "bench.reports.views.subjects:Subjects"
    has_slices: ClassVar[bool] = (
        False  # slices are compared with the system itself, which is better
    )

    train_subjects: tuple[int, ...] = option(
        (), "numbers of training subjects for a learning curve", type="counts"
    )

    def __post_init__(self) -> None:
        """Put the numbers in order."""
        object.__setattr__(self, "train_subjects", tuple(sorted({*self.train_subjects})))

    def params(self) -> dict[str, object]:
        """Return the numbers of subjects."""
        return {self.key: ", ".join(map(str, self.train_subjects))}

    def check_plan(self, plan: Plan) -> None:
        """Refuse numbers that a fold does not have, or that the system cannot learn from."""
        from bench import contract
        from bench.corpora.corpus import untrained_classes

        corpus, protocol = plan.corpus, f"protocol={plan.cell.protocol}"
        for fold in plan.folds:
            subjects = len(own_subjects(corpus, fold.train))
            for count in self.train_subjects:
                prefix = f"train_subjects={count}: "
                if count >= subjects:
                    raise InputError(
                        f"{prefix}fold {fold.name} of {protocol} has {subjects} training subjects; "
                        "give fewer than that (all of them are always used too)"
                    )
                seed = plan.cell.seed or 0
                part = captures_of_subjects(corpus, fold.train, fold.test, count, seed)
                if lacking := untrained_classes(corpus.gestures, part, fold.test):
                    raise InputError(
                        f"{prefix}in fold {fold.name} of {protocol} nobody is left who shows "
                        f"{lacking[0]}; give larger numbers"
                    )
                system = plan.cell.untrained_system
                contract.check_training(system, corpus[part], corpus.gestures[part])

    @property
    def timing_metrics(self) -> tuple[str, ...]:
        """Name of the wall time of the fits."""
        return ("refit_seconds",)

    def cases(self, at: FittedFold) -> Iterator[Case]:
        """Yield a system fitted on each number of training subjects."""
        for count in self.train_subjects:
            part = captures_of_subjects(
                at.corpus, at.fold.train, at.fold.test, count, at.cell.seed or 0
            )
            yield Case(level=count, system=at.fit_again(part), train_subjects=count)

    def measure_run(
        self, tables: Mapping[str, pd.DataFrame], folds: Sequence[FoldResult], rate_hz: float
    ) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
        """Return the learning curve, which ends with all training subjects."""
        from bench.values.stability import learning_curve

        curve = learning_curve(tables[LABELS_TABLE])
        numbers = {
            f"accuracy.train_subjects.{row['train_subjects']:g}": row["accuracy"]
            for row in curve.to_dict("records")
        }
        return numbers, {"learning": curve}


def captures_of_subjects(
    corpus: Corpus, train: np.ndarray, test: np.ndarray, count: int, seed: int
) -> np.ndarray:
    """Positions of the training captures of ``count`` training subjects, and of all of `also=`.

    The subjects have one random order per seed and test subjects, so that fewer are among more, and
    every system learns from the same ones.
    """
    import numpy as np

    subjects = own_subjects(corpus, train)
    identity = repr((seed, sorted(set(corpus.subjects[test]))))
    digest = hashlib.sha256(identity.encode()).digest()
    rng = np.random.default_rng(int.from_bytes(digest[:16], "little"))
    chosen = [subjects[i] for i in rng.permutation(len(subjects))[:count]]
    return train[np.isin(corpus.subjects[train], chosen) | corpus.is_added[train]]


def own_subjects(corpus: Corpus, train: np.ndarray) -> list[str]:
    """Training subjects without those of `also=`, sorted."""
    return sorted(set(corpus.subjects[train][~corpus.is_added[train]]))
