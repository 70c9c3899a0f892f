"""Any classifier on features, adapted to a person by scaling features or by fitting again."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, TransformerMixin, clone
from sklearn.pipeline import Pipeline

from bench import contract
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.features.base import capture_of_rows, is_constant, undamaged_rows
from bench.ground.registry import load_part, parameter_defaults
from touchbench_people.adaptation import SHOT_WEIGHT, can_adapt, class_codes, mean_weight

WAYS = ("centre", "scale", "pool")
SPREAD_PRIOR = 20.0  # weight of the spread of training beside the captures of a person, in captures


@dataclass(eq=False, repr=False)
class PersonScaler(TransformerMixin, BaseEstimator):
    """Scale features of a person to those of the average person; the identity until adapted.

    - ``centre``: subtract the difference of the person's mean, times `mean_weight`;
    - ``scale``: divide by the ratio of the spreads, to the power n / (n + 20) for n captures.

    Features that are constant in training do not change.

    Args:
        ways: adaptations from the list above; others have no effect here.

    Attributes:
        classes_: class names.
        mean_, sd_, within_: mean and SD of undamaged training rows, and SD within classes
            [features].
        centres_: means of the classes, relative to the overall mean [classes, features].
        shift_, scale_: subtracted shift, then divisor [features].
    """

    ways: tuple[str, ...] = WAYS[:2]

    def fit(self, X: pd.DataFrame, y: np.ndarray) -> PersonScaler:
        """Learn the usual range of features [rows, n_features] and class names [rows]."""
        rows = undamaged_rows(X)
        values = np.asarray(X, dtype=np.float64)[rows]
        self.classes_, codes = np.unique(np.asarray(y)[rows], return_inverse=True)
        self.n_features_in_ = values.shape[1]
        self.mean_ = values.mean(axis=0)
        class_means = [values[codes == c].mean(axis=0) for c in range(len(self.classes_))]
        self.centres_ = np.stack(class_means) - self.mean_
        constant = is_constant(values)
        self.sd_ = np.where(constant, 0, values.std(axis=0))
        within = (values - self.mean_ - self.centres_[codes]).std(axis=0)
        self.within_ = np.where(constant, 0, within)
        self.shift_, self.scale_ = np.zeros(len(self.mean_)), np.ones(len(self.mean_))
        return self

    def adapt(self, X: pd.DataFrame, y: np.ndarray | None) -> PersonScaler:
        """Return a scaler adapted to one person.

        Args:
            X: features [rows, n_features] of some captures of the person.
            y: class names [rows], all from training; None if unlabelled.
        """
        adapted = copy(self)
        captures = capture_of_rows(X)
        codes = None if y is None else class_codes(y, self.classes_)
        values = np.asarray(X, dtype=np.float64) - self.mean_
        within = values if codes is None else values - self.centres_[codes]
        if "centre" in self.ways:
            weight, is_unbalanced = mean_weight(captures, codes, len(self.classes_))
            shift = weight * (within if is_unbalanced else values).mean(axis=0)
            adapted.shift_ = np.where(self.sd_ > 0, shift, 0)
        if "scale" in self.ways:
            count = captures.max() + 1
            spread, usual = within.std(axis=0), self.sd_ if codes is None else self.within_
            varies = (spread > 0) & (usual > 0)
            ratio = np.log(np.where(varies, spread, 1)) - np.log(np.where(varies, usual, 1))
            adapted.scale_ = np.exp(count / (count + SPREAD_PRIOR) * ratio)
        return adapted

    def transform(self, X: pd.DataFrame) -> pd.DataFrame:
        """Scaled features [rows, n_features]; the same object if nothing was adapted."""
        if not self.shift_.any() and (self.scale_ == 1).all():
            return X
        return self.mean_ + (X - self.mean_ - self.shift_) / self.scale_


class ForPerson(Pipeline):
    """A feature set, a `PersonScaler` and a classifier, which adapt to a person.

    Attributes:
        rows_: training rows and their class names, with ``pool`` only.
    """

    def fit(self, X: Corpus, y: np.ndarray) -> ForPerson:
        """Learn from captures and their class names."""
        (name, features), *rest = self.steps
        table = features.fit_transform(X, y)
        if "pool" in rest[0][1].ways:
            self.rows_ = table, np.asarray(y)
        self.steps = [(name, features), *Pipeline(rest).fit(table, y).steps]
        return self

    def adapt(self, X: Corpus, y: np.ndarray | None) -> ForPerson:
        """Return a system with an adapted scaler, with ``pool`` fitted again.

        Each labelled row of the person then counts `SHOT_WEIGHT` times.
        """
        (name, features), (_, scaler), *rest = self.steps
        table = features.transform(X)
        scaler = scaler.adapt(table, y)
        if "pool" in scaler.ways and y is not None:
            rows, labels = self.rows_
            rows = pd.concat([rows, *[scaler.transform(table)] * SHOT_WEIGHT])
            labels = np.concatenate([labels, *[y] * SHOT_WEIGHT])
            rest = clone(Pipeline(rest)).fit(rows, labels).steps
        return ForPerson([(name, features), ("person", scaler), *rest])


def adaptable(
    features: contract.Features,
    classifier: str = "svm",
    ways: tuple[str, ...] = WAYS[:2],
    seed: int = 0,
) -> contract.System:
    """A classifier on features that adapts to a person.

    Args:
        features: feature set.
        classifier: name of a model that learns from features and does not adapt itself.
        ways: ``centre`` and ``scale`` use mean and spread of the person's features. ``pool`` keeps
            the training rows and fits the classifier again to these and the person's rows, each
            counted ten times.
        seed: random seed of the classifier, if it has one.
    """
    if wrong := [way for way in ways if way not in WAYS or ways.count(way) > 1]:
        raise InputError(
            f"model.ways={'+'.join(ways)}: {wrong[0]!r}: join each of {', '.join(WAYS)} once by +"
        )
    factory = load_part("models", classifier)
    arguments = {"seed": seed} if "seed" in parameter_defaults(factory) else {}
    system = contract.build_system(factory, features, **arguments)
    if not isinstance(system, Pipeline) or len(system.steps) < 2 or can_adapt(system):
        raise InputError(
            f"model.classifier={classifier}: name a classifier on features that does not adapt by "
            "itself"
        )
    first, *rest = system.steps
    return ForPerson([first, ("person", PersonScaler(ways)), *rest])
