"""Every published number beside ours under the same protocol and unit, with a verdict.

A verdict compares the printed number with the 95 % interval of ours over subjects: ``within
interval``, ``above`` (ours is, with its whole interval) or ``below``. Subjects of the paper are
other draws than ours, so that within says no more than that the two do not contradict each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from bench.reports.comparison import load_published, setting_of_paper, setting_of_run
from bench.reports.details import macro_interval
from bench.reports.notes import join_names
from bench.reports.own_numbers import OWN_NUMBER
from bench.values import few, scores
from bench.values.measures import UNKNOWN, Measure, text_measure, value_or_none
from bench.values.result import Result, Row, seed_number
from bench.values.table import Table, rows_of_frame

NAMES = {"cost": "CoST", "haart": "HAART", "cuddlebot": "CuddleBot", "shear": "a sheared skin"}
SHARED = ["data", "subset", "protocol", "words"]  # of published numbers that stand together
UNITS = {  # unit_key of published.csv: words, and prefix and name of the tracked metric
    "capture": ("captures", "", "pooled_accuracy"),
    "subject mean": ("captures, mean over subjects", "", "accuracy"),
    "capture vote": ("captures, majority vote", "vote_", "pooled_accuracy"),
    "window": ("windows", "window_", "pooled_accuracy"),
    "window macro precision": ("windows, macro precision", "window_", "macro_precision"),
    "window macro recall": ("windows, macro recall", "window_", "macro_recall"),
}
PAPER = (  # columns of published.csv that published.csv of the report has, too
    "id reference year data subset protocol unit unit_key features n_features classifier accuracy "
    "sd confidence system table4 table4_sd"
).split()
RENAMED = {"accuracy": "published", "sd": "published_sd"}  # columns of the papers' file
WHOLE = ("capture", "subject mean", "capture vote")  # units of whole captures
OWN, OWN_SYSTEMS = "yours", 5  # reference of rows without a paper, and how many of a protocol
WITHOUT_RUN = {
    name: np.nan for name in ("ours", "low", "high", "ours_sd", "subjects", "difference")
}
WITHOUT_RUN |= {"seed": ""}


def compare_with_published(
    results: Sequence[Result], numbers: pd.DataFrame | None = None
) -> pd.DataFrame:
    """Published numbers, or ``numbers``, in percent: a row for each and each seed of ours, if any.

    Only complete runs of the same system count, with the parameters of the paper, on captures of
    people. ``note`` has a remark a line.
    """
    runs = _real_runs(results)
    corpora = {r["data"] for r in runs}
    rows = []
    for paper in (load_published() if numbers is None else numbers).itertuples():
        of_model = [
            r
            for r in runs
            if setting_of_run(r) == setting_of_paper(paper)
            and paper.system in (r["model_name"], r.full_name, r.system)
        ]
        equal = [r for r in of_model if paper.system in (r.full_name, r.system)]
        same = [_value_beside(r, paper) for r in equal]
        others = sorted({r.system for r in of_model if r not in equal})
        values = [*filter(None, same)] or [_verdict_without_run(paper, corpora, others)]
        printed = {RENAMED.get(name, name): getattr(paper, name) for name in PAPER}
        corrections = [paper.correction] if isinstance(paper.correction, str) else []
        for value in values:
            notes = {"note": "\n".join(corrections + value["note"])}
            rows.append(printed | WITHOUT_RUN | value | notes)
    return pd.DataFrame(rows)


def own_systems(results: Sequence[Result], numbers: pd.DataFrame) -> pd.DataFrame:
    """Our most accurate systems beside the best number of each published protocol and unit.

    Each has its lowest seed; systems that a paper published have their own rows
    (`compare_with_published`).
    """
    runs = _real_runs(results)
    rows = []
    keys = ["data", "subset_key", "target_key", "protocol_key", "subset", "protocol", "unit_key"]
    for _, papers in numbers.dropna(subset="accuracy").groupby(keys, sort=False):
        best = next(papers.nlargest(1, "accuracy").itertuples())
        values: dict[str, Row] = {}
        for r in runs:
            same = setting_of_run(r) == setting_of_paper(best) and r.is_complete
            known = {*papers["system"], *values}
            if same and not known & {r.system, r.full_name}:
                if value := _value_beside(r, best):
                    values[r.system] = value
        printed = {c: getattr(best, c) for c in ("data", "subset", "protocol", "unit", "unit_key")}
        for system in sorted(values, key=lambda name: -values[name]["ours"])[:OWN_SYSTEMS]:
            value = values[system]
            about = {"reference": OWN, "classifier": system, "note": "\n".join(value["note"])}
            rows.append(printed | value | about)
    return pd.DataFrame(rows)


def _real_runs(results: Sequence[Result]) -> list[Result]:
    """Runs on captures of people, the lowest seed first."""
    runs = (r for r in results if r["synthetic"] != "true")
    return sorted(runs, key=lambda r: seed_number(r["seed"]))


def best_published(result: Result, numbers: pd.DataFrame) -> tuple[str, str, float] | None:
    """Source, system and percent of the best published number in the setting of a run."""
    papers = [
        paper
        for paper in numbers.dropna(subset="accuracy").itertuples()
        if setting_of_paper(paper) == setting_of_run(result) and paper.unit_key in WHOLE
    ]
    if result["synthetic"] == "true" or not papers:
        return None
    best = max(papers, key=lambda paper: paper.accuracy)
    return str(best.reference), str(best.classifier), float(best.accuracy)


def interval_verdict(published: float, low: float, high: float) -> str:
    """The position of our interval beside a published number."""
    if np.isnan(published):
        return "no number published"
    if np.isnan(low):
        return "no interval"
    if low <= published <= high:
        return "within interval"
    return "above" if low > published else "below"


def _verdict_without_run(paper: Any, corpora: set[str], others: list[str]) -> Row:
    """The verdict on a published number without a run of ours, and the reason."""
    if paper.data not in corpora:
        return {"verdict": "data not here", "note": []}
    notes = []
    if "other" in (paper.protocol_key, paper.unit_key):
        notes.append("Its protocol or unit is not published, so there is no comparison.")
    elif others:
        notes.append(f"Run with other parameters: {', '.join(others)}.")
    return {"verdict": "not run", "note": notes}


def _value_beside(run: Result, paper: Any) -> Row | None:
    """Our number in a published unit with its interval, None if the run has no such unit."""
    _, prefix, metric = UNITS.get(paper.unit_key, ("", "", ""))
    if prefix == "vote_" and not run.get("windows", 0) > 0:  # one decision a capture is its vote
        prefix = ""
    value = 100 * run.get(f"{prefix}{metric}", np.nan)
    if np.isnan(value):
        return None
    if not run.is_complete:
        note = f"The run of seed {run['seed']} has only {run.folds.replace('/', ' of ')} folds."
        return {"verdict": "not run", "note": [note]}
    low, high = _interval_in_unit(run, prefix, metric)
    subjects = int(run.get("subjects", 0))
    notes = [f"{few.too_few_sentence(subjects)}."] * (subjects < few.FEWEST_FOR_INTERVAL)
    if run["official_split"] == "false":
        notes.append("Our split is random, not the official one.")
    return {
        "ours": value,
        "low": low,
        "high": high,
        "ours_sd": 100 * run.get(f"{prefix}subject_sd", np.nan),
        "subjects": subjects,
        "difference": value - paper.accuracy,
        "seed": run["seed"],
        "run_id": run["run_id"],
        "verdict": interval_verdict(paper.accuracy, low, high),
        "note": notes,
    }


def _interval_in_unit(run: Result, prefix: str, metric: str) -> tuple[float, float]:
    """Percent, as tracked or from the predictions; NaN for a single subject or without these."""
    if prefix + metric in ("accuracy", "pooled_accuracy"):
        return 100 * run.get(f"{metric}_low", np.nan), 100 * run.get(f"{metric}_high", np.nan)
    table = run.tables.get("predictions")
    if table is None:
        return np.nan, np.nan
    labelled = scores.label_by_prefix(table, prefix)
    if metric == "pooled_accuracy":
        low, high = scores.pooled_accuracy_interval(labelled)
    else:
        low, high = macro_interval(labelled, scores.classes_of(table), metric)
    return 100 * low, 100 * high


def published_section(beside: pd.DataFrame) -> dict[str, object]:
    """Every published number beside ours; those on corpora without runs are a closed table."""
    table = beside.rename(columns={"low": "ours_low", "high": "ours_high"})
    words = {key: unit for key, (unit, *_) in UNITS.items()}
    words_of_unit = table["unit_key"].map(words).fillna(table["unit"])
    table = table.assign(words=words_of_unit, away=table["verdict"] == "data not here")
    table["place"] = table.groupby(["away", *SHARED], sort=False, dropna=False).ngroup()
    rows = rows_of_frame(table.sort_values(["data", "place"], kind="stable"))
    here, away = ([row for row in rows if row["away"] == is_away] for is_away in (False, True))
    corpora = sorted({NAMES.get(row["data"], row["data"]) for row in away})
    verb = "have" if len(corpora) > 1 else "has"
    is_own = beside["reference"] == OWN
    return {
        "here": _published_table(here),
        "away": _published_table(away),
        "elsewhere": f"published numbers on {join_names(corpora)}, which {verb} no runs here",
        "counts": beside.loc[beside["ours"].notna() & ~is_own, "verdict"].value_counts().to_dict(),
        "yours": bool(is_own.any()),
        "printed": beside.loc[beside["confidence"] != OWN_NUMBER, "id"].nunique(),
        "own": beside.loc[beside["confidence"] == OWN_NUMBER, "id"].nunique(),
        "few": int((beside["subjects"] < few.FEWEST_FOR_INTERVAL).sum()),
        "haart": any(row["data"] == "haart" for row in here),
    }


def _published_table(rows: Sequence[Row]) -> Table:
    remarks = [row["note"].split("\n") if row["note"] else [] for row in rows]
    return Table(COLUMNS, rows, remarks=remarks, groups=[_setting_words(row) for row in rows])


def _setting_words(row: Row) -> str:
    """Data, subset, protocol and unit of a published number, in words."""
    words = [
        f"{name} not published" if row[name] == "unknown" else row[name]
        for name in ("subset", "protocol")
    ]
    unit = "unit not published" if row["words"] == "unknown" else row["words"]
    return f"{NAMES.get(row['data'], row['data'])}: {'; '.join([*words, unit])}"


def _verdict_words(row: Row) -> str:
    too_few = row["subjects"] < few.FEWEST_FOR_INTERVAL  # False where ours is missing
    return few.too_few_sentence(int(row["subjects"])) if too_few else row["verdict"]


def _feature_words(row: Row) -> str:
    """Features of a paper, and their number."""
    words = value_or_none(row["features"]) or UNKNOWN
    number = value_or_none(row["n_features"])
    return words if number is None else f"{words} ({number:.0f})"


COLUMNS = (
    text_measure("system", source=lambda row: f"{row['reference']}: {row['classifier']}"),
    Measure("published", "published % ± SD", ("published", "published_sd"), "g", join=" ± "),
    Measure("ours", "ours % [95 %]", ends="ours"),
    text_measure("verdict", source=_verdict_words),
    Measure("difference", form="+.1f"),
    Measure("subjects", form=".0f"),
    text_measure("seed", source=lambda row: row["seed"] or None),
    text_measure("features", source=_feature_words),
    Measure("table4", "CNN85's Table 4", ("table4", "table4_sd"), "g", join=" ± "),
)
