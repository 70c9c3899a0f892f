"""How time and memory grow with people, systems, runs and folds, with the exponent between neighbouring sizes.

    python benchmarks/bench_scale.py [growth] [runs] [commands] [folds] [captures=84] [cluster=tcp://...]

All four tables take up to twenty minutes on two quiet cores; names select some.

- growth: plans, features, fits, fronts and wide skins, by generated people of 252 captures each;
- runs: what shows stored runs, by their number, in new processes;
- commands: `bench run` beside a script that fits and predicts in the same folds, in new processes;
- folds: how fast one command tracks folds that do nothing, and what of it takes how long.

Seconds are of all processors unless wall is said. Each table works in an empty folder.
"""

import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import log
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1]))  # where workers find it, too

from bench.result import Result
from bench.work.experiment import Experiment
from bench.work.results import FoldResult, table_of

PEOPLE = [10, 31, 100]
GRID = {"model": "lda,bayes", "features": "jung28,jung54,touch,gaus,hughes36"}
RUNS = [32, 100, 300, 1000, 3000]
TINY = "data.subjects=3 data.variants=normal data.repetitions=2"
EACH, FOLDS = 31, 1550  # folds of a run, and of all
SPENT: dict[str, float] = defaultdict(float)


def measured(words: str, sizes: list[int], made: Callable[[int], Callable[[], object]]) -> None:
    """Print seconds, the most memory that was allocated besides, and the exponent, for each size."""
    before = None
    for size in sizes:
        work = made(size)
        began = time.process_time()
        work()
        spent = time.process_time() - began
        tracemalloc.start()
        held = work()
        peak = tracemalloc.get_traced_memory()[1] / 1e6
        del held
        tracemalloc.stop()
        print(f"{words} {size}: {spent:.2f} s, {peak:.1f} MB{exponent(before, (size, spent))}", flush=True)
        before = size, spent


def exponent(before: tuple[int, float] | None, now: tuple[int, float]) -> str:
    """The exponent between two pairs of size and seconds, in words."""
    return f", k {log(now[1] / before[1]) / log(now[0] / before[0]):.2f}" if before else ""


def growth() -> None:
    """By people, systems and taxels."""
    from bench import pareto
    from bench.contract import features
    from bench.corpora.steps import Repair
    from bench.features.cache import _extracted
    from bench.plan.cells import cells
    from bench.plan.plan import planned

    def cells_of(people: int, **more: str) -> list:
        return cells({"data.subjects": str(people), "data.repetitions": "6", **more})

    def plans(people: int, count: int) -> Callable[[], object]:
        planned(cells_of(people, **GRID)[:1], 1)  # which makes the captures

        def work() -> list:
            every = planned(cells_of(people, **GRID)[:count], 1)
            return [(plan, plan.facts, plan.label, plan.identity()) for plan in every]

        return work

    def extraction(people: int) -> Callable[[], object]:
        (plan,) = planned(cells_of(people, model="lda", features="touch"), 1)
        (part,) = features(plan.cell.untrained).values()
        return lambda: _extracted(part, plan.corpus.blind(), ())

    def fits(people: int) -> Callable[[], object]:
        (plan,) = planned(cells_of(people, model="lda", features="touch"), 1)
        gestures = plan.corpus.gestures
        plan.cell.estimator().fit(plan.corpus[:500], gestures[:500])  # which keeps the features
        return lambda: [plan.cell.estimator().fit(plan.corpus[f.train], gestures[f.train]) for f in plan.folds]

    def fronts(systems: int) -> Callable[[], object]:
        accuracy, cost = np.random.default_rng(0).random((2, systems))
        return lambda: pareto.dominated_by(accuracy, cost[:, None])

    def repair(side: int) -> Callable[[], object]:
        skin = {"data.subjects": "4", "data.rows": str(side), "data.cols": str(side), "model": "lda"}
        (plan,) = planned(cells(skin), 1)
        return lambda: [Repair(("stuck", "dead"))(plan.corpus[i : i + 1]) for i in range(len(plan.corpus))]

    measured("plans of 1 cell, people:", PEOPLE, lambda n: plans(n, 1))
    measured("plans of 10 cells, people:", PEOPLE, lambda n: plans(n, 10))
    measured("features touch, people:", PEOPLE, extraction)
    measured("fits of lda on touch, LOSO, people:", PEOPLE, fits)
    measured("fronts, systems:", [1000, 3000, 10_000], fronts)
    measured("repair of 168 captures, side:", [8, 32], repair)


def enter(folder: str) -> None:
    """Work in a folder, with a store of its own: MLflow sets the address of the last one for the whole process."""
    os.chdir(folder)
    os.environ.pop("MLFLOW_TRACKING_URI", None)


def spent(*words: str) -> tuple[float, float]:
    """Processor and wall seconds of Python with some words in a new process, which must go well."""
    paths = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    began, before = time.perf_counter(), os.times()
    subprocess.run([sys.executable, *words], check=True, capture_output=True, env=paths)
    after = os.times()
    processor = after.children_user + after.children_system - before.children_user - before.children_system
    return processor, time.perf_counter() - began


