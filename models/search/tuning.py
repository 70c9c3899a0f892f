"""Parameters chosen inside the training part: a nested search over inner folds of whole subjects, with Optuna."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, ClassifierMixin, TransformerMixin, clone
from sklearn.utils.metaestimators import available_if
from sklearn.utils.validation import check_is_fitted

from bench import contract
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.paired import within_one_standard_error
from bench.pareto import front
from bench.registry import parameters
from models.search.inner_folds import Tables, inner_folds, milliseconds_of
from models.search.space import Range, Space, suggested
from models.search.study import identity, open_study

if TYPE_CHECKING:
    from bench.source import Code
    from models.search.space import Tuning

WORSE = 0.1  # p-value of a signed-rank test over subjects below which a combination is not followed further
COMBINATIONS = 1000  # at most so many are checked one by one before anything is run
OBJECTIVES = ("accuracy", "accuracy+time", "smallest")


class Search(ClassifierMixin, BaseEstimator):
    """The recogniser with the best parameters, judged by subjects that were left out of its training part.

    A combination is scored by the mean accuracy of the left-out training subjects. After each inner fold it is given
    up if a Wilcoxon signed-rank test over the subjects seen so far finds it worse than the best one (p < 0.1). The best
    one, of equal ones the one that takes the earliest values of each list, is then fitted to the whole training part.
    Where there are several models or feature sets, each is tried with each other once before the search goes deeper.

    The study of a stored corpus is kept in the data folder under everything that it depends on; a search that was
    interrupted goes on where it stopped and chooses as if it had not been.

    Args:
        models: factories by name; called with one value of each parameter of its space and, if they take them, with
            ``features`` and ``seed``.
        spaces: for each model the values of each parameter: a list, or a `Range`.
        features: feature sets to choose from by name; empty for models that read raw frames.
        inner: number of groups into which the training subjects are dealt, or ``loso``.
        trials: combinations to try; None for all of them, which needs lists only. Fewer than all are drawn by a
            tree-structured Parzen estimator.
        budget: seconds after which no new combination is begun.
        objective: ``accuracy``; or what gives nothing up and, of the combinations whose accuracy is not below the best
            by more than a standard error of the paired difference, takes the fastest (``accuracy+time``, which searches
            for both) or the one that comes first in the lists (``smallest``).
        seed: of the search, and of models that take one.

    Attributes:
        best_: the fitted recogniser.
        chosen_: model, features and parameters of it.
        trials_: one row per combination: its values, state, accuracy, predict_ms and whether it is on the front of
            accuracy against time.
        fit_seconds_: wall and CPU seconds of the last fit, ``search_seconds_`` those of all combinations.
    """

    searches = True

    def __init__(
        self,
        models: dict[str, Callable],
        spaces: dict[str, Space],
        features: dict[str, TransformerMixin] | None = None,
        inner: str = "3",
        trials: int | None = None,
        budget: float = float("inf"),
        objective: str = "accuracy",
        seed: int = 0,
    ) -> None:
        self.models = models
        self.spaces = spaces
        self.features = features
        self.inner = inner
        self.trials = trials
        self.budget = budget
        self.objective = objective
        self.seed = seed

    def check(self) -> None:
        """Refuse parameters that cannot be, before anything is run.

        Raises:
            InputError: one of them.
        """
        if self.inner != "loso" and not (self.inner.isdecimal() and int(self.inner) >= 2):
            raise InputError(f"model.inner={self.inner}: give a number of subject groups from 2 on, or loso")
        if self.trials is not None and self.trials < 1:
            raise InputError(f"model.trials={self.trials}: give at least 1")
        if not self.budget > 0:
            raise InputError(f"model.budget={self.budget:g}: give a number of seconds above 0")
        if self.objective not in OBJECTIVES:
            raise InputError(f"model.objective={self.objective}: give {', '.join(OBJECTIVES[:-1])} or {OBJECTIVES[-1]}")
        if self.trials is None and self.budget == float("inf") and not self._grid():
            raise InputError("this search has no end: give a number of trials, or a budget in seconds")
        for part in (self.features or {}).values():
            contract.check(part)

    def fit(self, X: Corpus, y: np.ndarray) -> Search:
        """Search on the captures and their class names, then fit the best recogniser to all of them.

        Raises:
            InputError: fewer than two subjects.
        """
        self.check()
        subjects = X.subjects.astype(str)
        folds = self._folds(X, y)
        tables = Tables(self.features or {}, X, y, folds)
        directions = ["maximize", "minimize"] if self.objective == "accuracy+time" else ["maximize"]
        with open_study(self.study_key(), X, y, directions, WORSE) as study:
            finished = _finished(study)
            ends = time.monotonic() + self.budget - _seconds(finished)
            while len(finished) < self._size() and (time.monotonic() < ends or not finished):
                self._try(study, len(finished), tables, y, subjects)
                finished = _finished(study)
        finished = self._counted(finished)
        names = [str(s) for s in np.unique(subjects)]
        self.trials_ = self._table(finished)
        ranked = self._ranked(finished, names)
        self.chosen_ = dict(finished[ranked[0]].params)
        self.search_seconds_ = _seconds(finished)
        wall, cpu = time.perf_counter(), time.process_time()
        self.best_ = self._make(self.chosen_, self._features(self.chosen_)).fit(X, y)
        self.fit_seconds_ = time.perf_counter() - wall, time.process_time() - cpu
        self.classes_ = self.best_.classes_
        return self

    def predict(self, X: Corpus) -> np.ndarray:
        """Class name of each capture."""
        check_is_fitted(self, "best_")
        return self.best_.predict(X)

    @available_if(lambda self: contract.inside(self) is self or contract.has_probabilities(self.best_))
    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Class probabilities [captures, classes], where the recogniser has them."""
        check_is_fitted(self, "best_")
        return self.best_.predict_proba(X)

    @available_if(lambda self: contract.inside(self) is not self and contract.decides_often(self.best_))
    def decide(self, X: Corpus) -> tuple[pd.DataFrame, np.ndarray]:
        """Decisions of a recogniser that makes several per capture."""
        return self.best_.decide(X)

    def _grid(self) -> dict[str, list] | None:
        """Values of each parameter where there is one model and all of them are lists."""
        spaces = list(self.spaces.values())
        if len(spaces) > 1 or any(isinstance(v, Range) for v in spaces[0].values()):
            return None
        model = next(iter(self.models))
        grid = {"model": [model]} | ({"features": list(self.features)} if self.features else {})
        return grid | {f"{model}.{k}": list(v) for k, v in spaces[0].items()}

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Refuse a training part, or listed values, before anything is run.

        Raises:
            InputError: it has fewer than two subjects, an inner training part has only one class, or a model refuses a
                combination of listed values or an inner training part.
        """
        folds = self._folds(X, y)
        for chosen in self._listed():
            model = self._make(chosen, "passthrough" if self.features else None)
            contract.check(model)
            for train, _ in folds:
                contract.check_training(model, X[train], np.asarray(y)[train])

    def _folds(self, X: Corpus, y: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """The inner folds of a training part."""
        folds = inner_folds(X.subjects.astype(str), self.inner)
        if any(len(np.unique(np.asarray(y)[train].astype(str))) < 2 for train, _ in folds):
            raise InputError(
                f"parameters are chosen by leaving training subjects out, which here leaves one class; "
                f"choose another inner= than {self.inner}, or more captures"
            )
        return folds

    def _listed(self) -> Iterator[dict[str, object]]:
        """Combinations of listed values of each model, ranges left at their defaults.

        Each value is there, and every combination where there are not too many of them to be made.
        """
        for name, space in self.spaces.items():
            lists = {f"{name}.{k}": v for k, v in space.items() if not isinstance(v, Range)}
            first = {"model": name} | {k: v[0] for k, v in lists.items()}
            yield from ({**first, k: value} for k, v in lists.items() for value in v)
            if np.prod([len(v) for v in lists.values()], dtype=float) <= COMBINATIONS:
                for values in itertools.product(*lists.values()):
                    yield {"model": name} | dict(zip(lists, values, strict=True))

    def study_key(self) -> dict[str, object]:
        """What trials depend on besides captures and labels; not on how many there are, so that a study can grow."""
        return {
            "models": {name: identity(model) for name, model in self.models.items()},
            "spaces": repr(self.spaces),
            "features": {
                name: [identity(type(f)), sorted(map(repr, f.get_params().items()))]
                for name, f in (self.features or {}).items()
            },
            "search": [identity(Search), self.inner, self.objective, self.seed, self._whole_grid()],
        }

    def _counted(self, finished: list) -> list:
        """Those of the stored trials that this search would have made: a study may hold a longer one."""
        if self.trials is not None:
            finished = finished[: self.trials]
        spent = np.cumsum([t.user_attrs["seconds"] for t in finished])
        return finished[: max(int((spent < self.budget).sum()) + 1, 1)]

    def _size(self) -> float:
        """Number of combinations to try."""
        every = float(np.prod([len(v) for v in grid.values()])) if (grid := self._grid()) else float("inf")
        return every if self.trials is None else min(self.trials, every)

    def _whole_grid(self) -> bool:
        grid = self._grid()
        return grid is not None and self._size() == float(np.prod([len(v) for v in grid.values()]))

    def _try(self, study: object, number: int, tables: Tables, y: np.ndarray, subjects: np.ndarray) -> None:
        """Score one combination, or the one that was cut off.

        What is tried depends on the seed and the finished trials alone, so that a resumed search is the same.
        """
        import optuna
        from optuna.trial import TrialState

        unfinished = study.get_trials(deepcopy=False, states=(TrialState.RUNNING, TrialState.WAITING))
        reported: set[int] = set()
        if unfinished and unfinished[0].state == TrialState.RUNNING:
            reported = set(unfinished[0].intermediate_values)
            trial = optuna.Trial(study, unfinished[0]._trial_id)
        else:
            if not unfinished and (given := self._given(number)):
                study.enqueue_trial(given)
            trial = study.ask()
        started = time.perf_counter()
        chosen = self._suggest(trial, number)
        features: object = chosen.get("features")
        name = None if self._prepares(chosen) else features  # what goes through steps first has tables of its own
        if features:
            features = "passthrough" if name else self._features(chosen)
        accuracy: dict[str, float] = {}
        for fold, (train, test) in enumerate(tables.folds):
            model = self._make(chosen, features)
            model.fit(tables.train(name, fold), y[train])
            hit = model.predict(contract.blinded(model, tables.test(name, fold))) == y[test]
            for subject in np.unique(subjects[test]):
                accuracy[str(subject)] = float(hit[subjects[test] == subject].mean())
            if self.objective == "accuracy":
                for step in range(len(accuracy) - len(np.unique(subjects[test])), len(accuracy)):
                    if step not in reported:
                        trial.report(list(accuracy.values())[step], step)
                if fold + 1 < len(tables.folds) and trial.should_prune():
                    trial.set_user_attr("seconds", time.perf_counter() - started)
                    study.tell(trial, state=TrialState.PRUNED)
                    return
        spent = tables.milliseconds(name) + milliseconds_of(model.predict, tables.alone(name, fold))
        trial.set_user_attr("predict_ms", spent)
        trial.set_user_attr("subjects", accuracy)
        trial.set_user_attr("seconds", time.perf_counter() - started)
        mean = float(np.mean(list(accuracy.values())))
        study.tell(trial, [mean, spent] if self.objective == "accuracy+time" else mean)

    def _given(self, number: int) -> dict[str, object]:
        """What is not left to the sampler: the points of a grid, or each model with each feature set once.

        The seed shuffles them, as a good one early makes giving up quicker. (Optuna's own grid sampler cannot go on
        after an interruption.)
        """
        grid = self._grid() if self._whole_grid() else {"model": list(self.models)}
        if not self._whole_grid() and self.features:
            grid["features"] = list(self.features)
        sizes = [len(values) for values in grid.values()]
        count = int(np.prod(sizes))
        if number >= count or count == 1:
            return {}
        place = np.unravel_index(np.random.default_rng(self.seed).permutation(count)[number], sizes)
        return {name: values[i] for (name, values), i in zip(grid.items(), place, strict=True)}

    def _suggest(self, trial: object, number: int) -> dict[str, object]:
        """The values of a trial; each is drawn with a seed of its own, in case the trial is cut off in between."""
        import optuna

        def seeded() -> object:
            seed = np.random.SeedSequence([self.seed, number, len(chosen)]).generate_state(1)[0]
            trial.study.sampler = optuna.samplers.TPESampler(seed=int(seed))
            return trial

        chosen: dict[str, object] = {}
        chosen["model"] = seeded().suggest_categorical("model", list(self.models))
        if self.features:
            chosen["features"] = seeded().suggest_categorical("features", list(self.features))
        for name, values in self.spaces[chosen["model"]].items():
            key = f"{chosen['model']}.{name}"
            chosen[key] = suggested(seeded(), key, values)
        return chosen

    def _prepares(self, chosen: dict[str, object]) -> bool:
        """Whether a trial's captures go through steps (`models.recipe.Recipe`) before its features are computed."""
        from models.recipe import besides  # here, so that steps are no part of what a search without them depends on

        usual = besides(self.models[chosen["model"]])
        return any(chosen.get(f"{chosen['model']}.{k}", v) not in (v, "") for k, v in usual.items())

    def _make(self, chosen: dict[str, object], features: object) -> ClassifierMixin:
        name = chosen["model"]
        factory = self.models[name]
        values = {"seed": self.seed} if "seed" in parameters(factory) else {}
        values |= {k.partition(".")[2]: v for k, v in chosen.items() if k.startswith(f"{name}.")}
        from models.recipe import build

        return build(factory, features, **values)

    def _table(self, finished: list) -> pd.DataFrame:
        rows = []
        for trial in finished:
            subjects = trial.user_attrs.get("subjects")
            seen = list(subjects.values()) if subjects else list(trial.intermediate_values.values())
            rows.append(
                trial.params
                | {"state": trial.state.name.lower(), "accuracy": float(np.mean(seen)), "subjects": len(seen)}
                | {"predict_ms": trial.user_attrs.get("predict_ms", np.nan)}
                | {"seconds": trial.user_attrs["seconds"]}
            )
        table = pd.DataFrame(rows)
        return table.assign(front=front(table["accuracy"].to_numpy(), table["predict_ms"].to_numpy()))

    def _features(self, params: dict[str, object]) -> TransformerMixin | None:
        return clone(self.features[params["features"]]) if self.features else None

    def _ranked(self, finished: list, subjects: list[str]) -> list[int]:
        """Positions of the complete trials, the one to take first; the order in which they were made has no say."""
        complete = [i for i, t in enumerate(finished) if "subjects" in t.user_attrs]
        scores = {i: np.array([finished[i].user_attrs["subjects"][s] for s in subjects]) for i in complete}
        ranked = sorted(complete, key=lambda i: (-round(scores[i].mean(), 9), self._place(finished[i].params)))
        if self.objective == "accuracy":
            return ranked
        lost = {i: scores[ranked[0]] - scores[i] for i in ranked}
        near = [i for i in ranked if within_one_standard_error(lost[i])]
        if self.objective == "smallest":
            return sorted(near, key=lambda i: self._place(finished[i].params))
        return sorted(near, key=lambda i: (finished[i].user_attrs["predict_ms"], ranked.index(i)))

    def _place(self, params: dict[str, object]) -> tuple:
        """Where a combination stands if every list is read from its first value."""
        place = [list(self.models).index(params["model"])]
        place += [list(self.features).index(params["features"])] if self.features else []
        for name, values in self.spaces[params["model"]].items():
            value = params[f"{params['model']}.{name}"]
            place.append(value if isinstance(values, Range) else list(values).index(value))
        return tuple(place)


