"""The common base of classifiers with probabilities."""

from __future__ import annotations

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, ClassifierMixin

from bench.corpora.corpus import Corpus


class MostProbable(ClassifierMixin, BaseEstimator):
    """A classifier that predicts the class with the highest probability, of equals the first."""

    classes_: np.ndarray

    def predict_proba(self, X: Corpus | pd.DataFrame | np.ndarray) -> np.ndarray:
        """Class probabilities [captures or rows, classes]."""
        raise NotImplementedError

    def predict(self, X: Corpus | pd.DataFrame | np.ndarray) -> np.ndarray:
        """Class names [captures or rows]."""
        return self.classes_[self.predict_proba(X).argmax(axis=1)]


def mean_by_capture(proba: np.ndarray, capture: np.ndarray) -> np.ndarray:
    """Mean of the rows of each capture, which are consecutive [captures, classes]."""
    first = np.flatnonzero(np.diff(capture, prepend=-1))
    return np.add.reduceat(proba, first) / np.bincount(capture)[:, None]
