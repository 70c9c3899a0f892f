"""Additions to any system: windows, repair, scaling, and training under faults."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import clone
from sklearn.pipeline import Pipeline

from bench import contract
from bench.corpora.corpus import COPY, Corpus, corpus_origin, shared_frames
from bench.corpora.faults import usual_faults
from bench.corpora.windows import Step, Windows
from bench.errors import InputError
from bench.features.base import FeatureSet, capture_copy_index, is_stateless
from bench.features.cache import PIECE_COLUMNS, load_after_steps
from bench.ground.machine import check_memory
from bench.ground.registry import parameter_defaults as defaults_of
from bench.models.by_person import PerPersonPipeline
from bench.models.most_probable import MostProbable, mean_by_capture
from bench.models.quantised import BITS, can_quantise, quantise_pipeline
from bench.models.steps import DamagedCopies, Repair, Scale, TurnedCopies

MAX_WINDOW_S = 3600.0  # of a window
PLAIN_PIPELINES = (Pipeline, PerPersonPipeline)  # whose fit is that of their steps


def _forward_hook(hook: Callable, attribute: str) -> property:
    """What a recipe answers as its system does, which it keeps as ``system``, untrained, or ``system_``, fitted."""
    return property(lambda recipe: hook(getattr(recipe, attribute)), doc=f"As of ``{attribute}``.")


@dataclass(eq=False, repr=False)
class Recipe(MostProbable):
    """A system behind steps (`bench.models.steps`) that its captures go through, in training and when it decides.

    On windows, a system that decides once per capture decides once per window, and a capture's probabilities are the
    mean over its windows.

    Args:
        system: system to train.
        window: seconds of a window; 0 leaves captures whole.
        hop: seconds from the beginning of one window to that of the next; 0 is half a window.
        repair: kinds of broken taxels that are repaired, of `bench.models.steps.REPAIRS`.
        scale: ``none``, ``peak``, divided by the largest reading so far, or ``log``.
        faults: faults for copies of the training captures only; ``all`` stands for every fault.
        copies: damaged copies of each training capture, if there are faults.
        turns: further copies of each training capture, on a grid that is mirrored or turned.
        bits: bits of a learnt weight in prediction: 32, or 8 as `bench export` stores them.
    """

    system: contract.System
    window: float = 0.0
    hop: float = 0.0
    repair: tuple[str, ...] = ()
    scale: str = "none"
    faults: tuple[str, ...] = ()
    copies: int = 3
    bits: int = 32
    turns: int = 0

    def check(self) -> None:
        """Refuse parameters that cannot be."""
        if not (0 <= self.window <= MAX_WINDOW_S and 0 <= self.hop <= MAX_WINDOW_S):
            raise InputError(
                f"model.window={self.window:g}, model.hop={self.hop:g}: give seconds from 0 to {MAX_WINDOW_S:g}"
            )
        if self.hop and not self.window:
            raise InputError(f"model.hop={self.hop:g} needs model.window=")
        if self.window and (
            contract.decides_often(self.system) or contract.window_frames(self.system, 1.0)
        ):
            raise InputError(
                f"model.window={self.window:g}: the system cuts its own windows; leave it out"
            )
        if self.bits not in BITS:
            raise InputError(f"model.bits={self.bits}: give 32 or 8")
        if self.bits != 32 and not (
            type(self.system) in PLAIN_PIPELINES and can_quantise(self.system.steps[-1][1])
        ):
            raise InputError(
                f"model.bits={self.bits}: reflex, lda, softmax, bayes and hughes2017_cnn have it; leave it out"
            )
        self.training_steps()
        contract.check_parameters(self.system)

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Forwarded to the wrapped system; refuses copies that need more memory than there is."""
        values = int(X.lengths.sum()) * X.grid[0] * X.grid[1]
        for name, copies in (("copies", self.copies if self.faults else 0), ("turns", self.turns)):
            if copies:
                values *= copies + 1
                check_memory(f"model.{name}={copies}", shared_frames(X)[0].itemsize * values)
        contract.check_training(self.system, X, y)

    def steps(self) -> list[Step]:
        """The steps of captures before the system."""
        repair: list[Step] = [Repair(self.repair)] if self.repair else []
        scale: list[Step] = [Scale(self.scale)] if self.scale != "none" else []
        return repair + scale + ([Windows(self.window, self.hop)] if self.window else [])

    def training_steps(self) -> list[Step]:
        """The same for training captures."""
        damage: list[Step] = (
            [DamagedCopies(self.trained_faults, self.copies)] if self.faults else []
        )
        return damage + ([TurnedCopies(self.turns)] if self.turns else []) + self.steps()

    @property
    def trained_faults(self) -> tuple[str, ...]:
        """Names of the faults that copies of the training captures go through."""
        return usual_faults() if self.faults == ("all",) else self.faults

    def seen(self, X: Corpus) -> list[Corpus]:
        """Captures after the steps of training, and after those of deciding."""
        return [apply_steps(X, steps)[0] for steps in (self.training_steps(), self.steps())]

    def fit(self, X: Corpus, y: np.ndarray) -> Recipe:
        """Learn from captures and their class names."""
        system = self._fit_system(X, np.asarray(y))
        self.system_ = system if self.bits == 32 else quantise_pipeline(system, self.bits)
        self.classes_ = system.classes_
        if self.window:
            self.window_ = Windows(self.window, self.hop).window_and_hop(X.rate_hz)[0]
        elif (frames := contract.frames_at_once(self.system_, sys.maxsize)) < sys.maxsize:
            self.window_ = frames
        return self

    def _fit_system(self, X: Corpus, y: np.ndarray) -> contract.System:
        """The system inside; one behind a feature set is given the kept features, where there are some."""
        system, steps = clone(self.system), self.training_steps()
        if (behind := _steps_after_features(system)) is None:
            seen, row = apply_steps(X, steps)
            return system.fit(seen, y[row])
        name, first = system.steps[0]
        if (
            stored := load_after_steps(first, X, tuple(steps)) if is_stateless(first) else None
        ) is not None:
            table, row = stored_rows(stored, X.index)
            first.fit(X)
        else:
            seen, row = apply_steps(X, steps)
            table = first.fit_transform(seen, y[row])
        return Pipeline([(name, first), *Pipeline(behind).fit(table, y[row]).steps])

    def decide(self, X: Corpus) -> tuple[pd.DataFrame, np.ndarray]:
        """Every decision: one per window, or those of the system inside (`bench.contract.predict_decisions`)."""
        seen, row = apply_steps(X, self.steps())
        table, proba = contract.predict_decisions(self.system_, seen)
        of = table["capture"].to_numpy()
        start = (
            table["start"].to_numpy()
            + (corpus_origin(seen).piece[of] - corpus_origin(X).piece[row[of]]) % COPY
        )
        return table.assign(capture=row[of], start=start), proba

    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Mean probabilities over the decisions on each capture [captures, classes]."""
        if not contract.decides_often(
            self.system_
        ):  # no table of decisions is needed, a tenth of a robot's time
            seen, row = apply_steps(X, self.steps())
            return mean_by_capture(contract.predict_probabilities(self.system_, seen), row)
        table, proba = self.decide(X)
        return mean_by_capture(proba, table["capture"].to_numpy())

    def keeps_before(self, taxels: int) -> int:
        """Numbers in memory for the steps."""
        return sum(step.kept_numbers(taxels) for step in self.steps())

    def length(self, rate_hz: float) -> int | None:
        """Frames of a window of the system inside, if it cuts its own."""
        return contract.window_frames(self.system, rate_hz)

    features = _forward_hook(contract.feature_sets, "system")
    searches = _forward_hook(contract.searches_itself, "system")
    best_ = _forward_hook(contract.inner_system, "system_")
    chosen_ = _forward_hook(contract.chosen_values, "system_")
    history_ = _forward_hook(contract.history, "system_")
    search_seconds_ = _forward_hook(contract.search_seconds, "system_")
    trials_ = _forward_hook(contract.trials, "system_")


def build_recipe(
    factory: Callable, feature_set: contract.Features | None, **parameters: object
) -> contract.System:
    """Build a system as `bench.contract.build_system` does, wrapped in its steps if some of the parameters are of `recipe_defaults`.

    Names joined by + give several values.
    """
    defaults = recipe_defaults(factory)
    options: dict[str, Any] = {
        k: _as_tuple(v, defaults[k]) for k, v in parameters.items() if k in defaults
    }
    system = contract.build_system(
        factory, feature_set, **{k: v for k, v in parameters.items() if k not in defaults}
    )
    return (
        Recipe(system, **options) if any(v != defaults[k] for k, v in options.items()) else system
    )


def recipe_defaults(factory: Callable) -> dict[str, object]:
    """Parameters of a `Recipe` that a factory has no own ones for, and their defaults."""
    return {k: v for k, v in defaults_of(Recipe).items() if k not in defaults_of(factory)}


def _steps_after_features(system: contract.System) -> list | None:
    """The steps behind the feature set of a pipeline; None for a system of another kind."""
    if type(system) in PLAIN_PIPELINES and system.memory is None and len(system.steps) > 1:
        name, first = system.steps[0]
        if name == "features" or isinstance(first, FeatureSet):
            return system.steps[1:]
    return None


def stored_rows(stored: pd.DataFrame, index: np.ndarray) -> tuple[pd.DataFrame, np.ndarray]:
    """Rows of the stored captures at ``index``, labelled as `FeatureSet.transform` does, and which one each is of.

    Those of one capture lie together, with `bench.features.cache.PIECE_COLUMNS`. No frame is touched, so no copy is damaged
    again.
    """
    of, piece = (stored[name].to_numpy() for name in PIECE_COLUMNS)
    first = np.searchsorted(of, index)
    count = np.searchsorted(of, index, side="right") - first
    row = np.repeat(np.arange(len(index)), count)
    at = first[row] + np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    return stored.iloc[at].drop(columns=[*PIECE_COLUMNS]).set_axis(
        capture_copy_index(of[at], piece[at] // COPY)
    ), row


def _as_tuple(value: object, default: object) -> object:
    """Names joined by +, which a search draws, as a tuple where the default is one."""
    return (
        tuple(filter(None, value.split("+")))
        if isinstance(default, tuple) and isinstance(value, str)
        else value
    )


def apply_steps(X: Corpus, steps: list[Step]) -> tuple[Corpus, np.ndarray]:
    """Captures after some steps, and which of ``X`` each comes from."""
    row = np.arange(len(X))
    for step in steps:
        rows = step.source_rows(X)
        X, row = step(X), row[rows]
    return X, row


def split_causal_steps(system: contract.System) -> tuple[list[Step], contract.System]:
    """The causal steps that a whole recording goes through, and the system behind them, which is given windows."""
    recipe = getattr(system, "whole_", system)
    if not isinstance(recipe, Recipe):
        return [], system
    return [step for step in recipe.steps() if not isinstance(step, Windows)], recipe.system_
