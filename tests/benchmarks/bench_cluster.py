"""What a fold costs beyond itself, in processes of this machine and on a cluster of two workers here: folds do nothing.

python tests/benchmarks/bench_cluster.py [folds]
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from bench.plan.arguments import Backend
from bench.plan.cells import cells
from bench.plan.plan import planned
from bench.work.cluster import Cluster
from bench.work.workers import Processes, Task

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))  # where workers find it, too
PORT = "28786"


def seconds(workers, plan, experiment, count):
    """Until so many folds are done, when the processes have imported what they need."""
    folds = [replace(plan.folds[0], name=str(i)) for i in range(count)]
    with workers:
        spent = []
        for part in (folds[:4], folds):
            waiting, left, begun = list(part), len(part), time.perf_counter()
            while left:
                while waiting and workers.room(plan):
                    workers.submit(Task(plan, experiment, waiting.pop(0), "key"))
                assert not workers.finished().result.error
                left -= 1
            spent.append(time.perf_counter() - begun)
    return spent[-1]


def main(count: int = 500) -> None:
    """Print milliseconds per fold of both."""
    from tests.benchmarks.folds import Nothing

    (plan,) = planned(cells({"model": "bayes", "features": "jung28", "data.subjects": "4"}), 2)
    here = seconds(Processes(), plan, Nothing(), count)
    print(f"two processes: {1000 * here / count:.1f} ms a fold", flush=True)
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    dask = [sys.executable, "-m"]
    quiet = {"env": env, "stderr": subprocess.DEVNULL}
    scheduler = subprocess.Popen([*dask, "distributed.cli.dask_scheduler", "--port", PORT, "--no-dashboard"], **quiet)
    place = f"tcp://127.0.0.1:{PORT}"
    two = ["--nworkers", "2", "--nthreads", "1", "--no-dashboard"]
    worker = subprocess.Popen([*dask, "distributed.cli.dask_worker", place, *two], **quiet)
    told = Path(tempfile.mkdtemp())
    try:
        time.sleep(5)
        there = seconds(Cluster(Backend(cluster=place), [(plan, Nothing())], print, told), plan, Nothing(), count)
        print(f"two workers of dask: {1000 * there / count:.1f} ms a fold")
    finally:
        worker.terminate()
        shutil.rmtree(told)
        scheduler.terminate()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
