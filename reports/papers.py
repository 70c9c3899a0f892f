"""Every published number beside ours under the same protocol and unit, with a verdict.

A verdict compares the printed number with the 95 % interval of ours over subjects: ``within interval``, ``above`` (ours
is, with its whole interval) or ``below``. Subjects of the paper are other draws than ours, so that within says no more
than that the two do not contradict each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from bench.reports.comparison import SAME, published
from bench.reports.contexts import listed
from bench.reports.details import macro_interval
from bench.values import few, scores
from bench.values.measures import NONE, Measure, known, text
from bench.values.result import Result, Row, seed_number
from bench.values.table import Table, rows_of

NAMES = {"cost": "CoST", "haart": "HAART", "cuddlebot": "CuddleBot", "shear": "a sheared skin"}
SHARED = ["data", "subset", "protocol", "words"]  # of published numbers that stand together
UNITS = {  # unit_key of published.csv: words, and prefix and name of the metric that is tracked for it
    "capture": ("captures", "", "pooled_accuracy"),
    "subject mean": ("captures, mean over subjects", "", "accuracy"),
    "capture vote": ("captures, majority vote", "vote_", "pooled_accuracy"),
    "window": ("windows", "window_", "pooled_accuracy"),
    "window macro precision": ("windows, macro precision", "window_", "macro_precision"),
    "window macro recall": ("windows, macro recall", "window_", "macro_recall"),
}
PAPER = (  # columns of published.csv that published.csv of the report has, too
    "id reference year data subset protocol unit unit_key features n_features classifier accuracy sd confidence system "
    "table4 table4_sd"
).split()
PRINTED = {
    "accuracy": "published",
    "sd": "published_sd",
}  # columns of the papers' file that are called otherwise here
WHOLE = ("capture", "subject mean", "capture vote")  # units of whole captures
MINE, YOURS = "yours", 5  # reference of rows without a paper, and how many of a protocol
NOTHING = dict.fromkeys(("ours", "low", "high", "ours_sd", "subjects", "difference"), np.nan) | {
    "seed": ""
}


def against(results: Sequence[Result]) -> pd.DataFrame:
    """Published numbers in percent, a row for each and each seed of ours; one without ours if there is none.

    Only complete runs of the very system count, with the parameters of the paper, on captures of people. ``note`` has
    a remark a line.
    """
    real = sorted(
        (r for r in results if r["synthetic"] != "true"), key=lambda r: seed_number(r["seed"])
    )
    here, ours = {r["data"] for r in real}, _by(real, "model_name")
    rows = []
    for paper in published().itertuples():
        runs = ours.get(tuple(getattr(paper, k) for k in SAME), [])
        measured = [
            m for run in runs if run.system == paper.system and (m := _measured(run, paper))
        ]
        others = sorted({run.system for run in runs} - {paper.system})
        as_printed = {PRINTED.get(c, c): getattr(paper, c) for c in PAPER} | NOTHING
        notes = (
            [paper.correction] if isinstance(paper.correction, str) else []
        )  # of what the paper claims
        for each in measured or [_nothing(paper, here, others)]:
            rows.append(as_printed | each | {"note": "\n".join(notes + each["note"])})
    return pd.DataFrame(rows)


def yours(results: Sequence[Result]) -> pd.DataFrame:
    """Our most accurate systems beside the best number of each published protocol and unit, whatever the systems are.

    Of a system, the lowest seed; those that a paper published stand in their own rows (`against`).
    """
    keys, rows = SAME[:-1], []
    real = sorted(
        (r for r in results if r["synthetic"] != "true"), key=lambda r: -seed_number(r["seed"])
    )
    ours = _by(real)
    numbers = published().dropna(subset="accuracy")
    for _, papers in numbers.groupby([*keys, "subset", "protocol", "unit_key"], sort=False):
        best = next(papers.nlargest(1, "accuracy").itertuples())
        here, named = ours.get(tuple(getattr(best, k) for k in keys), []), {*papers["system"]}
        lowest = {
            r.system: r for r in here if r.complete and r.system not in named
        }  # the last one stays
        values = {
            system: value
            for system, r in lowest.items()
            if not np.isnan(value := _value(r, best.unit_key)[1])
        }
        shown = {c: getattr(best, c) for c in ("data", "subset", "protocol", "unit", "unit_key")}
        for system in sorted(values, key=lambda name: -values[name])[:YOURS]:
            each = _measured(lowest[system], best)
            assert each is not None
            rows.append(
                shown
                | each
                | {"reference": MINE, "classifier": system, "note": "\n".join(each["note"])}
            )
    return pd.DataFrame(rows)


def _by(results: Sequence[Result], *more: str) -> dict[tuple, list[Result]]:
    """Results by what published numbers are on, and by more."""
    found: dict[tuple, list[Result]] = {}
    for r in results:
        found.setdefault(
            tuple(r[name] for name in (*(k.removesuffix("_key") for k in SAME[:-1]), *more)), []
        ).append(r)
    return found


def best_published(result: Result) -> tuple[str, str, float] | None:
    """The best published number on whole captures on the data of a run under its protocol, behind source and system."""
    table = published()
    alike = (table[SAME[:-1]] == [result[k.removesuffix("_key")] for k in SAME[:-1]]).all(axis=1)
    found = table[alike & table["unit_key"].isin(WHOLE)].dropna(subset="accuracy")
    if result["synthetic"] == "true" or not len(found):
        return None
    best = found.loc[found["accuracy"].idxmax()]
    return str(best["reference"]), str(best["classifier"]), float(best["accuracy"])


def verdict(published: float, low: float, high: float) -> str:
    """The position of our interval beside a published number."""
    if np.isnan(published):
        return "no number published"
    if np.isnan(low):
        return "no interval"
    if low <= published <= high:
        return "within interval"
    return "above" if low > published else "below"


def _nothing(paper: object, here: set[str], others: list[str]) -> Row:
    """The verdict on a published number that nothing stands beside, and why that is so."""
    if paper.data not in here:
        return {"verdict": "data not here", "note": []}
    if "other" in (paper.protocol_key, paper.unit_key):
        return {
            "verdict": "not run",
            "note": ["Its protocol or unit is not published, so there is no comparison."],
        }
    return {
        "verdict": "not run",
        "note": [f"Run with other parameters: {', '.join(others)}."] if others else [],
    }


def _value(run: Result, unit: str) -> tuple[str, float]:
    """Prefix of the metric of a published unit, and our number in percent; NaN if the run has no such unit."""
    _, prefix, metric = UNITS.get(unit, ("", "", ""))
    if prefix == "vote_" and not run.get("windows", 0) > 0:  # one decision a capture is its vote
        prefix = ""
    return prefix, 100 * run.get(f"{prefix}{metric}", np.nan)


def _measured(run: Result, paper: object) -> Row | None:
    """Our number in a published unit with its interval over subjects, None if the run has no such unit."""
    prefix, value = _value(run, paper.unit_key)
    if np.isnan(value):
        return None
    if not run.complete:
        why = [f"The run of seed {run['seed']} has only {run.folds.replace('/', ' of ')} folds."]
        return {"verdict": "not run", "note": why}
    low, high = _interval(run, prefix, UNITS[paper.unit_key][2])
    subjects = int(run.get("subjects", 0))
    notes = [f"{few.too_few(subjects)}."] * (subjects < few.INTERVAL)
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
        "verdict": verdict(paper.accuracy, low, high),
        "note": notes,
    }


def _interval(run: Result, prefix: str, metric: str) -> tuple[float, float]:
    """In percent; as tracked, or from the run's predictions. NaN for a single subject, or where they are gone."""
    if prefix + metric in ("accuracy", "pooled_accuracy"):
        return 100 * run.get(f"{metric}_low", np.nan), 100 * run.get(f"{metric}_high", np.nan)
    table = run.tables.get("predictions")
    if table is None:
        return np.nan, np.nan
    vote = prefix == "vote_"
    labelled = scores.windows(table) if prefix == "window_" else scores.captures(table, vote=vote)
    if metric == "pooled_accuracy":
        low, high = scores.subject_interval(labelled)
    else:
        low, high = macro_interval(labelled, scores.classes_of(table), metric)
    return 100 * low, 100 * high


