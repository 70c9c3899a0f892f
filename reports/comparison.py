"""The table of tracked runs, rebuilt from MLflow, the published numbers and the reference results."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files

import numpy as np
import pandas as pd

from bench.leaderboard.submissions import Submission
from bench.outcomes import statistics
from bench.comparable import Row, context_of, seed_number
from bench.outcomes.runs import rows_of, with_groups
from bench.outcomes.store import Store
from reports.numbers import bounded, number, p_value, whole, with_sd
from reports.reference_rows import BySubject, systems_by_subject

SAME = ["data", "subset_key", "target_key", "protocol_key", "system"]  # of published.csv, and without _key of a run
# Metrics' prefix: what a row labels, how its windows are combined, and the units of published numbers beside it.
SCORED = {
    "": ("capture", "mean probability", ("capture", "subject mean")),
    "vote_": ("capture", "majority vote", ("capture vote",)),
    "window_": ("window", "", ("window", "window macro precision", "window macro recall")),
}
CONTEXT = ["data", "subset", "protocol", "group"]
PERCENT = {"subject_mean": "subject_accuracy_mean", "subject_sd": "subject_accuracy_sd"}  # column: metric
PERCENT |= {name: name for name in ("accuracy", "macro_f1", "macro_precision")}
TESTED = ("difference", "p_holm")
MEASURED = ("fit_seconds", "predict_ms_p50", "predict_ms_p95", "parameters", "flash_bytes", "ram_bytes")
MEASURED += ("peak_rss_bytes", "captures", "subjects")
COLUMNS = (
    "system accuracy low high difference p_holm against unit combined seed source subject_mean subject_sd macro_f1 "
    "macro_precision fit_seconds predict_ms_p50 predict_ms_p95 decision_ms parameters flash_bytes ram_bytes "
    "peak_rss_bytes captures subjects published folds run_id group subset data protocol"
).split()


def published() -> pd.DataFrame:
    """The numbers of the papers, one row each; ``*_key`` columns are in the words that runs are tracked with."""
    with (files("reports") / "published.csv").open() as f:
        return pd.read_csv(f, dtype={"system": str}, keep_default_na=True).fillna({"system": ""})


def comparison(
    store: Store,
    runs: pd.DataFrame,
    papers: pd.DataFrame,
    beside: bool = True,
    by_group: Mapping[str, BySubject] | None = None,
) -> pd.DataFrame:
    """Table with a row per run and way to score it, best first within each data, subset, protocol and unit.

    ``unit`` is what is labelled, a capture or a window; ``combined`` is how a system on windows labels a capture.
    Accuracies, SDs and F1 are in percent. ``difference`` (points, mean over subjects) and ``p_holm`` compare the system
    with ``against``, the best of its group, as `bench.outcomes.statistics.against_best` does; a system on windows with
    its captures by mean probability. ``published`` holds numbers of the same system, data, subset, protocol and unit;
    rows from generated captures have none, whatever they are called.

    Args:
        store: store of the runs.
        runs: table of `bench.outcomes.runs.tracked`.
        papers: `published`.
        beside: True to add reference results of the same captures and protocol.
        by_group: `systems_by_subject` of each group, if already read.
    """
    rows = []
    numbers = {key: list(part.itertuples()) for key, part in papers.groupby(SAME)}
    for group, part in with_groups(runs).groupby("group", sort=False):
        subjects, _, references = by_group[str(group)] if by_group else systems_by_subject(store, part, beside)
        tests = _tests(subjects)
        for run in rows_of(part):
            for row in _rows(run, numbers):
                tested = row["combined"] != "majority vote" and row["unit"] == "capture"
                rows.append(row | (tests.get(str(row["system"]), {}) if tested else {}))
        first = _context(rows_of(part)[0])
        rows += [first | _reference(name, one) | tests.get(name, {}) for name, one in references.items()]
    table = pd.DataFrame(rows).reindex(columns=COLUMNS)
    context = [*CONTEXT, "unit"]
    best = table.groupby([*context, "system"])["accuracy"].transform("max")
    order = table.assign(best=-best, number=table["seed"].map(seed_number)).sort_values(
        [*context, "best", "system", "number"], kind="stable"
    )
    return order.drop(columns=["best", "number"]).reset_index(drop=True)


def _context(run: Row) -> dict[str, object]:
    return dict(zip(CONTEXT, (*context_of(run), run["group"]), strict=True))


def _tests(subjects: pd.DataFrame) -> dict[str, dict[str, object]]:
    """By system, its difference from the best one; empty where nothing can be compared."""
    if len(subjects) < 2 or subjects.shape[1] < 2:
        return {}
    rows = statistics.against_best(subjects.iloc[: statistics.RANKED])
    return {str(row["system"]): {k: row[k] for k in TESTED} | {"against": subjects.index[0]} for row in rows_of(rows)}


def _rows(run: Row, numbers: dict[tuple, list]) -> Iterator[dict[str, object]]:
    """The rows of a run."""
    for prefix, (unit, combined, units) in SCORED.items():
        if pd.isna(run.get(f"{prefix}accuracy", np.nan)):
            continue
        windowed = run.get("windows", 0) > 0
        ends = {"low": "accuracy_low", "high": "accuracy_high"} if not prefix else {}
        yield {
            **_context(run),
            **{name: 100 * run.get(f"{prefix}{metric}", np.nan) for name, metric in (PERCENT | ends).items()},
            **{name: run.get(name, np.nan) for name in MEASURED},
            "system": run["system"],
            "source": "store",
            "unit": unit,
            "combined": combined if windowed else "",
            "seed": run["seed"],
            "against": "",
            "decision_ms": run["decision_ms" if unit == "window" else "capture_decision_ms"],
            # One decision a capture is its vote.
            "published": _published(run, units if windowed else (*units, "capture vote"), numbers),
            "folds": f"{run['folds']:.0f}/{run['folds'] + run['folds_failed']:.0f}",
            "run_id": run["run_id"],
        }


def _reference(name: str, answer: Submission) -> dict[str, object]:
    """The row of a reference result; what only runs tell is missing."""
    texts = dict.fromkeys(("combined", "seed", "against", "published", "folds", "run_id"), "")
    sizes = {k: answer.metadata.get(k, np.nan) for k in ("parameters", "flash_bytes", "ram_bytes")}
    counts = {k: answer.table[k.removesuffix("s")].nunique() for k in ("captures", "subjects")}
    scored = {k: 100 * v for k, v in answer.scores.items()}
    return {"system": name, "source": "reference", "unit": "capture"} | texts | scored | sizes | counts


def _published(run: Row, units: Sequence[str], numbers: dict[tuple, list]) -> str:
    """Published numbers that may stand beside a row, each with its unit and id."""
    if run["synthetic"] == "true":
        return ""
    same = numbers.get(tuple(run[k.removesuffix("_key")] for k in SAME), [])
    return "; ".join(f"{r.accuracy:g} ({r.unit_key}, {r.id})" for r in same if r.unit_key in units)


def shown(table: pd.DataFrame) -> pd.DataFrame:
    """The same as text, without the group of each row."""
    rows = [*table.itertuples()]
    return pd.DataFrame(
        {
            "system": table["system"],
            "accuracy % [95 %]": [bounded(r.accuracy, r.low, r.high) for r in rows],
            "p Holm": table["p_holm"].map(p_value),
            "windows combined by": table["combined"].replace("", "-"),
            "seed": table["seed"].replace("", "-"),
            "flash kB": (table["flash_bytes"] / 1e3).map(_three),
            "RAM kB": (table["ram_bytes"] / 1e3).map(_three),
            "predict ms p50 / p95": [f"{number(r.predict_ms_p50, 2)} / {number(r.predict_ms_p95, 2)}" for r in rows],
            "decision ms": [number(r.decision_ms, 0) for r in rows],
            "fit s": [number(r.fit_seconds, 2) for r in rows],
            "macro-F1 %": table["macro_f1"].map(number),
            "subjects: mean ± SD": [with_sd(r.subject_mean, r.subject_sd) for r in rows],
            "n": table["subjects"].map(whole),
            "parameters": table["parameters"].map(whole),
            "published %": table["published"].replace("", "-"),
            "folds": table["folds"].replace("", "-"),
        }
    )


def _three(value: float) -> str:
    """With three digits that count."""
    return f"{value:.3g}" if value < 100 else whole(value)
