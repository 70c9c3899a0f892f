"""Build a small store with runs of every kind: ``python -m tests.net.build FOLDER``.

The folder has the user's data (``home``), the store (``mlflow.db``, ``mlruns``), the files that
commands wrote, and the output of each command (``printed``).
"""

from __future__ import annotations

import io
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.running.workers import FoldExecutor

GESTURES = {
    4: "pat",
    8: "rub",
    12: "stroke",
    13: "tap",
}  # of an exported table, whose gestures are numbers
VARIANTS = {1: "gentle", 2: "normal", 3: "rough"}
TABLE = ["grid=8x8", "rate_hz=45", "full_scale=1023"]
RATE = ["rate_hz=45.0"]
PEOPLES = ("people.csv", "three.csv")  # exported captures that become those of people
PROGRESS = re.compile(r" after [\d.]+ s, \d+ of \d+ folds|━|^run \d+ of \d+: .*…")
QUIET_FRAMES = 20  # behind each capture
SYNTH = [
    "data=synth",
    "data.subjects=3",
    "data.variants=normal",
    "data.repetitions=1",
    "data.rate_hz=45.0",
    "jobs=1",
]
PEOPLE, THREE = (["data=people", "jobs=1"], ["data=three", "jobs=1"])
SYSTEMS = '''"""Systems for special cases."""

import numpy as np
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.naive_bayes import GaussianNB


class Levels(ClassifierMixin, BaseEstimator):
    """Gaussians of the mean and the maximum of a capture."""

    def table(self, X):
        return np.array([(float(frames.mean()), float(frames.max())) for frames in X])

    def fit(self, X, y):
        self.inside_ = GaussianNB().fit(self.table(X), y)
        self.classes_ = self.inside_.classes_
        return self

    def predict_proba(self, X):
        return self.inside_.predict_proba(self.table(X))

    def predict(self, X):
        return self.classes_[self.predict_proba(X).argmax(axis=1)]


class Raises(Levels):
    """Fails in the fold that leaves subject 2 out."""

    def fit(self, X, y):
        if "2" not in set(X.subjects):
            raise RuntimeError("cannot learn without 2")
        return super().fit(X, y)


class Batch(Levels):
    """Depends on the other test captures."""

    def table(self, X):
        table = super().table(X)
        return table - table.mean(axis=0)


class Epochs(Levels):
    """Has numbers by epoch, and tells what it chose."""

    def fit(self, X, y):
        super().fit(X, y)
        self.history_ = [{"loss": 1 / 3**epoch} for epoch in range(5)]
        self.chosen_ = {"level": len(X) / 7}
        return self


class Knows(Levels):
    """Knows the variant of a capture."""

    conditions = ("variant",)

    def table(self, X):
        return np.c_[super().table(X), 9.0 * (X.captures["variant"] == "rough")]
'''
MINE = ",".join(f"mine.py:{name}" for name in ("Raises", "Batch", "Epochs", "Knows"))
RUNS = {  # commands that fill the store, by the name of what they print
    "corpora": [
        [
            "data",
            "export",
            "synth",
            "people.csv",
            "subjects=4",
            "repetitions=1",
            "variants=normal+rough",
            *RATE,
        ],
        [
            "data",
            "export",
            "synth",
            "three.csv",
            "subjects=3",
            "repetitions=1",
            "variants=normal",
            "seed=7",
            *RATE,
        ],
        ["data", "import", "table", "people.csv", "name=people", *TABLE],
        ["data", "import", "table", "three.csv", "name=three", *TABLE],
    ],
    "run": [
        ["run", *PEOPLE, "model=tree,bayes", "features=jung28"],
        ["run", *PEOPLE, "model=lda", "features=touch", "model.window=0.5"],
        ["run", *PEOPLE, "model=rf", "model.trees=5", "features=jung28", "seed=0,1"],
        ["run", *PEOPLE, f"model={MINE}"],
        [
            "run",
            *PEOPLE,
            "model=bayes",
            "features=jung28",
            "where=variant == 'rough'",
            "target=gesture+variant",
        ],
        ["run", *THREE, "model=bayes", "features=jung28", "protocol=kfold", "protocol.folds=2"],
        ["run", *THREE, "model=tree,bayes", "features=jung28"],
        ["run", *SYNTH, "model=tree", "features=jung28"],
    ],
    "tune": [["tune", *PEOPLE, "model=tree", "features=jung28", "model.level=1,9", "inner=2"]],
    "smallest": [
        [
            "tune",
            *PEOPLE,
            "model=tree",
            "features=jung28",
            "smallest=level",
            "model.level=1,3",
            "inner=2",
        ]
    ],
    "stress": [
        [
            "stress",
            *PEOPLE,
            "model=tree,bayes",
            "features=jung28",
            "faults=noise,dead_taxels",
            "train_subjects=1,2",
        ],
        [
            "stress",
            *SYNTH,
            "model=rf",
            "model.trees=5",
            "features=jung28",
            "seed=0,1",
            "faults=noise",
        ],
    ],
    "replay": [
        [
            "run",
            *THREE,
            "model=tree,bayes",
            "features=jung28",
            "after=each",
            "stopping=yes",
            "hop_ms=1200",
        ],
        [
            "run",
            *THREE,
            "model=tree",
            "features=jung28",
            "after=each",
            "stopping=yes",
            "start=middle",
        ],
    ],
}


