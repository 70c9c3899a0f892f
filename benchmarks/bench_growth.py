"""How processor time and memory grow with people and systems: plans, features, fits of `lda`, fronts, wide skins.

python benchmarks/bench_growth.py [people ...]

People have 252 generated captures each; by default 10, 31 and 100. Prints processor seconds, the most memory that was
allocated besides, and the exponent between neighbouring sizes.
"""

import sys
import time
import tracemalloc
from collections.abc import Callable
from math import log

import numpy as np

from bench import pareto
from bench.contract import features
from bench.corpora.steps import Repair
from bench.features.cache import _extracted
from bench.plan.cells import cells
from bench.plan.plan import planned

GRID = {"model": "lda,bayes", "features": "jung28,jung54,touch,gaus,hughes36"}


def cells_of(people: int, **more: str) -> list:
    """Cells on generated captures of so many people."""
    return cells({"data.subjects": str(people), "data.repetitions": "6", **more})


def plans(people: int, count: int) -> Callable[[], object]:
    """Plans of some cells, with what the store gets of them."""

    def work() -> list:
        found = planned(cells_of(people, **GRID)[:count], 1)
        return [(plan, plan.facts, plan.label, plan.identity()) for plan in found]

    return work


def extraction(people: int) -> Callable[[], object]:
    """Features of all captures."""
    (cell,) = cells_of(people, model="lda", features="touch")
    (plan,) = planned([cell], 1)
    (part,) = features(cell.untrained).values()
    return lambda: _extracted(part, plan.corpus.blind(), ())


def fits(people: int) -> Callable[[], object]:
    """`lda` fitted in every fold, with features that are kept."""
    (cell,) = cells_of(people, model="lda", features="touch")
    (plan,) = planned([cell], 1)
    cell.estimator().fit(plan.corpus[:500], plan.corpus.gestures[:500])  # which keeps the features
    gestures = plan.corpus.gestures
    return lambda: [cell.estimator().fit(plan.corpus[f.train], gestures[f.train]) for f in plan.folds]


def fronts(systems: int) -> Callable[[], object]:
    """Which of some systems are worse than another one."""
    accuracy, cost = np.random.default_rng(0).random((2, systems))
    return lambda: pareto.dominated_by(accuracy, cost[:, None])


def repair(side: int) -> Callable[[], object]:
    """Repair of 168 captures on a skin of so many rows and columns."""
    (plan,) = planned(cells({"data.subjects": "4", "data.rows": str(side), "data.cols": str(side), "model": "lda"}), 1)
    return lambda: [Repair(("stuck", "dead"))(plan.corpus[i : i + 1]) for i in range(len(plan.corpus))]


def measured(words: str, sizes: list[int], made: Callable[[int], Callable[[], object]]) -> None:
    """Print a line for each size."""
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
        k = f", k {log(spent / before[1]) / log(size / before[0]):.1f}" if before else ""
        print(f"{words} {size}: {spent:.2f} s, {peak:.0f} MB{k}", flush=True)
        before = size, spent


def main(*given: str) -> None:
    """All of them."""
    people = [*map(int, given)] or [10, 31, 100]
    measured("plans of 1 cell, people:", people, lambda n: plans(n, 1))
    measured("plans of 10 cells, people:", people, lambda n: plans(n, 10))
    measured("features touch, people:", people, extraction)
    measured("fits of lda on touch, LOSO, people:", people, fits)
    measured("fronts, systems:", [1000, 3000, 10_000], fronts)
    measured("repair of 168 captures, side:", [8, 32], repair)


if __name__ == "__main__":
    main(*sys.argv[1:])
