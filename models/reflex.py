"""reflex: the recogniser to ship."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from bench import contract
from bench.corpora.corpus import Corpus
from bench.corpora.windows import Windows
from bench.errors import check_value
from bench.features.base import FeatureSet
from bench.features.touch import TouchFeatures
from bench.models.classic.lda import lda
from bench.models.most_probable import MostProbable
from bench.models.out_of_distribution import GuardedDiscriminants
from bench.models.recipe import Recipe
from bench.models.search.inner_folds import make_inner_folds

EARLY_COPIES = 3  # for the discriminants of short windows
EARLY_DAMAGED = 0.1  # how much each counts


@dataclass(eq=False, repr=False)
class Reflex(MostProbable):
    """Linear discriminants on windows of 1 s, and a small network for out-of-distribution windows.

    1. *Repair*: stuck and dead taxels are detected in the capture's own past and filled from their
       neighbours.
    2. *Windows* of 1 s, one every 0.5 s. A capture shorter than 1 s is cut into windows of 0.5 s,
       one every 0.25 s.
    3. *Features*: `bench.features.touch`, rates and shares that mean the same on every grid and at
       every rate.
    4. *Discriminants* (`bench.models.classic.lda`), trained on undamaged windows. The covariance
       between captures counts twice, since two or more windows decide on most captures.
    5. *Doubt* (`bench.models.out_of_distribution`): features beyond 2.5 SDs of training shift the
       decision to a network of 18 units (`classic.perceptron`), wholly from 3 % of them on. It is
       trained on every capture and on eight damaged copies of it, each by a random fault and
       severity, with equal weights. This costs little without faults, as few features of undamaged
       captures are that far from the mean.
    6. Short windows have discriminants alone, trained with three damaged copies that count a tenth
       each.
    7. A capture's probabilities are the mean over its windows.

    Every number above was chosen on the training part of HAART's challenge split, leaving out its
    subjects one by one, or is round, except the 18 units, with which the system fits into 64 kB
    (docs/notes/systems.md lists the trials).

    Args:
        window: seconds of a window.
        early: seconds of the shorter window for captures shorter than a window.
        units: number of units of the network.
        doubt: share of unusual features from which on the network decides alone.
        repair: repairs, see `bench.models.recipe.Recipe`.
        faults: faults, see `bench.models.recipe.Recipe`; ``none`` for none.
        copies: damaged copies of each training capture.
        seed: random seed of the network; the damage is always the same.
        bits: bits of a learnt weight, see `bench.models.recipe.Recipe`.
        tune: yes: choose shrinkage and windows of the discriminants for whole windows by leaving
            out each training subject in turn, as ``lda`` does.
    """

    window: float = 1.0
    early: float = 0.5
    units: int = 18
    doubt: float = 0.03
    repair: tuple[str, ...] = ("stuck", "dead")
    faults: tuple[str, ...] = ("all",)
    copies: int = 8
    seed: int = 0
    bits: int = 32
    tune: bool = False

    def _make_recipes(self) -> tuple[Recipe, Recipe]:
        """Make the systems for whole windows and for shorter captures."""
        options: dict[str, Any] = {
            "bits": self.bits,
            "repair": () if self.repair == ("none",) else self.repair,
            "faults": () if self.faults == ("none",) else self.faults,
        }
        guarded = GuardedDiscriminants(
            units=self.units, doubt=self.doubt, seed=self.seed, tune=self.tune
        )
        whole = Pipeline([("features", TouchFeatures()), ("classifier", guarded)])
        early = lda(TouchFeatures(), damaged=EARLY_DAMAGED)
        return (
            Recipe(whole, self.window, copies=self.copies, **options),
            Recipe(early, self.early, copies=min(self.copies, EARLY_COPIES), **options),
        )

    def check(self) -> None:
        """Check the parameters.

        Raises:
            InputError: a parameter is out of its range.
        """
        advice = f"seconds above 0, at most model.window={self.window:g}"
        check_value("model.early", self.early, 0 < self.early <= self.window, advice)
        check_value("model.units", self.units, 1 <= self.units <= 4096, "1 to 4096")
        check_value("model.doubt", self.doubt, 0 < self.doubt <= 1, "a share above 0, at most 1")
        for recipe in self._make_recipes():
            recipe.check()

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Check the memory that copies need, and to tune, that each subject can be left out.

        Raises:
            InputError: there is less memory, or only one subject.
        """
        if self.tune:
            make_inner_folds(X, y, "loso")
        for recipe in self._make_recipes():
            recipe.check_training(X, y)

    def fit(self, X: Corpus, y: np.ndarray) -> Reflex:
        """Learn from captures and their class names."""
        whole, early = self._make_recipes()
        self.early_ = early.fit(X, y)  # first: its rows take most memory, and torch is not loaded
        self.whole_ = whole.fit(X, y)
        self.classes_, self.window_ = self.whole_.classes_, self.whole_.window_
        return self

    def _split_by_length(self, X: Corpus) -> list[tuple[Recipe, np.ndarray]]:
        """The systems that decide on some of the captures, each with their positions."""
        is_short = X.lengths < Windows(self.window).window_and_hop(X.rate_hz)[0]
        parts = [(self.whole_, np.flatnonzero(~is_short)), (self.early_, np.flatnonzero(is_short))]
        return [part for part in parts if len(part[1])]

    def decide(self, X: Corpus) -> tuple[pd.DataFrame, np.ndarray]:
        """Predict each window: a table with its frames, and probabilities [windows, classes]."""
        parts = self._split_by_length(X)
        if len(parts) == 1:
            return parts[0][0].decide(X)
        tables, probas = [], []
        for recipe, captures in parts:
            table, proba = recipe.decide(X[captures])
            tables.append(table.assign(capture=captures[table["capture"].to_numpy()]))
            probas.append(proba)
        table = pd.concat(tables, ignore_index=True)
        order = np.argsort(table["capture"].to_numpy(), kind="stable")
        return table.iloc[order].reset_index(drop=True), np.concatenate(probas)[order]

    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Mean probabilities over the windows of each capture [captures, classes]."""
        parts = self._split_by_length(X)
        if len(parts) == 1:
            return parts[0][0].predict_proba(X)
        proba = np.empty((len(X), len(self.classes_)))
        for recipe, captures in parts:
            proba[captures] = recipe.predict_proba(X[captures])
        return proba

    def seen(self, X: Corpus) -> list[Corpus]:
        """Captures as the features see them."""
        return [corpus for recipe in self._make_recipes() for corpus in recipe.seen(X)]

    @property
    def features(self) -> dict[str, FeatureSet]:
        """The feature set."""
        return {"touch": TouchFeatures()}

    @property
    def searches(self) -> bool:
        """True if it tunes itself."""
        return self.tune

    @property
    def chosen_(self) -> dict[str, object]:
        """Settings that the discriminants have chosen."""
        return contract.chosen_values(self.whole_)

    @property
    def trained_faults(self) -> tuple[str, ...]:
        """Names of the faults that copies of the training captures go through."""
        return self._make_recipes()[0].trained_faults

    def keeps_before(self, taxels: int) -> int:
        """Numbers for the other window: mean, squares and maximum of two halves per taxel."""
        return 6 * taxels

    @property
    def whole(self) -> Recipe:
        """The untrained system for whole windows."""
        return self._make_recipes()[0]

    @property
    def members(self) -> list[Recipe]:
        """The two classifiers."""
        return [self.whole_, self.early_]
