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
from bench.errors import InputError
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
MAX_GROWTH = 4.0  # how much more work than the best one of its model a trial may be
SMALL_FIT_S = 0.3  # seconds of work that any model may begin with
MAX_DRAWS = 20  # of the sampler, for one trial
MIN_TEMPERATURE, MAX_TEMPERATURE = 0.05, 20.0  # of a temperature
POOL_SIZE = 12  # of the best trials an ensemble is picked
TIMED_CAPTURES = 3  # single captures whose prediction is timed


@dataclass(eq=False, repr=False)
class Auto(MostProbable):
    """The best of many systems, or several together, searched in a given time on the training part alone.

    A trial is judged by training subjects that are left out (groups of them), and given up as soon as a Wilcoxon
    signed-rank test over the subjects seen so far finds it worse than the best one (p < 0.1), unless it needs less than
    half of the flash or memory of that. First come the trials of `portfolio.FIRST_TRIALS`, cheap ones that are known to
    be good; then a tree-structured Parzen estimator draws from `portfolio.SPACES`. A model may become larger
    only where its larger trials were its best: a trial is at most four times the work of the best one of its model.

    At last an ensemble is picked from the left-out probabilities of the trials (`ensemble.select_ensemble`), begun with
    the most accurate one, and fitted to the whole training part.

    Args:
        seconds: time of the fit. No trial begins when the rest is needed for the last fits. With ``inf`` nothing
            depends on time, unless ``max_predict`` is given.
        trials: number of trials; None for as many as the time allows. For a run that can be repeated give trials and
            ``seconds=inf``.
        inner: groups of training subjects that judge, or ``loso``.
        members: most systems that decide together.
        max_flash: limit of stored bytes, with 32 bits a number, such as ``64kB``; empty for none.
        max_ram: limit of memory during a decision.
        max_predict: limit of the time to compute a decision, such as ``2ms``.
        max_decision: touch after which a label must be there, such as ``1s``: trials are judged by the first second of
            left-out captures. What computing takes comes on top.
        seed: random seed of the search and of the systems.

    Attributes:
        best_: the fitted recogniser.
        chosen_: members of the ensemble, and progress of the search.
        trials_: a row per trial, with its costs and its weight.
        search_seconds_: seconds of all trials, also of those that were stored before; ``fit_seconds_`` wall and CPU
            seconds of the last fits.
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
        """Refuse parameters that cannot be, before anything is run."""
        if not self.seconds > 0:
            raise InputError(f"model.seconds={self.seconds:g}: give a number of seconds above 0")
        check_search(self.inner, self.trials, self.seconds, endless=True)
        if self.members < 1:
            raise InputError(f"model.members={self.members}: give at least 1")
        self._cost_limits(), self._touch_seconds()

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Refuse a training part with too few subjects or classes, or a touch shorter than a frame."""
        if (touch := self._touch_seconds()) is not None and touch * X.rate_hz < 1:
            raise InputError(
                f"model.max_decision={self.max_decision}: shorter than a frame at {X.rate_hz:g} Hz"
            )
        make_inner_folds(X, y, self.inner)

    def _cost_limits(self) -> dict[str, float]:
        """The limit of each cost."""
        texts = {parameter: text for parameter in LIMITS if (text := getattr(self, parameter))}
        return {
            LIMITS[p][0]: LIMITS[p][2] * parse_amount(p, text, LIMITS[p][1], prefix="model.")
            for p, text in texts.items()
        }

    def _touch_seconds(self) -> float | None:
        """Seconds of a touch that a decision may see."""
        return (
            parse_amount("max_decision", self.max_decision, "ms", prefix="model.") / 1e3
            if self.max_decision
            else None
        )

    @property
    def trained_faults(self) -> tuple[str, ...]:
        """Faults of damaged training copies; before the search every fault, since some trials may use any."""
        if "best_" not in vars(self):
            return usual_faults()
        return tuple(
            sorted({name for part in self.best_.members for name in contract.trained_faults(part)})
        )

    def fit(self, X: Corpus, y: np.ndarray) -> Auto:
        """Search on the captures and their class names, then fit the best system to all of them."""
        began = time.perf_counter()
        self.check()
        study = Study(
            {"model": list(portfolio.MODELS), "features": list(portfolio.FEATURES)}
            | portfolio.STEP_SPACE,
            {
                m: {f"{m}.{k}": values for k, values in space.items()}
                for m, space in portfolio.SPACES.items()
            },
            self.seed,
            np.inf if self.trials is None else self.trials,
            self.seconds,
            began,
            self._cost_limits(),
        )
        part = TrainingPart(
            X, np.asarray(y), make_inner_folds(X, y, self.inner), self._touch_seconds(), self.seed
        )
        study.judge_trials(lambda: self._judge_next(study, part), self.study_key(), X, part.y)
        self.search_seconds_ = sum(t.seconds for t in study.finished)
        wall, cpu = time.perf_counter(), time.process_time()
        chosen = self._fit_members(study, part)
        self.fit_seconds_ = time.perf_counter() - wall, time.process_time() - cpu
        self.classes_ = self.best_.classes_
        self.trials_ = _trials_table(study.finished, chosen)
        self.chosen_ = _describe_choice(study.finished, chosen)
        return self

    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Class probabilities [captures, classes]."""
        return self.best_.predict_proba(X)

    def study_key(self) -> dict[str, object]:
        """Influences on trials besides captures and labels; not their number, so that a study can grow."""
        limits = [self.max_flash, self.max_ram, self.max_predict, self.max_decision]
        return {"search": [source_identity(Auto), self.inner, self.seed, self.seconds, *limits]}

    def _judge_next(self, study: Study, part: TrainingPart) -> FinishedTrial | None:
        """Judge the next trial; None where there is no time, or none that is new and small enough."""
        last_fits = sum(tried.fit_seconds for tried, _ in self._select_members(study, part, {}))
        if study.finished and study.seconds_left <= last_fits:
            return None
        trial = _propose_trial(study, part)
        return self._judge_trial(study, part, trial) if trial else None

    def _judge_trial(self, study: Study, part: TrainingPart, trial: Trial) -> FinishedTrial:
        """Judge a trial, as far as it is worth it."""
        tried = FinishedTrial(
            trial, "complete", proba=np.zeros((len(part.y), len(part.classes)), dtype=np.float16)
        )
        try:
            for number, (train, test) in enumerate(part.folds, 1):
                system, seconds = part.fit_trial(trial, train)
                tried.fit_seconds = seconds * len(part.y) / len(train)
                proba = part.predict_left_out(system, test)
                tried.proba[test] = proba
                tried.add_subjects(proba.argmax(axis=1) == part.codes[test], part.subjects[test])
                tried.costs = part.measure_bytes(system)
                if not meets_limits(tried.costs, study.limits):
                    tried.state = "large"
                    break
                if number < len(part.folds) and _is_behind(study, tried):
                    tried.state = "pruned"
                    break
            else:
                tried.costs = part.measure_costs(system)
                tried.temperature = fit_temperature(
                    log_probabilities(tried.proba), part.codes, MIN_TEMPERATURE, MAX_TEMPERATURE
                )
        except Exception as e:  # whatever a system raises on these captures, others may do
            tried.state, tried.error = "failed", f"{type(e).__name__}: {e}"
        if tried.state != "complete":
            tried.proba = None
        return tried

    def _select_members(
        self, study: Study, part: TrainingPart, fitted: dict[int, dict[str, float]]
    ) -> list[tuple[FinishedTrial, float]]:
        """Trials that decide together, and how much each counts, the heaviest first.

        ``fitted`` has what trials cost fitted to all captures, by id; others cost what they did when they were judged.
        """
        costs = {id(t): t.costs for t in study.finished} | fitted
        pool = [
            t
            for t in study.finished
            if t.state == "complete" and meets_limits(costs[id(t)], study.limits)
        ]
        pool = sorted(pool, key=lambda t: -t.accuracy)[:POOL_SIZE]
        if not pool:
            return []

        def allowed(some: set[int]) -> bool:
            return len(some) <= self.members and meets_limits(
                add_costs([costs[id(pool[i])] for i in some]), study.limits
            )

        proba = np.stack([apply_temperature(t.proba, t.temperature) for t in pool])
        picked = [
            (pool[i], w)
            for i, w in select_ensemble(proba, part.codes, part.subjects, allowed).items()
        ]
        return sorted(picked, key=lambda pair: -pair[1])

    def _fit_members(self, study: Study, part: TrainingPart) -> list[tuple[FinishedTrial, float]]:
        """Fit the picked trials to the whole training part; others are picked if these then exceed a limit."""
        fits: dict[int, contract.System] = {}
        costs: dict[int, dict[str, float]] = {}
        while picked := self._select_members(study, part, costs):
            for tried, _ in picked:
                if id(tried) not in fits:
                    fits[id(tried)], _ = part.fit_trial(tried.trial, slice(None))
                    costs[id(tried)] = part.measure_costs(fits[id(tried)])
            if meets_limits(add_costs([costs[id(t)] for t, _ in picked]), study.limits):
                break
        else:
            if errors := [t.error for t in study.finished if t.error]:
                raise RuntimeError(
                    f"{len(errors)} of {len(study.finished)} trials failed, the first: {errors[0]}"
                )
            least = {
                n: min((t.costs[n] for t in study.finished if n in t.costs), default=np.nan)
                for n in study.limits
            }
            words = ", ".join(f"{name} {value:.3g}" for name, value in least.items())
            raise InputError(
                f"no trial is within the limits of model.max_*: the least of {len(study.finished)} are {words}"
            )
        total = sum(w for _, w in picked)
        chosen = [(t, w / total) for t, w in picked]
        self.best_ = Ensemble(
            [fits[id(t)] for t, _ in chosen],
            [w for _, w in chosen],
            [t.temperature for t, _ in chosen],
        )
        return chosen


class TrainingPart:
    """The captures of a training part, and its inner folds, of whose tested captures ``touch`` seconds are seen."""

    def __init__(
        self, X: Corpus, y: np.ndarray, folds: list, touch: float | None, seed: int
    ) -> None:
        self.X = X
        self.y = y
        self.folds = folds
        self.seed = seed
        self.subjects = X.subjects.astype(str)
        self.classes, self.codes = np.unique(y, return_inverse=True)
        self.judged = X if touch is None else _truncate_captures(X, touch)
        self.widths = {
            name: len(clone(one).fit(X[:1]).names_) for name, one in portfolio.FEATURES.items()
        }

    def expected_seconds(self, trial: Trial) -> float:
        """Seconds that a fit of a trial should take (`bench.models.search.portfolio.expected_fit_seconds`)."""
        return portfolio.expected_fit_seconds(
            trial, self.X, self.widths[str(trial["features"])], len(self.classes)
        )

    def fit_trial(self, trial: Trial, part: np.ndarray | slice) -> tuple[contract.System, float]:
        """The system of a trial, fitted to some of the captures, and the seconds of that."""
        system, X, y = portfolio.make_system(trial, self.seed), self.X[part], self.y[part]
        contract.check_training(system, X, y)
        began = time.perf_counter()
        return system.fit(X, y), time.perf_counter() - began

    def predict_left_out(self, system: contract.System, test: np.ndarray) -> np.ndarray:
        """Its probabilities of left-out captures [captures, classes], 0 for a class that it did not learn."""
        proba = np.zeros((len(test), len(self.classes)))
        columns = np.searchsorted(self.classes, system.classes_)
        proba[:, columns] = contract.predict_probabilities(system, self.judged[test])
        return proba

    def measure_bytes(self, system: contract.System) -> dict[str, float]:
        """Bytes of a fitted system in flash and memory, with 32 bits a number."""
        needed = measure_sizes(system, self.X.grid[0] * self.X.grid[1], int(self.X.lengths.max()))
        return {name: needed[name] for name in ("flash_bytes", "ram_bytes")}

    def measure_costs(self, system: contract.System) -> dict[str, float]:
        """The same, and milliseconds of a decision on a capture."""
        some = np.linspace(0, len(self.X) - 1, TIMED_CAPTURES).astype(int)
        spent = time_repeatedly(
            partial(system.predict, self.X[i : i + 1].detach()) for i in some
        ).ms
        return self.measure_bytes(system) | {"predict_ms": float(np.median(spent))}


def _truncate_captures(X: Corpus, seconds: float) -> Corpus:
    """The first seconds of each capture, at least a frame; without the digest, under which whole ones are kept."""
    frames = max(1, int(seconds * X.rate_hz + 1e-6))
    return X.with_fields(lengths=np.minimum(X.lengths, frames), digest="", path=None)


def _propose_trial(study: Study, part: TrainingPart) -> Trial | None:
    """The next of those that come first; then one that is drawn, small enough and new; None if there is none.

    It depends on the trials so far alone, not on the time that is left.
    """
    if len(study.finished) < len(portfolio.FIRST_TRIALS):
        return portfolio.with_defaults(portfolio.FIRST_TRIALS[len(study.finished)])
    earlier = [tried.trial for tried in study.finished]
    for draw in range(MAX_DRAWS):
        trial = study.draw_trial({}, draw)
        same = [
            t
            for t in study.finished
            if t.state == "complete" and t.trial["model"] == trial["model"]
        ]
        best = max(same, key=lambda t: t.accuracy, default=None)
        allowed = (
            max(SMALL_FIT_S, MAX_GROWTH * part.expected_seconds(best.trial))
            if best
            else SMALL_FIT_S
        )
        if trial not in earlier and part.expected_seconds(trial) <= allowed:
            return trial
    return None


def _is_behind(study: Study, tried: FinishedTrial) -> bool:
    """Whether a trial is worse than the best one that is within the limits, and not much smaller."""
    rivals = [
        t for t in study.finished if t.state == "complete" and meets_limits(t.costs, study.limits)
    ]
    if not rivals or not study.is_worse(tried):
        return False
    best = max(rivals, key=lambda t: t.accuracy)
    return not any(value < best.costs[name] / 2 for name, value in tried.costs.items())


def add_costs(costs: list[dict[str, float]]) -> dict[str, float]:
    """Costs of several systems that decide one after the other."""
    sums = {name: sum(each[name] for each in costs) for name in costs[0]}
    return sums | {"ram_bytes": max(each["ram_bytes"] for each in costs)}


def _trials_table(
    tried: list[FinishedTrial], chosen: list[tuple[FinishedTrial, float]]
) -> pd.DataFrame:
    """A row per trial, in their order."""
    weights = {id(t): w for t, w in chosen}
    rows = [
        t.as_row() | {"fit_seconds": t.fit_seconds, "weight": weights.get(id(t), 0.0)} | t.costs
        for t in tried
    ]
    return pd.DataFrame(rows)


def _describe_choice(
    tried: list[FinishedTrial], chosen: list[tuple[FinishedTrial, float]]
) -> dict[str, object]:
    """The chosen systems, in words, and the progress of the search."""
    words: dict[str, object] = {
        str(i): f"{w:.2f} {portfolio.describe_trial(t.trial)}" for i, (t, w) in enumerate(chosen, 1)
    }
    states = [t.state for t in tried]
    words |= {name: states.count(name) for name in ("complete", "pruned", "large", "failed")}
    return words | (
        {"error": next(t.error for t in tried if t.error)} if "failed" in states else {}
    )
