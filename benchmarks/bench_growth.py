"""How processor time and memory grow with people, systems and taxels, with the exponent between neighbouring sizes.

    python benchmarks/bench_growth.py

The people are generated, with 252 captures each. It takes about five minutes on two quiet cores.
"""

import time
import tracemalloc
from collections.abc import Callable
from math import log

import numpy as np

import bench
from bench.features.touch import TouchFeatures
from bench.models.steps import Repair
from bench.values import pareto

PEOPLE = [10, 31, 100]
GRID = {"model": ["lda", "bayes"], "features": ["jung28", "jung54", "touch", "gaus", "hughes36"]}


def measured(words: str, sizes: list[int], made: Callable[[int], Callable[[], object]]) -> None:
    """Print seconds, the highest memory allocated, and the exponent, for each size."""
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
        exponent = (
            f", exponent {log(spent / before[1]) / log(size / before[0]):.2f}" if before else ""
        )
        print(f"{words} {size}: {spent:.2f} s, {peak:.1f} MB{exponent}", flush=True)
        before = size, spent


def planned(people: int, **values: object) -> list:
    """Plans of generated people."""
    return bench.plans(data__subjects=people, data__repetitions=6, jobs=1, **values)


def plans(people: int) -> Callable[[], object]:
    """Ten plans with their keys."""
    planned(people, model="lda")  # generates the captures
    return lambda: [plan.identity() for plan in planned(people, **GRID)]


def features(people: int) -> Callable[[], object]:
    """The table of `touch`."""
    (plan,) = planned(people, model="lda")
    return lambda: TouchFeatures().fit(plan.corpus).transform(plan.corpus)


def fits(people: int) -> Callable[[], object]:
    """LOSO fits of `lda` on stored features."""
    (plan,) = planned(people, model="lda", features="touch")
    gestures = plan.corpus.gestures
    plan.cell.estimator().fit(plan.corpus[:500], gestures[:500])  # stores the features
    return lambda: [
        plan.cell.estimator().fit(plan.corpus[f.train], gestures[f.train]) for f in plan.folds
    ]


def fronts(systems: int) -> Callable[[], object]:
    """A Pareto front."""
    accuracy, cost = np.random.default_rng(0).random((2, systems))
    return lambda: pareto.is_on_front(accuracy, cost)


def repair(side: int) -> Callable[[], object]:
    """Repaired taxels of 168 captures on a square skin."""
    (plan,) = bench.plans(data__subjects=4, data__rows=side, data__cols=side, model="lda", jobs=1)
    return lambda: [
        Repair(("stuck", "dead"))(plan.corpus[i : i + 1]) for i in range(len(plan.corpus))
    ]


if __name__ == "__main__":
    measured("10 plans, people:", PEOPLE, plans)
    measured("features touch, people:", PEOPLE, features)
    measured("fits of lda on touch, LOSO, people:", PEOPLE, fits)
    measured("fronts, systems:", [1000, 3000, 10_000], fronts)
    measured("repair of 168 captures, side:", [8, 32], repair)
