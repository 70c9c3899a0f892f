"""The comparison table and the chart of accuracy against time, rebuilt from MLflow and the published numbers."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import numpy as np
import pandas as pd

from bench.errors import InputError

EXPERIMENT = "touchbench"
UNITS = {"capture": "", "capture vote": "vote_", "window": "window_"}


def write_report(client: object, folder: Path) -> list[Path]:
    """Write ``comparison.md``, ``comparison.csv`` and ``accuracy_time.png`` / ``.svg``.

    Args:
        client: an `mlflow.MlflowClient` on the store.
        folder: where they go; it is created.

    Returns:
        The files written.

    Raises:
        InputError: the store holds no scored run, or the folder cannot be written.
    """
    from reports.figures import accuracy_time

    runs = tracked(client)
    table = comparison(runs, published())
    try:
        folder.mkdir(parents=True, exist_ok=True)
        table.to_csv(folder / "comparison.csv", index=False)
        (folder / "comparison.md").write_text(markdown(table, context(table, published())))
        pictures = accuracy_time(table, folder)
    except OSError as e:
        raise InputError(f"{folder} cannot be written ({e.strerror}); choose another out=") from e
    return [folder / "comparison.md", folder / "comparison.csv", *pictures]


def published() -> pd.DataFrame:
    """The numbers of the papers, one row each; ``*_key`` columns are in the words that runs are tracked with."""
    with (files("reports") / "published.csv").open() as f:
        return pd.read_csv(f, dtype={"system": str}, keep_default_na=True).fillna({"system": ""})


def tracked(client: object, kind: str = "cell") -> pd.DataFrame:
    """Tags, parameters and metrics of every scored parent run of a kind, the newest of equal ones.

    Raises:
        InputError: there is none.
    """
    experiment = client.get_experiment_by_name(EXPERIMENT)
    rows, token = [], None
    while experiment:
        page = client.search_runs(
            [experiment.experiment_id], f"tags.`touchbench.kind` = '{kind}'", max_results=1000, page_token=token
        )
        rows += [
            {"target": "gesture"}
            | r.data.params
            | r.data.tags
            | r.data.metrics
            | {"run_id": r.info.run_id, "status": r.info.status, "started": r.info.start_time}
            for r in page
            if "accuracy" in r.data.metrics
        ]
        if not (token := page.token):
            break
    if not rows:
        raise InputError("no scored run is tracked here; make one first, for example: bench run model=svm")
    same = ["data", "corpus_digest", "subset", "target", "protocol", "protocol_label", "system", "seed"]
    found = pd.DataFrame(rows).sort_values("started")
    return found.drop_duplicates([*same, *(c for c in found if c.startswith("stream."))], keep="last")


def comparison(runs: pd.DataFrame, papers: pd.DataFrame) -> pd.DataFrame:
    """One row per run and unit, best captures first within each data, subset and protocol.

    Accuracies, SDs and F1 are in percent. ``published`` holds numbers of the same system, data, subset, protocol and
    unit; rows from generated captures have none, whatever they are called.
    """
    rows = []
    for run in runs.to_dict("records"):
        for unit, prefix in UNITS.items():
            if pd.isna(run.get(f"{prefix}accuracy", np.nan)):
                continue
            whole = unit != "window"
            rows.append(
                {
                    "system": run["system"],
                    "data": run["data"] + (" (synthetic)" if run["synthetic"] == "true" else ""),
                    "subset": run["subset"] + (f", {run['target']}" if run["target"] != "gesture" else ""),
                    "protocol": run["protocol_label"],
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
                    "published": _published(run, unit, papers),
                    "folds": f"{run['folds']:.0f}/{run['folds'] + run['folds_failed']:.0f}",
                }
            )
    table = pd.DataFrame(rows)
    best = table.groupby(["data", "subset", "protocol", "system"])["accuracy"].transform("max")
    order = table.assign(best=-best).sort_values(
        ["data", "subset", "protocol", "best", "system", "seed"], kind="stable"
    )
    return order.drop(columns="best").reset_index(drop=True)


def _published(run: dict, unit: str, papers: pd.DataFrame) -> str:
    """Published numbers that may stand beside a row, each with its unit and id."""
    if run["synthetic"] == "true":
        return ""
    units = {"capture": ["capture", "subject mean"], "capture vote": ["capture vote"]}
    if not run.get("windows", 0) > 0:  # one decision a capture: the vote over its decisions is that decision
        units["capture"].append("capture vote")
    units["window"] = ["window", "window macro precision", "window macro recall"]
    same = papers[
        (papers["data"] == run["data"])
        & (papers["subset_key"] == run["subset"])
        & (papers["target_key"] == run["target"])
        & (papers["protocol_key"] == run["protocol"])
        & (papers["system"] == run["system"])
        & papers["unit_key"].isin(units[unit])
    ]
    return "; ".join(f"{r.accuracy:g} ({r.unit_key}, {r.id})" for r in same.itertuples())


def context(table: pd.DataFrame, papers: pd.DataFrame) -> pd.DataFrame:
    """Published numbers on the data of the table that no row stands beside."""
    shown = " ".join(table["published"])
    here = papers[papers["data"].isin(set(table["data"])) & papers["accuracy"].notna()]
    rest = here[~here["id"].map(lambda i: f", {i})" in shown).astype(bool)]
    return rest[["reference", "data", "subset", "protocol", "unit", "classifier", "accuracy", "sd", "confidence"]]


def markdown(table: pd.DataFrame, papers: pd.DataFrame) -> str:
    """Both tables as a page."""
    shown = pd.DataFrame(
        {
            "system": table["system"],
            "data": table["data"],
            "subset": table["subset"],
            "protocol": table["protocol"],
            "unit": table["unit"],
            "seed": table["seed"],
            "accuracy % [95 %]": [_with_interval(r) for r in table.itertuples()],
            "subjects: mean ± SD": [_with_sd(r) for r in table.itertuples()],
            "macro-F1 %": table["macro_f1"].map("{:.1f}".format),
            "fit s": table["fit_seconds"].map("{:.2f}".format),
            "predict ms p50 / p95": [f"{r.predict_ms_p50:.2f} / {r.predict_ms_p95:.2f}" for r in table.itertuples()],
            "decision ms": table["decision_ms"].map("{:.0f}".format),
            "parameters": table["parameters"].map(lambda n: "-" if pd.isna(n) else f"{n:,.0f}".replace(",", " ")),
            "published %": table["published"].replace("", "-"),
            "folds": table["folds"],
        }
    )
    lines = ["# Comparison", ""]
    if table["data"].str.contains("synthetic").any():
        lines += ["Rows marked (synthetic) come from generated captures and say nothing about people.", ""]
    lines += [
        "Accuracy is pooled over the tested captures (or windows), its interval a bootstrap over subjects. Fit time is",
        "the mean of a fold without feature extraction; predict is one whole capture from raw frames to label on one",
        "thread, feature extraction included; decision is the median touch that must be observed plus computing time.",
        "Published numbers stand beside a row only if data, subset, protocol and unit agree.",
        "",
        pipe(shown),
    ]
    if len(papers):
        lines += ["", "## Published on the same data", "", pipe(papers.fillna("").astype(str))]
    return "\n".join(lines) + "\n"


def _with_interval(row: object) -> str:
    return f"{row.accuracy:.1f}" + ("" if pd.isna(row.low) else f" [{row.low:.1f}, {row.high:.1f}]")


def _with_sd(row: object) -> str:
    return f"{row.subject_mean:.1f}" + ("" if pd.isna(row.subject_sd) else f" ± {row.subject_sd:.1f}")


def pipe(table: pd.DataFrame) -> str:
    """A markdown table; bars in cells would end them."""
    rows = [table.columns.tolist(), ["---"] * len(table.columns), *table.values.tolist()]
    return "\n".join("| " + " | ".join(str(c).replace("|", "\\|") for c in row) + " |" for row in rows)
