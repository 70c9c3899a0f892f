"""Events that a watcher reported against touches that happened: found, missed, late, wrong, split, and false alarms.

Pure functions of two tables. Touches are `Recordings.events`: ``recording``, ``start``, ``end`` (frames, end exclusive)
and ``gesture``, sorted by recording and start, without overlaps. Reports have the columns of ``REPORT``:

- ``recording``: position of the recording, as in the touches;
- ``reported``: frames of the recording that were seen when the event was first reported;
- ``end``: frames seen when it ended, the length of the recording where the recording ended first;
- ``first``, ``label``: gesture reported at first and at the end of the event;
- ``confidence``: of the final label, 0 to 1.

Doubtful stretches (`Recordings.doubtful`) have the columns of touches. A report inside of one, or at most ``collar_s``
after it, is neither a hit nor a false alarm.

No column has missing values, except ``latency_s``, NaN for a missed touch. A table without rows keeps its columns and
their types, also in parquet files. Both tables may have more columns, such as ``subject``; they are kept.

The definitions follow the event-based scores of sound event detection (Mesaros, Heittola and Virtanen 2016, "Metrics
for polyphonic sound event detection"; sed_eval), with three differences. sed_eval wants the onset of a report within
``t_collar`` on either side of the true onset; here a report counts from the start of a touch until ``collar_s`` after
its end, and never before it starts, so that lateness is measured as latency and not counted as a miss. sed_eval
matches one report to one event and counts a second report of the same event as a false positive; here it is a
fragment, and an insertion if its label is wrong. sed_eval matches each gesture for itself, so that a wrong label is a
miss and a false positive; here the touch is found and its label incorrect.

Three words for what else may happen to a touch are those of Ward, Lukowicz and Gellersen 2011 ("Performance metrics for
activity recognition"), for events in place of segments: a touch is *fragmented* if it has several reports, *merged* if
it has none because a touch before it was not over yet, and *late* if it was over at its first report. sed_eval has no
such words: there, the first two are insertions and deletions.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import SupportsFloat

import numpy as np
import pandas as pd

from bench import scores
from bench.resampling import ratio_interval

REPORT = {"recording": np.int64, "reported": np.int64, "end": np.int64, "first": str, "label": str}
REPORT |= {"confidence": np.float64}
COLLAR_S = 0.5  # seconds after the end of a touch in which a report still belongs to it
FALSE_ALARM = -1  # the touch of a report that belongs to none
DOUBTFUL = -2  # the touch of a report that belongs to a doubtful stretch
SHARES = ("found", "first_correct", "end_correct")


def report_table(rows: Iterable[tuple[int, int, int, str, str, float]]) -> pd.DataFrame:
    """Reports from rows (recording, reported, end, first, label, confidence), in the types of ``REPORT``."""
    return pd.DataFrame(list(rows), columns=[*REPORT]).astype(REPORT)


def matched(
    truth: pd.DataFrame,
    reports: pd.DataFrame,
    rate_hz: float,
    collar_s: float = COLLAR_S,
    doubtful: pd.DataFrame | None = None,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Touches with the reports that belong to them.

    A report belongs to the touch or doubtful stretch with start <= reported < end; else to the latest one of its
    recording if it ended at most ``collar_s`` before the report; else it is a false alarm. The first and the last
    report of a touch are told by ``reported``, then by ``end``.

    Args:
        truth: touches, as described above.
        reports: reports, as described above, in any order.
        rate_hz: frames per second.
        collar_s: seconds after the end of a touch in which a report still belongs to it.
        doubtful: doubtful stretches, as described above; None for none.

    Returns:
        The touches with the columns

        - ``found`` (bool): it has a report;
        - ``late`` (bool): it is found, and was over at its first report;
        - ``merged`` (bool): it is missed, and began while a touch reported before it had not ended;
        - ``latency_s``: seconds from its start to its first report;
        - ``first_correct``, ``end_correct`` (bool): ``first`` of its first report, ``label`` of its last report is
          its gesture; False for a missed touch;
        - ``label``: ``label`` of its last report; empty for a missed touch;
        - ``fragments`` (int64): number of its reports;
        - ``insertions`` (int64): reports after the first whose ``label`` is not its gesture;

        and the reports with ``touch`` (int64): row of their touch, -1 for a false alarm, -2 in a doubtful stretch.
        Rows stay in order and are numbered from 0.
    """
    truth, reports = truth.reset_index(drop=True), reports.reset_index(drop=True)
    touch = touches_of(truth, reports, rate_hz, collar_s, doubtful)
    reports = reports.assign(touch=touch)

    of_touches = reports[touch >= 0].sort_values(["reported", "end"], kind="stable")
    wrong = of_touches["label"].to_numpy(object) != truth["gesture"].to_numpy(object)[of_touches["touch"]]
    again = of_touches.duplicated("touch").to_numpy()
    first = of_touches.drop_duplicates("touch").set_index("touch").reindex(truth.index)
    last = of_touches.drop_duplicates("touch", keep="last").set_index("touch").reindex(truth.index)
    fragments = _count(of_touches["touch"], truth)
    touches = truth.assign(
        found=fragments > 0,
        late=(first["reported"] >= truth["end"]).to_numpy(),
        merged=(fragments == 0) & _covered(truth, reports),
        latency_s=(first["reported"] - truth["start"]) / rate_hz,
        first_correct=first["first"].to_numpy(object) == truth["gesture"].to_numpy(object),
        end_correct=last["label"].to_numpy(object) == truth["gesture"].to_numpy(object),
        label=last["label"].fillna("").astype(str),
        fragments=fragments,
        insertions=_count(of_touches["touch"][again & wrong], truth),
    )
    kinds = dict.fromkeys((*SHARES, "late", "merged"), bool) | {"latency_s": np.float64}
    return touches.astype(kinds), reports


