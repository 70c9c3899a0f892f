"""Processor time of `bench run`, and of a script that fits and predicts in the same folds.

    python benchmarks/bench_plain.py

Each runs in a new process, on an empty store. The captures are generated; HAART is added if it is
imported.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from bench.corpora.library import imported_names

TINY = "data.subjects=3 data.variants=normal data.repetitions=2"
SYSTEMS = ("lda features=touch", "rf features=jung28", "svm features=jung28")
SCRIPT = """\
import bench
for plan in bench.plans(**{keywords!r}):
    y = plan.corpus.gestures
    for fold in plan.folds:
        train, test = plan.corpus[fold.train], plan.corpus[fold.test]
        plan.cell.estimator().fit(train, y[fold.train]).predict(test)
"""
COMMAND = "import sys; from bench.cli import main; sys.exit(main({words!r}))"


def measure_process(code: str, folder: str) -> tuple[float, float]:
    """Processor and wall seconds of Python code in a new process."""
    paths = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    paths.pop("MLFLOW_TRACKING_URI", None)
    started, before = time.perf_counter(), os.times()
    subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, cwd=folder, env=paths
    )
    after = os.times()
    processor = sum(after[2:4]) - sum(before[2:4])  # user and system time of children
    return processor, time.perf_counter() - started


def main() -> None:
    """Print a line for each system."""
    corpora = [TINY, *(["data=haart"] if "haart" in imported_names() else [])]
    for words in [f"{corpus} model={system}" for corpus in corpora for system in SYSTEMS]:
        keywords = {
            key.replace(".", "__"): value
            for key, value in (word.split("=") for word in words.split())
        }
        script = SCRIPT.format(keywords=keywords)
        with tempfile.TemporaryDirectory() as folder:
            measure_process(script, folder)  # generates the captures
            plain, plain_wall = measure_process(script, folder)
            ours, wall = measure_process(COMMAND.format(words=["run", *words.split()]), folder)
        line = f"{ours:.1f} s, script {plain:.1f} s, ratio {ours / plain:.2f}"
        print(f"{words}: {line}; wall {wall:.1f} and {plain_wall:.1f} s", flush=True)


if __name__ == "__main__":
    main()
