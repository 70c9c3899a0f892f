"""Any classifier on features for one person: with scaled features, or fitted again with the person's captures."""

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
from bench.features.base import captures_of, constant, undamaged
from bench.ground.registry import load, parameters
from touchbench_people.adaptation import WEIGHT, adapts, codes_of, share

WAYS = ("centre", "scale", "pool")
SPREAD_PRIOR = 20.0  # weight of the spread of training beside the captures of a person, in captures


@dataclass(eq=False, repr=False)
class PersonScaler(TransformerMixin, BaseEstimator):
    """Features of a person as they would be of the average person; the identity until it is adapted.

    - ``centre``: features are measured from the person's own mean, as far as `share` goes;
    - ``scale``: and by their own spread about it, of n captures n / (n + 20) of the way, on a logarithmic scale.

    What never varied in training stays as it is.

    Args:
        ways: adaptations, from the list above; others have no effect here.

    Attributes:
        classes_: class names.
        mean_, sd_, within_: mean and SD of the undamaged training rows, and the spread within classes [features].
        centres_: means of the classes, relative to the overall mean [classes, features].
        shift_, scale_: subtracted shift, then divisor [features].
    """

    ways: tuple[str, ...] = WAYS[:2]

    def fit(self, X: pd.DataFrame, y: np.ndarray) -> PersonScaler:
        """Learn the usual range of features [rows, n_features] and class names [rows]."""
        rows = undamaged(X)
        values = np.asarray(X, dtype=np.float64)[rows]
        self.classes_, codes = np.unique(np.asarray(y)[rows], return_inverse=True)
        self.n_features_in_ = values.shape[1]
        self.mean_ = values.mean(axis=0)
        self.centres_ = (
            np.stack([values[codes == c].mean(axis=0) for c in range(len(self.classes_))])
            - self.mean_
        )
        still = constant(values)
        self.sd_ = np.where(still, 0, values.std(axis=0))
        self.within_ = np.where(still, 0, (values - self.mean_ - self.centres_[codes]).std(axis=0))
        self.shift_, self.scale_ = np.zeros(len(self.mean_)), np.ones(len(self.mean_))
        return self

    def adapt(self, X: pd.DataFrame, y: np.ndarray | None) -> PersonScaler:
        """The same for one person.

        Args:
            X: features [rows, n_features] of some of their captures.
            y: class names [rows], all from training; None if unlabelled.
        """
        adapted = copy(self)
        captures = captures_of(X)
        codes = None if y is None else codes_of(y, self.classes_)
        values = np.asarray(X, dtype=np.float64) - self.mean_
        within = values if codes is None else values - self.centres_[codes]
        if "centre" in self.ways:
            believed, apart = share(captures, codes, len(self.classes_))
            adapted.shift_ = np.where(
                self.sd_ > 0, believed * (within if apart else values).mean(axis=0), 0
            )
        if "scale" in self.ways:
            count = captures.max() + 1
            spread, usual = within.std(axis=0), self.sd_ if codes is None else self.within_
            both = (spread > 0) & (usual > 0)
            ratio = np.log(np.where(both, spread, 1)) - np.log(np.where(both, usual, 1))
            adapted.scale_ = np.exp(count / (count + SPREAD_PRIOR) * ratio)
        return adapted

    def transform(self, X: pd.DataFrame) -> pd.DataFrame:
        """Features [rows, n_features], the same object where nothing was adapted."""
        if not self.shift_.any() and (self.scale_ == 1).all():
            return X
        return self.mean_ + (X - self.mean_ - self.shift_) / self.scale_


class ForPerson(Pipeline):
    """A feature set, a `PersonScaler` and a classifier, which adapt to a person.

    Attributes:
        rows_: rows of training and their class names, with ``pool`` alone.
    """

    def fit(self, X: Corpus, y: np.ndarray) -> ForPerson:
        """Learn from captures and their class names."""
        (name, features), *behind = self.steps
        table = features.fit_transform(X, y)
        if "pool" in behind[0][1].ways:
            self.rows_ = table, np.asarray(y)
        self.steps = [(name, features), *Pipeline(behind).fit(table, y).steps]
        return self

    def adapt(self, X: Corpus, y: np.ndarray | None) -> ForPerson:
        """The same for one person: scaled, and with ``pool`` fitted again; each labelled row counts `WEIGHT` times."""
        (name, features), (_, scaler), *rest = self.steps
        table = features.transform(X)
        scaler = scaler.adapt(table, y)
        if "pool" in scaler.ways and y is not None:
            rows, labels = zip(self.rows_, *[(scaler.transform(table), y)] * WEIGHT, strict=True)
            rest = clone(Pipeline(rest)).fit(pd.concat(rows), np.concatenate(labels)).steps
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
        ways: ``centre`` and ``scale`` use mean and spread of the person's features. ``pool`` keeps the rows of
            training, and fits the classifier again to these and the person's rows, each counted ten times.
        seed: random seed of the classifier, if it has one.
    """
    if wrong := [way for way in ways if way not in WAYS] or [
        way for way in WAYS if ways.count(way) > 1
    ]:
        raise InputError(
            f"model.ways={'+'.join(ways)}: {wrong[0]!r}: join each of {', '.join(WAYS)} once by +"
        )
    factory = load("models", classifier)
    system = contract.build(
        factory, features, **({"seed": seed} if "seed" in parameters(factory) else {})
    )
    if not isinstance(system, Pipeline) or len(system.steps) < 2 or adapts(system):
        raise InputError(
            f"model.classifier={classifier}: name a classifier on features that does not adapt by itself"
        )
    first, *rest = system.steps
    return ForPerson([first, ("person", PersonScaler(ways)), *rest])
