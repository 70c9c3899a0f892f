"""Operating points of a detector: thresholds that find more than all with as few false alarms."""

from __future__ import annotations

import numpy as np
import pandas as pd

from touchbench_streams.detectors.base import Point


def frontier(settings: pd.DataFrame) -> pd.DataFrame:
    """The rows that find more than all with as few alarms, by alarms; of equal ones the highest threshold.

    Args:
        settings: ``threshold``, ``alarms`` and ``found`` of each threshold on left-out training recordings.
    """
    rows = settings.sort_values(["alarms", "found", "threshold"], ascending=[True, False, False], kind="stable")
    before = rows["found"].cummax().shift(fill_value=-1.0)
    return rows[rows["found"] > before]


def points_of(settings: pd.DataFrame, learned: float) -> tuple[Point, ...]:
    """`touchbench_streams.detectors.base.Watches.points`: the `frontier` and the learned threshold.

    Args:
        settings: thresholds as of `frontier`, and ``hours`` of background.
        learned: one of its thresholds.
    """
    at_frontier = settings["threshold"].isin(frontier(settings)["threshold"])
    kept = settings[at_frontier | np.isclose(settings["threshold"], learned)]
    kept = kept.sort_values("threshold", ascending=False)
    kept = kept.assign(rate=kept["alarms"] / kept["hours"].replace(0, np.nan))
    return tuple(tuple(map(float, row)) for row in kept[["threshold", "rate", "found"]].to_numpy())