def touches_of(
    truth: pd.DataFrame,
    reports: pd.DataFrame,
    rate_hz: float,
    collar_s: float = COLLAR_S,
    doubtful: pd.DataFrame | None = None,
) -> np.ndarray:
    """Row of the touch that each report belongs to, int64 [reports]; arguments, -1 and -2 are those of `matched`.

    Touches do not overlap: if the latest one that started by the time of the report ended too early, all others did.
    """
    row = np.arange(len(truth))
    if doubtful is not None and len(doubtful):
        row = np.append(row, np.full(len(doubtful), DOUBTFUL))
        truth = pd.concat([truth[["recording", "start", "end"]], doubtful[["recording", "start", "end"]]])
        order = np.lexsort([truth["start"], truth["recording"]])
        row, truth = row[order], truth.iloc[order].reset_index(drop=True)
    collar = int(collar_s * rate_hz + 1e-6)
    recording, reported = reports["recording"].to_numpy(), reports["reported"].to_numpy()
    span = 1 + max(truth["start"].max(), reported.max()) if len(truth) and len(reports) else 1
    starts = (truth["recording"] * span + truth["start"]).to_numpy()
    latest = np.searchsorted(starts, recording * span + reported, side="right") - 1
    of_recording = np.append(truth["recording"], -1)[latest] == recording  # -1: no touch started before
    in_time = reported - np.append(truth["end"], 0)[latest] <= collar
    return np.where(of_recording & in_time, np.append(row, FALSE_ALARM)[latest], FALSE_ALARM).astype(np.int64)


def _covered(truth: pd.DataFrame, reports: pd.DataFrame) -> np.ndarray:
    """Whether a touch that was reported before each touch began had not ended then, bool [touches]."""
    covered = np.zeros(len(truth), bool)
    for recording, part in reports.groupby("recording"):
        ordered = part.sort_values("reported")
        last = np.maximum.accumulate(np.append(-1, ordered["end"].to_numpy()))  # of the reports so far
        mine = (truth["recording"] == recording).to_numpy()
        start = truth.loc[mine, "start"].to_numpy()
        covered[mine] = last[np.searchsorted(ordered["reported"].to_numpy(), start, side="right")] > start
    return covered


def _count(rows: pd.Series, truth: pd.DataFrame) -> np.ndarray:
    return np.bincount(rows.to_numpy(np.int64), minlength=len(truth)).astype(np.int64)


