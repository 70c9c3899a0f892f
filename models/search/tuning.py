"""Parameters chosen inside the training part: a nested search over inner folds of whole subjects, with Optuna."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, ClassifierMixin, TransformerMixin, clone
from sklearn.utils.metaestimators import available_if
from sklearn.utils.validation import check_is_fitted

from bench import contract
from bench.corpora.corpus import Corpus
from bench.features.selection import COLUMN_COUNTS, Subset
from bench.ground.registry import parameter_defaults
from bench.models.recipe import build_recipe, recipe_defaults
from bench.models.search.inner_folds import FoldInputs, check_search, make_inner_folds
from bench.models.search.study import FinishedTrial, Study, source_identity
from bench.models.space import Range, Space, Trial, Tuning
from bench.values.intervals import within_one_standard_error

MAX_LISTED = 1000  # at most so many are checked one by one before anything is run


@dataclass(eq=False, repr=False)
class Search(ClassifierMixin, BaseEstimator):
    """The recogniser with the best parameters, judged by subjects that were left out of its training part.

    A combination is scored by the mean accuracy of the left-out training subjects. After each inner fold it is given
    up if a Wilcoxon signed-rank test over the subjects seen so far finds it worse than the best one (p < 0.1). The best
    one, of equal ones the one that takes the earliest values of each list, is then fitted to the whole training part.

    The study of a stored corpus is kept in the data folder under everything that it depends on; a search that was
    interrupted goes on where it stopped and chooses as if it had not been.

    Args:
        models: the factory, by its name; called with one value of each parameter of its space and, if it takes them,
            with ``features`` and ``seed``.
        spaces: values of each parameter, by the name of the model: a list, or a `Range`.
        features: feature sets to choose from by name; empty for a model that reads raw frames.
        inner: number of groups into which the training subjects are dealt, or ``loso``.
        trials: combinations to try; None for all of them, which needs lists only. Fewer than all are drawn by a
            tree-structured Parzen estimator.
        seconds: seconds after which no new combination is begun.
        objective: ``accuracy``; or ``smallest``, which gives nothing up and takes, of the combinations whose accuracy
            is not below the best by more than a standard error of the paired difference, the one that comes first in
            the lists.
        seed: random seed of the search, and of models that take one.

    Attributes:
        best_: the fitted recogniser.
        chosen_: model, features and parameters of it.
        trials_: one row per combination: its values, state, accuracy and seconds.
        fit_seconds_: wall and CPU seconds of the last fit, ``search_seconds_`` those of all combinations, also of
            those that were stored before.
    """

    searches = True

    models: dict[str, Callable]
    spaces: dict[str, Space]
    features: dict[str, TransformerMixin] | None = None
    inner: str = "3"
    trials: int | None = None
    seconds: float = math.inf
    objective: str = "accuracy"
    seed: int = 0

    def check(self) -> None:
        """Refuse parameters that cannot be, before anything is run."""
        check_search(
            self.inner, self.trials, self.seconds, endless=self._count_combinations() == math.inf
        )
        for part in (self.features or {}).values():
            contract.check_parameters(part)

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Refuse a training part, or listed values that a model refuses, before anything is run."""
        folds = make_inner_folds(X, y, self.inner)
        for trial in self._iter_listed_trials():
            model = self._make_model(trial, "passthrough" if self.features else None)
            contract.check_parameters(model)
            for train, _ in folds:
                contract.check_training(model, X[train], np.asarray(y)[train])

    def fit(self, X: Corpus, y: np.ndarray) -> Search:
        """Search on the captures and their class names, then fit the best recogniser to all of them."""
        began = time.perf_counter()
        self.check()
        tables = FoldInputs(self.features or {}, X, y, make_inner_folds(X, y, self.inner))
        study = Study(
            self._space(),
            {self._model_name: {}},
            self.seed,
            self._count_trials(),
            self.seconds,
            began,
        )
        study.judge_trials(lambda: self._judge_next(study, tables), self.study_key(), X, y)
        self.search_seconds_ = sum(t.seconds for t in study.finished)
        self.trials_ = pd.DataFrame([t.as_row() for t in study.finished])
        self.chosen_ = study.finished[self._rank_trials(study.finished)[0]].trial
        wall, cpu = time.perf_counter(), time.process_time()
        self.best_ = self._make_model(self.chosen_, self._make_features(self.chosen_)).fit(X, y)
        self.fit_seconds_ = time.perf_counter() - wall, time.process_time() - cpu
        self.classes_ = self.best_.classes_
        return self

    def predict(self, X: Corpus) -> np.ndarray:
        """Class name of each capture."""
        check_is_fitted(self, "best_")
        return self.best_.predict(X)

    @available_if(
        lambda self: contract.inner_system(self) is self or contract.has_probabilities(self.best_)
    )
    def predict_proba(self, X: Corpus) -> np.ndarray:
        """Class probabilities [captures, classes], where the recogniser has them."""
        check_is_fitted(self, "best_")
        return self.best_.predict_proba(X)

    @available_if(
        lambda self: contract.inner_system(self) is not self and contract.decides_often(self.best_)
    )
    def decide(self, X: Corpus) -> tuple[pd.DataFrame, np.ndarray]:
        """Decisions of a recogniser that makes several per capture."""
        return self.best_.decide(X)

    def study_key(self) -> dict[str, object]:
        """Influences on trials besides captures and labels; not their number, so that a study can grow."""
        features = (self.features or {}).items()
        return {
            "models": {name: source_identity(model) for name, model in self.models.items()},
            "spaces": repr(self.spaces),
            "features": {
                n: [source_identity(type(f)), sorted(map(repr, f.get_params().items()))]
                for n, f in features
            },
            "search": [
                source_identity(Search),
                self.inner,
                self.objective,
                self.seed,
                self._is_exhaustive(),
            ],
        }

    @property
    def _model_name(self) -> str:
        (name,) = self.models
        return name

    def _space(self) -> Space:
        """Values of everything, in the order in which it is drawn."""
        features = {"features": list(self.features)} if self.features else {}
        space = {
            f"{self._model_name}.{name}": values
            for name, values in self.spaces[self._model_name].items()
        }
        return {"model": [self._model_name], **features, **space}

    def _count_combinations(self) -> float:
        """Number of combinations, endless with a range."""
        return math.prod(
            math.inf if isinstance(values, Range) else len(values)
            for values in self._space().values()
        )

    def _count_trials(self) -> float:
        """Number of combinations to try."""
        return min(self.trials or math.inf, self._count_combinations())

    def _is_exhaustive(self) -> bool:
        return self._count_trials() == self._count_combinations() < math.inf

    def _iter_listed_trials(self) -> Iterator[Trial]:
        """Combinations of listed values, or of too many each value alone; ranges at their defaults."""
        values = {
            name: v
            for name, v in self._space().items()
            if name != "features" and not isinstance(v, Range)
        }
        first = {name: listed[0] for name, listed in values.items()}
        if math.prod(map(len, values.values())) <= MAX_LISTED:
            yield from (
                dict(zip(values, point, strict=True))
                for point in itertools.product(*values.values())
            )
        else:
            yield from (
                first | {name: value} for name, listed in values.items() for value in listed
            )

    def _grid_point(self, number: int) -> Trial:
        """The points of a grid, which are not left to the sampler.

        The seed shuffles them, as a good one early makes giving up quicker. (Optuna's own grid sampler cannot go on
        after an interruption.)
        """
        if not self._is_exhaustive():
            return {}
        sizes = [len(values) for values in self._space().values()]
        position = np.unravel_index(
            np.random.default_rng(self.seed).permutation(math.prod(sizes))[number], sizes
        )
        return {
            name: values[i]
            for (name, values), i in zip(self._space().items(), position, strict=True)
        }

    def _judge_next(self, study: Study, tables: FoldInputs) -> FinishedTrial | None:
        """Judge the next combination; None where there is no time, but for the first."""
        if study.finished and study.seconds_left <= 0:
            return None
        tried = FinishedTrial(
            study.draw_trial(self._grid_point(len(study.finished)), each=True), "complete"
        )
        # Captures that go through steps first have features of their own.
        name = None if self._has_steps(tried.trial) else tried.trial.get("features")
        features = "passthrough" if name else self._make_features(tried.trial)
        for fold, (train, test) in enumerate(tables.folds):
            model = self._make_model(tried.trial, features)
            model.fit(tables.load_input(name, fold, 0), tables.y[train])
            hit = (
                model.predict(contract.blind_captures(model, tables.load_input(name, fold, 1)))
                == tables.y[test]
            )
            tried.add_subjects(hit, tables.X.subjects.astype(str)[test])
            if (
                self.objective == "accuracy"
                and fold + 1 < len(tables.folds)
                and study.is_worse(tried)
            ):
                tried.state = "pruned"
                break
        return tried

    def _has_steps(self, trial: Trial) -> bool:
        """Whether a trial's captures go through steps (`bench.models.recipe`) before its features are computed."""
        usual = recipe_defaults(self.models[self._model_name])
        return any(trial.get(f"{self._model_name}.{k}", v) not in (v, "") for k, v in usual.items())

    def _make_model(self, trial: Trial, features: object) -> ClassifierMixin:
        factory = self.models[self._model_name]
        values = {"seed": self.seed} if "seed" in parameter_defaults(factory) else {}
        prefix = f"{self._model_name}."
        values |= {k.removeprefix(prefix): v for k, v in trial.items() if k.startswith(prefix)}
        return build_recipe(factory, features, **values)

    def _make_features(self, trial: Trial) -> TransformerMixin | None:
        return clone(self.features[trial["features"]]) if self.features else None

    def _rank_trials(self, tried: list[FinishedTrial]) -> list[int]:
        """Positions of the complete trials, the one to take first; the order in which they were made has no say."""
        place = [self._list_position(t.trial) for t in tried]
        complete = [i for i, t in enumerate(tried) if t.state == "complete"]
        ranked = sorted(complete, key=lambda i: (-round(tried[i].accuracy, 9), place[i]))
        if self.objective == "accuracy":
            return ranked
        best = tried[ranked[0]].subjects
        losses = {
            i: np.array([best[s] - tried[i].subjects[s] for s in sorted(best)]) for i in ranked
        }
        return sorted(
            (i for i in ranked if within_one_standard_error(losses[i])), key=place.__getitem__
        )

    def _list_position(self, trial: Trial) -> tuple:
        """Where a combination stands if every list is read from its first value."""
        return tuple(
            trial[name] if isinstance(values, Range) else list(values).index(trial[name])
            for name, values in self._space().items()
        )


def make_search(
    name: str,
    factory: Callable,
    features: dict[str, TransformerMixin] | None,
    shown: str,
    tuning: Tuning,
) -> Search:
    """The search of `bench tune` and `bench tune smallest=` for a model, on its feature set or captures.

    ``tuning`` has the ``space`` of its parameters, ``smallest`` (``features`` for the smallest subset of these, called
    ``shown`` in tables, that suffices), and further arguments of `Search`.
    """
    if tuning.get("smallest") == "features":
        (all_columns,) = features.values()
        features = {
            f"{n} best of {shown}": Subset(clone(all_columns), n) for n in COLUMN_COUNTS
        } | features
    how = {k: v for k, v in tuning.items() if k not in ("space", "smallest")}
    return Search({name: factory}, {name: tuning["space"]}, features, **how)
