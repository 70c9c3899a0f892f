"""Runs that look as if ``bench run`` had made them, without running anything."""

import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from bench.outcomes import scores
from bench.outcomes.results import measure

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


def with_hits(hits, of=20):
    """A predictions table in which of each subject's ``of`` captures as many are right as ``hits`` says."""
    names = ["fold", "capture", "start", "frames", "true", "subject", *(f"p_{g}" for g in GESTURES)]
    rows = []
    for s, right in enumerate(hits, 1):
        for c in range(of):
            truth = c % len(GESTURES)
            p = np.full(len(GESTURES), 0.1)
            p[truth if c < right else (truth + 1) % len(GESTURES)] = 0.8
            rows.append((str(s), 100 * s + c, 0, 10, GESTURES[truth], str(s), *p))
    return pd.DataFrame(rows, columns=names)


def tracked_run(store, system, predictions, failed=0, history=(), cost=1.0, **about):
    """Store a parent run with its artifacts and a child for each fold; ``about`` are tags and parameters."""
    given = {k: str(v) for k, v in about.items()}
    own = ("corpus_digest", "git", "cpu", "threads")
    params = {k: v for k, v in given.items() if k in own or ("." in k and not k.startswith("touchbench."))}
    tags = {
        "touchbench.kind": "cell",
        "touchbench.depends_on_batch": "false",
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
    tags |= {k: v for k, v in given.items() if k not in params}
    names = list(predictions["fold"].unique())
    folds = len(names) + failed
    ratio = repr(1 / (folds - 1)) if folds > 1 else ""
    tags = {"mixes_subjects": "false", "test_over_train": ratio, "official_split": ""} | tags
    run = store.create(system, tags)
    params = {"corpus_digest": "d" * 64, "git": "abc", "cpu": "one", "threads": "1", "version.python": "3"} | params
    params |= {"model": tags["model"].split("[")[0], "protocol": tags["protocol"].split("[")[0]}
    results = [Result(name, cost) for name in names]
    metrics = measure(predictions, results, 50.0) | {"folds": len(names), "folds_failed": failed}
    store.log(run, metrics, params)
    with tempfile.TemporaryDirectory() as folder:
        labelled = scores.captures(predictions)
        predictions.to_parquet(Path(folder) / "predictions.parquet", index=False)
        scores.per_subject(labelled).to_csv(Path(folder) / "per_subject.csv", index=False)
        scores.per_class(labelled, scores.classes_of(predictions)).to_csv(Path(folder) / "per_class.csv", index=False)
        store.keep(run, Path(folder))
    for name in names:
        child = store.create(name, {"mlflow.parentRunId": run, "touchbench.kind": "fold", "touchbench.fold": name})
        found = scores.accuracies(predictions[predictions["fold"] == name])
        store.log(child, found, history=[{"loss": value} for value in history])
        store.end(child, "FINISHED")
    store.end(run, "FAILED" if failed else "FINISHED")
    return run


def other_run(store, kind, system, metrics, params=(), status="FINISHED", **tags):
    """Store a run of ``bench stress`` or ``bench stream``: its tags, parameters and metrics alone."""
    about = {"touchbench.depends_on_batch": "false", "data": "haart", "synthetic": "false", "subset": "all"}
    about |= {"target": "gesture", "protocol": "loso", "protocol_label": "LOSO (10 subjects)", "seed": "0"}
    run = store.create(system, about | {"touchbench.kind": kind, "system": system} | tags)
    store.log(run, metrics, {"corpus_digest": "d"} | dict(params))
    store.end(run, status)
    return run


def stressed(store, system, accuracy, losses, more=(), **about):
    """A stress run with losses by fault."""
    metrics = {"accuracy": accuracy, "failing_slices": 3, "tested_slices": 40, "worst.subject": accuracy / 2}
    metrics |= {f"loss.{fault}": loss for fault, loss in losses.items()} | dict(more)
    return other_run(store, "stress", system, metrics, {"faults": ", ".join(losses)}, **about)


WATCHED = pd.DataFrame(  # 100 s at 50 Hz, 10 s of it touched; one touch is found, one missed, one false alarm raised
    [("recording", np.nan, 5000, None, np.nan, None, None, np.nan)]
    + [("touch", 500, 750, "pat", np.nan, None, None, np.nan), ("touch", 1000, 1250, "rub", np.nan, None, None, np.nan)]
    + [("report", np.nan, 755, None, 550, "tap", "pat", 0.8), ("report", np.nan, 2000, None, 1900, "rub", "rub", 0.6)]
    + [("probability", np.nan, np.nan, None, seen, None, None, 0.1) for seen in range(20, 5000, 100)],
    columns=["kind", "start", "end", "gesture", "reported", "first", "label", "confidence"],
).assign(recording=0, subject="1", fold="1")


def watched(store, system, end_correct, alarms, latency, flash=4000.0, **params):
    """A run of ``bench watch`` with the shares of touches of each subject that end with the correct label."""
    metrics = {"end_correct": sum(end_correct) / len(end_correct), "touches_found": 0.9, "first_correct": 0.5}
    metrics |= {"false_alarms_per_hour": alarms, "latency_s_p50": latency, "flash_bytes": flash, "ram_bytes": 900.0}
    metrics |= {"touches": 2.0, "background_minutes": 1.5}
    params = {"watch.false_alarms": "5.0", "watch.background": "", "watch.unknown": "", "cpu": "one"} | params
    facts = {"mixes_subjects": "false", "test_over_train": "", "official_split": ""}
    run = other_run(store, "watch", system, metrics, params, **facts)
    hours = {"false_alarms_per_hour": alarms, "background_s": 90.0 / len(end_correct)}
    table = pd.DataFrame({"subject": range(1, len(end_correct) + 1), "end_correct": end_correct, **hours})
    with tempfile.TemporaryDirectory() as folder:
        table.to_csv(Path(folder) / "per_subject.csv", index=False)
        WATCHED.to_parquet(Path(folder) / "predictions.parquet")
        curve = pd.DataFrame({"offset": [-1, 0], "missed": [0.5, 0.0], "false_alarms_per_hour": [0.0, 40]})
        curve.to_csv(Path(folder) / "curve.csv", index=False)
        store.keep(run, Path(folder))
    return run


def streamed(store, system, start="onset", hop="None", **metrics):
    """A stream run with its tables."""
    metrics = {"accuracy": 0.7, "adaptive_accuracy": 0.65, "adaptive_ms": 812.0, "mean_ms": 900.0} | metrics
    metrics |= {"decide_ms_p50": 1.04, "decide_ms_p95": 2.0}
    run = other_run(store, "stream", system, metrics, {"stream.start": start, "stream.hop_ms": hop})
    table = pd.DataFrame({"ms": [100.0, 900], "mean_ms": [100.0, 900], "accuracy": [0.4, 0.7], "low": 0.3, "high": 0.8})
    with tempfile.TemporaryDirectory() as folder:
        for name in ("instants", "stopping"):
            table.to_csv(Path(folder) / f"{name}.csv", index=False)
        store.keep(run, Path(folder))
    return run
