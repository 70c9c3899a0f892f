"""Results as commands make them, without runs and a store; ``about`` has further tags."""

from itertools import count

import numpy as np
import pandas as pd

from bench.running.circumstances.faults import Faults
from bench.running.circumstances.subjects import Subjects
from bench.running.results import FoldResult, score_run
from bench.values.result import Result
from bench.values.stability import find_failing_slices

GESTURES = ("pat", "rub", "tap")
NAMES = ("fold", "capture", "start", "frames", "true", "subject", *(f"p_{g}" for g in GESTURES))
_started = count(1)  # later results are newer


def make_predictions(
    subjects=4, per_class=4, skill=0.7, seed=0, windows=1, gestures=GESTURES, hard=False, folds=None
):
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
    return pd.DataFrame(rows, columns=[*NAMES[:6], *(f"p_{g}" for g in gestures)])


def predictions_with_hits(hits, of=20):
    """A predictions table with ``hits`` right labels of ``of`` captures of each subject."""
    rows = []
    for s, right in enumerate(hits, 1):
        for c in range(of):
            truth = c % len(GESTURES)
            p = np.full(len(GESTURES), 0.1)
            p[truth if c < right else (truth + 1) % len(GESTURES)] = 0.8
            rows.append((str(s), 100 * s + c, 0, 10, GESTURES[truth], str(s), *p))
    return pd.DataFrame(rows, columns=NAMES)


def make_result(system="svm", kind="cell", metrics=(), tables=None, failed=0, **about):
    """A result of a kind of run with these numbers and tables."""
    number = next(_started)
    usual = {
        "touchbench.kind": kind,
        "touchbench.depends_on_batch": "false",
        **{
            "data": "synth",
            "synthetic": "true",
            "corpus_digest": "d" * 64,
            "subset": "all",
            "target": "gesture",
        },
        **{
            "protocol": "loso",
            "protocol_label": "LOSO",
            "system": system,
            "model": system.split(" · ")[0],
        },
        **{"features": "jung54", "features_name": "jung54", "seed": "0"},
        **{"mixes_subjects": "false", "test_over_train": "", "official_split": ""},
        **{"git": "abc", "cpu": "one", "threads": "1", "version.python": "3"},
        **{
            "run_id": f"run{number}",
            "started": number,
            "status": "FAILED" if failed else "FINISHED",
        },
    }
    about = usual | {k: v if k == "started" else str(v) for k, v in about.items()}
    parts = {f"{part}_name": about[part].split("[")[0] for part in ("model", "protocol")}
    counts = {"folds": 10, "folds_failed": failed}
    return Result(parts | about, counts | dict(metrics), tables or {})


def make_run(
    system="svm",
    predictions=None,
    failed=0,
    cost=1.0,
    kind="cell",
    metrics=(),
    tables=None,
    **about,
):
    """A result of ``bench run`` with these predictions."""
    predictions = make_predictions(per_class=1) if predictions is None else predictions
    sizes = {
        "fit_seconds": 3.0,
        "parameters": 1000,
        "flash_bytes": 4000,
        "ram_bytes": 500,
        "peak_rss_bytes": 2e8,
    }
    names = [*predictions["fold"].unique()]
    folds = [
        FoldResult(
            name,
            predictions[predictions["fold"] == name],
            metrics={k: cost * v for k, v in sizes.items()} | {"quiet_ms": 2.0},
            times={"predict_ms": [1.0 * cost, 2.0 * cost], "decide_ms": [0.5 * cost]},
        )
        for name in names
    ]
    numbers, usual, _ = score_run(folds, 50.0)
    tables = usual | {"predictions": predictions} | dict(tables or {})
    every = len(names) + failed
    usual = {"protocol_label": f"LOSO ({predictions['subject'].nunique()} subjects)"}
    usual |= {"test_over_train": repr(1 / (every - 1)) if every > 1 else ""}
    numbers |= {"folds": len(names), "folds_failed": failed} | dict(metrics)
    return make_result(system, kind, numbers, tables, failed, **usual | about)


def rows_of_case(table, circumstance="", case="none", level=0, amount="", **columns):
    """Labels of captures in a case, as the table ``labels`` has them."""
    return table.assign(circumstance=circumstance, case=case, level=level, amount=amount, **columns)


def analyse_labels(table, system="svm", **about):
    """A result of ``bench stress`` with this table of labels, analysed as the run does."""
    asked = {"labels": table}
    faulty, fewer = (table[table["circumstance"] == c.key] for c in (Faults, Subjects))
    circumstances = [Faults(tuple(dict.fromkeys(faulty["case"])))]
    if len(fewer):
        circumstances.append(Subjects(tuple(sorted({*fewer["train_subjects"]}))))
    clean = table[table["circumstance"] == ""]
    right = clean["true"] == clean["predicted"]
    numbers = {"accuracy": right.groupby(clean["subject"]).mean().mean()}
    tables, about = asked, dict(about)
    for one in circumstances:
        measured, made = one.measure_run(asked, [], 50.0)
        numbers, tables, about = numbers | measured, tables | made, one.params() | about
    words = {Faults.key: Faults.case_noun}
    measured, made = find_failing_slices(
        pd.concat([clean, faulty], ignore_index=True), words, about.get("target", "gesture")
    )
    return make_result(system, metrics=numbers | measured, tables=tables | made, **about)


HAART = {
    "data": "haart",
    "synthetic": "false",
    "corpus_digest": "d",
    "protocol_label": "LOSO (10 subjects)",
}


def make_stress_run(system, accuracy, losses, more=(), tables=None, **about):
    """A result of ``bench stress`` with losses by fault."""
    metrics = {
        "accuracy": accuracy,
        "failing_slices.under": 3,
        "tested_slices.under": 40,
        "worst.subject": accuracy / 2,
    }
    metrics |= {f"loss.{fault}": loss for fault, loss in losses.items()} | dict(more)
    return make_run(
        system, metrics=metrics, tables=tables, **HAART | {"faults": ", ".join(losses)} | about
    )


def make_replay_run(system, start="onset", hop="None", tables=None, metrics=(), **about):
    """A result of ``after=each``, with its tables."""
    numbers = {
        "replay_accuracy": 0.7,
        "adaptive_accuracy": 0.65,
        "adaptive_ms": 812.0,
        "mean_ms": 900.0,
    }
    numbers |= {"replay_ms_p50": 1.04, "replay_ms_p95": 2.0} | dict(metrics)
    table = pd.DataFrame(
        {
            "ms": [100.0, 900],
            "mean_ms": [100.0, 900],
            "accuracy": [0.4, 0.7],
            "low": 0.3,
            "high": 0.8,
        }
    )
    usual = {"instants": table, "stopping": table} | (tables or {})
    options = {
        "stream.start": start,
        "stream.hop_ms": hop,
        "stream.after": "each",
        "stream.stopping": True,
    }
    return make_run(system, metrics=numbers, tables=usual, **HAART | options | about)


def system_names(results):
    """Names of the systems of some results, in their order."""
    return [r["system"] for r in results]
