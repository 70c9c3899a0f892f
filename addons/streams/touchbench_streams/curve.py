"""Missed touches at a few rates of false alarms, from one sweep of thresholds."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bench.values import few
from bench.values.intervals import draw_weights, percentile_interval
from touchbench_streams import RATES

MOST_REPORTS = 1.25  # per touch
COUNTS = ["hits", "alarms", "reports"]


def pool_sweeps(table: pd.DataFrame) -> pd.DataFrame:
    """Counts at each threshold that all folds tried, by offset and subject.

    The folds learn different thresholds; an offset is the distance from the learned one.

    Args:
        table: rows of kind ``curve``.

    Returns:
        Columns ``hits``, ``alarms`` and ``reports``.
    """
    counts = table.groupby(["offset", "subject"])[COUNTS].sum()
    subjects = table["subject"].nunique()
    return counts[counts.groupby("offset")["hits"].transform("size") == subjects]


def missed_at(counts: pd.DataFrame, touches: pd.Series, hours: pd.Series) -> dict[str, float]:
    """The lowest share of missed touches at some false-alarm rates, with 95 % intervals.

    All thresholds around the learned ones are tried. A threshold counts only if a touch has at most
    `MOST_REPORTS` reports: others find every touch by reporting all the time. The interval is a
    bootstrap over subjects; it is NaN for too few of them (`bench.values.few`).

    Args:
        counts: result of `pool_sweeps`.
        touches: number of touches of each subject.
        hours: hours of background of each subject.
    """
    subjects = [*hours.index]
    if not len(counts):
        return {}
    columns = pd.MultiIndex.from_product([COUNTS, subjects])
    table = counts.unstack("subject").reindex(columns=columns)
    cube = table.to_numpy(np.float64).reshape(len(table), len(COUNTS), len(subjects))
    sizes = np.stack([touches.reindex(subjects, fill_value=0), hours]).astype(np.float64)
    weights = np.ones((1, len(subjects)), np.int64)  # every subject once, then the drawings
    if len(subjects) >= few.FEWEST_FOR_INTERVAL:
        weights = np.concatenate([weights, draw_weights([len(subjects)])[0]])
    missed = {}
    for rate in RATES:
        shares = _lowest_missed(cube, sizes, weights, rate)
        low, high = np.nan, np.nan
        if len(weights) > 1:
            low, high = percentile_interval(shares[1:][~np.isnan(shares[1:])])
        name = f"missed_at_{rate}"
        missed |= {name: shares[0], f"{name}_low": low, f"{name}_high": high}
    return missed


def _lowest_missed(
    cube: np.ndarray, sizes: np.ndarray, weights: np.ndarray, rate: float
) -> np.ndarray:
    """The lowest share of missed touches in each drawing; NaN if no threshold keeps to the rate.

    Args:
        cube: hits, alarms and reports [thresholds, 3, subjects].
        sizes: touches and hours of background [2, subjects].
        weights: how often each drawing contains each subject [drawings, subjects].
        rate: most false alarms per hour of background.
    """
    hits, alarms, reports = np.moveaxis(np.einsum("tcp,dp->dtc", cube, weights), 2, 0)
    touches, hours = sizes @ weights.T
    keeps_rate = alarms <= rate * hours[:, None] + 1e-9
    keeps_reports = reports - alarms <= MOST_REPORTS * np.maximum(hits, 1)
    most_hits = np.where(keeps_rate & keeps_reports, hits, -np.inf).max(axis=1)
    is_defined = np.isfinite(most_hits) & (touches > 0) & (hours > 0)
    return np.where(is_defined, 1 - most_hits / np.maximum(touches, 1), np.nan)