def summary(touches: pd.DataFrame, reports: pd.DataFrame, background_s: float) -> dict[str, float]:
    """The scores of all touches and reports together; NaN where there is nothing to divide by.

    Results of `matched` for several folds may be joined, because only the sign of ``touch`` counts.

    Args:
        touches: touches, from `matched`.
        reports: reports, from `matched`.
        background_s: seconds outside of touches and doubtful stretches in the recordings.

    Returns:
        ``touches`` (number); ``touches_found``, ``first_correct`` and ``end_correct`` (shares of all touches, a missed
        one is incorrect); ``first_correct_found`` and ``end_correct_found`` (shares of the touches found);
        ``late``, ``merged`` and ``fragmented`` (shares of all touches; the last is found and has several reports);
        ``false_alarms_per_hour`` of background; ``latency_s_p50`` and ``latency_s_p90`` (of the touches found);
        ``fragments`` (mean number of reports of a touch found); ``insertions_per_touch`` (mean over all touches).
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


def per_subject(touches: pd.DataFrame, reports: pd.DataFrame, background_s: Mapping[str, float]) -> pd.DataFrame:
    """The `summary` of each subject, sorted by ``subject``, and ``background_s``.

    Args:
        touches: touches, from `matched`, with ``subject``.
        reports: reports, from `matched`, with ``subject``.
        background_s: seconds outside of touches in the recordings of each subject, also of those without touches.

    Raises:
        ValueError: a touch or a report is of a subject without an entry in ``background_s``.
    """
    _check_subjects(touches, reports, background_s)
    rows = [
        summary(touches[touches["subject"] == s], reports[reports["subject"] == s], background_s[s])
        for s in sorted(background_s)
    ]
    table = pd.DataFrame(rows, columns=[*summary(touches, reports, 0)], dtype=np.float64)
    table.insert(0, "subject", pd.Series(sorted(background_s), dtype=str))
    return table.assign(background_s=[float(background_s[s]) for s in sorted(background_s)]).astype(
        {"touches": np.int64}
    )


def over_people(touches: pd.DataFrame, reports: pd.DataFrame, background_s: Mapping[str, float]) -> dict[str, float]:
    """Shares of touches as means over subjects with 95 % t-intervals, and the interval of false alarms.

    Args:
        touches: touches, from `matched`, with ``subject``.
        reports: reports, from `matched`, with ``subject``.
        background_s: seconds outside of touches in the recordings of each subject, also of those without touches.

    Returns:
        ``touches_found``, ``first_correct`` and ``end_correct``; these and ``false_alarms_per_hour``, each followed by
        ``_low`` and ``_high``, NaN for too few subjects (`bench.few`) with touches, or with background; ``subjects``.

    Raises:
        ValueError: a touch or a report is of a subject without an entry in ``background_s``.
    """
    _check_subjects(touches, reports, background_s)
    numbers: dict[str, float] = {"subjects": len(background_s)}
    for share in SHARES:
        name = "touches_found" if share == "found" else share
        scored = scores.over_people(touches.assign(true=True, predicted=touches[share]))
        numbers |= {name: scored["accuracy"], f"{name}_low": scored["low"], f"{name}_high": scored["high"]}
    alarms = reports.loc[reports["touch"] == FALSE_ALARM, "subject"].value_counts()
    counts = [(alarms.get(s, 0), background_s[s] / 3600) for s in sorted(background_s)]
    low, high = alarm_interval(np.array(counts, dtype=np.float64).reshape(-1, 2))
    return numbers | {"false_alarms_per_hour_low": low, "false_alarms_per_hour_high": high}


def alarm_interval(counts: np.ndarray) -> tuple[float, float]:
    """95 % interval of false alarms per hour: the wider of the bootstrap over subjects and the exact Poisson interval.

    Without any alarm there is an upper limit alone, of 95 % confidence, and no lower end. With alarms of too few
    subjects both are NaN.

    Args:
        counts: false alarms and hours of background of each subject [subjects, 2].
    """
    from scipy.special import gammaincinv  # not scipy.stats, which takes half a second

    alarms, hours = counts.sum(axis=0)
    if not hours:
        return np.nan, np.nan
    if not alarms:
        return np.nan, float(-np.log(0.05) / hours)
    drawn = ratio_interval(counts)
    exact = float(gammaincinv(alarms, 0.025) / hours), float(gammaincinv(alarms + 1, 0.975) / hours)
    return exact if drawn[1] - drawn[0] < exact[1] - exact[0] else drawn


def _check_subjects(touches: pd.DataFrame, reports: pd.DataFrame, background_s: Mapping[str, float]) -> None:
    if lacking := sorted({*touches["subject"], *reports["subject"]} - {*background_s}):
        raise ValueError(f"background_s has no entry for subject {lacking[0]}; add its seconds of background")


def last_confidence(
    truth: pd.DataFrame, reports: pd.DataFrame, rate_hz: float, doubtful: pd.DataFrame | None = None
) -> pd.Series:
    """Confidence of the last label of each touch that was found, by the row of the touch, in order of the touches.

    Args:
        truth: touches, as described above.
        reports: reports, as described above.
        rate_hz: frames per second.
        doubtful: doubtful stretches, as described above; None for none.
    """
    reports = reports.assign(touch=touches_of(truth, reports, rate_hz, doubtful=doubtful))
    ordered = reports[reports["touch"] >= 0].sort_values(["touch", "reported", "end"], kind="stable")
    return ordered.drop_duplicates("touch", keep="last").set_index("touch")["confidence"]


def unknown_scores(known_confidence: np.ndarray, unknown_confidence: np.ndarray, threshold: float) -> dict[str, float]:
    """Rejection of gestures that were not in the training set, by the confidence of the label.

    Args:
        known_confidence: confidence of the label of each touch with a gesture of the training set, finite.
        unknown_confidence: the same for touches with another gesture.
        threshold: confidence below which a label is rejected.

    Returns:
        ``auroc`` (probability that a known touch has a higher confidence than an unknown one, ties count half),
        ``rejected_unknown`` and ``rejected_known`` (shares of the touches); NaN where there are no such touches.
    """
    from sklearn.metrics import roc_auc_score

    known, unknown = pd.Series(known_confidence, dtype=float), pd.Series(unknown_confidence, dtype=float)
    is_known = np.repeat([True, False], [len(known), len(unknown)])
    both = len(known) > 0 and len(unknown) > 0
    return {
        "auroc": float(roc_auc_score(is_known, np.concatenate([known, unknown]))) if both else np.nan,
        "rejected_unknown": float((unknown < threshold).mean()),
        "rejected_known": float((known < threshold).mean()),
    }
