"""The search over everything, within a budget that is the whole fit."""

from __future__ import annotations

import time

import numpy as np
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.utils.validation import check_is_fitted

from bench import contract
from bench.amounts import quantity
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.models.recipe import Recipe
from bench.models.search import portfolio
from bench.models.search.ensemble import Ensemble, logarithms, selected, tempered
from bench.models.search.identity import identity
from bench.models.search.inner_folds import by_subject, check_search, labelled_folds
from bench.models.search.space import Trial
from bench.models.search.study import Study, Tried, within
from bench.models.search.trial_scores import Inner
from bench.models.search.trials import COSTS, summary, table_of, together
from bench.models.temperature import fit_temperature

LIMITS = {"flash": ("kB", 1e3), "ram": ("kB", 1e3), "predict": ("ms", 1.0)}  # unit, and its factor
GROWTH = 4.0  # how much more work than the best one of its model a trial may be
SMALL = 0.3  # seconds of work that any model may begin with
DRAWS = 20  # of the sampler, for one trial
COLDEST, HOTTEST = 0.05, 20.0  # of a temperature
POOL = 12  # of the best trials an ensemble is picked
TABLES = 0.4  # of the budget that the features of all captures may take
CAUTION = 1.2  # times what a trial should take must be left
SKIPS = 5  # drawn trials one after the other that would take too long end the search
SPARE = 0.02  # of the budget, for what cannot be foreseen
CHEAP = 3  # of those that come first, where there is no time to judge any