def tuned(
    name: str, factory: Callable, features: dict[str, TransformerMixin] | None, shown: str, tuning: Tuning
) -> Search:
    """The search that `bench tune` and `bench choose over=` ask for.

    Args:
        name: of the model.
        factory: of the model.
        features: one feature set by name, None for a model that reads captures.
        shown: the feature set as it is named in tables.
        tuning: ``space`` of the model's parameters, ``over`` (``features`` for the smallest subset of these that
            suffices), and further arguments of `Search`.
    """
    if len(tuning["space"].get("person", [()])) > 1:
        raise InputError("model.person= cannot be tuned: nobody whom a search judges by is known; give one value")
    if tuning.get("over") == "features":
        from features.selection import COUNTS, Subset

        (whole,) = features.values()
        features = {f"{n} best of {shown}": Subset(clone(whole), n) for n in COUNTS} | features
    how = {k: v for k, v in tuning.items() if k not in ("space", "over")}
    return Search({name: factory}, {name: tuning["space"]}, features, **how)


def machinery(tuning: Tuning) -> list[Code]:
    """Modules that such a search depends on besides its parts."""
    import features.selection

    return [Search, *([features.selection] if tuning.get("over") == "features" else [])]


def _finished(study: object) -> list:
    return [t for t in study.get_trials(deepcopy=False) if t.state.is_finished()]


def _seconds(finished: list) -> float:
    """Seconds that combinations took; Optuna's own would count the time in which a search lay interrupted."""
    return sum(t.user_attrs["seconds"] for t in finished)
