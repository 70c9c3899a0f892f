"""How processor time and memory grow with people, systems and taxels.

    python benchmarks/bench_growth.py

It prints the exponent between neighbouring sizes. The people are generated, with 252 captures each.
It takes about five minutes on two quiet cores.
"""

import time
import tracemalloc
from collections.abc import Callable
from math import log

import numpy as np

import bench
from bench.features.touch import TouchFeatures
from bench.models.steps import Repair
from bench.values.pareto import is_on_front

PEOPLE = [10, 31, 100]
GRID = {"model": ["lda", "bayes"], "features": ["jung28", "jung54", "touch", "gaus", "hughes36"]}


def print_growth(title: str, sizes: list[int], make_work: Callable[[int], Callable]) -> None:
    """Print seconds, the highest memory allocated, and the exponent, for each size."""
    last_size, last_seconds = 0, 0.0
    for size in sizes:
        work = make_work(size)
        started = time.process_time()
        work()
        seconds = time.process_time() - started
        tracemalloc.start()
        result = work()
        peak_mb = tracemalloc.get_traced_memory()[1] / 1e6
        del result
        tracemalloc.stop()
        line = f"{title} {size}: {seconds:.2f} s, {peak_mb:.1f} MB"
        if last_size:
            line += f", exponent {log(seconds / last_seconds) / log(size / last_size):.2f}"
        print(line, flush=True)
        last_size, last_seconds = size, seconds


def plan_people(people: int, **values: object) -> list:
    """Plans of generated people."""
    return bench.plans(data__subjects=people, data__repetitions=6, jobs=1, **values)


def plan_grid(people: int) -> Callable[[], object]:
    """Ten plans with their identities."""
    plan_people(people, model="lda")  # generates the captures
    return lambda: [plan.identity() for plan in plan_people(people, **GRID)]


def extract_touch(people: int) -> Callable[[], object]:
    """The feature set `touch` of all captures."""
    (plan,) = plan_people(people, model="lda")
    return lambda: TouchFeatures().fit(plan.corpus).transform(plan.corpus)


def fit_folds(people: int) -> Callable[[], object]:
    """LOSO fits of `lda` on stored features."""
    (plan,) = plan_people(people, model="lda", features="touch")
    gestures = plan.corpus.gestures
    plan.cell.estimator().fit(plan.corpus[:500], gestures[:500])  # stores the features
    return lambda: [
        plan.cell.estimator().fit(plan.corpus[f.train], gestures[f.train]) for f in plan.folds
    ]


def find_front(systems: int) -> Callable[[], object]:
    """A Pareto front."""
    accuracy, cost = np.random.default_rng(0).random((2, systems))
    return lambda: is_on_front(accuracy, cost)


def repair_captures(side: int) -> Callable[[], object]:
    """Repaired taxels of 168 captures on a square skin."""
    (plan,) = bench.plans(data__subjects=4, data__rows=side, data__cols=side, model="lda", jobs=1)
    captures = [plan.corpus[i : i + 1] for i in range(len(plan.corpus))]
    return lambda: [Repair(("stuck", "dead"))(capture) for capture in captures]


if __name__ == "__main__":
    print_growth("10 plans, people:", PEOPLE, plan_grid)
    print_growth("features touch, people:", PEOPLE, extract_touch)
    print_growth("fits of lda on touch, LOSO, people:", PEOPLE, fit_folds)
    print_growth("fronts, systems:", [1000, 3000, 10_000], find_front)
    print_growth("repair of 168 captures, side:", [8, 32], repair_captures)
