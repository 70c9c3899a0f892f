"""A system that misbehaves when it is told to."""

import os
import sys

import numpy as np
from sklearn.base import BaseEstimator, ClassifierMixin


class Wayward(ClassifierMixin, BaseEstimator):
    """Guesses the first class; fails, exits, dies or gives NaN on the subject it is told to."""

    def __init__(self, fail="", die="", nan="", exit=""):
        self.fail, self.die, self.nan, self.exit = fail, die, nan, exit

    def fit(self, X, y):
        left_out = {"1", "2", "3", "4"} - set(X.subjects)
        if self.fail in left_out:
            raise RuntimeError(f"cannot learn without {self.fail}")
        if self.exit in left_out:
            sys.exit("enough")
        if self.die in left_out:
            os._exit(9)
        self.classes_ = np.unique(y)
        self.broken_ = self.nan in left_out
        return self

    def predict_proba(self, X):
        return np.tile(np.eye(len(self.classes_))[0] * (np.nan if self.broken_ else 1), (len(X), 1))

    def predict(self, X):
        return np.full(len(X), self.classes_[0])
