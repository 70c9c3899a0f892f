"""The work of a fit of each model, which `dry=yes` takes for systems without a similar stored run.

    python benchmarks/bench_folds.py bench/running/work.csv

Each model is fitted, with its defaults, to generated captures. Training of a network is measured
for one epoch and for two, and extended to all of its epochs. The unit of work is the reference
workload of `bench.ground.timing`, so the figures hold for other processors, roughly.
"""

import csv
import sys
import warnings

from bench.ground.registry import load_part, parameter_defaults
from bench.ground.timing import time_once
from bench.models import PARTS
from bench.plan.grid import make_cells
from bench.plan.plan import make_plans
from bench.running.fold import limit_threads
from bench.running.workers import fill_cache

CAPTURES = {"data.subjects": 4, "data.variants": "normal", "data.repetitions": 2}
SEARCHES = {"auto"}  # its work depends on the systems that it tries


def fit_work(name: str, **parameters: int) -> tuple[float, bool, int, int]:
    """Work of a fit, whether it uses features, and numbers of captures and frames."""
    typed = {f"model.{key}": value for key, value in parameters.items()}
    (plan,) = make_plans(make_cells({"model": name, **CAPTURES, **typed}), 1)
    cell, corpus = plan.cell, plan.corpus
    fill_cache(cell, corpus)
    system = cell.estimator()
    with limit_threads(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        _, times, _ = time_once(lambda: system.fit(corpus, corpus.gestures))
    return times.ms[0] / times.quiet_ms, bool(cell.feature_sets()), len(corpus), len(corpus.frames)


def main(path: str) -> None:
    """Write the file."""
    with open(path, "w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["model", "per_capture", "per_frame"])
        for name in PARTS:
            if name in SEARCHES:
                continue
            epochs = parameter_defaults(load_part("models", name)).get("epochs")
            if isinstance(epochs, int):
                first, *sizes = fit_work(name, epochs=1)
                second, *_ = fit_work(name, epochs=2)
                work = first + max(0.0, second - first) * (epochs - 1)
            else:
                work, *sizes = fit_work(name)
            uses_features, captures, frames = sizes
            shares = (work / captures, 0.0) if uses_features else (0.0, work / frames)
            rows.writerow([name, *(f"{share:.3g}" for share in shares)])
            file.flush()
            print(name, shares, flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
