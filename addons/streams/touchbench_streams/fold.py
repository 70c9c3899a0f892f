"""A fold of ``bench watch``: fit, learn to watch, watch; and the numbers of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from bench import contract
from bench.errors import InputError
from bench.ground.timing import Times, time_repeatedly
from bench.running.fold import (
    TIMED_CAPTURES,
    WARM_UP,
    check_agreement,
    find_batch_effects,
    fit_timed,
    limit_threads,
    memory_metrics,
    pace_metrics,
)
from bench.running.results import FoldResult, combine_costs, concat_predictions
from bench.values.result import format_count
from bench.values.sentences import render_sentences
from touchbench_streams import NO_TOUCH
from touchbench_streams.composer import (
    QUIET,
    check_background,
    compose_recordings,
    split_touch_and_background,
)
from touchbench_streams.curve import missed_at, pool_sweeps
from touchbench_streams.detectors.base import UNKNOWN
from touchbench_streams.detectors.ticks import learn_watcher
from touchbench_streams.events import (
    drop_undefined,
    match_tables,
    score_tables,
    summarise_by_subject,
)
from touchbench_streams.recordings import (
    DOUBT,
    GAP,
    Recordings,
    comes_from_recordings,
    restore_recordings,
)
from touchbench_streams.rejection import learn_reject, rejection_scores
from touchbench_streams.stored import join_background, load_background
from touchbench_streams.stress import FAULT_REPORTS, watch_under_faults

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan
    from touchbench_streams.detectors.detector import Detector
    from touchbench_streams.detectors.ticks import TickWatcher

TIMELINE_S = 120.0  # of the first recording of each fold, whose probability of touch is stored


def default_background(corpus: Corpus, background: str = "") -> str:
    """The class of background of captures: the given one, else ``notouch``, else quiet ends."""
    if comes_from_recordings(corpus):
        return GAP
    if background:
        return background
    return NO_TOUCH if NO_TOUCH in corpus.gestures else QUIET


def make_recordings(captures: Corpus, background: str) -> Recordings:
    """The recordings that captures were cut from, else recordings composed of them.

    ``background`` comes from `default_background`.
    """
    if comes_from_recordings(captures):
        return restore_recordings(captures)
    return compose_recordings(*split_touch_and_background(captures, background))


def check_plan(plan: Plan, background: str, unknown: str) -> None:
    """Refuse folds that mix subjects or train on one, and a background that does not exist."""
    corpus, cell = plan.corpus, plan.cell
    has_recordings, protocol = comes_from_recordings(corpus), cell.protocol
    if any(fold.pairs for fold in plan.folds):
        raise InputError(
            f"protocol={protocol} has several systems in a fold, bench watch tests one; choose loso"
        )
    if plan.mixes_subjects:
        raise InputError(
            f"protocol={protocol}: bench watch needs other subjects in the test part; "
            "choose loso or challenge"
        )
    if has_recordings and background:
        load_background(background, corpus)
    if background == QUIET and QUIET in corpus.gestures:
        raise InputError(f"background={QUIET}: {cell.data} also has a class {QUIET}; rename it")
    background_class = default_background(corpus, background)
    if unknown and unknown != UNKNOWN and UNKNOWN in corpus.gestures:
        raise InputError(
            f"unknown={unknown}: rejected touches are labelled {UNKNOWN}, but {cell.data} has a "
            "gesture of this name; rename it"
        )
    if unknown and unknown not in {*corpus.gestures} - {background_class}:
        raise InputError(
            f"unknown={unknown}: {cell.data} has no such gesture besides the background"
        )
    if cell.target != "gesture":
        raise InputError(f"target={cell.target}: bench watch names gestures; leave it out")
    untouched = [background_class, unknown]
    if has_recordings:
        untouched.append(DOUBT)
    is_touch = ~np.isin(corpus.gestures, untouched)
    if not has_recordings:
        check_background(*split_touch_and_background(corpus, background_class))
    elif not is_touch.any():
        raise InputError(
            f"data={cell.data}: its recordings have no touch; label the frames of touches"
        )
    for fold in plan.folds:
        subjects = set(corpus.subjects[fold.train[is_touch[fold.train]]])
        if len(subjects) < 2:
            raise InputError(
                f"protocol={protocol}: fold {fold.name} trains on touches of "
                f"{format_count(len(subjects), 'subject')}; bench watch learns its post-processing "
                "by leaving training subjects out and needs two"
            )
    if conditions := contract.required_conditions(cell.untrained_system):
        raise InputError(
            f"model={cell.model}: it predicts with {', '.join(conditions)}, which a recording does "
            "not have; remove its conditions, or evaluate it with bench run"
        )


def short_background_warnings(
    corpus: Corpus, trains: list[np.ndarray], false_alarms: float, background: str
) -> list[str]:
    """Warn if a training part has too little background to learn a rate of false alarms.

    A single alarm in so little background is a higher rate. Only without any alarm in 3 / rate
    hours is the rate lower with a confidence of 95 % (Poisson). Composed recordings pass: their
    background is as long as their touches are many.
    """
    if not comes_from_recordings(corpus):
        return []
    background_frames = np.where(corpus.gestures == GAP, corpus.lengths, 0)
    frames = min(float(background_frames[train].sum()) for train in trains)
    if background:
        frames += load_background(background, corpus).background_frames().sum()
    minutes = frames / corpus.rate_hz / 60
    if not minutes or 60 / minutes <= false_alarms:
        return []
    return render_sentences(
        "touchbench_streams",
        "touches",
        "short",
        accepted=f"{false_alarms:g}",
        data=corpus.name,
        minutes=f"{minutes:.1f}",
        least=f"{60 / minutes:.3g}",
        needed=f"{180 / false_alarms:.0f}",
    )


def watch_fold(
    cell: Cell,
    corpus: Corpus,
    fold: Fold,
    threads: int,
    *,
    detector: Detector,
    false_alarms: float,
    background: str,
    unknown: str,
    under: Sequence[str],
) -> FoldResult:
    """Fit, learn the post-processing on training recordings, watch those of the test subjects.

    The options are those of `touchbench_streams.study.Continuous`. The stored table has rows of
    several kinds (``kind``):

    - ``recording``: ``end`` is its number of frames, ``refused`` of which are refused or saturated;
    - ``touch`` and ``doubtful`` stretch: ``start``, ``end``, ``gesture``;
    - ``report``: columns of `events.REPORT`;
    - point of the ``curve``: ``offset`` of the threshold, ``hits``, ``alarms`` and ``reports``;
    - ``probability`` of touch after ``reported`` frames, in the first two minutes.

    Reports under faults are the table `FAULT_REPORTS`.
    """
    estimator = cell.estimator()
    background_class = default_background(corpus, background)
    train = corpus[fold.train]
    if unknown:
        train = train[train.gestures != unknown]
    if unknown and comes_from_recordings(train):  # composed again, without the unknown gesture
        parts = split_touch_and_background(train, background_class)
        recordings = compose_recordings(*parts)
    else:
        recordings = make_recordings(train, background_class)
    if background and comes_from_recordings(corpus):
        more = load_background(background, corpus)
        recordings = join_background(recordings, more, corpus.subjects[fold.test])
    with limit_threads(threads):
        metrics = fit_timed(estimator, train)
        watcher, sweep = learn_watcher(
            detector, cell.estimator, estimator, recordings, false_alarms
        )
        if unknown:
            watcher.reject = learn_reject(cell.estimator, train, recordings, watcher)
        test = make_recordings(corpus[fold.test], background_class)
        if unknown:
            test = replace(test, labelled=test.labelled.replace({"gesture": {unknown: UNKNOWN}}))
        table = _fold_table(watcher, test).assign(fold=fold.name)
        tables = {}
        if under:
            reports = watch_under_faults(watcher, test, under)
            tables[FAULT_REPORTS] = reports.assign(fold=fold.name)
        effects = find_batch_effects(estimator, corpus, fold.test)
        if not effects:
            check_agreement(estimator, corpus, fold.test)
    with limit_threads(1):
        times = _time_decisions(watcher, test)
    metrics |= memory_metrics(estimator, corpus) | pace_metrics(times)
    metrics["flash_bytes"] += 4 * watcher.numbers  # in C it is stored beside the system
    return FoldResult(
        fold.name,
        table,
        metrics,
        chosen=watcher.chosen,
        trials=sweep,
        batch_effects=effects,
        tables=tables,
        times={
            "predict_ms": times.ms,
            "decide_ms": times.ms,
            "predict_wall_ms": times.wall_ms,
            "decide_wall_ms": times.wall_ms,
        },
    )


def _fold_table(watcher: TickWatcher, test: Recordings) -> pd.DataFrame:
    """The stored table of a fold, without its name."""
    sensed = watcher.sense(test.corpus)
    refused = watcher.count_refused(sensed)
    frames = {"recording": np.arange(len(test)), "end": test.corpus.lengths, "refused": refused}
    reported = watcher.count * np.arange(1, len(sensed.signs[0]) + 1)
    columns = {"reported": reported, "confidence": sensed.signs[0][:, 0], "recording": 0}
    probability = pd.DataFrame(columns)
    in_timeline = probability["reported"] <= TIMELINE_S * test.corpus.rate_hz
    parts = {
        "recording": pd.DataFrame(frames),
        "touch": test.events,
        "doubtful": test.doubtful,
        "report": watcher.name_touches(sensed),
        "curve": _sweep_by_subject(watcher, test, sensed.evidence),
        "probability": probability[in_timeline],
    }
    subjects = test.subjects.astype(str)
    rows = [
        part.assign(kind=kind, subject=subjects[part["recording"]]) for kind, part in parts.items()
    ]
    return pd.concat(rows, ignore_index=True)


def run_numbers(
    folds: list[FoldResult], rate_hz: float, unknown: str
) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
    """Scores of touches and costs of a run, and its tables.

    Scores are means over subjects, with intervals. The tables are ``predictions`` (of all folds),
    ``touches``, ``reports``, ``per_subject`` and ``curve`` (missed touches by false alarms).
    """
    table = concat_predictions(folds)
    touches, reports, background_s = match_tables(table, rate_hz)
    numbers = score_tables(table, rate_hz, by_subject=True)
    hours = sum(background_s.values()) / 3600
    sweep = pool_sweeps(table[table["kind"] == "curve"])
    counts = sweep.groupby("offset").sum()
    missed, alarms = 1 - counts["hits"] / max(len(touches), 1), counts["alarms"] / (hours or np.nan)
    tables = {
        "predictions": table,
        "touches": touches,
        "reports": reports,
        "per_subject": summarise_by_subject(touches, reports, background_s),
        "curve": pd.DataFrame({"missed": missed, "false_alarms_per_hour": alarms}).reset_index(),
    }
    touch_counts = touches["subject"].value_counts()
    numbers |= missed_at(sweep, touch_counts, pd.Series(background_s) / 3600)
    if unknown:
        thresholds = {fold.name: float(str(fold.chosen["reject"])) for fold in folds}
        numbers |= rejection_scores(table, thresholds, rate_hz)
    numbers = drop_undefined(numbers | {"background_minutes": 60 * hours})
    return numbers | combine_costs(folds), tables


def _sweep_by_subject(
    watcher: TickWatcher, test: Recordings, evidence: list[np.ndarray]
) -> pd.DataFrame:
    """Sweep the thresholds over the recordings of each subject; ``recording`` is its first one."""
    parts = []
    for rows in pd.Series(range(len(test))).groupby(test.subjects.astype(str)).groups.values():
        sweep = watcher.sweep_recordings(test[[*rows]], [evidence[i] for i in rows])
        parts.append(sweep.assign(recording=rows[0]))
    return pd.concat(parts)


def _time_decisions(watcher: TickWatcher, test: Recordings) -> Times:
    """Measure the time of some decisions on one thread."""
    recording = contract.blind_captures(watcher.system, test.corpus[[0]].detach())
    ends = np.linspace(1, recording.lengths[0], TIMED_CAPTURES + WARM_UP).astype(int)
    for end in ends[:WARM_UP]:
        watcher.decide_once(recording, end)
    return time_repeatedly(partial(watcher.decide_once, recording, end) for end in ends[WARM_UP:])
