"""reflex: the recogniser to ship."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from bench.corpora.corpus import Corpus
from bench.corpora.windows import Windows
from bench.errors import InputError
from bench.features.base import FeatureSet
from bench.features.touch import TouchFeatures
from bench.models.classic.lda import lda
from bench.models.most_probable import MostProbable
from bench.models.out_of_distribution import GuardedDiscriminants
from bench.models.recipe import Recipe

EARLY_COPIES = 3  # for the discriminants of short windows
EARLY_DAMAGED = 0.1  # how much each counts


@dataclass(eq=False, repr=False)
class Reflex(MostProbable):
    """Linear discriminants on windows of a second, and a small network for windows that look like nothing in training.

    1. *Repair*: taxels that are stuck or dead are found in the capture's own past and filled from their neighbours.
    2. *Windows* of 1 s, one every half second. What is shorter than a second is cut into windows of 0.5 s, one every
       quarter of a second.
    3. *Features*: `bench.features.touch`, rates and shares that mean the same on every grid and at every rate.
    4. *Discriminants* (`bench.models.classic.lda`), learnt from undamaged windows. What is particular to a capture
       counts as much again as what varies within it, since two or more windows decide on most captures.
    5. *Doubt* (`bench.models.out_of_distribution`): a window some of whose features lie beyond 2.5 SDs of training is
       judged by a network of 18 units (`classic.perceptron`) instead, wholly from 3 % of them on. It has learnt from
       every capture as it is and in eight damaged copies, each by a fault and a severity drawn at random, a copy
       counting as much as the capture. Faults cost little where there are none, as few features of sound captures are
       unusual.
    6. The short windows have discriminants alone, learnt from three copies as well, each of which counts a tenth.
    7. A capture's probabilities are the mean over its windows.

    Every number above was chosen on the training part of HAART's challenge split, leaving out its subjects one by one,
    or is round, but for the 18 units, which fit into 64 kB with all else: docs/notes/systems.md tells what was tried.

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

    def _make_recipes(self) -> tuple[Recipe, Recipe]:
        """For a whole window, and for less."""
        options: dict[str, Any] = {
            "bits": self.bits,
            "repair": () if self.repair == ("none",) else self.repair,
            "faults": () if self.faults == ("none",) else self.faults,
        }
        judge = GuardedDiscriminants(units=self.units, doubt=self.doubt, seed=self.seed)
        usual = Pipeline([("features", TouchFeatures()), ("classifier", judge)])
        early = lda(TouchFeatures(), damaged=EARLY_DAMAGED)
        return (
            Recipe(usual, self.window, copies=self.copies, **options),
            Recipe(early, self.early, copies=min(self.copies, EARLY_COPIES), **options),
        )

    def check(self) -> None:
        """Refuse parameters that cannot be.

        Raises:
            InputError: one of them.
        """
        if not 0 < self.early <= self.window:
            raise InputError(
                f"model.early={self.early:g}: give seconds above 0, at most model.window={self.window:g}"
            )
        if not 1 <= self.units <= 4096:
            raise InputError(f"model.units={self.units}: give 1 to 4096")
        if not 0 < self.doubt <= 1:
            raise InputError(f"model.doubt={self.doubt:g}: give a share above 0, at most 1")
        for recipe in self._make_recipes():
            recipe.check()

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Refuse copies that need more memory than there is.

        Raises:
            InputError: they do.
        """
        for recipe in self._make_recipes():
            recipe.check_training(X, y)

    def fit(self, X: Corpus, y: np.ndarray) -> Reflex:
        """Learn from captures and their class names."""
        self.whole_, self.early_ = (recipe.fit(X, y) for recipe in self._make_recipes())
        self.classes_, self.window_ = self.whole_.classes_, self.whole_.window_
        return self

    def _split_by_length(self, X: Corpus) -> list[tuple[Recipe, np.ndarray]]:
        """Who decides on which captures [n]: one on those of a window and more, one on shorter ones."""
        short = X.lengths < Windows(self.window).window_and_hop(X.rate_hz)[0]
        parts = [(self.whole_, np.flatnonzero(~short)), (self.early_, np.flatnonzero(short))]
        return [part for part in parts if len(part[1])]

    def decide(self, X: Corpus) -> tuple[pd.DataFrame, np.ndarray]:
        """Predict each window: frames seen, and probabilities [windows, classes]."""
        parts = self._split_by_length(X)
        if len(parts) == 1:
            return parts[0][0].decide(X)
        tables, probabilities = [], []
        for recipe, captures in parts:
            table, proba = recipe.decide(X[captures])
            tables.append(table.assign(capture=captures[table["capture"].to_numpy()]))
            probabilities.append(proba)
        table = pd.concat(tables, ignore_index=True)
        order = np.argsort(table["capture"].to_numpy(), kind="stable")
        return table.iloc[order].reset_index(drop=True), np.concatenate(probabilities)[order]

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
        """The input of the features."""
        return [corpus for recipe in self._make_recipes() for corpus in recipe.seen(X)]

    @property
    def features(self) -> dict[str, FeatureSet]:
        """The feature set."""
        return {"touch": TouchFeatures()}

    @property
    def trained_faults(self) -> tuple[str, ...]:
        """Names of the faults that copies of the training captures go through."""
        return self._make_recipes()[0].trained_faults

    def keeps_before(self, taxels: int) -> int:
        """Numbers per taxel: mean, squares and largest of two halves of the other window; both lengths are kept."""
        return 6 * taxels

    @property
    def members(self) -> list[Recipe]:
        """The two classifiers."""
        return [self.whole_, self.early_]
