"""Scores of reported events: found, missed, late, wrong or split touches, and false alarms.

Touches and doubtful stretches are tables as of `Recordings.events`. Reports have the columns of
``REPORT``:

- ``recording``: position of the recording, as in the touches;
- ``reported``: frames of the recording that were seen when the event was first reported;
- ``end``: frames seen when it ended; the length of the recording if that ended first;
- ``first``, ``label``: gesture reported at first and at the end of the event;
- ``confidence``: of the final label, 0 to 1;
- ``changes``: how often the label changed, its end included.

Further columns, such as ``subject``, are kept. A table without rows has the same columns and types.

The definitions follow the event-based scores of sound event detection (Mesaros, Heittola and
Virtanen 2016, "Metrics for polyphonic sound event detection"; sed_eval), with three differences.
In sed_eval, the onset of a report must lie within ``t_collar`` on either side of the true onset;
here a report counts from the start of a touch until the collar after its end, and never before it
starts, so that lateness is measured as latency. In sed_eval, a second report of the same event is
a false positive; here it is a fragment, and an insertion if its label is wrong. sed_eval matches
each gesture separately, so that a wrong label is a miss and a false positive; here the touch is
found and its label incorrect.

Three terms are those of Ward, Lukowicz and Gellersen 2011 ("Performance metrics for activity
recognition"), for events instead of segments: a touch is *fragmented* if it has several reports,
*merged* if it has none because an earlier reported touch had not ended, and *late* if it had ended
before its first report.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import SupportsFloat

import numpy as np
import pandas as pd

from bench.values import scores
from bench.values.intervals import ratio_interval

REPORT = {"recording": np.int64, "reported": np.int64, "end": np.int64, "first": str, "label": str}
REPORT |= {"confidence": np.float64, "changes": np.int64}
COLLAR_S = 0.5  # seconds after the end of a touch in which a report still belongs to it
FALSE_ALARM = -1  # the touch of a report that belongs to none
DOUBTFUL = -2  # the touch of a report that belongs to a doubtful stretch
SHARES = ("found", "first_correct", "end_correct")


def report_table(rows: Iterable[tuple[int, int, int, str, str, float, int]]) -> pd.DataFrame:
    """The table of reports from rows, which have the columns and types of ``REPORT``."""
    return pd.DataFrame(list(rows), columns=[*REPORT]).astype(REPORT)


def match_reports(
    truth: pd.DataFrame, reports: pd.DataFrame, rate_hz: float, doubtful: pd.DataFrame | None = None
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Match reports to touches (`assign_touches`).

    The first and the last report of a touch are determined by ``reported``, then by ``end``.

    Args:
        truth: touches.
        reports: reports, in any order.
        rate_hz: frames per second.
        doubtful: doubtful stretches; None for none.

    Returns:
        The touches with the columns

        - ``found`` (bool): it has a report;
        - ``late`` (bool): it is found, and was over at its first report;
        - ``merged`` (bool): it is missed, and began while a touch reported before it had not ended;
        - ``latency_s``: seconds from its start to its first report, NaN for a missed touch;
        - ``first_correct`` (bool): ``first`` of its first report is its gesture; False for a
          missed touch;
        - ``end_correct`` (bool): the same of ``label`` of its last report;
        - ``label``: ``label`` of its last report; empty for a missed touch;
        - ``confidence``: that of its last report, NaN for a missed touch;
        - ``changes`` (int64): label changes of all its reports;
        - ``fragments`` (int64): number of its reports;
        - ``insertions`` (int64): reports after the first whose ``label`` is not its gesture;

        and the reports. Rows stay in order and are numbered from 0.
    """
    truth, reports = truth.reset_index(drop=True), reports.reset_index(drop=True)
    touch = assign_touches(truth, reports, rate_hz, doubtful)
    reports = reports.assign(touch=touch)

    gestures = truth["gesture"].to_numpy(object)
    hits = reports[touch >= 0].sort_values(["reported", "end"], kind="stable")
    is_wrong = hits["label"].to_numpy(object) != gestures[hits["touch"]]
    is_repeated = hits.duplicated("touch").to_numpy()
    first = hits.drop_duplicates("touch").set_index("touch").reindex(truth.index)
    last = hits.drop_duplicates("touch", keep="last").set_index("touch").reindex(truth.index)
    fragments = _count_by_touch(hits["touch"], truth)
    touches = truth.assign(
        found=fragments > 0,
        late=(first["reported"] >= truth["end"]).to_numpy(),
        merged=(fragments == 0) & _began_during_report(truth, reports),
        latency_s=(first["reported"] - truth["start"]) / rate_hz,
        first_correct=first["first"].to_numpy(object) == gestures,
        end_correct=last["label"].to_numpy(object) == gestures,
        label=last["label"].fillna("").astype(str),
        confidence=last["confidence"],
        changes=hits.groupby("touch")["changes"].sum().reindex(truth.index, fill_value=0),
        fragments=fragments,
        insertions=_count_by_touch(hits["touch"][is_repeated & is_wrong], truth),
    )
    kinds = dict.fromkeys((*SHARES, "late", "merged"), bool)
    kinds |= {"latency_s": np.float64, "confidence": np.float64, "changes": np.int64}
    return touches.astype(kinds), reports


