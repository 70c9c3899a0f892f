"""Runs that look as if ``bench run`` had made them, without running anything."""

import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
from mlflow.entities import Metric, Param, RunTag

from bench.outcomes.results import measure
from bench.outcomes.scores import accuracies
from bench.outcomes.store import EXPERIMENT, _write_tables

GESTURES = ("pat", "rub", "tap")


class Result:
    """What `bench.tracking.measure` asks of a fold."""

    def __init__(self, name, cost=1.0):
        self.name = name
        self.metrics = {
            "fit_seconds": 3.0 * cost,
            "parameters": 1000 * cost,
            "flash_bytes": 4000 * cost,
            "ram_bytes": 500 * cost,
            "peak_rss_bytes": 2e8 * cost,
        }
        self.predict_ms = [1.0 * cost, 2.0 * cost]
        self.decide_ms = [0.5 * cost]


def made_up(subjects=4, per_class=4, skill=0.7, seed=0, windows=1, gestures=GESTURES, hard=False, folds=None):
    """A predictions table; a subject's captures are right with a probability around ``skill``."""
    rng = np.random.default_rng(seed)
    rows = []
    for s in range(subjects):
        level = np.clip(skill + 0.15 * np.sin(s), 0, 1)
        for c, gesture in enumerate(list(gestures) * per_class):
            truth = c % len(gestures)
            for w in range(windows):
                p = rng.dirichlet(np.ones(len(gestures)))
                said = truth if rng.random() < level else int(rng.integers(len(gestures)))
                p[[said, p.argmax()]] = p[[p.argmax(), said]]
                if hard:
                    p = np.eye(len(gestures))[said]
                fold = str(s + 1) if folds is None else str(s % folds + 1)
                rows.append((fold, 100 * s + c, 10 * w, 10, gesture, str(s + 1), *p))
    names = ["fold", "capture", "start", "frames", "true", "subject", *(f"p_{g}" for g in gestures)]
    return pd.DataFrame(rows, columns=names)


def tracked_run(client, system, predictions, failed=0, history=(), cost=1.0, **about):
    """Store a parent run with its artifacts and a child for each fold; ``about`` are tags and parameters."""
    experiment = client.get_experiment_by_name(EXPERIMENT).experiment_id
    params = {k: str(v) for k, v in about.items() if "." in k or k in ("corpus_digest", "git", "cpu", "threads")}
    tags = {
        "touchbench.kind": "cell",
        "data": "synth",
        "synthetic": "true",
        "subset": "all",
        "target": "gesture",
        "protocol": "loso",
        "protocol_label": f"LOSO ({predictions['subject'].nunique()} subjects)",
        "system": system,
        "model": system.split(" · ")[0],
        "features": "jung54",
        "seed": "0",
    }
    tags |= {k: str(v) for k, v in about.items() if k not in params}
    run = client.create_run(experiment, run_name=system, tags=tags).info.run_id
    params = {"corpus_digest": "d" * 64, "git": "abc", "cpu": "one", "threads": "1", "version.python": "3"} | params
    names = list(predictions["fold"].unique())
    results = [Result(name, cost) for name in names]
    metrics = measure(predictions, results, 50.0) | {"folds": len(names), "folds_failed": failed}
    now = int(time.time() * 1000)
    client.log_batch(
        run,
        [Metric(k, float(v), now, 0) for k, v in metrics.items()],
        [Param(k, v) for k, v in params.items()],
        [RunTag("mlflow.note.content", "made up")],
    )
    with tempfile.TemporaryDirectory() as folder:
        _write_tables(predictions, Path(folder))
        client.log_artifacts(run, folder)
    for name in names:
        tags = {"mlflow.parentRunId": run, "touchbench.kind": "fold", "touchbench.fold": name}
        child = client.create_run(experiment, run_name=name, tags=tags).info.run_id
        found = accuracies(predictions[predictions["fold"] == name])
        points = [Metric(k, float(v), now, 0) for k, v in found.items()]
        points += [Metric("loss", v, now, step) for step, v in enumerate(history, 1)]
        client.log_batch(child, points)
        client.set_terminated(child, "FINISHED")
    client.set_terminated(run, "FAILED" if failed else "FINISHED")
    return run