@contextmanager
def inside(folder: Path, template: Path | None = None) -> Iterator[None]:
    """Work in a folder as a user would, with folds in this process and tables that are not cut."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TOUCHBENCH_HOME", str(folder / "home"))
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        patch.chdir(folder)
        if template:
            patch.setattr(
                "bench.store.client.create_database", lambda path: shutil.copy(template, path)
            )
        patch.setattr("bench.running.workers.ProcessExecutor", FoldExecutor)
        patch.setattr(
            "bench.commands.printing.WIDTH", 250
        )  # room for all columns, however long times are
        yield


def build(folder: Path, runs: dict[str, list[list[str]]], template: Path | None = None) -> None:
    """Do commands in a folder, and keep what they print."""
    (folder / "printed").mkdir(parents=True, exist_ok=True)
    (folder / "mine.py").write_text(SYSTEMS)
    with inside(folder, template):
        for name, commands in runs.items():
            text = "".join(step(command) for command in commands)
            (folder / "printed" / f"{name}.txt").write_text(text)


def copy(folder: Path, to: Path) -> Path:
    """Copy a folder with a store, whose files lie beside it."""
    return Path(shutil.copytree(folder, to))


def step(command: list[str]) -> str:
    """A command, its output, its exit code, and what it says beside its output but progress."""
    from bench.cli import main

    out, errors = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(errors):
        code = main([*command])
    if command[:2] == ["data", "export"] and command[3] in PEOPLES:
        _like_people(Path(command[3]))
    said = [
        f"! {line}\n"
        for line in errors.getvalue().splitlines()
        if line and not PROGRESS.search(line)
    ]
    end = f"exit code {code}\n\n" if code else "\n\n"
    return f"$ bench {' '.join(command)}\n{out.getvalue()}{''.join(said)}{end}"


def _like_people(path: Path) -> None:
    """Keep some gestures, by name, and no mark of generated captures."""
    table = pd.read_csv(path, skipinitialspace=True)
    table = table[table["gesture"].isin(GESTURES)].drop(columns="synthetic")
    table["gesture"], table["variant"] = (
        table["gesture"].map(GESTURES),
        table["variant"].map(VARIANTS),
    )
    channels, rng = [name for name in table if name.startswith("ch")], np.random.default_rng(0)
    captures = []
    for _, capture in table.groupby(["subject", "variant", "gesture"], sort=False):
        quiet = capture.iloc[
            [0] * 5 * QUIET_FRAMES
        ].copy()  # more than are used: what is drawn depends on it
        quiet[channels] = rng.integers(0, 4, (len(quiet), len(channels)))
        captures.append(pd.concat([capture, quiet[:QUIET_FRAMES]]))
        captures[-1]["frame"] = np.arange(1, len(captures[-1]) + 1)
    pd.concat(captures).to_csv(path, index=False)


if __name__ == "__main__":
    build(Path(sys.argv[1]).resolve(), RUNS)
