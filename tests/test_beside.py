"""In a folder whose ``models``, ``features``, ``protocols``, ``reports``, ``tests`` are a user's own packages."""

import os
import subprocess
import sys
from pathlib import Path

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
    (folder / "wrap.py").write_text("from models.mynet import Mine\ndef mine():\n    return Mine()\n")
    (folder / "script.py").write_text(SCRIPT)
    monkeypatch.chdir(folder)
    return folder


def said(*command):
    """What a command prints that a user types in the folder; this project is no part of its path."""
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, timeout=600, env=env)
    assert done.returncode == 0, f"{command}: {done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done.stdout


BENCH = Path(sys.executable).with_name("bench")
OPTIONS = [f"{key}={value}" for key, value in SMALL.items()]


def test_scripts_workers_and_tests_of_the_folder(mine):
    alone, spawned = said(sys.executable, "script.py").splitlines()[-2:]
    assert alone == spawned and len(alone.split()) == 2
    assert "1 passed" in said(sys.executable, "-m", "pytest", "-q", "tests")


def test_systems_of_files_and_saved_models(mine):
    said(BENCH, "run", "model=wrap.py:mine", "jobs=2", *OPTIONS)
    said(BENCH, "fit", "model=wrap.py:mine", "out=rec", *OPTIONS)
    said(BENCH, "fit", "model=lda", "features=jung28", "out=lda_rec", *OPTIONS)
    frames = mine / "frames.csv"
    frames.write_text("frame," + ",".join(f"ch{i + 1}" for i in range(64)) + "\n")
    with frames.open("a") as file:
        file.writelines(f"{t}," + ",".join(["7"] * 64) + "\n" for t in range(30))
    for model in ("rec", "lda_rec"):
        assert "label" in said(BENCH, "predict", model, "frames.csv")
    # Without touchbench: the code that a model carries is enough, wherever it is loaded.
    code = "import mlflow, sys; m = mlflow.pyfunc.load_model('lda_rec'); import bench; print(bench.__file__)"
    assert str(mine / "lda_rec") in said(sys.executable, "-c", f"import sys; sys.modules.pop('bench', None); {code}")
