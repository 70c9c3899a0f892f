"""The table of tracked runs, one row per run and unit, rebuilt from MLflow and the published numbers."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pandas as pd

from bench.outcomes.comparable import context_of, seed_number
from bench.outcomes.runs import with_groups

SAME = ["data", "subset_key", "target_key", "protocol_key", "system"]  # of published.csv, and without _key of a run
UNITS = {"capture": "", "capture vote": "vote_", "window": "window_"}


def published() -> pd.DataFrame:
    """The numbers of the papers, one row each; ``*_key`` columns are in the words that runs are tracked with."""
    with (files("reports") / "published.csv").open() as f:
        return pd.read_csv(f, dtype={"system": str}, keep_default_na=True).fillna({"system": ""})


def comparison(runs: pd.DataFrame, papers: pd.DataFrame) -> pd.DataFrame:
    """One row per run and unit, best captures first within each data, subset and protocol.

    Accuracies, SDs and F1 are in percent. ``published`` holds numbers of the same system, data, subset, protocol and
    unit; rows from generated captures have none, whatever they are called.
    """
    rows = []
    numbers = {key: list(part.itertuples()) for key, part in papers.groupby(SAME)}
    for run in with_groups(runs).to_dict("records"):
        for unit, prefix in UNITS.items():
            if pd.isna(run.get(f"{prefix}accuracy", np.nan)):
                continue
            whole = unit != "window"
            data, subset, protocol = context_of(run)
            rows.append(
                {
                    "system": run["system"],
                    "data": data,
                    "subset": subset,
                    "protocol": protocol,
                    "unit": "capture, mean probability" if unit == "capture" and run.get("windows", 0) > 0 else unit,
                    "seed": run["seed"],
                    "accuracy": 100 * run[f"{prefix}accuracy"],
                    "low": 100 * run.get("accuracy_low", np.nan) if unit == "capture" else np.nan,
                    "high": 100 * run.get("accuracy_high", np.nan) if unit == "capture" else np.nan,
                    "subject_mean": 100 * run[f"{prefix}subject_accuracy_mean"],
                    "subject_sd": 100 * run.get(f"{prefix}subject_accuracy_sd", np.nan),
                    "macro_f1": 100 * run[f"{prefix}macro_f1"],
                    "macro_precision": 100 * run[f"{prefix}macro_precision"],
                    "fit_seconds": run["fit_seconds"],
                    "predict_ms_p50": run["predict_ms_p50"],
                    "predict_ms_p95": run["predict_ms_p95"],
                    "decision_ms": run["capture_decision_ms" if whole else "decision_ms"],
                    "parameters": run.get("parameters", np.nan),
                    "flash_bytes": run.get("flash_bytes", np.nan),
                    "ram_bytes": run.get("ram_bytes", np.nan),
                    "peak_rss_bytes": run.get("peak_rss_bytes", np.nan),
                    "captures": run.get("captures", np.nan),
                    "subjects": run.get("subjects", np.nan),
                    "published": _published(run, unit, numbers),
                    "folds": f"{run['folds']:.0f}/{run['folds'] + run['folds_failed']:.0f}",
                    "run_id": run["run_id"],
                    "group": run["group"],
                }
            )
    table = pd.DataFrame(rows)
    best = table.groupby(["data", "subset", "protocol", "system"])["accuracy"].transform("max")
    order = table.assign(best=-best, number=table["seed"].map(seed_number)).sort_values(
        ["data", "subset", "protocol", "best", "system", "number"], kind="stable"
    )
    return order.drop(columns=["best", "number"]).reset_index(drop=True)


def _published(run: dict, unit: str, numbers: dict[tuple, list]) -> str:
    """Published numbers that may stand beside a row, each with its unit and id."""
    if run["synthetic"] == "true":
        return ""
    units = {"capture": ["capture", "subject mean"], "capture vote": ["capture vote"]}
    if not run.get("windows", 0) > 0:  # one decision a capture: the vote over its decisions is that decision
        units["capture"].append("capture vote")
    units["window"] = ["window", "window macro precision", "window macro recall"]
    same = numbers.get(tuple(run[k.removesuffix("_key")] for k in SAME), [])
    return "; ".join(f"{r.accuracy:g} ({r.unit_key}, {r.id})" for r in same if r.unit_key in units[unit])


def shown(table: pd.DataFrame) -> pd.DataFrame:
    """The same as text, for people who know the group of each row."""
    return pd.DataFrame(
        {
            "system": table["system"],
            "accuracy % [95 %]": [_with_interval(r) for r in table.itertuples()],
            "unit": table["unit"],
            "seed": table["seed"],
            "flash kB": (table["flash_bytes"] / 1e3).map(_three),
            "RAM kB": (table["ram_bytes"] / 1e3).map(_three),
            "predict ms p50 / p95": [f"{r.predict_ms_p50:.2f} / {r.predict_ms_p95:.2f}" for r in table.itertuples()],
            "decision ms": table["decision_ms"].map("{:.0f}".format),
            "fit s": table["fit_seconds"].map("{:.2f}".format),
            "macro-F1 %": table["macro_f1"].map("{:.1f}".format),
            "subjects: mean ± SD": [_with_sd(r) for r in table.itertuples()],
            "n": table["subjects"].map(_whole),
            "parameters": table["parameters"].map(_whole),
            "published %": table["published"].replace("", "-"),
            "folds": table["folds"],
        }
    )


def _three(number: float) -> str:
    """With three digits that count."""
    return "-" if pd.isna(number) else f"{number:.3g}" if number < 100 else _whole(number)


def _whole(number: float) -> str:
    return "-" if pd.isna(number) else f"{number:,.0f}".replace(",", " ")


def _with_interval(row: object) -> str:
    return f"{row.accuracy:.1f}" + ("" if pd.isna(row.low) else f" [{row.low:.1f}, {row.high:.1f}]")


def _with_sd(row: object) -> str:
    return f"{row.subject_mean:.1f}" + ("" if pd.isna(row.subject_sd) else f" ± {row.subject_sd:.1f}")
