"""Recordings of test subjects under faults: what a sensor that changes after training costs a watcher."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.faults import Fault, all_faults, as_readings, as_shares, asked_faults, seeded
from bench.errors import InputError
from bench.words import CLEAN, SEVERITIES
from bench.work.results import table_of, tables_of
from touchbench_streams.recordings import Recordings
from touchbench_streams.scored import numbers_of

if TYPE_CHECKING:
    from bench.work.results import FoldResult
    from touchbench_streams.detectors.base import Watches

FAULTED = "reports_under_faults"  # table of a run
FAULTS = "scores_under_faults"  # table of a run, a row for each case
CASE = ("fault", "severity", "amount")  # columns that name a case
SCORES = ("touches_found", "first_correct", "end_correct", "false_alarms_per_hour", "fragments", "refused")  # tracked


def faults_of(key: str, names: Sequence[object]) -> tuple[str, ...]:
    """Faults of recordings by their typed names; ``all`` stands for every one of them.

    Raises:
        InputError: there is no such fault, or frames are lost under it.
    """
    asked = asked_faults(key, names, every := whole_faults())
    if lossy := [name for name in asked if name not in every]:
        raise InputError(f"{key}={lossy[0]}: it removes frames, so touches have no place any more; leave it out")
    return asked


def whole_faults() -> tuple[str, ...]:
    """Names of the faults under which recordings keep all frames."""
    return tuple(name for name, one in all_faults().items() if not one.shortens)


def disturbed(recordings: Recordings, shares: Sequence[np.ndarray], fault: Fault, severity: int) -> Recordings:
    """Recordings that went through a fault.

    A fault of the sensor is the one that captures of the same subject have. Any other is drawn for each recording, by
    its subject and its place among the recordings of this subject.

    Args:
        recordings: recordings of any subjects.
        shares: their frames as shares of full scale, from `bench.corpora.faults.as_shares`.
        fault: fault that keeps all frames.
        severity: 1 to 5.
    """
    corpus, streams, places = recordings.corpus, [], Counter[str]()
    for subject, frames in zip(map(str, recordings.subjects), shares, strict=True):
        places[subject] += 1
        whom = f"sensor of {subject}" if fault.sensor else f"recording {places[subject]} of {subject}"
        changed = fault.drawn(frames, severity, seeded(f"{fault.name}, {whom}"), corpus.rate_hz)
        streams.append(as_readings(corpus, changed))
    fields = {"full_scale": corpus.full_scale, "name": corpus.name, "info": corpus.info}
    return replace(recordings, corpus=Corpus.from_captures(streams, corpus.captures, corpus.rate_hz, **fields))


def faulted(watcher: Watches, test: Recordings, under: Sequence[str]) -> pd.DataFrame:
    """What a watcher reports of recordings under each fault at each severity.

    Args:
        watcher: a watcher that was learned on recordings as they are.
        test: recordings of the test subjects.
        under: names of faults.

    Returns:
        Rows of the kinds ``recording`` and ``report``, as of `touchbench_streams.watch.fold_of`, with `CASE`.
    """
    shares = as_shares(test.corpus, np.arange(len(test)))
    subjects, parts = test.subjects.astype(str), []
    for fault in map(all_faults().__getitem__, under):
        for severity in range(1, SEVERITIES + 1):
            corpus = disturbed(test, shares, fault, severity).corpus
            evidence = watcher.evidence(corpus)
            frames = pd.DataFrame({"recording": np.arange(len(test)), "end": corpus.lengths})
            frames = frames.assign(refused=watcher.refused(corpus, evidence))
            for kind, part in (("recording", frames), ("report", watcher.reports(corpus, evidence))):
                case = dict(zip(CASE, (fault.name, severity, fault.describe(severity)), strict=True))
                parts.append(part.assign(kind=kind, subject=subjects[part["recording"]], **case))
    return pd.concat(parts, ignore_index=True)


def fault_table(table: pd.DataFrame, cases: pd.DataFrame, rate_hz: float, people: bool = False) -> pd.DataFrame:
    """Scores of touches as they are, and under each fault at each severity.

    Args:
        table: stored tables of some folds.
        cases: results of `faulted` for the same folds, with ``fold``.
        rate_hz: frames per second.
        people: argument of `touchbench_streams.scored.numbers_of`.

    Returns:
        A row for each case, that without a fault first: `CASE`, and the scores of `numbers_of`.
    """
    truth = table[table["kind"].isin(["touch", "doubtful"])]
    rows = [dict(zip(CASE, (CLEAN, 0, ""), strict=True)) | numbers_of(table, rate_hz, people)]
    for case, part in cases.groupby([*CASE], sort=False):
        both = pd.concat([truth, part], ignore_index=True)
        rows.append(dict(zip(CASE, case, strict=True)) | numbers_of(both, rate_hz, people))
    return pd.DataFrame(rows)


def run_under(folds: Sequence[FoldResult], rate_hz: float) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
    """Tracked scores of a run under faults, and its tables `FAULTED` and `FAULTS`."""
    cases = tables_of(folds)[FAULTED]
    table = fault_table(table_of([*folds]), cases, rate_hz, people=True)
    return tracked_scores(table), {FAULTED: cases, FAULTS: table}


def tracked_scores(table: pd.DataFrame) -> dict[str, float]:
    """The numbers of a run from `fault_table`, such as ``touches_found.noise.3``."""
    kept = [name for name in SCORES if name in table]
    return {
        f"{name}.{row['fault']}.{row['severity']}": float(row[name])
        for row in table[table["severity"] > 0].to_dict("records")
        for name in kept
        if row[name] == row[name]
    }
