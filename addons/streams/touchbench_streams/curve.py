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
    """Counts of each threshold that all folds tried: columns ``hits``, ``alarms``, ``reports`` by offset and subject.

    Folds learn other thresholds; an offset is the distance from the learned one. Rows are of kind ``curve``.
    """
    counts = table.groupby(["offset", "subject"])[COUNTS].sum()
    people = table["subject"].nunique()
    return counts[counts.groupby("offset")["hits"].transform("size") == people]


def missed_at(counts: pd.DataFrame, touches: pd.Series, hours: pd.Series) -> dict[str, float]:
    """The lowest share of missed touches at so many false alarms per hour, of all thresholds around the learned ones.

    A threshold counts only if a touch has at most `MOST_REPORTS` reports: others find each touch by reporting always.
    The 95 % interval is that of the same number in drawings of subjects; none for too few of them (`bench.values.few`).

    Args:
        counts: result of `pool_sweeps`.
        touches: number of touches of each subject.
        hours: hours of background of each subject.
    """
    people = [*hours.index]
    if not len(counts):
        return {}
    table = counts.unstack("subject").reindex(columns=pd.MultiIndex.from_product([COUNTS, people]))
    cube = table.to_numpy(np.float64).reshape(len(table), len(COUNTS), len(people))
    sizes = np.stack([touches.reindex(people, fill_value=0), hours]).astype(np.float64)
    once = np.ones((1, len(people)), np.int64)
    drawn = draw_weights([len(people)])[0] if len(people) >= few.FEWEST_FOR_INTERVAL else once[:0]
    missed = {}
    for rate in RATES:
        least = _least_missed(cube, sizes, np.concatenate([once, drawn]), rate)
        low, high = (
            percentile_interval(least[1:][~np.isnan(least[1:])]) if len(drawn) else (np.nan, np.nan)
        )
        missed |= {
            f"missed_at_{rate}": least[0],
            f"missed_at_{rate}_low": low,
            f"missed_at_{rate}_high": high,
        }
    return missed


def _least_missed(
    cube: np.ndarray, sizes: np.ndarray, drawn: np.ndarray, rate: float
) -> np.ndarray:
    """The lowest share of missed touches in each drawing; NaN where no threshold keeps to the rate [drawings].

    ``cube`` has hits, alarms and reports [thresholds, 3, people]; ``sizes`` has touches and hours of background
    [2, people]; ``drawn`` is how often each person is in each drawing [drawings, people].
    """
    hits, alarms, reports = np.moveaxis(np.einsum("tcp,dp->dtc", cube, drawn), 2, 0)
    touches, hours = sizes @ drawn.T
    kept = (alarms <= rate * hours[:, None] + 1e-9) & (
        reports - alarms <= MOST_REPORTS * np.maximum(hits, 1)
    )
    most = np.where(kept, hits, -np.inf).max(axis=1)
    defined = np.isfinite(most) & (touches > 0) & (hours > 0)
    return np.where(defined, 1 - most / np.maximum(touches, 1), np.nan)
