"""Nested search of parameters over inner folds of whole training subjects, with Optuna."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
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

MAX_LISTED = 1000  # combinations that are all checked before anything is run


@dataclass(eq=False, repr=False)
class Search(ClassifierMixin, BaseEstimator):
    """The recogniser with the best parameters for left-out training subjects.

    A combination is scored by the mean accuracy of the left-out training subjects. After each inner
    fold it is pruned if a Wilcoxon signed-rank test over the subjects so far finds it worse than
    the best one (p < 0.1). The best one, of equals the one with the earliest values of each list,
    is then fitted to the whole training part.

    The study of a stored corpus is kept in the data folder under everything that it depends on; an
    interrupted search continues where it stopped, and chooses the same.

    Args:
        models: the factory, by its name; called with one value of each parameter of its space and,
            if it takes them, with ``features`` and ``seed``.
        spaces: values of each parameter, by the name of the model: a list, or a `Range`.
        features: feature sets to choose from by name; empty for a model that reads raw frames.
        inner: number of groups into which the training subjects are dealt, or ``loso``.
        trials: number of combinations; None for all of them, which needs lists only. Fewer than all
            are drawn by a tree-structured Parzen estimator.
        seconds: seconds after which no new combination is begun.
        objective: ``accuracy``; or ``smallest``, which prunes nothing and chooses, of the
            combinations within one standard error of the paired difference to the best one, the
            first one in the lists.
        seed: random seed of the search, and of models that take one.

    Attributes:
        best_: the fitted recogniser.
        chosen_: model, features and parameters of it.
        trials_: one row per combination: its values, state, accuracy and seconds.
        fit_seconds_: wall and CPU seconds of the last fit, ``search_seconds_`` those of all
            combinations, also of those that were stored before.
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
        """Check the parameters."""
        is_endless = self._count_combinations() == math.inf
        check_search(self.inner, self.trials, self.seconds, is_endless)
        for feature_set in (self.features or {}).values():
            contract.check_parameters(feature_set)

    def check_training(self, X: Corpus, y: np.ndarray) -> None:
        """Check the training captures, and whether the model accepts the listed values."""
        folds = make_inner_folds(X, y, self.inner)
        for trial in self._list_trials():
            model = self._make_model(trial, "passthrough" if self.features else None)
            contract.check_parameters(model)
            for train, _ in folds:
                contract.check_training(model, X[train], np.asarray(y)[train])

    def fit(self, X: Corpus, y: np.ndarray) -> Search:
        """Search on the captures and their class names, then fit the best recogniser to all."""
        started = time.perf_counter()
        self.check()
        inputs = FoldInputs(self.features or {}, X, y, make_inner_folds(X, y, self.inner))
        spaces, trials = {self._model_name: {}}, self._count_trials()
        study = Study(self._space(), spaces, self.seed, trials, self.seconds, started)
        study.judge_trials(lambda: self._judge_next(study, inputs), self.study_key(), X, y)
        self.search_seconds_ = sum(trial.seconds for trial in study.finished)
        self.trials_ = pd.DataFrame([trial.as_row() for trial in study.finished])
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
        """Influences on trials besides captures and labels.

        The number of trials is none, so that a study can grow.
        """
        features = {}
        for name, part in (self.features or {}).items():
            parameters = sorted(map(repr, part.get_params().items()))
            features[name] = [source_identity(type(part)), parameters]
        settings = [self.inner, self.objective, self.seed, self._is_exhaustive()]
        return {
            "models": {name: source_identity(model) for name, model in self.models.items()},
            "spaces": repr(self.spaces),
            "features": features,
            "search": [source_identity(Search), *settings],
        }

    @property
    def _model_name(self) -> str:
        (name,) = self.models
        return name

    def _space(self) -> Space:
        """Values of all parameters in the order of their draws."""
        name = self._model_name
        space: Space = {"model": [name]}
        if self.features:
            space["features"] = list(self.features)
        return space | {f"{name}.{key}": values for key, values in self.spaces[name].items()}

    def _count_combinations(self) -> float:
        """Number of combinations, infinite with a range."""
        spaces = self._space().values()
        return math.prod(math.inf if isinstance(s, Range) else len(s) for s in spaces)

    def _count_trials(self) -> float:
        """Number of combinations to try."""
        return min(self.trials or math.inf, self._count_combinations())

    def _is_exhaustive(self) -> bool:
        return self._count_trials() == self._count_combinations() < math.inf

    def _list_trials(self) -> list[Trial]:
        """Combinations of listed values, or each value alone if they are too many."""
        space = self._space().items()
        lists = {k: v for k, v in space if k != "features" and not isinstance(v, Range)}
        if math.prod(map(len, lists.values())) <= MAX_LISTED:
            points = itertools.product(*lists.values())
            return [dict(zip(lists, point, strict=True)) for point in points]
        first = {name: values[0] for name, values in lists.items()}
        return [first | {name: value} for name, values in lists.items() for value in values]

    def _grid_point(self, number: int) -> Trial:
        """A point of a grid, shuffled by the seed, as an early good one makes pruning faster.

        It is empty if the sampler draws. (Optuna's own grid sampler cannot be resumed.)
        """
        if not self._is_exhaustive():
            return {}
        space = self._space()
        sizes = [len(values) for values in space.values()]
        order = np.random.default_rng(self.seed).permutation(math.prod(sizes))
        indices = np.unravel_index(order[number], sizes)
        return {name: space[name][i] for name, i in zip(space, indices, strict=True)}

    def _judge_next(self, study: Study, inputs: FoldInputs) -> FinishedTrial | None:
        """Judge the next combination; None if no time is left, except for the first."""
        if study.finished and study.seconds_left <= 0:
            return None
        drawn = study.draw_trial(self._grid_point(len(study.finished)), each=True)
        trial = FinishedTrial(drawn, "complete")
        # Steps before the features change them, so these are computed by the model.
        name = None if self._has_steps(drawn) else drawn.get("features")
        features = "passthrough" if name else self._make_features(drawn)
        may_prune = self.objective == "accuracy"
        for fold, (train, test) in enumerate(inputs.folds):
            model = self._make_model(drawn, features)
            model.fit(inputs.load_input(name, fold, 0), inputs.y[train])
            tested = contract.blind_captures(model, inputs.load_input(name, fold, 1))
            is_correct = model.predict(tested) == inputs.y[test]
            trial.add_subjects(is_correct, inputs.X.subjects.astype(str)[test])
            if may_prune and fold + 1 < len(inputs.folds) and study.is_worse(trial):
                trial.state = "pruned"
                break
        return trial

    def _has_steps(self, trial: Trial) -> bool:
        """True if a trial's captures go through steps of a `Recipe` before its features."""
        defaults = recipe_defaults(self.models[self._model_name])
        prefix = f"{self._model_name}."
        return any(trial.get(prefix + k, v) not in (v, "") for k, v in defaults.items())

    def _make_model(self, trial: Trial, features: object) -> ClassifierMixin:
        factory = self.models[self._model_name]
        values = {"seed": self.seed} if "seed" in parameter_defaults(factory) else {}
        prefix = f"{self._model_name}."
        values |= {k.removeprefix(prefix): v for k, v in trial.items() if k.startswith(prefix)}
        return build_recipe(factory, features, **values)

    def _make_features(self, trial: Trial) -> TransformerMixin | None:
        return clone(self.features[trial["features"]]) if self.features else None

    def _rank_trials(self, trials: list[FinishedTrial]) -> list[int]:
        """Positions of the complete trials, the one to choose first, whatever their order was."""
        position = [self._list_position(t.trial) for t in trials]
        complete = [i for i, t in enumerate(trials) if t.state == "complete"]
        ranked = sorted(complete, key=lambda i: (-round(trials[i].accuracy, 9), position[i]))
        if self.objective == "accuracy":
            return ranked
        best = trials[ranked[0]].subjects
        sufficient = []
        for i in ranked:
            losses = [best[subject] - trials[i].subjects[subject] for subject in sorted(best)]
            if within_one_standard_error(np.array(losses)):
                sufficient.append(i)
        return sorted(sufficient, key=position.__getitem__)

    def _list_position(self, trial: Trial) -> tuple:
        """Positions of a combination's values in their lists; values of ranges."""
        position = []
        for name, values in self._space().items():
            is_range = isinstance(values, Range)
            position.append(trial[name] if is_range else list(values).index(trial[name]))
        return tuple(position)


def make_search(
    name: str,
    factory: Callable,
    features: dict[str, TransformerMixin] | None,
    shown: str,
    tuning: Tuning,
) -> Search:
    """Make the search of `bench tune` for a model, on its feature set or captures.

    Args:
        name: name of the model.
        factory: factory of the model.
        features: its feature set by name, if it takes one.
        shown: name of the feature set in tables.
        tuning: ``space`` of its parameters; ``smallest``, which is ``features`` to choose the
            smallest sufficient subset of these; further arguments of `Search`.
    """
    if tuning.get("smallest") == "features":
        (feature_set,) = features.values()
        subsets = {f"{n} best of {shown}": Subset(clone(feature_set), n) for n in COLUMN_COUNTS}
        features = subsets | features
    arguments = {k: v for k, v in tuning.items() if k not in ("space", "smallest")}
    return Search({name: factory}, {name: tuning["space"]}, features, **arguments)
