"""What tracking adds to a 31-fold svm run on a generated corpus of CoST's size.

The same folds, each time in new processes: without tracking, and by ``bench run`` with a new store.

    python benchmarks/bench_tracking.py [rounds]
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from bench.corpora.library import open_corpus

SIZE = ["data.subjects=31", "data.repetitions=6"]
UNTRACKED = """
from bench.arguments import KEYS, parse
from bench.plan.cells import cells
from bench.plan.plan import planned
from bench.work.evaluation import Evaluation
from bench.work.workers import fill_cache
import sys
sys.path.append(sys.argv.pop(1))
from folds import folds_done
(plan,) = planned(cells(parse(sys.argv[1:], KEYS)), None)
fill_cache(plan.cell, plan.corpus)
assert len(list(folds_done(plan, Evaluation(), plan.folds))) == 31
"""
TRACKED = "import sys; from bench.cli import main; sys.exit(main(['run', *sys.argv[1:]]))"


def seconds(code: str, *given: str) -> float:
    """Wall time of one whole process in an empty folder."""
    with tempfile.TemporaryDirectory() as folder:
        started = time.perf_counter()
        subprocess.run([sys.executable, "-c", code, *given, *SIZE], check=True, cwd=folder, capture_output=True)
        return time.perf_counter() - started


def main(rounds: int = 3) -> None:
    """Print both in turn, and what tracking added beside what is allowed."""
    from bench.plan.cells import cells

    (cell,) = cells({"data.subjects": "31", "data.repetitions": "6"})
    cell.features.make().fit_transform(open_corpus(cell.data, cell.data_parameters)[:1])  # both find them cached
    pairs = []
    for _ in range(rounds):
        pairs.append((seconds(UNTRACKED, str(Path(__file__).parent.absolute())), seconds(TRACKED)))
        print("without tracking {:.1f} s, with it {:.1f} s".format(*pairs[-1]), flush=True)
    without, tracked = np.median(pairs, axis=0)
    print(f"added {tracked - without:.1f} s; 5 % of the run and 3 s are {0.05 * without + 3:.1f} s")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
