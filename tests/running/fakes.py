"""A store in memory and a kind of run that records its folds: no MLflow, processes or training."""

from dataclasses import dataclass
from itertools import count
from pathlib import Path
from shutil import copy, copytree, rmtree
from tempfile import mkdtemp
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pandas as pd
from scipy.special import softmax
from sklearn.base import BaseEstimator, ClassifierMixin

from bench.protocols.subjects import LOSO
from bench.running.circumstances.base import RunKind, option
from bench.running.results import FoldResult, concat_predictions
from bench.store.client import Store
from bench.values.result import Result


class MemoryStore(Store):
    """A store without MLflow."""

    def __init__(self):
        self.kept, self.ids = {}, count()

    def create_run(self, name, tags, params=None):
        run_id = str(next(self.ids))
        data = SimpleNamespace(tags=dict(tags), params=dict(params or {}), metrics={}, steps={})
        info = SimpleNamespace(
            run_id=run_id, status="RUNNING", run_name=name, start_time=int(run_id)
        )
        info.artifact_uri = mkdtemp()
        self.kept[run_id] = SimpleNamespace(info=info, data=data, folder=Path(info.artifact_uri))
        return self.kept[run_id]

    def log_values(self, run_id, metrics=None, params=None, tags=None, step=0):
        data = self.kept[run_id].data
        data.metrics.update(metrics or {})
        data.params.update({k: str(v) for k, v in (params or {}).items()})
        data.tags.update(tags or {})
        data.steps.setdefault(step, {}).update(metrics or {})

    def next_step(self, run_id, metric):
        steps = [step for step, each in self.kept[run_id].data.steps.items() if metric in each]
        return 1 + max(steps, default=-1)

    def log_artifact(self, address, path, subfolder=""):
        folder = Path(address) / subfolder
        folder.mkdir(exist_ok=True)
        copytree(path, folder, dirs_exist_ok=True) if path.is_dir() else copy(path, folder)

    def delete_artifact(self, address, name):
        rmtree(Path(address) / name, ignore_errors=True)

    def set_status(self, run_id, status):
        self.kept[run_id].info.status = status

    def delete_run(self, run_id):
        del self.kept[run_id]

    def find_run(self, key, kind="cell"):
        return next(
            (r for r in self.runs_of_kind(kind) if r.data.tags["touchbench.cell"] == key), None
        )

    def runs_of_kind(self, kind, data=""):
        return [r for r in self.kept.values() if r.data.tags["touchbench.kind"] == kind]

    def newest_runs(self, kind, most, **params):
        return self.runs_of_kind(kind)[::-1][:most]

    def statuses(self, kind="echo"):
        return [r.info.status for r in self.runs_of_kind(kind)]


DONE = []  # (number, fold) in the order in which they were done
MEASURED = {}  # folds that a run was measured from, by number


@dataclass(frozen=True)
class Echo(RunKind):
    """Predicts nothing: a row for each test capture; fails in the folds of ``fails``."""

    key: ClassVar[str] = "echo"
    fails: ClassVar[dict] = {}  # what to raise, by fold

    number: int = option(0, "number", type="count")

    def evaluate_fold(self, cell, corpus, fold, threads):
        DONE.append((self.number, fold.name))
        if fold.name in self.fails:
            raise self.fails[fold.name]
        table = pd.DataFrame(
            {"fold": fold.name, "capture": corpus.index[fold.test], "value": 8 / (1 + fold.test)}
        )
        metrics = {"tested": len(fold.test), "third": 1 / 3}
        times, score = {"predict_ms": [0.1]}, {"score": int(fold.name) / 3}
        return FoldResult(fold.name, table, metrics, times=times, tracked_metrics=score)

    def measure_run(self, plan, about, folds):
        MEASURED[self.number] = folds
        captures = sum(fold.metrics["tested"] for fold in folds)
        return Result(about, {"captures": captures}, {"predictions": concat_predictions(folds)})


class Level(ClassifierMixin, BaseEstimator):
    """Nearest class mean of the pressure."""

    def fit(self, X, y):
        X, y = self.select_training(X, np.asarray(y))
        level = self.measure_levels(X)
        self.classes_ = np.unique(y)
        self.means_ = np.array([level[y == c].mean() for c in self.classes_])
        return self

    def select_training(self, X, y):
        return X, y

    def measure_levels(self, X):
        return np.array([self.measure_level(frames) for frames in X])

    def measure_level(self, frames):
        return frames.mean()

    def predict_proba(self, X):
        return softmax(-np.abs(self.measure_levels(X)[:, None] - self.means_) / 10, axis=1)

    def predict(self, X):
        return self.classes_[self.predict_proba(X).argmax(axis=1)]


def fake_cell(system, *circumstances):
    """The parts of a cell that a fold needs; it makes systems of a class of the tests."""
    fields = {"title": lambda: "a cell", "seed": 0, "run_kind": None, "splitter": LOSO()}
    fields |= {"design": None}
    return SimpleNamespace(estimator=system, circumstances=circumstances, **fields)
