"""A user's folder with own packages ``models``, ``features``, ``protocols``, ``reports``."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

MINE = '''
import features.mean
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.naive_bayes import GaussianNB

class Mine(ClassifierMixin, BaseEstimator):
    """Reads the means of features/mean.py."""
    def fit(self, X, y):
        self.bayes_ = GaussianNB().fit(features.mean.of(X), y)
        self.classes_ = self.bayes_.classes_
        return self
    def predict(self, X):
        return self.bayes_.predict(features.mean.of(X))
'''
MEAN = """
import numpy as np
def of(X):
    return np.array([[frames.mean(), frames.std()] for frames in X])
"""
SCRIPT = """
import bench
from models.mine import Mine
import protocols, reports, tests
small = {"data.subjects": 3, "data.variants": "normal", "data.repetitions": 2}
if __name__ == "__main__":
    for jobs in (1, 2):
        results = bench.run(model=["lda", Mine()], protocol="loso", jobs=jobs, seed=jobs, **small)
        print(*results["accuracy"].round(6))
"""


@pytest.mark.live
def test_scripts_and_workers_of_the_folder():
    """This project is no part of the path."""
    for package in ("models", "features", "protocols", "reports", "tests"):
        Path(package).mkdir()
        Path(package, "__init__.py").touch()
    for path, text in {
        "models/mine.py": MINE,
        "features/mean.py": MEAN,
        "script.py": SCRIPT,
    }.items():
        Path(path).write_text(text)
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "script.py"], capture_output=True, text=True, timeout=600, env=env
    )
    assert done.returncode == 0, done.stderr[-2000:]
    alone, spawned = done.stdout.splitlines()[-2:]
    assert alone == spawned and len(alone.split()) == 2
