"""Early stopping of replayed captures: the label at an instant, and the end of useful waiting.

Pure functions of the replay table, which `bench.running.replay` describes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd

from bench.values.intervals import mean_and_error, within_one_standard_error
from bench.values.scores import label_windows, mean_over_subjects

THRESHOLDS = (
    *np.round(np.arange(0.05, 0.96, 0.05), 2).tolist(),
    *(0.97, 0.98, 0.99, 0.995, 0.999, np.inf),
)
NO_SAVING = "no saving found by deciding early"
CAPTURE = ["fold", "capture"]


def standing_decisions(table: pd.DataFrame, frames: int) -> pd.DataFrame:
    """The latest decision on each capture within ``frames`` frames, with its label."""
    decisions = table[table["instant"] <= frames]
    return label_windows(decisions.groupby(CAPTURE, sort=False).tail(1))


def stopping_decisions(table: pd.DataFrame, threshold: float) -> pd.DataFrame:
    """The first decision on each capture that is settled enough, else the last, with its label."""
    settled = (table["settled"] >= threshold).astype(int)
    before = settled.groupby([table[name] for name in CAPTURE], sort=False).cumsum() - settled
    return label_windows(table[before == 0].groupby(CAPTURE, sort=False).tail(1))


def learn_stopping(table: pd.DataFrame, rate_hz: float) -> tuple[float, pd.DataFrame]:
    """Find the threshold that saves most time without loss on training subjects.

    It has the smallest mean observed time whose accuracy, as a mean over subjects, is not below
    that of whole captures by more than one standard error of the difference.

    Returns:
        The threshold, and a row for each threshold tried.
    """
    at_the_end = _accuracy_by_subject(stopping_decisions(table, np.inf))
    rows = []
    for threshold in THRESHOLDS:
        decisions = stopping_decisions(table, threshold)
        losses = (at_the_end - _accuracy_by_subject(decisions)).to_numpy()
        lost, error = mean_and_error(losses)
        rows.append(
            {
                "threshold": threshold,
                "accuracy": (decisions["true"] == decisions["predicted"]).mean(),
                "lost": lost,
                "error": error,
                "allowed": within_one_standard_error(losses),
                "mean_ms": 1000 / rate_hz * decisions["frames"].mean(),
            }
        )
    series = pd.DataFrame(rows)
    fastest = series[series["allowed"]].sort_values(
        ["mean_ms", "threshold"], ascending=[True, False], kind="stable"
    )
    return float(fastest["threshold"].iloc[0]), series


def _accuracy_by_subject(labelled: pd.DataFrame) -> pd.Series:
    return (labelled["true"] == labelled["predicted"]).groupby(labelled["subject"]).mean()


def accuracy_by_instant(table: pd.DataFrame, rate_hz: float) -> pd.DataFrame:
    """Accuracy of the standing decisions at every instant (``ms``).

    ``mean_ms`` is the mean observed time: shorter captures end before.
    """
    rows = []
    for frames in np.sort(table["instant"].unique()):
        scores = _score_decisions(standing_decisions(table, frames), rate_hz)
        rows.append({"ms": 1000 / rate_hz * frames} | scores)
    return pd.DataFrame(rows)


def accuracy_by_threshold(table: pd.DataFrame, rate_hz: float) -> pd.DataFrame:
    """Accuracy and mean observed time of stopping at every threshold of `THRESHOLDS`."""
    rows = []
    for threshold in THRESHOLDS:
        scores = _score_decisions(stopping_decisions(table, threshold), rate_hz)
        rows.append({"threshold": threshold} | scores)
    return pd.DataFrame(rows)


def accuracy_when_stopping(
    table: pd.DataFrame, rules: pd.DataFrame, rate_hz: float
) -> dict[str, float]:
    """Accuracy and mean observed time where each fold stops at its learned threshold."""
    thresholds = rules.set_index(rules["fold"].astype(str))["threshold"]
    parts = []
    for fold, rows in table.groupby("fold", sort=False):
        parts.append(stopping_decisions(rows, float(thresholds[str(fold)])))
    return _score_decisions(pd.concat(parts, ignore_index=True), rate_hz)


def _score_decisions(decisions: pd.DataFrame, rate_hz: float) -> dict[str, float]:
    mean_ms = 1000 / rate_hz * decisions["frames"].mean()
    return {"mean_ms": mean_ms} | mean_over_subjects(decisions)


def labels_after(
    table: pd.DataFrame, times: Iterable[float], key: str, rate_hz: float
) -> pd.DataFrame:
    """Labels after each time in ms, in the columns of ``labels`` (`bench.values.stability`)."""
    parts = []
    for ms in times:
        rows = standing_decisions(table, _frames_after(ms, rate_hz))
        rows = rows[["fold", "capture", "subject", "true", "predicted"]]
        parts.append(rows.assign(circumstance=key, case=key, level=ms, amount=f"{ms:g} ms"))
    return pd.concat(parts, ignore_index=True)


def _frames_after(ms: float, rate_hz: float) -> int:
    return int(ms * rate_hz / 1000 + 1e-6)


def replay_fold_metrics(tables: Mapping[str, pd.DataFrame], rate_hz: float) -> dict[str, float]:
    """Accuracy of whole captures, and of stopping where a threshold was learned."""
    table = tables["replay"]
    whole = mean_over_subjects(standing_decisions(table, int(table["instant"].max())))
    metrics = {"replay_accuracy": whole["accuracy"]}
    if "rules" in tables:
        stopping = accuracy_when_stopping(table, tables["rules"], rate_hz)
        metrics["adaptive_accuracy"] = stopping["accuracy"]
        metrics["adaptive_ms"] = stopping["mean_ms"]
    return metrics


def replay_run_metrics(
    tables: Mapping[str, pd.DataFrame], times: Iterable[float], decision_ms: float, rate_hz: float
) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
    """Return numbers and curves of a replay, and of early stopping where it was learned.

    Args:
        tables: ``replay``, and ``rules`` where stopping was learned.
        times: ms of the numbers ``accuracy_at_..._ms``.
        decision_ms: 95th percentile of the time of a decision.
        rate_hz: frames per second.
    """
    table = tables["replay"]
    curves = {"instants": accuracy_by_instant(table, rate_hz)}
    end = curves["instants"].iloc[-1]
    metrics = {
        "replay_accuracy": end["accuracy"],
        "mean_ms": end["mean_ms"],
        "decisions_per_second": 1000 / decision_ms,
        "replay_accuracy_low": end["low"],
        "replay_accuracy_high": end["high"],
    }
    for ms in times:
        frames = _frames_after(ms, rate_hz)
        if table["instant"].min() <= frames <= table["instant"].max():
            decisions = mean_over_subjects(standing_decisions(table, frames))
            metrics[f"accuracy_at_{ms:g}_ms"] = decisions["accuracy"]
    if "rules" in tables:
        stopping = accuracy_when_stopping(table, tables["rules"], rate_hz)
        metrics["adaptive_ms"] = stopping["mean_ms"]
        metrics |= {f"adaptive_{name}": stopping[name] for name in ("accuracy", "low", "high")}
        curves["stopping"] = accuracy_by_threshold(table, rate_hz)
    return {name: float(value) for name, value in metrics.items() if not np.isnan(value)}, curves
