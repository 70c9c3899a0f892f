"""Time of a full LOSO of one system on a generated corpus of CoST's size, from its first folds.

python benchmarks/bench_loso.py [model] [folds]
"""

import sys
import time

from folds import folds_done  # beside this file

from bench.plan.cells import cells
from bench.plan.plan import planned
from bench.work.evaluation import Evaluation


def main(model: str = "cnn85", count: str = "4") -> None:
    """Print seconds per fold, accuracy, peak memory, and the wall time extrapolated to all folds."""
    (cell,) = cells({"model": model, "data.subjects": "31", "data.repetitions": "6"})
    (plan,) = planned([cell], None)
    corpus, folds, jobs, threads = plan.corpus, plan.folds, plan.workers, plan.threads
    print(f"{cell.system()}, {len(corpus)} synthetic captures, {jobs} workers x {threads} threads", flush=True)
    started = time.perf_counter()
    for result in folds_done(plan, Evaluation(), folds[: int(count)]):
        rows = result.predictions
        classes = [c for c in rows if c.startswith("p_")]
        correct = rows[classes].idxmax(axis=1).str.removeprefix("p_") == rows["true"]
        told = f"rates {sorted({h['rate'] for h in result.history if 'rate' in h})}" if result.history else ""
        if result.chosen:
            told = f"search {result.metrics['search_seconds']:.0f} s, {result.chosen}"
            told += f", given up {(result.trials['state'] == 'pruned').sum()} of {len(result.trials)}"
        print(
            f"fold {result.name}: fit {result.metrics['fit_seconds']:.0f} s, {len(rows)} decisions, "
            f"{correct.mean():.1%} of them right, peak {result.metrics['peak_rss_bytes'] / 2**20:.0f} MiB, {told}",
            flush=True,
        )
    wall = time.perf_counter() - started
    hours = wall * len(folds) / int(count) / 3600
    print(f"{count} folds in {wall:.0f} s; all {len(folds)} extrapolated: {hours:.2f} h")


if __name__ == "__main__":
    main(*sys.argv[1:])
