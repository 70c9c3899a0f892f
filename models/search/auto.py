"""The search over everything, within a budget of time and limits of memory."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from sklearn.base import clone

from bench import contract
from bench.corpora.corpus import Corpus
from bench.corpora.faults import usual_faults
from bench.errors import InputError, check_value
from bench.ground.timing import time_repeatedly
from bench.ground.typed import parse_amount
from bench.models.most_probable import MostProbable
from bench.models.search import portfolio
from bench.models.search.ensemble import (
    Ensemble,
    apply_temperature,
    fit_temperature,
    log_probabilities,
    select_ensemble,
)
from bench.models.search.inner_folds import check_search, make_inner_folds
from bench.models.search.study import FinishedTrial, Study, meets_limits, source_identity
from bench.models.sizes import measure_sizes
from bench.models.space import Trial

LIMITS = {  # by parameter: the cost, its unit, and the factor of that
    "max_flash": ("flash_bytes", "kB", 1e3),
    "max_ram": ("ram_bytes", "kB", 1e3),
    "max_predict": ("predict_ms", "ms", 1.0),
}
MAX_GROWTH = 4.0  # of the expected fit time, relative to the best trial of the same model
SMALL_FIT_S = 0.3  # expected fit time that a first trial of a model may have
MAX_DRAWS = 20  # of the sampler, for one trial
MIN_TEMPERATURE, MAX_TEMPERATURE = 0.05, 20.0
POOL_SIZE = 12  # number of the best trials that an ensemble is selected from
TIMED_CAPTURES = 3  # single captures whose prediction is timed


@dataclass(eq=False, repr=False)
class Auto(MostProbable):
    """An ensemble of the best of many systems, searched in a given time on the training part.

    A trial is scored on left-out groups of training subjects. It is pruned as soon as a Wilcoxon
    signed-rank test over the subjects so far finds it worse than the best one (p < 0.1), unless it
    needs less than half of that one's flash or memory. The first trials are those of
    `portfolio.FIRST_TRIALS`, cheap ones that are known to be good; then a tree-structured Parzen
    estimator draws from `portfolio.SPACES`. A trial may take at most four times as long to fit as
    the best one of its model, so a model grows only while that helps.

    At last an ensemble is selected by the left-out probabilities of the trials
    (`ensemble.select_ensemble`), starting with the most accurate one, and fitted to the whole
    training part.

    Args:
        seconds: time of the fit. No trial begins when the rest is needed for the last fits. With
            ``inf`` nothing depends on time, unless ``max_predict`` is given.
        trials: number of trials; None for as many as the time allows. For a reproducible run give
            trials and ``seconds=inf``.
        inner: number of groups of training subjects that are left out in turn, or ``loso``.
        members: largest number of systems in the ensemble.
        max_flash: limit of stored bytes, with 32 bits a number, such as ``64kB``; empty for none.
        max_ram: limit of memory during a decision.
        max_predict: limit of the time to compute a decision, such as ``2ms``.
        max_decision: duration of touch after which a label must be there, such as ``1s``: trials
            are scored on the first second of left-out captures. Computing time is not included.
        seed: random seed of the search and of the systems.

    Attributes:
        best_: the fitted ensemble.
        chosen_: members of the ensemble, and progress of the search.
        trials_: a row per trial, with its costs and its weight.
        search_seconds_: seconds of all trials, also of those that were stored before;
            ``fit_seconds_`` wall and CPU seconds of the last fits.
    """

    searches = True
    features = portfolio.FEATURES

    seconds: float = 60.0
    trials: int | None = None
    inner: str = "3"
    members: int = 5
    max_flash: str = ""
    max_ram: str = ""
    max_predict: str = ""
    max_decision: str = ""
    seed: int = 0

    def check(self) -> None:
        """Check the parameters."""
        seconds = "a number of seconds above 0"
        check_value("model.seconds", self.seconds, self.seconds > 0, seconds)
        check_search(self.inner, self.trials, self.seconds, is_endless=True)
        check_value("model.members", self.members, self.members >= 1, "at least 1")
        self._cost_limits(), self._touch_seconds()

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Check the subjects and classes, and that the limit of touch is at least a frame."""
        if (touch_s := self._touch_seconds()) is not None:
            frame = f"at least a frame at {X.rate_hz:g} Hz"
            check_value("model.max_decision", self.max_decision, touch_s * X.rate_hz >= 1, frame)
        make_inner_folds(X, y, self.inner)

    def _cost_limits(self) -> dict[str, float]:
        """Limit of each cost that has one."""
        limits = {}
        for parameter, (cost, unit, factor) in LIMITS.items():
            if text := getattr(self, parameter):
                limits[cost] = factor * parse_amount(parameter, text, unit, prefix="model.")
        return limits

    def _touch_seconds(self) -> float | None:
        """Seconds of touch before a decision; None for whole captures."""
        if not self.max_decision:
            return None
        return parse_amount("max_decision", self.max_decision, "ms", prefix="model.") / 1e3

    @property
    def trained_faults(self) -> tuple[str, ...]:
        """Faults of damaged training copies; all before the search, as trials may use any."""
        if "best_" not in vars(self):
            return usual_faults()
        faults = [name for part in self.best_.members for name in contract.trained_faults(part)]
        return tuple(sorted({*faults}))

    def fit(self, X: Corpus, y: np.ndarray) -> Auto:
        """Search on the captures and their class names, then fit the ensemble to all of them."""
        started = time.perf_counter()
        self.check()
        common = {"model": list(portfolio.MODELS), "features": list(portfolio.FEATURES)}
        spaces = {}
        for model, space in portfolio.SPACES.items():
            spaces[model] = {f"{model}.{key}": values for key, values in space.items()}
        study = Study(
            common | portfolio.STEP_SPACE,
            spaces,
            self.seed,
            np.inf if self.trials is None else self.trials,
            self.seconds,
            started,
            self._cost_limits(),
        )
        folds = make_inner_folds(X, y, self.inner)
        part = TrainingPart(X, np.asarray(y), folds, self._touch_seconds(), self.seed)
        study.judge_trials(lambda: self._judge_next(study, part), self.study_key(), X, part.y)
        self.search_seconds_ = sum(trial.seconds for trial in study.finished)
        wall, cpu = time.perf_counter(), time.process_time()
        weights = self._fit_members(study, part)
        self.fit_seconds_ = time.perf_counter() - wall, time.process_time() - cpu
        self.classes_ = self.best_.classes_
        self.trials_ = _trials_table(study.finished, weights)
        self.chosen_ = _describe_choice(study.finished, weights)
        return self

    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Class probabilities [captures, classes]."""
        return self.best_.predict_proba(X)

    def study_key(self) -> dict[str, object]:
        """Influences on trials besides captures and labels.

        The number of trials is none, so that a study can grow.
        """
        limits = [self.max_flash, self.max_ram, self.max_predict, self.max_decision]
        return {"search": [source_identity(Auto), self.inner, self.seed, self.seconds, *limits]}

    def _judge_next(self, study: Study, part: TrainingPart) -> FinishedTrial | None:
        """Judge the next trial; None if no time is left, or no new small trial was drawn."""
        members = self._select_members(study, part, {})
        last_fits = sum(trial.fit_seconds for trial in members)
        if study.finished and study.seconds_left <= last_fits:
            return None
        proposed = _propose_trial(study, part)
        return self._judge_trial(study, part, proposed) if proposed else None

    def _judge_trial(self, study: Study, part: TrainingPart, proposed: Trial) -> FinishedTrial:
        """Judge a trial on all inner folds, or until it fails, is too large, or is pruned."""
        trial = FinishedTrial(proposed, "complete")
        probas = np.zeros((len(part.y), len(part.classes)), dtype=np.float16)
        try:
            for number, (train, test) in enumerate(part.folds, 1):
                system, seconds = part.fit_trial(proposed, train)
                trial.fit_seconds = seconds * len(part.y) / len(train)
                proba = part.predict_left_out(system, test)
                probas[test] = proba
                is_correct = proba.argmax(axis=1) == part.codes[test]
                trial.add_subjects(is_correct, part.subjects[test])
                trial.costs = part.measure_bytes(system)
                if not meets_limits(trial.costs, study.limits):
                    trial.state = "large"
                elif number < len(part.folds) and _is_behind(study, trial):
                    trial.state = "pruned"
                if trial.state != "complete":
                    return trial
            trial.costs = part.measure_costs(system)
            scores = log_probabilities(probas)
            bounds = MIN_TEMPERATURE, MAX_TEMPERATURE
            trial.temperature = fit_temperature(scores, part.codes, *bounds)
            trial.proba = probas
        except Exception as e:  # a system may raise anything; other trials go on
            trial.state, trial.error = "failed", f"{type(e).__name__}: {e}"
        return trial

    def _select_members(
        self, study: Study, part: TrainingPart, fitted_costs: dict[FinishedTrial, dict[str, float]]
    ) -> dict[FinishedTrial, float]:
        """Trials of the ensemble and their weights, in falling order.

        ``fitted_costs`` are those of systems fitted to all captures; others count with the costs of
        their trials.
        """
        costs = {trial: trial.costs for trial in study.finished} | fitted_costs
        complete = [trial for trial in study.finished if trial.state == "complete"]
        pool = [trial for trial in complete if meets_limits(costs[trial], study.limits)]
        pool = sorted(pool, key=lambda trial: -trial.accuracy)[:POOL_SIZE]
        if not pool:
            return {}

        def is_allowed(positions: set[int]) -> bool:
            together = add_costs([costs[pool[i]] for i in positions])
            return len(positions) <= self.members and meets_limits(together, study.limits)

        proba = np.stack([apply_temperature(trial.proba, trial.temperature) for trial in pool])
        weights = select_ensemble(proba, part.codes, part.subjects, is_allowed)
        return {pool[i]: weights[i] for i in sorted(weights, key=lambda i: -weights[i])}

    def _fit_members(self, study: Study, part: TrainingPart) -> dict[FinishedTrial, float]:
        """Fit the ensemble to the whole training part; select another one if it exceeds a limit.

        Returns:
            Weights of the trials in the ensemble.

        Raises:
            InputError: no ensemble is within the limits.
            RuntimeError: there is none, since trials failed.
        """
        systems: dict[FinishedTrial, contract.System] = {}
        costs: dict[FinishedTrial, dict[str, float]] = {}
        while weights := self._select_members(study, part, costs):
            for trial in weights:
                if trial not in systems:
                    systems[trial], _ = part.fit_trial(trial.trial, slice(None))
                    costs[trial] = part.measure_costs(systems[trial])
            if meets_limits(add_costs([costs[trial] for trial in weights]), study.limits):
                break
        else:
            _refuse_trials(study)
        total = sum(weights.values())
        weights = {trial: weight / total for trial, weight in weights.items()}
        members, temperatures = [systems[t] for t in weights], [t.temperature for t in weights]
        self.best_ = Ensemble(members, [*weights.values()], temperatures)
        return weights


def _refuse_trials(study: Study) -> None:
    """Raise an error that says why no trial can be used."""
    count = len(study.finished)
    if errors := [trial.error for trial in study.finished if trial.error]:
        raise RuntimeError(f"{len(errors)} of {count} trials failed, the first: {errors[0]}")
    lowest = []
    for cost in study.limits:
        values = [trial.costs[cost] for trial in study.finished if cost in trial.costs]
        lowest.append(f"{cost} {min(values, default=np.nan):.3g}")
    limits = "no trial is within the limits of model.max_*"
    raise InputError(f"{limits}: the least of {count} are {', '.join(lowest)}")


class TrainingPart:
    """The captures of a training part, its inner folds, and predictions of left-out captures."""

    def __init__(
        self, X: Corpus, y: np.ndarray, folds: list, touch_s: float | None, seed: int
    ) -> None:
        self.X = X
        self.y = y
        self.folds = folds
        self.seed = seed
        self.subjects = X.subjects.astype(str)
        self.classes, self.codes = np.unique(y, return_inverse=True)
        self.judged = X if touch_s is None else _truncate_captures(X, touch_s)
        sets = portfolio.FEATURES.items()
        self.widths = {name: len(clone(part).fit(X[:1]).names_) for name, part in sets}

    def expected_seconds(self, trial: Trial) -> float:
        """Seconds that a fit of a trial should take."""
        width = self.widths[str(trial["features"])]
        return portfolio.expected_fit_seconds(trial, self.X, width, len(self.classes))

    def fit_trial(self, trial: Trial, rows: np.ndarray | slice) -> tuple[contract.System, float]:
        """Fit the system of a trial to some captures; return it and the seconds of the fit."""
        system, X, y = portfolio.make_system(trial, self.seed), self.X[rows], self.y[rows]
        contract.check_training(system, X, y)
        started = time.perf_counter()
        return system.fit(X, y), time.perf_counter() - started

    def predict_left_out(self, system: contract.System, test: np.ndarray) -> np.ndarray:
        """Probabilities of left-out captures [captures, classes], 0 for unknown classes."""
        proba = np.zeros((len(test), len(self.classes)))
        columns = np.searchsorted(self.classes, system.classes_)
        proba[:, columns] = contract.predict_probabilities(system, self.judged[test])
        return proba

    def measure_bytes(self, system: contract.System) -> dict[str, float]:
        """Bytes of a fitted system in flash and memory, with 32 bits a number."""
        taxels, longest = self.X.grid[0] * self.X.grid[1], int(self.X.lengths.max())
        sizes = measure_sizes(system, taxels, longest)
        return {name: sizes[name] for name in ("flash_bytes", "ram_bytes")}

    def measure_costs(self, system: contract.System) -> dict[str, float]:
        """Bytes, and milliseconds of a decision on a capture."""
        rows = np.linspace(0, len(self.X) - 1, TIMED_CAPTURES).astype(int)
        captures = [self.X[i : i + 1].detach() for i in rows]
        times = time_repeatedly(partial(system.predict, capture) for capture in captures)
        return self.measure_bytes(system) | {"predict_ms": float(np.median(times.ms))}


def _truncate_captures(X: Corpus, seconds: float) -> Corpus:
    """The first seconds of each capture, at least a frame, without the digest of whole ones."""
    frames = max(1, int(seconds * X.rate_hz + 1e-6))
    return X.with_fields(lengths=np.minimum(X.lengths, frames), digest="", path=None)


def _propose_trial(study: Study, part: TrainingPart) -> Trial | None:
    """The next one of the first trials, then a drawn one; None if no new small one is drawn.

    It depends on the finished trials alone, not on the time that is left.
    """
    if len(study.finished) < len(portfolio.FIRST_TRIALS):
        return portfolio.with_defaults(portfolio.FIRST_TRIALS[len(study.finished)])
    earlier = [finished.trial for finished in study.finished]
    complete = [finished for finished in study.finished if finished.state == "complete"]
    for draw in range(MAX_DRAWS):
        trial = study.draw_trial({}, draw)
        rivals = [finished for finished in complete if finished.trial["model"] == trial["model"]]
        limit = SMALL_FIT_S
        if rivals:
            best = max(rivals, key=lambda rival: rival.accuracy)
            limit = max(limit, MAX_GROWTH * part.expected_seconds(best.trial))
        if trial not in earlier and part.expected_seconds(trial) <= limit:
            return trial
    return None


def _is_behind(study: Study, trial: FinishedTrial) -> bool:
    """True if a trial is worse than the best one within the limits, and not much smaller."""
    complete = [finished for finished in study.finished if finished.state == "complete"]
    rivals = [rival for rival in complete if meets_limits(rival.costs, study.limits)]
    if not rivals or not study.is_worse(trial):
        return False
    best = max(rivals, key=lambda rival: rival.accuracy)
    return not any(value < best.costs[name] / 2 for name, value in trial.costs.items())


def add_costs(costs: list[dict[str, float]]) -> dict[str, float]:
    """Costs of several systems that decide one after another."""
    sums = {name: sum(each[name] for each in costs) for name in costs[0]}
    return sums | {"ram_bytes": max(each["ram_bytes"] for each in costs)}


def _trials_table(trials: list[FinishedTrial], weights: dict[FinishedTrial, float]) -> pd.DataFrame:
    """Table with a row per trial, in their order."""
    rows = []
    for trial in trials:
        facts = {"fit_seconds": trial.fit_seconds, "weight": weights.get(trial, 0.0)}
        rows.append(trial.as_row() | facts | trial.costs)
    return pd.DataFrame(rows)


def _describe_choice(
    trials: list[FinishedTrial], weights: dict[FinishedTrial, float]
) -> dict[str, object]:
    """The members of the ensemble in words, and the progress of the search."""
    description: dict[str, object] = {}
    for number, (trial, weight) in enumerate(weights.items(), 1):
        description[str(number)] = f"{weight:.2f} {portfolio.describe_trial(trial.trial)}"
    states = [trial.state for trial in trials]
    for state in ("complete", "pruned", "large", "failed"):
        description[state] = states.count(state)
    if errors := [trial.error for trial in trials if trial.error]:
        description["error"] = errors[0]
    return description
