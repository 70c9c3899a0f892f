"""What tracking adds to a 31-fold svm run on a generated corpus of CoST's size: the same folds without it and with it.

python tests/benchmarks/bench_tracking.py
"""

import os
import tempfile
import time

from bench.cells import cells
from bench.runner import folds_of, run_folds, share_cores
from bench.store import open_corpus
from bench.tracking import CellRun, connect


def main() -> None:
    """Print seconds without tracking, with it, and the difference beside what is allowed."""
    (cell,) = cells({"model": "svm", "data.subjects": "31", "data.repetitions": "6"})
    corpus = open_corpus(cell.data, cell.data_parameters)
    folds = folds_of(cell, corpus)
    share = share_cores(None, len(folds))
    cell.features.make().fit_transform(corpus[:1])
    list(run_folds(cell, corpus, folds[: share[0]], *share))  # starts the workers

    started = time.perf_counter()
    results = list(run_folds(cell, corpus, folds, *share))
    without = time.perf_counter() - started

    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        started = time.perf_counter()
        run = CellRun(connect(), cell, corpus, "benchmark", "LOSO", share[1])  # imports MLflow and creates the store
        opened = time.perf_counter() - started
        for result in run_folds(cell, corpus, folds, *share):
            run.add(result)
        run.close([fold.name for fold in folds])
        tracked = time.perf_counter() - started
    print(f"{len(results)} folds, {len(corpus)} synthetic captures")
    print(f"without tracking {without:.1f} s; with it {tracked:.1f} s, of which import and new store {opened:.1f} s")
    print(f"added {tracked - without:.1f} s; 5 % of the run and 3 s are {0.05 * without + 3:.1f} s")


if __name__ == "__main__":
    main()
