"""Recordings of test subjects under faults of a sensor that changed after training."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.fault_names import NO_FAULT, SEVERITIES
from bench.corpora.faults import (
    FAULTS,
    Fault,
    as_readings,
    as_shares,
    parse_fault_names,
    seeded_generator,
)
from bench.errors import InputError
from touchbench_streams.events import score_tables
from touchbench_streams.recordings import Recordings

if TYPE_CHECKING:
    from touchbench_streams.detectors.ticks import TickWatcher

FAULT_REPORTS = "reports_under_faults"  # table of a run
FAULT_SCORES = "scores_under_faults"  # table of a run, a row for each case
CASE = ("fault", "severity", "amount")  # columns that name a case
SCORES = (  # tracked
    "touches_found",
    "first_correct",
    "end_correct",
    "false_alarms_per_hour",
    "fragments",
    "refused",
)


def parse_faults(names: Sequence[object]) -> tuple[str, ...]:
    """Faults of recordings from the names in ``under=``; ``all`` stands for every one of them."""
    allowed = faults_of_recordings()
    faults = parse_fault_names("under", names, allowed)
    if shortening := [name for name in faults if name not in allowed]:
        raise InputError(
            f"under={shortening[0]}: it removes an end, where touches may lie; leave it out"
        )
    return faults


def faults_of_recordings() -> tuple[str, ...]:
    """Names of the faults that recordings can have: all that keep both ends."""
    return tuple(name for name, fault in FAULTS.items() if not fault.shortens)


def apply_fault(
    recordings: Recordings, shares: Sequence[np.ndarray], fault: Fault, severity: int
) -> tuple[Corpus, list[np.ndarray]]:
    """Recordings with a fault; ``shares`` are these as shares of full scale.

    A fault of the sensor is the one that captures of the same subject have. Any other is drawn for
    each recording, by its subject and its position among the recordings of this subject.

    Returns:
        The recordings, and the position that each of their frames had before, int64 [frames] each.
    """
    corpus, streams, places, counts = recordings.corpus, [], [], Counter[str]()
    for subject, frames in zip(map(str, recordings.subjects), shares, strict=True):
        counts[subject] += 1
        source = f"recording {counts[subject]} of {subject}"
        if fault.sensor:
            source = f"sensor of {subject}"
        place = np.arange(len(frames))
        if fault.moves:  # what it does to frames that hold their position
            shares_of_length = (place / len(place)).astype(np.float32)[:, None, None]
            moved = _damage(fault, severity, source, shares_of_length, corpus.rate_hz)
            place = np.rint(len(place) * moved.ravel().astype(np.float64)).astype(np.int64)
        streams.append(
            as_readings(corpus, _damage(fault, severity, source, frames, corpus.rate_hz))
        )
        places.append(place)
    fields = {"full_scale": corpus.full_scale, "name": corpus.name, "info": corpus.info}
    return Corpus.from_captures(streams, corpus.captures, corpus.rate_hz, **fields), places


def _damage(
    fault: Fault, severity: int, source: str, frames: np.ndarray, rate_hz: float
) -> np.ndarray:
    rng = seeded_generator(f"{fault.name}, {source}")
    return fault.apply_with(frames, severity, rng, rate_hz)


def watch_under_faults(
    watcher: TickWatcher, test: Recordings, under: Sequence[str]
) -> pd.DataFrame:
    """Rows of a fold's table under each fault at each severity: recordings, reports, and `CASE`."""
    shares = as_shares(test.corpus, np.arange(len(test)))
    subjects, parts = test.subjects.astype(str), []
    for fault in (FAULTS[name] for name in under):
        for severity in range(1, SEVERITIES + 1):
            case = dict(zip(CASE, (fault.name, severity, fault.describe(severity)), strict=True))
            corpus, places = apply_fault(test, shares, fault, severity)
            sensed = watcher.sense(corpus)
            frames = pd.DataFrame({"recording": np.arange(len(test)), "end": test.corpus.lengths})
            refused = watcher.count_refused(sensed) * frames["end"] / corpus.lengths
            frames = frames.assign(refused=refused.round().astype(np.int64))
            reports = _times_before(watcher.name_touches(sensed), places)
            for kind, part in (("recording", frames), ("report", reports)):
                parts.append(part.assign(kind=kind, subject=subjects[part["recording"]], **case))
    return pd.concat(parts, ignore_index=True)


def _times_before(reports: pd.DataFrame, places: Sequence[np.ndarray]) -> pd.DataFrame:
    """Reports with the times that their frames had before a fault moved them."""
    times = {}
    for name in ("reported", "end"):
        pairs = zip(reports["recording"], reports[name], strict=True)
        times[name] = np.array([places[i][time - 1] + 1 for i, time in pairs], dtype=np.int64)
    return reports.assign(**times)


def fault_table(
    table: pd.DataFrame, cases: pd.DataFrame, rate_hz: float, by_subject: bool = False
) -> pd.DataFrame:
    """Scores without a fault, and under each fault at each severity.

    Args:
        table: the table of some folds.
        cases: results of `watch_under_faults` for the same folds, with ``fold``.
        rate_hz: frames per second.
        by_subject: as for `score_tables`.

    Returns:
        A row per case with `CASE` and the scores of `score_tables`.
    """
    truth = table[table["kind"].isin(["touch", "doubtful"])]
    no_fault = dict(zip(CASE, (NO_FAULT, 0, ""), strict=True))
    rows = [no_fault | score_tables(table, rate_hz, by_subject)]
    for values, part in cases.groupby([*CASE], sort=False):
        case = dict(zip(CASE, values, strict=True))
        with_truth = pd.concat([truth, part], ignore_index=True)
        rows.append(case | score_tables(with_truth, rate_hz, by_subject))
    return pd.DataFrame(rows)


def tracked_scores(table: pd.DataFrame) -> dict[str, float]:
    """The tracked numbers of a `fault_table`, such as ``touches_found.noise.3``."""
    names = [name for name in SCORES if name in table]
    return {
        f"{name}.{row['fault']}.{row['severity']}": float(row[name])
        for row in table[table["severity"] > 0].to_dict("records")
        for name in names
        if row[name] == row[name]
    }
