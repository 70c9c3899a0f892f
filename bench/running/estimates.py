"""A rough time of a run without a similar stored one, by its captures, protocol and model.

`work.csv` has the work of a fit of each model in reference workloads (`bench.ground.timing`), by
`benchmarks/bench_folds.py`. One workload is timed on this machine.
"""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path

import numpy as np

from bench.ground.registry import parameter_defaults
from bench.ground.timing import WARM_UP, measure_ms, run_reference_workload, update_quiet_ms
from bench.plan.plan import Plan

FOLD_WORK = 300  # of a fold besides its fit: predictions, checks and timing; a guess
LOOPS = ("epochs", "trees", "runs")  # parameters to which the work of a fit is proportional


def estimate_from_work(plan: Plan) -> float | None:
    """Seconds of a fold; None for a search, a kind of run, or a model without a figure."""
    cell, figures = plan.cell, _work_by_model().get(plan.cell.model.name)
    if figures is None or cell.tuning or cell.run_kind:
        return None
    per_capture, per_frame = figures
    captures = float(np.mean([len(fold.train) for fold in plan.folds]))
    work = captures * (per_capture + per_frame * float(plan.corpus.lengths.mean()))
    defaults = parameter_defaults(cell.model.factory)
    for name in LOOPS:
        default, value = defaults.get(name), cell.model.parameters.get(name)
        if isinstance(default, int) and isinstance(value, int):
            work *= value / max(1, default)
    return (FOLD_WORK + work) * _seconds_of_workload()


@cache
def _work_by_model() -> dict[str, tuple[float, float]]:
    """Work of a fit of each model, per training capture and per training frame."""
    with Path(__file__).with_name("work.csv").open(encoding="utf-8") as file:
        return {
            row["model"]: (float(row["per_capture"]), float(row["per_frame"]))
            for row in csv.DictReader(file)
        }


@cache
def _seconds_of_workload() -> float:
    """Seconds of the reference workload on this machine when it is quiet."""
    return (
        update_quiet_ms(min(measure_ms(run_reference_workload)[1] for _ in range(WARM_UP))) / 1000
    )