def bench(words: str) -> tuple[str, ...]:
    """A command as words for `spent`."""
    return "-c", f"import sys; from bench.cli import main; sys.exit(main({words.split()!r}))"


def runs() -> None:
    """By number of stored runs, in four groups."""
    from benchmarks.bench_report import fill

    shown = {
        "bench.results()": ("-c", "import bench; bench.results()"),
        "choose": bench("choose data=cost"),
        "report": bench("report"),
        "a stored run again": bench(f"run {TINY} model=bayes features=jung28"),
    }
    before: dict[str, tuple[int, float]] = {}
    for size in RUNS:
        with tempfile.TemporaryDirectory() as folder:
            enter(folder)
            fill(size)
            spent(*shown["a stored run again"])
            for name, words in shown.items():
                processor, wall = spent(*words)
                k = exponent(before.get(name), (size, processor))
                print(f"{name}, stored runs {size}: {processor:.1f} s, wall {wall:.1f} s{k}", flush=True)
                before[name] = size, processor
            os.chdir("/")


def commands() -> None:
    """`bench run` beside a script on the same folds: generated captures, and HAART where it is imported."""
    from bench.corpora.library import imported

    systems = [f"{TINY} model=svm features=jung28"]
    if "haart" in imported():
        systems += [f"data=haart model={names}" for names in ("lda features=touch", "rf features=jung28")]
    for words in systems:
        given = dict(word.split("=") for word in words.split())
        keywords = {key.replace(".", "__"): value for key, value in given.items()}
        script = (
            f"import bench\nfor plan in bench.plans(**{keywords!r}):\n"
            "    y = plan.corpus.gestures\n"
            "    for fold in plan.folds:\n"
            "        train, test = plan.corpus[fold.train], plan.corpus[fold.test]\n"
            "        plan.cell.estimator().fit(train, y[fold.train]).predict(test)\n"
        )
        with tempfile.TemporaryDirectory() as folder:
            enter(folder)
            spent("-c", script)  # which makes the captures
            sides = [spent("-c", script), spent(*bench(f"run {words}"))]
            os.chdir("/")
        (plain, waited), (ours, wall) = sides
        beside = f"script {plain:.1f} s, {ours / plain:.1f} times; wall {wall:.1f} and {waited:.1f} s"
        print(f"{words}: {ours:.1f} s, {beside}", flush=True)


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
    captures: int = 84  # as in CoST

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


def timed(owner: type, name: str) -> None:
    """Add up what a method takes."""
    real = getattr(owner, name)

    def method(*args, **kwargs):
        began = time.perf_counter()
        try:
            return real(*args, **kwargs)
        finally:
            SPENT[f"{owner.__name__}.{name}"] += time.perf_counter() - began

    setattr(owner, name, method)


def folds(captures: int, cluster: str) -> None:
    """Folds that do nothing, by the loop as it is: on a cluster, workers of the same code."""
    from bench.on_cluster.cluster import Cluster
    from bench.outcomes.store import Store
    from bench.plan.cells import cells
    from bench.plan.plan import planned
    from bench.work import loop
    from bench.work.backend import Backend
    from bench.work.tracking import TrackedRun
    from bench.work.workers import Processes
    from benchmarks.bench_scale import Empty as Known  # as workers import it

    one = {"model": "bayes", "features": "jung28", "data.subjects": str(EACH), "data.repetitions": "1"}
    with tempfile.TemporaryDirectory() as folder:
        enter(folder)
        (plan,) = planned(cells(one), 2)
        todo = [(plan, Known(number, captures)) for number in range(FOLDS // EACH)]
        for owner, names in (
            (TrackedRun, ("__init__", "add", "close")),
            (Processes, ("finished", "submit")),
            (Cluster, ("finished", "submit")),
            (Store, ("add", "log", "keep", "end")),
        ):
            for name in names:
                timed(owner, name)
        loop.console.quiet = True
        began = time.perf_counter()
        results = loop.execute(todo, Backend(workers="cluster", address=cluster) if cluster else Backend(jobs=2))
        seconds = time.perf_counter() - began
        assert all(r.folds == f"{EACH}/{EACH}" for r in results)
        print(f"{FOLDS} folds of {len(todo)} runs in {seconds:.0f} s (wall): {FOLDS / seconds:.1f} a second")
        for name, each in sorted(SPENT.items(), key=lambda item: -item[1]):
            print(f"  {name}: {1000 * each / FOLDS:.2f} ms a fold")
        os.chdir("/")


def main(*given: str) -> None:
    """The tables that are asked for, or all."""
    from bench.scratch import home

    os.environ["TOUCHBENCH_HOME"] = str(home().absolute())
    values = dict(word.split("=", 1) for word in given if "=" in word)
    asked = [word for word in given if "=" not in word]
    tables = {
        "growth": growth,
        "runs": runs,
        "commands": commands,
        "folds": partial(folds, int(values.get("captures", 84)), values.get("cluster", "")),
    }
    for name, table in tables.items():
        if not asked or name in asked:
            began = time.perf_counter()
            table()
            print(f"table {name}: {time.perf_counter() - began:.0f} s\n", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
