"""Touches and reports of the folds of a run, matched and scored."""

from __future__ import annotations

import numpy as np
import pandas as pd

from touchbench_streams.events import DOUBTFUL, REPORT, matched, over_people, summary


def numbers_of(table: pd.DataFrame, rate_hz: float, people: bool = False) -> dict[str, float]:
    """All scores of touches and reports that are defined.

    Args:
        table: tables of some folds.
        rate_hz: frames per second.
        people: True for means over subjects with intervals, and False for one fold.
    """
    touches, reports, background_s = scored(table, rate_hz)
    numbers = summary(touches, reports, sum(background_s.values()))
    if people:
        numbers |= over_people(touches, reports, background_s)
    frames = table.loc[table["kind"] == "recording", ["refused", "end"]].sum()
    return defined(numbers | doubtful_count(reports) | {"refused": frames["refused"] / frames["end"]})


def doubtful_count(reports: pd.DataFrame) -> dict[str, float]:
    """The number of reports in doubtful stretches, if there are any."""
    count = float((reports["touch"] == DOUBTFUL).sum())
    return {"doubtful_reports": count} if count else {}


def scored(table: pd.DataFrame, rate_hz: float) -> tuple[pd.DataFrame, pd.DataFrame, dict[str, float]]:
    """Touches and reports of all folds, matched, and seconds of background of each subject.

    Args:
        table: tables of the folds of a run.
        rate_hz: frames per second.
    """
    background: dict[str, float] = {}
    touches, reports = [], []
    for _, part in table.groupby("fold", sort=False):
        truth, doubtful, reported = touches_and_reports(part)
        matches = matched(truth, reported, rate_hz, doubtful=doubtful)
        touches.append(matches[0])
        reports.append(matches[1])
        labelled = pd.concat([truth, doubtful])
        touched = (labelled["end"] - labelled["start"]).groupby(labelled["subject"]).sum()
        for subject, frames in part[part["kind"] == "recording"].groupby("subject")["end"].sum().items():
            background[str(subject)] = background.get(str(subject), 0.0) + (frames - touched.get(subject, 0)) / rate_hz
    return pd.concat(touches, ignore_index=True), pd.concat(reports, ignore_index=True), background


def touches_and_reports(part: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """The touches, the doubtful stretches and the reports in the table of a fold."""
    kinds = {"recording": np.int64, "start": np.int64, "end": np.int64}
    truth, doubtful = (
        part.loc[part["kind"] == kind, [*kinds, "gesture", "subject", "fold"]].astype(kinds).reset_index(drop=True)
        for kind in ("touch", "doubtful")
    )
    reported = part.loc[part["kind"] == "report", [*REPORT, "subject", "fold"]].astype(REPORT)
    return truth, doubtful, reported


def defined(numbers: dict[str, float]) -> dict[str, float]:
    """The numbers that are defined."""
    return {name: float(value) for name, value in numbers.items() if value == value}
