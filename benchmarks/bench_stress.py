"""Time of `bench stress` with every fault: what it takes beyond fitting, and the analysis. Nothing is tracked.

python benchmarks/bench_stress.py [data=haart] [model=svm] [features=jung54] [jobs=2] ...
"""

import sys
import tempfile
import time
from pathlib import Path

import pandas as pd
from folds import folds_done  # beside this file

from bench.arguments import KEYS, jobs_of, parse
from bench.corpora.faults import SEVERITIES, known
from bench.outcomes import stability
from bench.plan.cells import cells
from bench.plan.plan import planned
from bench.work.stress import Stress
from reports import stability_tables


def main(arguments: list[str]) -> None:
    """Print seconds per fold and in all, and of analysing and drawing."""
    values = parse(arguments, KEYS)
    faults = tuple(known().values())
    (plan,) = planned(cells(values), jobs_of(values))
    cell, corpus, folds, jobs, threads = plan.cell, plan.corpus, plan.folds, plan.workers, plan.threads
    print(
        f"{cell.system()}, {cell.data}, {len(corpus)} captures, {len(faults)} faults x {SEVERITIES} severities, "
        f"{jobs} workers x {threads} threads",
        flush=True,
    )
    started = time.perf_counter()
    parts, spent = [], pd.DataFrame()
    for result in folds_done(plan, Stress(faults), folds):
        assert not result.error, result.error
        parts.append(result.predictions)
        spent[result.name] = result.metrics
        print(f"fold {result.name}: " + ", ".join(f"{k} {v:.1f}" for k, v in result.metrics.items()), flush=True)
    wall = time.perf_counter() - started
    total = spent.sum(axis=1)
    print(
        f"{len(folds)} folds in {wall:.0f} s; fits {total['fit_seconds']:.0f} s, faults {total['fault_seconds']:.0f} s "
        f"({total['fault_cpu_seconds']:.0f} s of CPU), of all workers together"
    )
    tags = {
        "system": cell.system(),
        "seed": "0",
        "data": cell.data,
        "synthetic": str(corpus.synthetic).lower(),
        "subset": cell.where or "all",
        "target": cell.target,
        "protocol_label": str(cell.protocol),
    }
    cpu, started = time.process_time(), time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        stability_tables.write([stability.analyse(tags, pd.concat(parts, ignore_index=True))], Path(folder))
    wall, cpu = time.perf_counter() - started, time.process_time() - cpu
    print(f"analysis, tables and figures: {wall:.0f} s ({cpu:.0f} s of CPU)")


if __name__ == "__main__":
    main(sys.argv[1:])