def published_section(beside: pd.DataFrame) -> dict[str, object]:
    """Every published number beside ours; those on corpora that nothing is tracked on are a closed table."""
    table = beside.rename(columns={"low": "ours_low", "high": "ours_high"})
    words = [
        UNITS[key][0] if key in UNITS else unit
        for key, unit in zip(table["unit_key"], table["unit"], strict=True)
    ]
    table = table.assign(words=words, away=table["verdict"] == "data not here")
    table["place"] = table.groupby(["away", *SHARED], sort=False, dropna=False).ngroup()
    rows = rows_of(table.sort_values(["data", "place"], kind="stable"))
    elsewhere = sorted({NAMES.get(row["data"], row["data"]) for row in rows if row["away"]})
    have = "have" if len(elsewhere) > 1 else "has"
    return {
        "here": _shown([row for row in rows if not row["away"]]),
        "away": _shown([row for row in rows if row["away"]]),
        "elsewhere": f"published numbers on {listed(elsewhere)}, which {have} no runs here"
        if elsewhere
        else "",
        "counts": beside.loc[beside["ours"].notna() & (beside["reference"] != MINE), "verdict"]
        .value_counts()
        .to_dict(),
        "yours": bool((beside["reference"] == MINE).any()),
        "few": int((beside["subjects"] < few.INTERVAL).sum()),
        "haart": any(row["data"] == "haart" and not row["away"] for row in rows),
    }


def _shown(rows: Sequence[Row]) -> Table:
    remarks = [row["note"].split("\n") if row["note"] else [] for row in rows]
    return Table(COLUMNS, rows, remarks=remarks, groups=[_on(row) for row in rows])


def _on(row: Row) -> str:
    """Data, subset, protocol and unit of a published number, in words."""
    words = [
        f"{name} not published" if row[name] == "unknown" else row[name]
        for name in ("subset", "protocol")
    ]
    unit = "unit not published" if row["words"] == "unknown" else row["words"]
    return f"{NAMES.get(row['data'], row['data'])}: {'; '.join([*words, unit])}"


def _verdict(row: Row) -> str:
    lacking = row["subjects"] < few.INTERVAL  # False where ours is missing
    return few.too_few(int(row["subjects"])) if lacking else row["verdict"]


def _features(row: Row) -> str | None:
    """Features of a paper, and how many numbers they are."""
    words = known(row["features"]) or NONE
    return words if known(row["n_features"]) is None else f"{words} ({row['n_features']:.0f})"


COLUMNS = (
    text("system", read=lambda row: f"{row['reference']}: {row['classifier']}"),
    Measure("published", "published % ± SD", ("published", "published_sd"), "g", join=" ± "),
    Measure("ours", "ours % [95 %]", ends="ours"),
    text("verdict", read=_verdict),
    Measure("difference", form="+.1f"),
    Measure("subjects", form=".0f"),
    text("seed", read=lambda row: row["seed"] or None),
    text("features", read=_features),
    Measure("table4", "CNN85's Table 4", ("table4", "table4_sd"), "g", join=" ± "),
)
