"""The common part of classifiers with probabilities."""

from __future__ import annotations

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator, ClassifierMixin

from bench.corpora.corpus import Corpus


class MostProbable(ClassifierMixin, BaseEstimator):
    """A classifier whose label is the class with the largest probability; of equal ones the first."""

    classes_: np.ndarray

    def predict_proba(self, X: Corpus | pd.DataFrame | np.ndarray) -> np.ndarray:
        """Class probabilities [captures or rows, classes]."""
        raise NotImplementedError

    def predict(self, X: Corpus | pd.DataFrame | np.ndarray) -> np.ndarray:
        """Class names [captures or rows]."""
        return self.classes_[self.predict_proba(X).argmax(axis=1)]
