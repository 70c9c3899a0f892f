"""Scores of `auto` trials: by left-out training subjects, on tables that trials share."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from sklearn.base import clone
from sklearn.pipeline import Pipeline

from bench import contract
from bench.corpora.corpus import Corpus
from bench.corpora.steps import Step
from bench.features.base import FeatureSet
from bench.features.cache import after, is_kept
from bench.models import recipe
from bench.models.search import portfolio
from bench.models.search.inner_folds import TIMED, milliseconds_of
from bench.models.search.space import Trial
from bench.models.sizes import sizes

PROBED = 4  # captures whose features are timed
PROBED_FRAMES = 500  # of each, at most
WINDOWED = 2.5  # times as long as of whole captures: each frame is in two
HELD = 1 << 29  # bytes of tables that stay in memory
BEFORE = ("features", "window", "repair", "faults", "scale")  # what tells one table from another
LEAST_S = 0.02  # of a fit, however small
READ_S = 0.05  # to read a kept table
CHANGED = 1.5  # times as long, where frames are changed as well
JUDGING = 1.3  # times the fits of a trial: predictions, copies of tables


@dataclass
class Table:
    """Features of training captures.

    Attributes:
        values: features, labelled by capture and copy if there are windows or copies.
        row: capture of each row.
        sound: rows without damage.
    """

    values: pd.DataFrame
    row: np.ndarray
    sound: np.ndarray

    @property
    def bytes(self) -> int:
        """Bytes of the values."""
        return self.values.shape[0] * self.values.shape[1] * 4


class Inner:
    """The captures of a training part, its inner folds, and the tables of features made so far.

    Args:
        X: the captures.
        y: their class names.
        folds: (train, test) positions; nobody is on both sides, and every capture is tested once.
        touch: seconds of each tested capture that are seen; None for all.
        seed: random seed of the systems.
    """

    def __init__(self, X: Corpus, y: np.ndarray, folds: list, touch: float | None, seed: int) -> None:
        self.X = X
        self.y = y
        self.folds = folds
        self.seed = seed
        self.subjects = X.subjects.astype(str)
        self.classes, self.codes = np.unique(y, return_inverse=True)
        self.longest = int(X.lengths.max())
        self.begun = None if touch is None else beginning(X, touch)
        self.tables: dict[tuple[object, ...], Table] = {}
        self.probed: dict[str, float] = {}
        self.widths = {name: len(clone(part).fit(X[:1]).names_) for name, part in portfolio.FEATURES.items()}

    def _captures(self, trial: Trial, tested: bool) -> tuple[tuple, Corpus, recipe.Recipe, list[Step]]:
        """Of a table: its key, the captures, their recipe, and its steps for what is learnt from or judged by."""
        begun = tested and self.begun is not None
        key = (*(trial[name] for name in BEFORE), begun)
        prepared = portfolio.steps_of(trial)
        steps = prepared.steps() if begun else prepared.training_steps()
        return key, self.begun if begun else self.X, prepared, steps

    def table(self, trial: Trial, tested: bool = False) -> Table:
        """The training input of a trial, or its test input."""
        key, X, prepared, steps = self._captures(trial, tested)
        if key not in self.tables:
            prepared.check_copies(X)
            self.tables[key] = tabled(clone(portfolio.FEATURES[str(trial["features"])]), X, steps)
            while sum(t.bytes for t in self.tables.values()) > HELD and len(self.tables) > 2:
                self.tables.pop(next(iter(self.tables)))
        return self.tables[key]

    def rows(self, trial: Trial) -> int:
        """Rows of the training table of a trial."""
        key, X, prepared, _ = self._captures(trial, tested=False)
        if key in self.tables:
            return len(self.tables[key].row)
        cut = prepared.steps()[-1].rows(X) if prepared.window else X.index
        return len(cut) * (1 + prepared.copies * bool(prepared.faults))

    def work(self, trial: Trial, share: float = 1.0) -> float:
        """Seconds that a fit to a share of the captures should take (`bench.models.search.portfolio.work`)."""
        width = self.widths[str(trial["features"])]
        return LEAST_S + portfolio.work(trial, int(share * self.rows(trial)), width, len(self.classes))

    def judging(self, trial: Trial) -> float:
        """The same for all fits and predictions of a trial."""
        return JUDGING * sum(self.work(trial, len(train) / len(self.X)) for train, _ in self.folds)

    def tabling(self, trial: Trial) -> float:
        """Seconds to make the tables of a trial that are not there yet: timed on a few captures."""
        return sum(self._tabling(trial, tested) for tested in ([False] if self.begun is None else [False, True]))

    def _tabling(self, trial: Trial, tested: bool) -> float:
        key, X, prepared, steps = self._captures(trial, tested)
        if key in self.tables:
            return 0.0
        name = str(trial["features"])
        if is_kept(portfolio.FEATURES[name], X, tuple(steps)):
            return READ_S
        grown = len(X.index) / (X.index.max() + 1) if X.digest else 1.0  # of a stored corpus all are computed and kept
        copies = 1 + prepared.copies * bool(prepared.faults and not tested)
        changed = CHANGED if prepared.repair or prepared.faults or prepared.scale != "none" else 1.0
        seconds = self._probed(name) * int(X.lengths.sum()) / grown
        return seconds * copies * changed * (WINDOWED if prepared.window else 1.0)

    def _probed(self, name: str) -> float:
        """Seconds to compute the features of captures, per frame, by those of a few short and long ones."""
        if name not in self.probed:
            order = np.argsort(self.X.lengths, kind="stable")
            some = self.X[order[np.linspace(0, len(order) - 1, PROBED).astype(int)]].detached()
            some = some.changed(lengths=np.minimum(some.lengths, PROBED_FRAMES))
            began = time.perf_counter()
            portfolio.FEATURES[name].extract(some)
            self.probed[name] = (time.perf_counter() - began) / int(some.lengths.sum())
        return self.probed[name]

    def judge(self, trial: Trial) -> Iterator[tuple[Pipeline, np.ndarray, np.ndarray, float]]:
        """For each inner fold: the fitted estimator, positions of tested captures, their probabilities, seconds."""
        learnt, tested = self.table(trial), self.table(trial, tested=True)
        for train, test in self.folds:
            part = np.isin(learnt.row, train)
            began = time.perf_counter()
            model = portfolio.classifier(trial, self.seed)
            model.fit(learnt.values[part], self.y[learnt.row[part]])
            spent = time.perf_counter() - began
            part = np.isin(tested.row, test) & tested.sound
            captures, row = np.unique(tested.row[part], return_inverse=True)
            proba = np.zeros((len(captures), len(self.classes)))
            columns = np.searchsorted(self.classes, model.classes_)
            proba[:, columns] = recipe.mean_of(contract.probabilities(model, tested.values[part]), row)
            yield model, captures, proba, spent

    def fitted(self, trial: Trial) -> contract.System:
        """The system of a trial, fitted to all captures."""
        learnt = self.table(trial)
        model = portfolio.classifier(trial, self.seed).fit(learnt.values, self.y[learnt.row])
        return self.system(trial, model)

    def system(self, trial: Trial, model: Pipeline) -> contract.System:
        """A system on captures, made of an estimator fitted to a table."""
        prepared, features = portfolio.steps_of(trial), portfolio.FEATURES[str(trial["features"])]
        system = Pipeline([("features", clone(features).fit(self.X)), *model.steps])
        if not prepared.steps() and not prepared.faults:
            return system
        return prepared.set_params(system=system).around(system, self.X)

    def bytes(self, system: contract.System) -> dict[str, float]:
        """Bytes of a fitted system in flash and memory, with 32 bits a number."""
        needed = sizes(system, self.X.grid[0] * self.X.grid[1], self.longest)
        return {name: needed[name] for name in ("flash_bytes", "ram_bytes")}

    def costs(self, system: contract.System) -> dict[str, float]:
        """The same, and milliseconds of a decision on a capture."""
        some = np.linspace(0, len(self.X) - 1, TIMED).astype(int)
        spent = milliseconds_of(system.predict, [self.X[i : i + 1].detached() for i in some])
        return self.bytes(system) | {"predict_ms": spent}


def beginning(X: Corpus, seconds: float) -> Corpus:
    """The first seconds of each capture, at least a frame; without the digest, under which whole ones are kept."""
    frames = max(1, int(seconds * X.rate_hz + 1e-6))
    return X.changed(lengths=np.minimum(X.lengths, frames), digest="", path=None)


def tabled(features: FeatureSet, X: Corpus, steps: list[Step]) -> Table:
    """Features of captures after some steps; kept ones where there are some."""
    features = features.fit(X)
    if steps and (stored := after(features, X, tuple(steps))) is not None:
        values, row = recipe.rows_of(stored, X.index)
    else:
        seen, row = recipe.taken(X, steps)
        values = features.transform(seen)
    sound = values.index.get_level_values("copy") == 0 if steps else np.ones(len(values), dtype=bool)
    return Table(values, row, np.asarray(sound))
