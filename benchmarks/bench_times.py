"""Times of ten systems on a quiet machine and beside four busy loops, in turns.

Do the numbers and their order stay the same?

    python benchmarks/bench_times.py [CORPUS]

Each round fits every system to the training captures of a challenge split and times predictions, as
``bench run`` does. It prints, for fit and prediction, the times as tables show them and by the wall
clock, as a ratio to those of the first quiet round. A round before it warms up libraries.
"""

from __future__ import annotations

import subprocess
import sys
import warnings

import numpy as np
import pandas as pd
from scipy.stats import spearmanr

import bench
from bench.running.fold import fit_timed, limit_threads, measure_latency

SYSTEMS = ["svm", "bayes", "lda", "rf", "et", "xgb", "tree", "softmax", "perceptron"]
LOOPS = 4
THREADS = 1  # for fitting, as with as many jobs as cores
ROUNDS = ("warm-up", "quiet", "loops", "quiet", "loops")
SHOWN = ("fit_seconds", "fit_wall_seconds", "predict_ms", "predict_wall_ms")


def measure_times(plan: object) -> dict[str, float]:
    """Times of a system in the first fold of a plan."""
    fold, system = plan.folds[0], plan.cell.estimator()
    with limit_threads(THREADS):
        numbers = fit_timed(system, plan.corpus[fold.train])
    with limit_threads(1):
        longest = int(plan.corpus.lengths.max())
        times, pace = measure_latency(system, plan.corpus[fold.test], longest)
    medians = {name: np.median(times[name]) for name in ("predict_ms", "predict_wall_ms")}
    return numbers | medians | pace


def main(data: str) -> None:
    """Print the table of all rounds, and what changes between them."""
    warnings.simplefilter("ignore")
    protocol = "challenge" if data != "synth" else "kfold"
    plans = bench.plans(data=data, protocol=protocol, model=SYSTEMS, features=["touch"], jobs=1)
    plans += bench.plans(data=data, protocol=protocol, model=["reflex"], jobs=1)
    rows = []
    for number, state in enumerate(ROUNDS):
        count = LOOPS if state == "loops" else 0
        loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
        try:
            for plan in plans:
                rows.append(
                    {"system": plan.cell.system_name(), "round": f"{number} {state}"}
                    | measure_times(plan)
                )
                print(f"{rows[-1]['round']}: {rows[-1]['system']}", file=sys.stderr)
        finally:
            for loop in loops:
                loop.kill()
    table = pd.DataFrame(rows)
    table = table[table["round"] != f"0 {ROUNDS[0]}"]
    for name in SHOWN:
        wide = table.pivot(index="system", columns="round", values=name)
        ratios = wide.div(wide.iloc[:, 0], axis=0)
        order = [spearmanr(wide.iloc[:, 0], wide[column]).statistic for column in wide]
        print(f"\n{name}\n{wide.round(3)}\nratio to the first round\n{ratios.round(2)}")
        print(f"rank correlation with the first round: {np.round(order, 3)}")
    slower = table.groupby("round")["slowdown"].agg(["min", "median", "max"])
    print(f"\nslowdown of the reference workload\n{slower.round(2)}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "haart")