def assign_touches(
    truth: pd.DataFrame, reports: pd.DataFrame, rate_hz: float, doubtful: pd.DataFrame | None = None
) -> np.ndarray:
    """Row of the touch that each report belongs to, int64 [reports].

    It is `FALSE_ALARM` for a false alarm and `DOUBTFUL` in a doubtful stretch. A report belongs to
    the touch or stretch with start <= reported < end, otherwise to the latest one of its recording
    if that ended at most `COLLAR_S` before the report. Touches do not overlap: if the latest one
    that started by the time of the report ended too early, all others did.
    """
    row = np.arange(len(truth))
    if doubtful is not None and len(doubtful):
        row = np.append(row, np.full(len(doubtful), DOUBTFUL))
        truth = pd.concat([part[["recording", "start", "end"]] for part in (truth, doubtful)])
        order = np.lexsort([truth["start"], truth["recording"]])
        row, truth = row[order], truth.iloc[order].reset_index(drop=True)
    collar = int(COLLAR_S * rate_hz + 1e-6)
    recording, reported = reports["recording"].to_numpy(), reports["reported"].to_numpy()
    span = 1 + max(truth["start"].max(), reported.max()) if len(truth) and len(reports) else 1
    starts = (truth["recording"] * span + truth["start"]).to_numpy()
    latest = np.searchsorted(starts, recording * span + reported, side="right") - 1
    # the appended row, latest = -1, is for reports before any touch
    in_recording = np.append(truth["recording"], -1)[latest] == recording
    in_time = reported - np.append(truth["end"], 0)[latest] <= collar
    touch = np.append(row, FALSE_ALARM)[latest]
    return np.where(in_recording & in_time, touch, FALSE_ALARM).astype(np.int64)


def _began_during_report(truth: pd.DataFrame, reports: pd.DataFrame) -> np.ndarray:
    """Whether each touch began while an earlier report had not ended, bool [touches]."""
    began = np.zeros(len(truth), bool)
    for recording, part in reports.groupby("recording"):
        ordered = part.sort_values("reported")
        last_end = np.maximum.accumulate(np.append(-1, ordered["end"].to_numpy()))
        in_recording = (truth["recording"] == recording).to_numpy()
        start = truth.loc[in_recording, "start"].to_numpy()
        earlier = np.searchsorted(ordered["reported"].to_numpy(), start, side="right")
        began[in_recording] = last_end[earlier] > start
    return began


def _count_by_touch(rows: pd.Series, truth: pd.DataFrame) -> np.ndarray:
    return np.bincount(rows.to_numpy(np.int64), minlength=len(truth)).astype(np.int64)


def summarise_touches(
    touches: pd.DataFrame, reports: pd.DataFrame, background_s: float
) -> dict[str, float]:
    """Scores over all touches and reports of `match_reports`; NaN if there is nothing to divide by.

    Results of several folds may be concatenated, because only the sign of ``touch`` counts. Shares
    are of all touches, and a missed touch is incorrect. Shares in ``_found``, latencies and
    ``fragments`` are of touches found. ``fragmented`` is the share of touches with several reports.
    False alarms are per hour of ``background_s`` seconds.
    """
    found = touches[touches["found"]]
    false_alarms = int((reports["touch"] == FALSE_ALARM).sum())
    numbers: dict[str, SupportsFloat] = {
        "touches": len(touches),
        "touches_found": touches["found"].mean(),
        "first_correct": touches["first_correct"].mean(),
        "end_correct": touches["end_correct"].mean(),
        "late": touches["late"].mean(),
        "merged": touches["merged"].mean(),
        "fragmented": (touches["fragments"] > 1).mean(),
        "first_correct_found": found["first_correct"].mean(),
        "end_correct_found": found["end_correct"].mean(),
        "false_alarms_per_hour": 3600 * false_alarms / background_s if background_s > 0 else np.nan,
        "latency_s_p50": found["latency_s"].quantile(0.5),
        "latency_s_p90": found["latency_s"].quantile(0.9),
        "fragments": found["fragments"].mean(),
        "insertions_per_touch": touches["insertions"].mean(),
    }
    return {name: float(value) for name, value in numbers.items()}


def summarise_by_subject(
    touches: pd.DataFrame, reports: pd.DataFrame, background_s: Mapping[str, float]
) -> pd.DataFrame:
    """`summarise_touches` of each subject in ``background_s``, sorted; with ``background_s``."""
    rows = []
    for subject in sorted(background_s):
        seconds = float(background_s[subject])
        parts = (part[part["subject"] == subject] for part in (touches, reports))
        numbers = summarise_touches(*parts, seconds)
        rows.append({"subject": subject} | numbers | {"background_s": seconds})
    return pd.DataFrame(rows).astype({"touches": np.int64})


