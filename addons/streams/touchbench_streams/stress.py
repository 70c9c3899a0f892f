"""Recordings of test subjects under faults: what a sensor that changes after training costs a watcher."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.fault_names import NO_FAULT, SEVERITIES
from bench.corpora.faults import (
    Fault,
    FAULTS,
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

FAULTED = "reports_under_faults"  # table of a run
FAULTS = "scores_under_faults"  # table of a run, a row for each case
CASE = ("fault", "severity", "amount")  # columns that name a case
SCORES = (
    "touches_found",
    "first_correct",
    "end_correct",
    "false_alarms_per_hour",
    "fragments",
    "refused",
)  # tracked


def parse_faults(names: Sequence[object]) -> tuple[str, ...]:
    """Faults of recordings by the names in ``under=``; ``all`` stands for every one of them."""
    asked = parse_fault_names("under", names, every := whole_faults())
    if lossy := [name for name in asked if name not in every]:
        raise InputError(
            f"under={lossy[0]}: it removes frames, so touches have no place any more; leave it out"
        )
    return asked


def whole_faults() -> tuple[str, ...]:
    """Names of the faults under which recordings keep all frames."""
    return tuple(name for name, one in FAULTS.items() if not one.shortens)


def apply_fault(
    recordings: Recordings, shares: Sequence[np.ndarray], fault: Fault, severity: int
) -> Corpus:
    """Recordings that went through a fault, which keeps all frames.

    A fault of the sensor is the one that captures of the same subject have. Any other is drawn for each recording, by
    its subject and its place among the recordings of this subject. ``shares`` are the frames as shares of full scale.
    """
    corpus, streams, places = recordings.corpus, [], Counter[str]()
    for subject, frames in zip(map(str, recordings.subjects), shares, strict=True):
        places[subject] += 1
        whom = (
            f"sensor of {subject}" if fault.sensor else f"recording {places[subject]} of {subject}"
        )
        changed = fault.apply_with(
            frames, severity, seeded_generator(f"{fault.name}, {whom}"), corpus.rate_hz
        )
        streams.append(as_readings(corpus, changed))
    fields = {"full_scale": corpus.full_scale, "name": corpus.name, "info": corpus.info}
    return Corpus.from_captures(streams, corpus.captures, corpus.rate_hz, **fields)


def watch_under_faults(
    watcher: TickWatcher, test: Recordings, under: Sequence[str]
) -> pd.DataFrame:
    """What a watcher reports of recordings under each fault at each severity: rows of a fold's table, with `CASE`."""
    shares = as_shares(test.corpus, np.arange(len(test)))
    subjects, parts = test.subjects.astype(str), []
    for fault in map(FAULTS.__getitem__, under):
        for severity in range(1, SEVERITIES + 1):
            corpus = apply_fault(test, shares, fault, severity)
            evidence = watcher.collect_evidence(corpus)
            frames = pd.DataFrame({"recording": np.arange(len(test)), "end": corpus.lengths})
            frames = frames.assign(refused=watcher.count_refused(corpus, evidence))
            for kind, part in (
                ("recording", frames),
                ("report", watcher.report_touches(corpus, evidence)),
            ):
                case = dict(
                    zip(CASE, (fault.name, severity, fault.describe(severity)), strict=True)
                )
                parts.append(part.assign(kind=kind, subject=subjects[part["recording"]], **case))
    return pd.concat(parts, ignore_index=True)


def fault_table(
    table: pd.DataFrame, cases: pd.DataFrame, rate_hz: float, people: bool = False
) -> pd.DataFrame:
    """Scores of touches as they are, and under each fault at each severity: `CASE`, and those of `score_tables`.

    ``table`` and ``cases``, results of `watch_under_faults` with ``fold``, are of the same folds.
    """
    truth = table[table["kind"].isin(["touch", "doubtful"])]
    rows = [dict(zip(CASE, (NO_FAULT, 0, ""), strict=True)) | score_tables(table, rate_hz, people)]
    for case, part in cases.groupby([*CASE], sort=False):
        both = pd.concat([truth, part], ignore_index=True)
        rows.append(dict(zip(CASE, case, strict=True)) | score_tables(both, rate_hz, people))
    return pd.DataFrame(rows)


def tracked_scores(table: pd.DataFrame) -> dict[str, float]:
    """The numbers of a run from `fault_table`, such as ``touches_found.noise.3``."""
    kept = [name for name in SCORES if name in table]
    return {
        f"{name}.{row['fault']}.{row['severity']}": float(row[name])
        for row in table[table["severity"] > 0].to_dict("records")
        for name in kept
        if row[name] == row[name]
    }
