"""How fast one command tracks: folds that do nothing, with tables of as many captures as asked, by the loop as it is.

python benchmarks/bench_scale.py [folds [captures [tcp://scheduler:8786]]]

A fold of CoST has 84 captures.

Prints folds a second as it goes, and at last where the time of the command went. A new store in an empty folder; on a
cluster, workers of the same code.
"""

import os
import sys
import tempfile
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1]))  # where workers find it, too

from bench.outcomes.results import FoldResult, table_of
from bench.result import Result
from bench.work.experiment import Experiment

EACH = 31  # folds of a run
SPENT = defaultdict(float)


@dataclass(frozen=True)
class Empty(Experiment):
    """Hands back what a fold of CoST would, without doing anything.

    Attributes:
        number: tells runs apart.
        captures: tested captures of a fold.
    """

    tag: ClassVar[str] = "empty"
    heading: ClassVar[str] = "Empty folds"

    number: int = 0
    captures: int = 84

    def command(self, cell):
        """What would make such a run."""
        return "bench run"

    def arguments(self):
        """None of its own."""
        return {}

    def options(self):
        """Both."""
        return {"number": self.number, "captures": self.captures}

    def fold(self, cell, corpus, fold, threads):
        """A table of captures in 14 classes, and ten numbers."""
        table = pd.DataFrame(
            {"fold": fold.name, "capture": np.arange(self.captures), "start": 0, "frames": 135, "true": "a"}
        )
        table = table.assign(subject=fold.name, **{f"p_{c}": np.float32(1 / 14) for c in "abcdefghijklmn"})
        return FoldResult(fold.name, table, {f"cost_{i}": float(i) for i in range(10)}, [1.0] * 20, [1.0] * 20)

    def result(self, plan, about, folds):
        """A number and a table."""
        return Result(about, {"accuracy": 1 / 14}, {"predictions": table_of(folds)})


def timed(owner, name):
    """Add up what a method takes."""
    real = getattr(owner, name)

    def method(*args, **kwargs):
        began = time.perf_counter()
        try:
            return real(*args, **kwargs)
        finally:
            SPENT[f"{owner.__name__}.{name}"] += time.perf_counter() - began

    setattr(owner, name, method)


def run(folds: int, captures: int, cluster: str) -> None:
    """So many folds, in runs of 31."""
    from bench.on_cluster.cluster import Cluster
    from bench.outcomes.store import Store
    from bench.plan.cells import cells
    from bench.plan.plan import planned
    from bench.work import loop
    from bench.work.backend import Backend
    from bench.work.tracking import TrackedRun
    from bench.work.workers import Processes
    from benchmarks.bench_scale import Empty as Known  # as workers import it

    (plan,) = planned(
        cells({"model": "bayes", "features": "jung28", "data.subjects": str(EACH), "data.repetitions": "1"}), 2
    )
    todo = [(plan, Known(number, captures)) for number in range(folds // EACH)]
    for owner, names in (
        (TrackedRun, ("__init__", "add", "close")),
        (Processes, ("finished", "submit")),
        (Cluster, ("finished", "submit")),
        (Store, ("create", "log", "keep", "end")),
    ):
        for name in names:
            timed(owner, name)
    loop.console.quiet = True
    began, done, at = time.perf_counter(), [0], [time.perf_counter()]
    real = TrackedRun.add

    def add(self, *given):
        done[0] += 1
        if done[0] % 1000 == 0:
            now = time.perf_counter()
            print(f"{done[0]} folds, {1000 / (now - at[0]):.0f} a second", flush=True)
            at[0] = now
        return real(self, *given)

    TrackedRun.add = add
    results = loop.execute(todo, Backend(workers="cluster", address=cluster) if cluster else Backend(jobs=2))
    spent = time.perf_counter() - began
    assert all(r.folds == f"{EACH}/{EACH}" for r in results)
    print(f"{done[0]} folds of {len(todo)} runs in {spent:.0f} s: {done[0] / spent:.1f} a second")
    for name, seconds in sorted(SPENT.items(), key=lambda item: -item[1]):
        print(f"  {name}: {1000 * seconds / done[0]:.2f} ms a fold")


def main(*given: str) -> None:
    """In an empty folder."""
    from bench.scratch import home

    os.environ.setdefault("TOUCHBENCH_HOME", str(home()))
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        folds, captures, cluster = (*given, *("20000", "84", "")[len(given) :])
        run(int(folds), int(captures), cluster)


if __name__ == "__main__":
    main(*sys.argv[1:])
