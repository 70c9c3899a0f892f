"""Additions to any system: windows, repair, scaling, and training under faults."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from sklearn.base import clone
from sklearn.pipeline import Pipeline

from bench import contract
from bench.corpora.corpus import COPY, Corpus, shared_frames, unblind
from bench.corpora.faults import usual_faults
from bench.corpora.windows import Step, Windows
from bench.errors import InputError, check_value
from bench.features.base import (
    FeatureSet,
    capture_copy_index,
    index_by_source,
    is_stateless,
)
from bench.features.cache import PIECE_COLUMNS, load_after_steps
from bench.ground.machine import check_memory
from bench.ground.registry import parameter_defaults
from bench.models.by_person import PerPersonPipeline
from bench.models.by_source import SourceScaler
from bench.models.most_probable import MostProbable, mean_by_capture
from bench.models.quantised import BITS, can_quantise, quantise_pipeline
from bench.models.search.inner_folds import tested_subjects
from bench.models.steps import DamagedCopies, Repair, Scale, TurnedCopies

MAX_WINDOW_S = 3600.0
FIT_METHOD = contract.Method("fit", ("X", "y", "subjects"), lambda X, y, subjects: None)
PLAIN_PIPELINES = (Pipeline, PerPersonPipeline)  # which are fitted by fitting their steps


def _forward_hook(hook: Callable, attribute: str) -> property:
    """Property with a hook's value for the wrapped system, ``system`` or ``system_``."""
    return property(lambda recipe: hook(getattr(recipe, attribute)), doc=f"Of ``{attribute}``.")


