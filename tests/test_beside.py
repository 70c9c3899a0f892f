"""In a folder whose ``models``, ``features``, ``protocols``, ``reports``, ``tests`` are a user's own packages."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.live
NET = '''
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
    def predict_proba(self, X):
        return self.bayes_.predict_proba(features.mean.of(X))
'''
MEAN = "import numpy as np\ndef of(X):\n    return np.array([[frames.mean(), frames.std()] for frames in X])\n"
SMALL = {"data.subjects": 3, "data.variants": "normal", "data.repetitions": 2}
SCRIPT = f"""
import bench
from models.mynet import Mine
import protocols, reports, tests
if __name__ == "__main__":
    for jobs in (1, 2):
        results = bench.run(model=["lda", Mine()], protocol="loso", jobs=jobs, seed=jobs, **{SMALL})
        print(*results["accuracy"].round(6))
"""
TEST = """
import bench
from models.mynet import Mine
def test_mine():
    import tests.near
    assert len(bench.run(model=Mine(), **{small})) == 1 and "mine" in tests.near.__file__
"""


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """The folder, as working folder."""
    folder = tmp_path / "mine"
    for package in ("models", "features", "protocols", "reports", "tests"):
        (folder / package).mkdir(parents=True)
        (folder / package / "__init__.py").touch()
    (folder / "models" / "mynet.py").write_text(NET)
    (folder / "features" / "mean.py").write_text(MEAN)
    (folder / "tests" / "near.py").touch()
    (folder / "tests" / "test_mine.py").write_text(TEST.format(small=SMALL))
    (folder / "script.py").write_text(SCRIPT)
    monkeypatch.chdir(folder)


def said(*command):
    """What a command prints that a user types in the folder; this project is no part of its path."""
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, timeout=600, env=env)
    assert done.returncode == 0, f"{command}: {done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done.stdout


@pytest.mark.usefixtures("mine")
def test_scripts_workers_and_tests_of_the_folder():
    alone, spawned = said(sys.executable, "script.py").splitlines()[-2:]
    assert alone == spawned and len(alone.split()) == 2
    assert "1 passed" in said(sys.executable, "-m", "pytest", "-q", "tests")