class Auto(ClassifierMixin, BaseEstimator):
    """The best of many systems, or several together, searched in a given time on the training part alone.

    A trial is judged by training subjects that are left out (groups of them), and given up as soon as a Wilcoxon
    signed-rank test over the subjects seen so far finds it worse than the best one (p < 0.1), unless it needs less than
    half of the flash or memory of that. First come the trials of `portfolio.FIRST`, cheap ones that are known to
    be good; then a tree-structured Parzen estimator draws from `portfolio.SPACES`. A model may become larger
    only where its larger trials were its best: a trial is at most four times the work of the best one of its model.

    At last an ensemble is picked from the left-out probabilities of the trials (`ensemble.selected`), begun with
    the most accurate one, and fitted to the whole training part.

    The budget is all of that: features that are not kept yet, trials, the last fits. A trial that cannot end in what
    is left, after the last fits, is not begun. Where not even the features of all captures can be computed, as many as
    there is time for are used. With ``seconds=inf`` nothing depends on time, unless ``max_predict`` is asked for.

    Args:
        seconds: time of the whole fit. Progress depends on the machine; see ``chosen_``.
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
        trials_: a row per trial, with its costs, its weight, and whether it is on the front of accuracy and each cost.
        tried_: the same as `Tried`.
        search_seconds_: seconds of all trials, also of those that were stored before; ``fit_seconds_`` wall and CPU
            seconds of the last fits.
    """

    searches = True
    features = portfolio.FEATURES

    def __init__(
        self,
        seconds: float = 60.0,
        trials: int | None = None,
        inner: str = "3",
        members: int = 5,
        max_flash: str = "",
        max_ram: str = "",
        max_predict: str = "",
        max_decision: str = "",
        seed: int = 0,
    ) -> None:
        self.seconds = seconds
        self.trials = trials
        self.inner = inner
        self.members = members
        self.max_flash = max_flash
        self.max_ram = max_ram
        self.max_predict = max_predict
        self.max_decision = max_decision
        self.seed = seed

    def check(self) -> None:
        """Refuse parameters that cannot be, before anything is run.

        Raises:
            InputError: one of them.
        """
        if not self.seconds > 0:
            raise InputError(f"model.seconds={self.seconds:g}: give a number of seconds above 0")
        check_search(self.inner, self.trials, self.seconds, endless=True)
        if self.members < 1:
            raise InputError(f"model.members={self.members}: give at least 1")
        self._limits(), self._touch()

    def _limits(self) -> dict[str, float]:
        """What each cost must not exceed."""
        limits = {}
        for cost, (unit, factor) in LIMITS.items():
            if text := getattr(self, f"max_{cost}"):
                limits[COSTS[cost]] = factor * quantity(f"max_{cost}", text, unit, prefix="model.")
        return limits

    def _touch(self) -> float | None:
        """Seconds of a touch that a decision may see."""
        return quantity("max_decision", self.max_decision, "ms", prefix="model.") / 1e3 if self.max_decision else None

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Refuse a training part before anything is run.

        Raises:
            InputError: it has fewer than two subjects, or an inner training part has only one class.
        """
        if (touch := self._touch()) is not None and touch * X.rate_hz < 1:
            raise InputError(f"model.max_decision={self.max_decision}: shorter than a frame at {X.rate_hz:g} Hz")
        labelled_folds(X, y, self.inner)

    @property
    def trained_faults(self) -> tuple[str, ...]:
        """Faults of damaged training copies; before the search every fault, since some trials may use any."""
        if "best_" in vars(self):
            parts = contract.members(self.best_) or [self.best_]
            return tuple(sorted({name for part in parts for name in contract.trained_faults(part)}))
        return Recipe(None, faults=("all",)).trained_faults  # type: ignore[arg-type]

    def fit(self, X: Corpus, y: np.ndarray) -> Auto:
        """Search on the captures and their class names, then fit the best system to all of them.

        Raises:
            InputError: fewer than two subjects, or no trial is within the limits.
        """
        began = time.perf_counter()
        self.check()
        self.part_ = self._affordable(X, np.asarray(y))
        X, y = X[self.part_], np.asarray(y)[self.part_]
        # Features are kept by the digest, for all captures: not of a part of them.
        captures = X if isinstance(self.part_, slice) else X.changed(digest="", path=None)
        inner = Inner(captures, y, labelled_folds(X, y, self.inner), self._touch(), self.seed)
        study = Study(
            {"model": list(portfolio.MODELS), "features": list(portfolio.FEATURES)} | portfolio.BEFORE,
            {m: {f"{m}.{k}": values for k, values in space.items()} for m, space in portfolio.SPACES.items()},
            self.seed,
            np.inf if self.trials is None else self.trials,
            self.seconds,
            began,
            self._limits(),
        )
        self.tried_ = study.tried
        study.search(lambda: self._step(inner, study), self.study_key(), X, y)
        self.search_seconds_ = time.perf_counter() - study.began
        wall, cpu = time.perf_counter(), time.process_time()
        chosen = self._fitted(inner, study)
        self.fit_seconds_ = time.perf_counter() - wall, time.process_time() - cpu
        self.classes_ = self.best_.classes_
        self.trials_ = table_of(self.tried_, chosen)
        self.chosen_ = summary(self.tried_, chosen, self.part_)
        for tried in self.tried_:  # nobody needs them to decide, and saved systems hold nothing of training captures
            tried.proba = None
        return self

    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Class probabilities [captures, classes]."""
        check_is_fitted(self, "best_")
        return self.best_.predict_proba(X)

    def predict(self, X: Corpus) -> np.ndarray:
        """Class name of each capture."""
        return self.classes_[self.predict_proba(X).argmax(axis=1)]

    def study_key(self) -> dict[str, object]:
        """Influences on trials besides captures and labels; not their number, so that a study can grow."""
        limits = [self.max_flash, self.max_ram, self.max_predict, self.max_decision]
        return {"search": [identity(Auto), self.inner, self.seed, self.seconds, *limits]}

    def _affordable(self, X: Corpus, y: np.ndarray) -> slice | np.ndarray:
        """All captures, or as many of each class and subject as there is time to compute the features of."""
        first = portfolio.complete(portfolio.FIRST[0])
        needed = Inner(X, y, [], self._touch(), self.seed).tabling(first)
        every = max(1, int(np.ceil(needed / (TABLES * self.seconds))))
        order = np.lexsort((X.subjects.astype(str), y.astype(str)))
        while every > 1:
            part = np.sort(order[::every])
            try:
                labelled_folds(X[part], y[part], self.inner)
                return part
            except InputError:  # too few of them to judge by
                every //= 2
        return slice(None)

    def _step(self, inner: Inner, study: Study) -> Tried | None:
        """Judge the next trial, or skip it; None where there is no time, or none that is new and fits into it."""
        spare = SPARE * self.seconds if np.isfinite(self.seconds) else 0.0
        left = study.left - spare - self._last_fits(inner, study.left)
        trial = self._next(study, inner) if left > 0 else None
        if trial is None or [t.state for t in self.tried_[len(portfolio.FIRST) :]][-SKIPS:] == ["skipped"] * SKIPS:
            return None
        if self._expected(inner, trial) > left:
            return Tried(trial, "skipped")
        return self._try(study, inner, trial, left)

    def _next(self, study: Study, inner: Inner) -> Trial | None:
        """The next of those that come first; then one that is drawn, small enough and new; None if there is none.

        It depends on the trials so far alone, not on the time that is left.
        """
        if len(self.tried_) < len(portfolio.FIRST):
            return portfolio.complete(portfolio.FIRST[len(self.tried_)])
        earlier = [tried.trial for tried in self.tried_]
        for draw in range(DRAWS):
            trial = study.drawn({}, draw)
            if trial not in earlier and inner.work(trial) <= self._allowed(inner, trial):
                return trial
        return None

    def _allowed(self, inner: Inner, trial: Trial) -> float:
        """Work that a trial of a model may be: some times that of its best one."""
        same = [t for t in self.tried_ if t.state == "complete" and t.trial["model"] == trial["model"]]
        best = max(same, key=lambda t: t.accuracy, default=None)
        return max(SMALL, GROWTH * inner.work(best.trial)) if best else SMALL

    def _expected(self, inner: Inner, trial: Trial) -> float:
        """Seconds that a trial and its last fit should take, by those before."""
        ratio = self._ratio(inner, trial)
        return CAUTION * (inner.tabling(trial) + ratio * (inner.judging(trial) + inner.work(trial)))

    def _ratio(self, inner: Inner, trial: Trial) -> float:
        """Seconds over work: of the last trial of the same model, else the median of the last of others, else 1."""
        last = {t.trial["model"]: t.fit_seconds / inner.work(t.trial) for t in self.tried_ if t.fit_seconds}
        return last.get(trial["model"], float(np.median([*last.values()])) if last else 1.0)

    def _try(self, study: Study, inner: Inner, trial: Trial, left: float) -> Tried:
        """Judge a trial, as far as it is worth it."""
        began = time.perf_counter()
        tried = Tried(trial, "complete", proba=np.zeros((len(inner.y), len(inner.classes)), dtype=np.float16))
        try:
            inner.table(trial), inner.table(trial, tested=True)
            left, began = left - (time.perf_counter() - began), time.perf_counter()
            self._judge(study, inner, tried, began, left)
        except Exception as e:  # whatever a system raises on these captures, others may do
            tried.state, tried.error = "failed", f"{type(e).__name__}: {e}"
        if tried.state != "complete":
            tried.proba = None
        return tried

    def _judge(self, study: Study, inner: Inner, tried: Tried, began: float, left: float) -> None:
        """Fill in what the inner folds say of a trial, until it is not worth it any more."""
        trial = tried.trial
        done = spent = 0.0
        for number, (model, test, proba, seconds) in enumerate(inner.judge(trial), 1):
            tried.proba[test] = proba
            done += inner.work(trial, len(inner.folds[number - 1][0]) / len(inner.X))
            spent += seconds
            tried.fit_seconds = spent * inner.work(trial) / done
            tried.subjects |= by_subject(proba.argmax(axis=1) == inner.codes[test], inner.subjects[test])
            system = inner.system(trial, model)
            tried.costs = inner.bytes(system)
            if not within(tried.costs, study.limits):
                tried.state = "large"
                return
            if number == len(inner.folds):
                tried.costs = inner.costs(system)
                tried.heat = fit_temperature(logarithms(tried.proba), inner.codes, COLDEST, HOTTEST)
            elif self._behind(study, tried):
                tried.state = "pruned"
                return
            elif (time.perf_counter() - began) / number * len(inner.folds) + tried.fit_seconds > left:
                tried.state = "late"
                return

    def _behind(self, study: Study, tried: Tried) -> bool:
        """Whether a trial is worse than the best one that is within the limits, and not much smaller."""
        rivals = [t for t in self.tried_ if t.state == "complete" and within(t.costs, study.limits)]
        if not rivals or not study.worse(tried):
            return False
        best = max(rivals, key=lambda t: t.accuracy)
        return not any(value < best.costs[name] / 2 for name, value in tried.costs.items())

    def _picked(
        self, inner: Inner, left: float, fitted: dict[int, dict[str, float]] | None = None
    ) -> list[tuple[Tried, float]]:
        """Trials that decide together, and how much each counts; their last fits should end in the seconds left.

        Args:
            inner: the captures.
            left: seconds.
            fitted: by its id, what a trial costs fitted to all captures; else what it cost when it was judged.
        """
        limits = self._limits()
        costs = {id(t): t.costs for t in self.tried_} | (fitted or {})
        pool = [t for t in self.tried_ if t.state == "complete" and within(costs[id(t)], limits)]
        pool = sorted(pool, key=lambda t: -t.accuracy)[:POOL]
        if not pool:
            return []

        def allowed(some: set[int]) -> bool:
            in_time = len(some) == 1 or sum(_last_fit(inner, pool[i]) for i in some) <= left
            both = together([costs[id(pool[i])] for i in some])
            return len(some) <= self.members and in_time and within(both, limits)

        proba = np.stack([tempered(t.proba, t.heat) for t in pool])
        return [(pool[i], w) for i, w in selected(proba, inner.codes, inner.subjects, allowed).items()]

    def _last_fits(self, inner: Inner, left: float) -> float:
        """Seconds that the last fits should take, if the search ended here."""
        return sum(_last_fit(inner, tried) for tried, _ in self._picked(inner, left))

    def _fitted(self, inner: Inner, study: Study) -> list[tuple[Tried, float]]:
        """Fit what was picked to the whole training part; what then exceeds a limit, or comes too late, is left out."""
        if not any(t.state == "complete" for t in self.tried_):
            return self._unjudged(inner)
        fits: dict[int, contract.System] = {}
        costs: dict[int, dict[str, float]] = {}
        while picked := self._picked(inner, study.left, costs):
            heavy = sorted(picked, key=lambda pair: -pair[1])
            for tried, _ in heavy:
                some = any(id(t) in fits for t, _ in picked)
                if id(tried) not in fits and (not some or _last_fit(inner, tried) <= study.left):
                    fits[id(tried)] = inner.fitted(tried.trial)
                    costs[id(tried)] = inner.costs(fits[id(tried)])
            kept = [(t, w) for t, w in heavy if id(t) in fits]
            if within(together([costs[id(t)] for t, _ in kept]), self._limits()):
                break
        else:
            raise InputError(self._too_large())
        total = sum(w for _, w in kept)
        kept = [(t, w / total) for t, w in kept]
        self.best_ = Ensemble([fits[id(t)] for t, _ in kept], [w for _, w in kept], [t.heat for t, _ in kept])
        return kept

    def _unjudged(self, inner: Inner) -> list[tuple[Tried, float]]:
        """The first that is within the limits, where there was no time to judge any.

        Raises:
            InputError: none of the cheap ones is.
        """
        for trial in portfolio.FIRST[:CHEAP]:
            tried = Tried(portfolio.complete(trial), "unjudged")
            self.best_ = inner.fitted(tried.trial)
            tried.costs = inner.costs(self.best_)
            self.tried_.append(tried)
            if within(tried.costs, self._limits()):
                return [(tried, 1.0)]
        raise InputError(self._too_large())

    def _too_large(self) -> str:
        """The message where nothing is within the limits."""
        least = {n: min((t.costs[n] for t in self.tried_ if n in t.costs), default=np.nan) for n in self._limits()}
        words = ", ".join(f"{name} {value:.3g}" for name, value in least.items())
        return f"no trial is within the limits of model.max_*: the least of {len(self.tried_)} are {words}"


def _last_fit(inner: Inner, tried: Tried) -> float:
    """Seconds that the last fit of a trial should take."""
    return tried.fit_seconds + inner.tabling(tried.trial)