@dataclass(eq=False, repr=False)
class Recipe(MostProbable):
    """A system with steps (`bench.models.steps`) that captures go through before it.

    On windows, a system that decides once per capture decides once per window, and a capture's
    probabilities are the mean over its windows.

    Args:
        system: system to train.
        window: seconds of a window; 0 leaves captures whole.
        hop: seconds from the beginning of one window to that of the next; 0 is half a window.
        repair: kinds of broken taxels that are repaired, of `bench.models.steps.REPAIRS`.
        scale: ``none``; ``peak``, divided by the largest reading so far; or ``log``.
        faults: faults for copies of the training captures only; ``all`` stands for every fault.
        copies: damaged copies of each training capture, if there are faults.
        turns: further copies of each training capture, on a grid that is mirrored or turned.
        bits: bits of a learnt weight in prediction: 32, or 8 as `bench export` stores them.
        by_source: True to bring the features of each joined corpus to one mean and SD
            (`bench.models.by_source`); networks always do.
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
    by_source: bool = False

    def check(self) -> None:
        """Check the parameters.

        Raises:
            InputError: a parameter is out of its range, or the system does not support it.
        """
        seconds = f"seconds from 0 to {MAX_WINDOW_S:g}"
        check_value("model.window", self.window, 0 <= self.window <= MAX_WINDOW_S, seconds)
        check_value("model.hop", self.hop, 0 <= self.hop <= MAX_WINDOW_S, seconds)
        if self.hop and not self.window:
            raise InputError(f"model.hop={self.hop:g} needs model.window=")
        system = self.system
        if self.window:
            has_windows = contract.decides_often(system) or contract.window_frames(system, 1.0)
            advice = "0, as the system cuts its own windows"
            check_value("model.window", self.window, not has_windows, advice)
        check_value("model.bits", self.bits, self.bits in BITS, "32 or 8")
        is_plain = type(system) in PLAIN_PIPELINES
        is_supported = self.bits == 32 or (is_plain and can_quantise(system.steps[-1][1]))
        advice = "32; reflex, lda, softmax, perceptron, bayes and hughes2017_cnn can have 8"
        check_value("model.bits", self.bits, is_supported, advice)
        advice = "no, as the system has no feature set of its own"
        is_possible = not self.by_source or _has_feature_step(system)
        check_value("model.by_source", "yes", is_possible, advice)
        self.training_steps()
        contract.check_parameters(system)

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Check the memory that copies need, then call the wrapped system's method."""
        values = int(X.lengths.sum()) * X.grid[0] * X.grid[1]
        for name, copies in (("copies", self.copies if self.faults else 0), ("turns", self.turns)):
            if copies:
                values *= copies + 1
                check_memory(f"model.{name}={copies}", shared_frames(X)[0].itemsize * values)
        contract.check_training(self.system, X, y)

    def prediction_steps(self) -> list[Step]:
        """Steps before the system in prediction."""
        steps: list[Step] = []
        if self.repair:
            steps.append(Repair(self.repair))
        if self.scale != "none":
            steps.append(Scale(self.scale))
        if self.window:
            steps.append(Windows(self.window, self.hop))
        return steps

    def training_steps(self) -> list[Step]:
        """Steps before the system in training."""
        steps: list[Step] = []
        if self.faults:
            steps.append(DamagedCopies(self.trained_faults, self.copies))
        if self.turns:
            steps.append(TurnedCopies(self.turns))
        return steps + self.prediction_steps()

    @property
    def trained_faults(self) -> tuple[str, ...]:
        """Names of the faults that copies of the training captures go through."""
        return usual_faults() if self.faults == ("all",) else self.faults

    def seen(self, X: Corpus) -> list[Corpus]:
        """Captures after the steps of training, and after those of prediction."""
        chains = self.training_steps(), self.prediction_steps()
        return [apply_steps(X, steps)[0] for steps in chains]

    def fit(self, X: Corpus, y: np.ndarray) -> Recipe:
        """Fit to captures and their class names."""
        return self._keep_fitted(self._fit_system(X, np.asarray(y)), X.rate_hz)

    def fit_parts(self, parts: Iterable[Corpus]) -> Recipe:
        """Fit to captures that come in parts, of which only features stay in memory if possible."""
        system, steps = self._make_system(), self.training_steps()
        if not _has_feature_step(system) or not is_stateless(system.steps[0][1]):
            captures = _join_parts([*parts])
            return self.fit(captures, captures.gestures)
        (name, features), *later_steps = system.steps
        tables, labels, subjects = [], [], []
        for part in parts:
            seen, source = apply_steps(part, steps)
            tables.append(features.fit_transform(seen))
            labels.append(part.gestures[source])
            subjects.append(tested_subjects(part)[source])
        rate_hz = part.rate_hz
        del part, seen  # and with them their frames
        table, y = pd.concat(tables), np.concatenate(labels)
        tables.clear()
        later = _fit_later_steps(later_steps, table, y, np.concatenate(subjects))
        return self._keep_fitted(Pipeline([(name, features), *later.steps]), rate_hz)

    def _make_system(self) -> contract.System:
        """A new untrained system, with its scales by source."""
        system = clone(self.system)
        if self.by_source:
            system.steps.insert(1, ("sources", SourceScaler()))
        return system

    def _keep_fitted(self, system: contract.System, rate_hz: float) -> Recipe:
        """Keep the fitted system, and what follows from it."""
        self.system_ = system if self.bits == 32 else quantise_pipeline(system, self.bits)
        self.classes_ = system.classes_
        if self.window:
            self.window_ = Windows(self.window, self.hop).window_and_hop(rate_hz)[0]
        elif (frames := contract.frames_at_once(self.system_, sys.maxsize)) < sys.maxsize:
            self.window_ = frames
        return self

    def _fit_system(self, X: Corpus, y: np.ndarray) -> contract.System:
        """Fit the wrapped system, on cached features if there are any."""
        system, steps = self._make_system(), self.training_steps()
        if not _has_feature_step(system):
            seen, source = apply_steps(X, steps)
            return contract.fit_system(system, seen, y[source])
        (name, features), *later_steps = system.steps
        stored = load_after_steps(features, X, tuple(steps)) if is_stateless(features) else None
        if stored is not None:
            table, source = select_stored_rows(stored, X.index)
            table = index_by_source(table, X, source)
            del stored  # it may be large
            features.fit(X)
        else:
            seen, source = apply_steps(X, steps)
            table = features.fit_transform(seen, y[source])
        later = _fit_later_steps(later_steps, table, y[source], tested_subjects(X)[source])
        return Pipeline([(name, features), *later.steps])

    def decide(self, X: Corpus) -> tuple[pd.DataFrame, np.ndarray]:
        """Every decision: one per window, or those of the system."""
        seen, source = apply_steps(X, self.prediction_steps())
        table, proba = contract.predict_decisions(self.system_, seen)
        position = table["capture"].to_numpy()
        capture = source[position]
        shift = (unblind(seen).piece[position] - unblind(X).piece[capture]) % COPY
        return table.assign(capture=capture, start=table["start"].to_numpy() + shift), proba

    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Mean probabilities over the decisions on each capture [captures, classes]."""
        if contract.decides_often(self.system_):
            table, proba = self.decide(X)
            return mean_by_capture(proba, table["capture"].to_numpy())
        # without the table of decisions, which takes a tenth of a robot's time
        seen, source = apply_steps(X, self.prediction_steps())
        return mean_by_capture(contract.predict_probabilities(self.system_, seen), source)

    def keeps_before(self, taxels: int) -> int:
        """Numbers in memory for the steps."""
        return sum(step.kept_numbers(taxels) for step in self.prediction_steps())

    def length(self, rate_hz: float) -> int | None:
        """Frames of a window of the wrapped system, if it cuts its own."""
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
    """Build a system, within a `Recipe` if one of its parameters is not at its default.

    A system has the parameters of a `Recipe` except those of the same name as its own. A search
    draws names that are joined by +; these become a tuple.
    """
    defaults = recipe_defaults(factory)
    options: dict[str, Any] = {}
    own: dict[str, object] = {}
    for name, value in parameters.items():
        if isinstance(defaults.get(name), tuple) and isinstance(value, str):
            value = tuple(filter(None, value.split("+")))
        (options if name in defaults else own)[name] = value
    system = contract.build_system(factory, feature_set, **own)
    is_changed = any(value != defaults[name] for name, value in options.items())
    return Recipe(system, **options) if is_changed else system


def recipe_defaults(factory: Callable) -> dict[str, object]:
    """Defaults of the parameters of `Recipe`, without those that the factory has itself."""
    own = parameter_defaults(factory)
    return {name: v for name, v in parameter_defaults(Recipe).items() if name not in own}


def _has_feature_step(system: contract.System) -> bool:
    """True for a plain pipeline of a feature set and further steps."""
    if type(system) not in PLAIN_PIPELINES or system.memory is not None or len(system.steps) < 2:
        return False
    name, first = system.steps[0]
    return name == "features" or isinstance(first, FeatureSet)


def _fit_later_steps(
    steps: list[tuple[str, Any]], table: pd.DataFrame, y: np.ndarray, subjects: np.ndarray
) -> Pipeline:
    """Fit the steps after the features; the last gets the subjects if its ``fit`` takes them."""
    name, classifier = steps[-1]
    takes_subjects = FIT_METHOD.find_method(classifier) is not None
    arguments = {f"{name}__subjects": subjects} if takes_subjects else {}
    return Pipeline(steps).fit(table, y, **arguments)


def select_stored_rows(stored: pd.DataFrame, index: np.ndarray) -> tuple[pd.DataFrame, np.ndarray]:
    """Select the rows of captures from a cached table.

    Args:
        stored: table with `bench.features.cache.PIECE_COLUMNS`; the rows of a capture are
            consecutive.
        index: captures to select.

    Returns:
        The rows, indexed as by `FeatureSet.transform`, and for each the position of its capture in
        ``index``.
    """
    capture, piece = (stored[name].to_numpy() for name in PIECE_COLUMNS)
    first = np.searchsorted(capture, index)
    count = np.searchsorted(capture, index, side="right") - first
    source = np.repeat(np.arange(len(index)), count)
    within = np.arange(len(source)) - np.repeat(np.cumsum(count) - count, count)
    rows = first[source] + within
    labels = capture_copy_index(capture[rows], piece[rows] // COPY)
    return stored.iloc[rows].drop(columns=[*PIECE_COLUMNS]).set_axis(labels), source


def apply_steps(X: Corpus, steps: list[Step]) -> tuple[Corpus, np.ndarray]:
    """Captures after some steps, and the position in ``X`` that each comes from."""
    source = np.arange(len(X))
    for step in steps:
        source = source[step.source_rows(X)]
        X = step(X)
    return X, source


def split_causal_steps(system: contract.System) -> tuple[list[Step], contract.System]:
    """Split a fitted system: the causal steps for a whole recording, the system for windows."""
    recipe = getattr(system, "whole_", system)
    if not isinstance(recipe, Recipe):
        return [], system
    causal = [step for step in recipe.prediction_steps() if not isinstance(step, Windows)]
    return causal, recipe.system_


def split_training(system: contract.System) -> tuple[list[Step], list[Step], Recipe]:
    """Split an untrained system: steps that damage, causal steps, and the recipe for windows."""
    recipe = getattr(system, "whole", system)
    if not isinstance(recipe, Recipe):
        return [], [], Recipe(system)
    damaging = [step for step in recipe.training_steps() if isinstance(step, DamagedCopies)]
    causal = [step for step in recipe.prediction_steps() if not isinstance(step, Windows)]
    return damaging, causal, replace(recipe, faults=(), repair=(), scale="none")


def _join_parts(parts: Sequence[Corpus]) -> Corpus:
    """Join captures of the same sensor; frames that some of them share are not copied again."""
    frames, starts, first = [], [], 0
    for part_frames, part_starts in map(shared_frames, parts):
        frames.append(part_frames)
        starts.append(first + part_starts)
        first += len(part_frames)
    fields = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("lengths", "index", "piece")
    }
    tables = [part.captures for part in parts]
    return parts[0].with_fields(
        frames=np.concatenate(frames),
        starts=np.concatenate(starts),
        captures=pd.concat(tables, ignore_index=True),
        **fields,
    )
