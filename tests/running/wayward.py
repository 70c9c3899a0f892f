"""A system that kills its process when it is told to."""

import os

import numpy as np
from sklearn.base import BaseEstimator, ClassifierMixin


class Wayward(ClassifierMixin, BaseEstimator):
    """Guesses the first class; dies in the fold of the subject it is told to."""

    def __init__(self, die=""):
        self.die = die

    def fit(self, X, y):
        if self.die not in X.subjects:
            os._exit(9)
        self.classes_ = np.unique(y)
        return self

    def predict_proba(self, X):
        return np.tile(np.eye(len(self.classes_))[0], (len(X), 1))

    def predict(self, X):
        return np.full(len(X), self.classes_[0])
