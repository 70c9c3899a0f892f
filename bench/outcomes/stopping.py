"""Early stopping of replayed captures: the label at an instant, and the end of useful waiting.

Pure functions of the replay table, which `bench.work.replay` describes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd

from bench.outcomes.scores import subject_interval, windows
from bench.paired import mean_and_error, within_one_standard_error

THRESHOLDS = (*np.round(np.arange(0.05, 0.96, 0.05), 2).tolist(), 0.97, 0.98, 0.99, 0.995, 0.999, np.inf)
NO_SAVING = "no saving found by deciding early"
SHOWN_MS = (250, 500, 1000, 2000)  # what is told of the curve


def standing(table: pd.DataFrame, frames: int) -> pd.DataFrame:
    """The latest decision of each capture within ``frames`` frames, with its label."""
    return windows(table[table["instant"] <= frames].groupby(["fold", "capture"], sort=False).tail(1))


def stopped(table: pd.DataFrame, threshold: float) -> pd.DataFrame:
    """The first decision of each capture that is settled enough, else its last, with its label."""
    keys = [table["fold"], table["capture"]]
    reached = (table["settled"] >= threshold).astype(int)
    before = reached.groupby(keys, sort=False).cumsum() - reached
    return windows(table[before == 0].groupby(["fold", "capture"], sort=False).tail(1))


def learn_stopping(table: pd.DataFrame, rate_hz: float) -> tuple[float, pd.DataFrame]:
    """The threshold that saves most time without loss on training subjects.

    Args:
        table: replay of training captures by systems that their subjects had no part in, with ``settled``.
        rate_hz: frames per second.

    Returns:
        The threshold with the smallest mean observed time whose accuracy, as a mean over subjects, is not below that of
        whole captures by more than one standard error of the difference; and what each threshold of the series gives.
    """
    at_the_end = _hits(stopped(table, np.inf))
    rows = []
    for threshold in THRESHOLDS:
        labelled = stopped(table, threshold)
        losses = (at_the_end - _hits(labelled)).to_numpy()
        lost, error = mean_and_error(losses)
        rows.append(
            {
                "threshold": threshold,
                "accuracy": (labelled["true"] == labelled["predicted"]).mean(),
                "lost": lost,
                "error": error,
                "allowed": within_one_standard_error(losses),
                "mean_ms": 1000 / rate_hz * labelled["frames"].mean(),
            }
        )
    series = pd.DataFrame(rows)
    allowed = series[series["allowed"]]
    best = allowed.sort_values(["mean_ms", "threshold"], ascending=[True, False], kind="stable").iloc[0]
    return float(best["threshold"]), series


def saves(measured: Mapping[str, float]) -> bool:
    """Return True if early decisions take less touch than whole captures, by the metrics of a ``bench stream`` run."""
    return measured["adaptive_ms"] < measured.get("mean_ms", math.inf) - 0.5  # ms, as they are printed


def _hits(labelled: pd.DataFrame) -> pd.Series:
    """Accuracy of each subject."""
    return (labelled["true"] == labelled["predicted"]).groupby(labelled["subject"]).mean()


def by_instant(table: pd.DataFrame, rate_hz: float) -> pd.DataFrame:
    """Accuracy of the standing decisions at every instant, with ``ms`` and ``mean_ms``, as shorter captures end."""
    instants = np.sort(table["instant"].unique())
    return pd.DataFrame(
        {"ms": 1000 / rate_hz * frames} | _scored(standing(table, frames), rate_hz) for frames in instants
    )


def by_threshold(table: pd.DataFrame, rate_hz: float) -> pd.DataFrame:
    """Accuracy and mean observed time of stopping at every threshold of the series."""
    return pd.DataFrame({"threshold": t} | _scored(stopped(table, t), rate_hz) for t in THRESHOLDS)


def learned_point(table: pd.DataFrame, thresholds: dict[str, float], rate_hz: float) -> dict[str, float]:
    """Accuracy and mean observed time where each fold stops at the threshold that its training part gave."""
    parts = [stopped(rows, thresholds[str(fold)]) for fold, rows in table.groupby("fold", sort=False)]
    return _scored(pd.concat(parts, ignore_index=True), rate_hz)


def _scored(labelled: pd.DataFrame, rate_hz: float) -> dict[str, float]:
    low, high = subject_interval(labelled)
    subjects = _hits(labelled)
    return {
        "mean_ms": 1000 / rate_hz * labelled["frames"].mean(),
        "accuracy": (labelled["true"] == labelled["predicted"]).mean(),
        "low": low,
        "high": high,
        "subject_mean": subjects.mean(),
        "subject_sd": subjects.std(ddof=1),
    }


def shown(table: pd.DataFrame, rate_hz: float) -> dict[int, float]:
    """Accuracy of the latest decisions after a few round times, of those with any decisions."""
    accuracy = {}
    for ms in SHOWN_MS:
        frames = int(ms * rate_hz / 1000 + 1e-6)
        if table["instant"].min() <= frames <= table["instant"].max():
            labelled = standing(table, frames)
            accuracy[ms] = float((labelled["true"] == labelled["predicted"]).mean())
    return accuracy