def mean_over_subjects(
    touches: pd.DataFrame, reports: pd.DataFrame, background_s: Mapping[str, float]
) -> dict[str, float]:
    """Shares of touches as means over subjects with 95 % intervals; interval of false alarms.

    The ends are NaN for too few subjects (`bench.values.few`) with touches or with background.
    ``background_s`` has an entry for every subject.
    """
    numbers: dict[str, float] = {"subjects": len(background_s)}
    for share in SHARES:
        name = "touches_found" if share == "found" else share
        mean = scores.mean_over_subjects(touches.assign(true=True, predicted=touches[share]))
        numbers |= {name: mean["accuracy"]}
        numbers |= {f"{name}_{end}": mean[end] for end in ("low", "high")}
    alarms = reports.loc[reports["touch"] == FALSE_ALARM, "subject"].value_counts()
    counts = [(alarms.get(s, 0), background_s[s] / 3600) for s in sorted(background_s)]
    low, high = alarm_interval(np.array(counts, dtype=np.float64).reshape(-1, 2))
    return numbers | {"false_alarms_per_hour_low": low, "false_alarms_per_hour_high": high}


def alarm_interval(counts: np.ndarray) -> tuple[float, float]:
    """95 % interval of false alarms per hour.

    It is the wider of the bootstrap over subjects and the exact Poisson interval. Without any alarm
    there is only an upper limit of 95 % confidence, and the lower end is NaN. With alarms of too
    few subjects both ends are NaN.

    Args:
        counts: false alarms and hours of background [subjects, 2].
    """
    from scipy.special import gammaincinv  # not scipy.stats, which takes half a second

    alarms, hours = counts.sum(axis=0)
    if not hours:
        return np.nan, np.nan
    if not alarms:
        return np.nan, float(-np.log(0.05) / hours)
    bootstrap = ratio_interval(counts)
    low, high = gammaincinv(alarms, 0.025) / hours, gammaincinv(alarms + 1, 0.975) / hours
    if bootstrap[1] - bootstrap[0] < high - low:
        return float(low), float(high)
    return bootstrap


def score_tables(table: pd.DataFrame, rate_hz: float, by_subject: bool = False) -> dict[str, float]:
    """All defined scores of the tables of some folds; with ``by_subject`` means over subjects."""
    touches, reports, background_s = match_tables(table, rate_hz)
    numbers = summarise_touches(touches, reports, sum(background_s.values()))
    if by_subject:
        numbers |= mean_over_subjects(touches, reports, background_s)
    if doubtful_reports := float((reports["touch"] == DOUBTFUL).sum()):
        numbers["doubtful_reports"] = doubtful_reports
    frames = table.loc[table["kind"] == "recording", ["refused", "end"]].sum()
    return drop_undefined(numbers | {"refused": frames["refused"] / frames["end"]})


def match_tables(
    table: pd.DataFrame, rate_hz: float
) -> tuple[pd.DataFrame, pd.DataFrame, dict[str, float]]:
    """Matched touches and reports of some folds, and seconds of background of each subject."""
    background_s: dict[str, float] = {}
    touches, reports = [], []
    for _, part in table.groupby("fold", sort=False):
        truth, doubtful, reported = split_fold_table(part)
        fold_touches, fold_reports = match_reports(truth, reported, rate_hz, doubtful)
        touches.append(fold_touches)
        reports.append(fold_reports)
        labelled = pd.concat([truth, doubtful])
        labelled_frames = (labelled["end"] - labelled["start"]).groupby(labelled["subject"]).sum()
        recorded = part[part["kind"] == "recording"].groupby("subject")["end"].sum()
        for subject, frames in recorded.items():
            quiet_frames = frames - labelled_frames.get(subject, 0)
            background_s[str(subject)] = (
                background_s.get(str(subject), 0.0) + quiet_frames / rate_hz
            )
    return (
        pd.concat(touches, ignore_index=True),
        pd.concat(reports, ignore_index=True),
        background_s,
    )


def split_fold_table(part: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """Touches, doubtful stretches and reports in the table of a fold."""
    kinds = {"recording": np.int64, "start": np.int64, "end": np.int64}
    truth, doubtful = (
        part.loc[part["kind"] == kind, [*kinds, "gesture", "subject", "fold"]]
        .astype(kinds)
        .reset_index(drop=True)
        for kind in ("touch", "doubtful")
    )
    reported = part.loc[part["kind"] == "report", [*REPORT, "subject", "fold"]].astype(REPORT)
    return truth, doubtful, reported


def drop_undefined(numbers: dict[str, float]) -> dict[str, float]:
    """The numbers that are not NaN."""
    return {name: float(value) for name, value in numbers.items() if value == value}
