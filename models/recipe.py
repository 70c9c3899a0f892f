"""What any system can be given besides: windows, repair, scaling, and training under faults."""

from __future__ import annotations

import sys
from collections.abc import Callable
from copy import copy
from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, ClassifierMixin, clone
from sklearn.pipeline import Pipeline
from sklearn.utils.metaestimators import available_if

from bench import contract
from bench.corpora.corpus import COPY, Corpus, origin, storage
from bench.corpora.faults import known
from bench.corpora.steps import Faulted, Repair, Scale, Step, Turned, Windows
from bench.errors import InputError
from bench.memory import ensure
from bench.registry import parameters as known_parameters
from features.base import FeatureSet, labels
from features.cache import PIECES, after
from models.person import WAYS, Own, pooled
from models.quantised import BITS, can_be, in_bits

LONGEST_S = 3600.0  # of a window


class Recipe(ClassifierMixin, BaseEstimator):
    """A system behind steps (`bench.corpora.steps`) that its captures go through, in training and when it decides.

    On windows, a system that decides once per capture decides once per window, and a capture's probabilities are the
    mean over its windows.

    Args:
        system: what learns and decides.
        window: seconds of a window; 0 leaves captures whole.
        hop: seconds from the beginning of one window to that of the next; 0 is half a window.
        repair: kinds of broken taxels that are repaired, of `bench.corpora.steps.REPAIRS`.
        scale: ``none``, ``peak``, divided by the largest reading so far, or ``log``.
        faults: that copies of the training captures go through; nothing else does. ``all`` stands for every fault.
        copies: of each training capture, where there are faults.
        turns: further copies of each training capture, on a grid that is mirrored or turned.
        person: how a classifier on features adapts to one person (`models.person.WAYS`): ``centre`` and ``scale``
            features by their own, and ``pool``, which keeps the training rows and is fitted anew to them and the
            person's, each of which counts ten times.
        bits: of a learnt weight when it decides: 32, or 8 as `bench export` stores them.
    """

    rows_: tuple[pd.DataFrame, np.ndarray] | None = None  # of training, where a person's are pooled with them

    def __init__(
        self,
        system: contract.System,
        window: float = 0.0,
        hop: float = 0.0,
        repair: tuple[str, ...] = (),
        scale: str = "none",
        faults: tuple[str, ...] = (),
        copies: int = 3,
        person: tuple[str, ...] = (),
        bits: int = 32,
        turns: int = 0,
    ) -> None:
        self.system = system
        self.window = window
        self.hop = hop
        self.repair = repair
        self.scale = scale
        self.faults = faults
        self.copies = copies
        self.person = person
        self.bits = bits
        self.turns = turns

    def check(self) -> None:
        """Refuse parameters that cannot be.

        Raises:
            InputError: one of them.
        """
        if not (0 <= self.window <= LONGEST_S and 0 <= self.hop <= LONGEST_S):
            said = f"model.window={self.window:g}, model.hop={self.hop:g}"
            raise InputError(f"{said}: give seconds from 0 to {LONGEST_S:g}")
        if self.hop and not self.window:
            raise InputError(f"model.hop={self.hop:g} needs model.window=")
        if self.window and (contract.decides_often(self.system) or contract.window(self.system, 1.0)):
            raise InputError(f"model.window={self.window:g}: the system cuts its own windows; leave it out")
        self._check_person()
        if self.bits not in BITS:
            raise InputError(f"model.bits={self.bits}: give 32 or 8")
        if self.bits != 32 and not (type(self.system) is Pipeline and can_be(self.system.steps[-1][1])):
            raise InputError(
                f"model.bits={self.bits}: reflex, lda, softmax, bayes and hughes2017_cnn have it; leave it out"
            )
        self.training_steps()
        contract.check(self.system)

    def _check_person(self) -> None:
        if not self.person:
            return
        said = f"model.person={'+'.join(self.person)}"
        if len(set(self.person)) < len(self.person):
            raise InputError(f"{said}: name each way once")
        if wrong := set(self.person) - set(WAYS):
            raise InputError(f"{said}: {min(wrong)!r} is none of {', '.join(WAYS)}; join some of them by +")
        if contract.adapts(self.system):
            raise InputError(f"{said}: the system adapts by itself; leave it out")
        if _behind_features(self.system) is None:
            raise InputError(f"{said}: the system has no classifier on features; leave it out")

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """As of the system inside; refuses copies that need more memory than there is."""
        self.check_copies(X)
        contract.check_training(self.system, X, y)

    def check_copies(self, X: Corpus) -> None:
        """Refuse damaged copies that need more memory than there is.

        Raises:
            InputError: they do.
        """
        values = int(X.lengths.sum()) * X.grid[0] * X.grid[1]
        for name, copies in (("copies", self.copies if self.faults else 0), ("turns", self.turns)):
            if copies:
                values *= copies + 1
                ensure(f"model.{name}={copies}", storage(X)[0].itemsize * values)

    def steps(self) -> list[Step]:
        """What captures go through before the system sees them."""
        repair: list[Step] = [Repair(self.repair)] if self.repair else []
        scale: list[Step] = [Scale(self.scale)] if self.scale != "none" else []
        return repair + scale + ([Windows(self.window, self.hop)] if self.window else [])

    def training_steps(self) -> list[Step]:
        """The same for training captures."""
        damage: list[Step] = [Faulted(self.trained_faults, self.copies)] if self.faults else []
        return damage + ([Turned(self.turns)] if self.turns else []) + self.steps()

    @property
    def trained_faults(self) -> tuple[str, ...]:
        """Names of the faults that copies of the training captures go through."""
        return tuple(known()) if self.faults == ("all",) else self.faults

    def seen(self, X: Corpus) -> list[Corpus]:
        """Captures after the steps of training, and after those of deciding."""
        return [taken(X, steps)[0] for steps in (self.training_steps(), self.steps())]

    def fit(self, X: Corpus, y: np.ndarray) -> Recipe:
        """Learn from captures and their class names."""
        system = self._fitted(X, np.asarray(y))
        return self.around(system if self.bits == 32 else in_bits(system, self.bits), X)

    def around(self, system: contract.System, X: Corpus) -> Recipe:
        """Take a system that has learnt from what the training steps make of some captures."""
        self.system_, self.classes_ = system, system.classes_
        if self.window:
            self.window_ = Windows(self.window, self.hop).lengths(X.rate_hz)[0]
        elif (inside := contract.frames_at_once(self.system_, sys.maxsize)) < sys.maxsize:
            self.window_ = inside
        return self

    @available_if(lambda self: self.bits == 32 and (bool(self.person) or contract.adapts(self.system)))
    def adapt(self, X: Corpus, y: np.ndarray | None) -> Recipe:
        """The same for one person, some of whose captures the system inside adapts to (`bench.contract.adapted`)."""
        seen, row = taken(X, self.steps())
        labels = None if y is None else np.asarray(y)[row]
        found = copy(self)
        if not self.person:
            found.system_ = contract.adapted(self.system_, seen, labels)
            return found
        (name, features), (_, own), *rest = self.system_.steps
        table = features.transform(seen)
        own, behind = own.adapt(table, labels), Pipeline(rest)
        if self.rows_ is not None and labels is not None:
            behind = pooled(behind, self.rows_, (own.transform(table), labels))
        found.system_ = Pipeline([(name, features), ("own", own), *behind.steps])
        return found

    def _fitted(self, X: Corpus, y: np.ndarray) -> contract.System:
        """The system inside; one behind a feature set is given the kept features, where there are some."""
        system, steps = clone(self.system), self.training_steps()
        if (behind := _behind_features(system)) is None:
            seen, row = taken(X, steps)
            return system.fit(seen, y[row])
        name, first = system.steps[0]
        if (found := after(first, X, tuple(steps)) if _plain(first) else None) is not None:
            table, row = rows_of(found, X.index)
            first.fit(X)
        else:
            seen, row = taken(X, steps)
            table = first.fit_transform(seen, y[row])
        own = [("own", Own(self.person))] if self.person else []
        self.rows_ = (table, y[row]) if "pool" in self.person else None
        return Pipeline([(name, first), *Pipeline([*own, *behind]).fit(table, y[row]).steps])

    def decide(self, X: Corpus) -> tuple[pd.DataFrame, np.ndarray]:
        """Every decision: one per window, or those of the system inside (`bench.contract.decide`)."""
        seen, row = taken(X, self.steps())
        table, proba = contract.decide(self.system_, seen)
        of = table["capture"].to_numpy()
        start = table["start"].to_numpy() + (origin(seen).piece[of] - origin(X).piece[row[of]]) % COPY
        return table.assign(capture=row[of], start=start), proba

    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Mean probabilities over the decisions on each capture [captures, classes]."""
        if not contract.decides_often(self.system_):  # no table of decisions is needed, a tenth of a robot's time
            seen, row = taken(X, self.steps())
            return mean_of(contract.probabilities(self.system_, seen), row)
        table, proba = self.decide(X)
        return mean_of(proba, table["capture"].to_numpy())

    def predict(self, X: Corpus) -> np.ndarray:
        """Class name of each capture."""
        return self.classes_[self.predict_proba(X).argmax(axis=1)]

    def length(self, rate_hz: float) -> int | None:
        """Frames of a window of the system inside, if it cuts its own."""
        return contract.window(self.system, rate_hz)

    @property
    def features(self) -> dict[str, contract.Features]:
        """Feature sets of the system inside."""
        return contract.features(self.system)

    @property
    def searches(self) -> bool:
        """Whether the system inside chooses its parameters itself."""
        return contract.searches(self.system)

    def keeps_before(self, taxels: int) -> int:
        """Numbers in memory for the steps."""
        return sum(step.keeps(taxels) for step in self.steps())

    @property
    def best_(self) -> contract.System:
        """What decides."""
        return contract.inside(self.system_)

    @property
    def history_(self) -> list[dict[str, float]]:
        """Of the system inside."""
        return contract.history(self.system_)

    @property
    def search_seconds_(self) -> float | None:
        """Of the system inside."""
        return contract.search_seconds(self.system_)

    @property
    def chosen_(self) -> dict[str, object]:
        """Of the system inside."""
        return contract.chosen(self.system_)

    @property
    def trials_(self) -> pd.DataFrame | None:
        """Of the system inside."""
        return contract.trials(self.system_)


def build(factory: Callable, feature_set: contract.Features | None, **parameters: object) -> contract.System:
    """A system as of `bench.contract.build`, behind its steps where some of the parameters ask for steps.

    Args:
        factory: a class or a function.
        feature_set: a transformer of captures to a table; None for a system that reads captures.
        parameters: keyword arguments, and any of `besides`; names joined by + stand for several.
    """
    usual = besides(factory)
    own = {k: v for k, v in parameters.items() if k not in usual}
    asked: dict[str, Any] = {k: _typed(v, usual[k]) for k, v in parameters.items() if k in usual}
    system = contract.build(factory, feature_set, **own)
    return Recipe(system, **asked) if any(v != usual[k] for k, v in asked.items()) else system


def besides(factory: Callable) -> dict[str, object]:
    """Parameters of a `Recipe` that a factory has no own ones for, and their defaults."""
    own = known_parameters(factory)
    return {k: v for k, v in known_parameters(Recipe).items() if k not in own}


def _behind_features(system: contract.System) -> list | None:
    """The steps behind the feature set of a pipeline; None for a system of another kind."""
    if type(system) is Pipeline and system.memory is None and len(system.steps) > 1:
        name, first = system.steps[0]
        if name == "features" or isinstance(first, FeatureSet):
            return system.steps[1:]
    return None


def _plain(first: object) -> bool:
    """Whether a part is a feature set whose table is what it extracts, whatever it is fitted to."""
    kind = type(first)
    return isinstance(first, FeatureSet) and (kind.fit, kind.transform) == (FeatureSet.fit, FeatureSet.transform)


def rows_of(found: pd.DataFrame, index: np.ndarray) -> tuple[pd.DataFrame, np.ndarray]:
    """Rows of some stored captures, labelled as `features.base.FeatureSet.transform` does, and which one each is of.

    No frame is touched, so no copy is damaged again.

    Args:
        found: of all captures, those of one capture together, with `features.cache.PIECES`.
        index: positions in the stored corpus.
    """
    of, piece = (found[name].to_numpy() for name in PIECES)
    first = np.searchsorted(of, index)
    count = np.searchsorted(of, index, side="right") - first
    row = np.repeat(np.arange(len(index)), count)
    place = first[row] + np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    return found.iloc[place].drop(columns=[*PIECES]).set_axis(labels(of[place], piece[place] // COPY)), row


def _typed(value: object, usual: object) -> object:
    """Names joined by +, which a search draws, as a tuple where that is what is usual."""
    return tuple(filter(None, value.split("+"))) if isinstance(usual, tuple) and isinstance(value, str) else value


def taken(X: Corpus, steps: list[Step]) -> tuple[Corpus, np.ndarray]:
    """Captures after some steps, and which of ``X`` each comes from."""
    row = np.arange(len(X))
    for step in steps:
        rows = step.rows(X)
        X, row = step(X), row[rows]
    return X, row


def mean_of(proba: np.ndarray, capture: np.ndarray) -> np.ndarray:
    """Mean of the rows of each capture, which lie together [captures, classes]."""
    return np.add.reduceat(proba, np.flatnonzero(np.diff(capture, prepend=-1))) / np.bincount(capture)[:, None]
