"""What a stream promises: touches found, labels, times and false alarms, of people left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.plan.grid import make_cells
from touchbench_builder.bounds import SPREAD, gesture_spread, new_person_bounds
from touchbench_builder.rates import UpperBounds, new_person_rate_bounds, new_person_time_bounds
from touchbench_streams import NO_TOUCH
from touchbench_streams.composer import QUIET, check_background, split_touch_and_background
from touchbench_streams.detectors.base import UNKNOWN
from touchbench_streams.events import FALSE_ALARM, match_reports, match_tables, report_table
from touchbench_streams.fold import default_background, make_recordings
from touchbench_streams.recordings import comes_from_recordings
from touchbench_streams.study import Continuous

if TYPE_CHECKING:
    from bench.values.result import Result
    from touchbench_streams.recordings import Recordings

SHARES = {"found": "found", "first": "first_correct", "last": "end_correct"}  # of touches
CONFIDENCES = (0.5, 0.7, 0.9)
MISSED = "missed"  # column of the confusions
ENDED = 3  # TOUCH_ENDED
COMPARED_S = 600.0  # most seconds of a recording in which the C is compared with Python
FEWEST_PEOPLE = 3  # a person is left out twice, of training and of the choice of a threshold


@dataclass(frozen=True)
class WatchedPeople:
    """Touches of people, and reports, as of `touchbench_streams.events.match_reports`.

    Attributes:
        touches: a row per touch, with ``subject``.
        reports: a row per report, with ``subject``.
        background_s: seconds without touch of each person.
    """

    touches: pd.DataFrame
    reports: pd.DataFrame
    background_s: Mapping[str, float]

    def count_right(self, share: str, gesture: str = "") -> pd.DataFrame:
        """Touches of which a share of `SHARES` is true, and all, by person: right, total."""
        touches = self.touches
        if gesture:
            touches = touches[touches["gesture"] == gesture]
        return touches.groupby("subject")[SHARES[share]].agg(right="sum", total="size")

    def count_alarms(self) -> pd.DataFrame:
        """False alarms, and hours without touch, by person: alarms, hours."""
        alarms = self.reports["subject"][self.reports["touch"] == FALSE_ALARM].value_counts()
        hours = pd.Series(self.background_s, dtype=float) / 3600
        table = pd.DataFrame({"alarms": alarms.reindex(hours.index, fill_value=0), "hours": hours})
        return table[table["hours"] > 0]


def open_stream_captures(on: Mapping[str, Any], corpus: Corpus) -> Corpus:
    """Captures to make recordings of: parts of recordings if there are some, else the corpus."""
    keys = {key: value for key, value in on.items() if key != "jobs"}
    (cell,) = make_cells({**keys, "model": "tree", "features": "jung28"})  # any system
    opened = Continuous().open_captures(cell)
    return corpus if opened is None else opened


def why_no_stream(captures: Corpus) -> str:
    """Reason why captures cannot teach a detector of touches; "" if they can."""
    if len(set(captures.subjects)) < FEWEST_PEOPLE:
        return f"a stream needs {FEWEST_PEOPLE} subjects or more"
    try:
        if not comes_from_recordings(captures):
            background = default_background(captures)
            check_background(*split_touch_and_background(captures, background))
    except InputError as e:
        if "background" not in str(e):  # such as too little memory
            return str(e)
        problem = str(e).partition("; ")[0].removeprefix(f"background={QUIET}: ")
        return f"{problem}; bench build needs captures called {NO_TOUCH} of each subject"
    return ""


def recordings_of_people(on: Mapping[str, Any], corpus: Corpus) -> Recordings:
    """Recordings of people: theirs, or composed of their captures."""
    captures = open_stream_captures(on, corpus)
    return make_recordings(captures, default_background(captures))


def first_recording(on: Mapping[str, Any], corpus: Corpus) -> Corpus:
    """The first minutes of the first recording of `recordings_of_people`."""
    first = recordings_of_people(on, corpus).corpus[[0]]
    lengths = np.minimum(first.lengths, round(COMPARED_S * first.rate_hz))
    return first.with_fields(lengths=lengths, digest="", path=None)


def count_other_reports(reports: pd.DataFrame, others: pd.DataFrame) -> int:
    """Reports that have another time or last label in another table, or are not there."""
    same = reports.merge(others, on=["recording", "reported", "label"])
    return max(len(reports), len(others)) - len(same)


def reports_of_news(
    news: Sequence[np.ndarray], recordings: Corpus, classes: list[str]
) -> pd.DataFrame:
    """Reports as of `touchbench_streams.events` from the news of the C, by recording."""
    names = np.array([*classes, UNKNOWN], dtype=object)  # TOUCH_UNKNOWN is -1
    rows = []
    for recording, (part, length) in enumerate(zip(news, recordings.lengths, strict=True)):
        of_event = np.cumsum(np.append(0, part["news"] == ENDED))[:-1]
        for number in range(of_event.max(initial=-1) + 1):
            event = part[of_event == number]
            last = event[-1]
            end = int(last["end"]) if last["news"] == ENDED else int(length)
            labels = names[event["label"]]
            changes = int((labels[1:] != labels[:-1]).sum())
            rows.append(
                (
                    recording,
                    int(last["reported"]),
                    end,
                    labels[0],
                    labels[-1],
                    float(last["confidence"]),
                    changes,
                )
            )
    return report_table(rows)


def select_people(results: Sequence[Result], systems: Mapping[str, str]) -> pd.DataFrame:
    """Rows of each person, as stored, of the system that the other people choose.

    Args:
        results: runs of ``bench watch``.
        systems: the system of each person.
    """
    tables = {r.system: r.tables["predictions"] for r in results}
    parts = []
    for person, system in systems.items():
        is_own = tables[system]["subject"].astype(str) == person
        parts.append(tables[system][is_own])
    return pd.concat(parts, ignore_index=True)


def people_of_rows(rows: pd.DataFrame, rate_hz: float, delay: int) -> WatchedPeople:
    """Touches and reports of `select_people`; reports come some frames later than stored."""
    late = delay * (rows["kind"] == "report")
    rows = rows.assign(reported=rows["reported"] + late, end=rows["end"] + late)
    return WatchedPeople(*match_tables(rows, rate_hz))


def people_of_reports(recordings: Recordings, reports: pd.DataFrame) -> WatchedPeople:
    """Touches and reports of the people of some recordings."""
    rate_hz, subjects = recordings.corpus.rate_hz, recordings.subjects.astype(str)
    touches, reports = match_reports(recordings.events, reports, rate_hz, recordings.doubtful)
    background = pd.Series(recordings.background_frames() / rate_hz).groupby(subjects).sum()
    touches, reports = (
        part.assign(subject=subjects[part["recording"]]) for part in (touches, reports)
    )
    return WatchedPeople(touches, reports, background.to_dict())


def describe_stream(watched: WatchedPeople, composed: bool) -> dict[str, Any]:
    """What a new person may expect of a stream: the content of the certificate."""
    touches, alarms = watched.touches, watched.count_alarms()
    gestures = sorted(set(touches["gesture"].astype(str)))
    facts: dict[str, Any] = {"composed": composed, "touches": len(touches)}
    facts["background_minutes"] = round(60 * float(alarms["hours"].sum()), 1)
    facts |= {share: bounds_of_counts(watched.count_right(share), SPREAD) for share in SHARES}
    facts["gestures"] = {gesture: {} for gesture in gestures}
    for share in SHARES:
        counts = {gesture: watched.count_right(share, gesture) for gesture in gestures}
        for gesture, bounds in bounds_of_gestures(counts).items():
            facts["gestures"][gesture][share] = bounds
    facts |= _describe_times(touches)
    facts["changes"] = _rounded(
        new_person_rate_bounds(*_sums_by_person(touches[touches["found"]], "changes"))
    )
    facts["alarms"] = _describe_alarms(alarms)
    facts["unknown"] = round(float((touches["label"] == UNKNOWN).mean()), 4)
    label = touches["label"].where(touches["found"], MISSED)
    table = pd.crosstab(touches["gesture"].astype(str), label)
    facts["confusions"] = {str(name): row.to_dict() for name, row in table.iterrows()}
    facts["confidence"] = [_describe_confidence(watched, least) for least in CONFIDENCES]
    return facts


def bounds_of_counts(counts: pd.DataFrame, spread: float) -> dict[str, Any]:
    """Bounds of a share for a new person, and the counts of each person."""
    right, total = counts["right"].to_numpy(), counts["total"].to_numpy()
    bounds = asdict(new_person_bounds(right, total, spread))
    rounded = {name: value if value is None else round(value, 4) for name, value in bounds.items()}
    people = {str(p): [int(row["right"]), int(row["total"])] for p, row in counts.iterrows()}
    return rounded | {"people": people}


def bounds_of_gestures(counts: Mapping[str, pd.DataFrame]) -> dict[str, Any]:
    """`bounds_of_counts` of each gesture, with the spread of people that they have together."""
    arrays = ((part["right"].to_numpy(), part["total"].to_numpy()) for part in counts.values())
    spread = gesture_spread(arrays)
    return {gesture: bounds_of_counts(part, spread) for gesture, part in counts.items()}


def _describe_times(touches: pd.DataFrame) -> dict[str, Any]:
    """Seconds from the start of a touch to its first label: median and 90 % of each person."""
    times = touches[touches["found"]].groupby("subject")["latency_s"]
    quantiles = {"latency_s": times.quantile(0.5), "latency_90_s": times.quantile(0.9)}
    return {
        name: _rounded(new_person_time_bounds(values.to_numpy()))
        for name, values in quantiles.items()
        if len(values)
    }


def _describe_alarms(alarms: pd.DataFrame) -> dict[str, Any] | None:
    """False alarms an hour; None without background."""
    if not len(alarms):
        return None
    people = {str(p): [int(a), round(float(h), 6)] for p, a, h in alarms.itertuples()}
    bounds = new_person_rate_bounds(alarms["alarms"].to_numpy(), alarms["hours"].to_numpy())
    return _rounded(bounds) | {"count": int(alarms["alarms"].sum()), "people": people}


def _describe_confidence(watched: WatchedPeople, least: float) -> dict[str, Any]:
    """How many touches have a label of some confidence at least, how often it is right, alarms."""
    sure = watched.touches[watched.touches["confidence"] >= least]
    is_alarm = watched.reports["touch"] == FALSE_ALARM
    alarms = int((is_alarm & (watched.reports["confidence"] >= least)).sum())
    right = round(float(sure["end_correct"].mean()), 4) if len(sure) else None
    share = round(len(sure) / len(watched.touches), 4)
    return {"at_least": least, "touches": share, "right": right, "alarms": alarms}


def _sums_by_person(touches: pd.DataFrame, column: str) -> tuple[np.ndarray, np.ndarray]:
    """Sum of a column, and number of touches, of each person."""
    table = touches.groupby("subject")[column].agg(["sum", "size"])
    return table["sum"].to_numpy(), table["size"].to_numpy()


def _rounded(bounds: UpperBounds) -> dict[str, float | None]:
    return {n: value if value is None else round(value, 3) for n, value in asdict(bounds).items()}
