"""Systems in continuous recordings: false alarms, missed touches and latency."""

from __future__ import annotations

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
from touchbench_streams.stress import FAULTED, watch_under_faults

if TYPE_CHECKING:
    from bench.corpora.corpus import Corpus
    from bench.plan.cells import Cell
    from bench.plan.plan import Fold, Plan
    from touchbench_streams.detectors.ticks import TickWatcher
    from touchbench_streams.study import Continuous

SHOWN_S = 120.0  # of a recording in each fold, for the timeline


def usual_background(corpus: Corpus, background: str = "") -> str:
    """The background of a whole corpus of captures: the class that was asked for, ``notouch``, or their quiet ends."""
    if comes_from_recordings(corpus):
        return GAP
    return background or (NO_TOUCH if NO_TOUCH in corpus.gestures else QUIET)


def make_recordings(captures: Corpus, background: str) -> Recordings:
    """Recordings of the subjects of some captures: their own, or composed ones with a background as of `usual_background`."""
    if comes_from_recordings(captures):
        return restore_recordings(captures)
    return compose_recordings(*split_touch_and_background(captures, background))


def refuse(plan: Plan, background: str, unknown: str) -> None:
    """Refuse folds that mix subjects or train on one, and a background that does not exist."""
    corpus, name = plan.corpus, plan.cell.protocol
    if any(fold.pairs for fold in plan.folds):
        raise InputError(
            f"protocol={name} has several systems in a fold, bench watch tests one; choose loso"
        )
    if plan.mixes_subjects:
        raise InputError(
            f"protocol={name}: bench watch needs other subjects in the test part; choose loso or challenge"
        )
    if comes_from_recordings(corpus) and background:
        load_background(background, corpus)
    if background == QUIET and QUIET in corpus.gestures:
        raise InputError(
            f"background={QUIET}: {plan.cell.data} also has a class {QUIET}; rename it"
        )
    if unknown and unknown != UNKNOWN and UNKNOWN in corpus.gestures:
        raise InputError(
            f"unknown={unknown}: rejected touches are labelled {UNKNOWN}, but {plan.cell.data} has a gesture of this "
            "name; rename it"
        )
    if unknown and unknown not in {*corpus.gestures} - {usual_background(corpus, background)}:
        raise InputError(
            f"unknown={unknown}: {plan.cell.data} has no such gesture beside the background"
        )
    if plan.cell.target != "gesture":
        raise InputError(f"target={plan.cell.target}: bench watch names gestures; leave it out")
    doubt = [DOUBT] if comes_from_recordings(corpus) else []
    touches = ~np.isin(corpus.gestures, [usual_background(corpus, background), unknown, *doubt])
    if not comes_from_recordings(corpus):
        check_background(*split_touch_and_background(corpus, usual_background(corpus, background)))
    elif not touches.any():
        raise InputError(
            f"data={plan.cell.data}: its recordings have no touch; label the frames of touches"
        )
    for fold in plan.folds:
        if len(touching := set(corpus.subjects[fold.train[touches[fold.train]]])) < 2:
            raise InputError(
                f"protocol={name}: fold {fold.name} trains on touches of {format_count(len(touching), 'subject')}; bench "
                "watch learns its post-processing by leaving training subjects out and needs two"
            )
    if conditions := contract.required_conditions(plan.cell.untrained_system):
        raise InputError(
            f"model={plan.cell.model}: it predicts with {', '.join(conditions)}, which a recording does not have; "
            "remove its conditions, or evaluate it with bench run"
        )


def short_background_warnings(
    corpus: Corpus, trains: list[np.ndarray], false_alarms: float, background: str
) -> list[str]:
    """A line where the shortest background of some training parts is too short to learn a rate of false alarms.

    One alarm in so much background is a higher rate. Without any alarm in 3 / rate hours, the rate is lower with a
    confidence of 95 % (Poisson). Background of composed recordings is as long as their touches are many.
    """
    if not comes_from_recordings(corpus):
        return []
    quiet = np.where(corpus.gestures == GAP, corpus.lengths, 0)
    frames = min(float(quiet[train].sum()) for train in trains)
    if background:
        frames += load_background(background, corpus).background_frames().sum()
    minutes = frames / corpus.rate_hz / 60
    if not minutes or 60 / minutes <= false_alarms:
        return []
    return render_sentences(
        *("touchbench_streams", "touches", "short"),
        asked=f"{false_alarms:g}",
        data=corpus.name,
        minutes=f"{minutes:.1f}",
        least=f"{60 / minutes:.3g}",
        needed=f"{180 / false_alarms:.0f}",
    )


def fold_of(study: Continuous, cell: Cell, corpus: Corpus, fold: Fold, threads: int) -> FoldResult:
    """Fit, learn the post-processing on recordings of training subjects, watch those of the test subjects.

    The stored table has rows of several kinds (``kind``): a ``recording`` (``end`` is its number of frames,
    ``refused`` of which are refused or saturated), a ``touch`` (``start``, ``end``, ``gesture``), a ``doubtful``
    stretch (the same), a ``report`` (columns of `events.REPORT`), a point of the ``curve`` (``offset``
    of the bias, ``hits`` and ``alarms``: touches found and false alarms) and the ``probability`` of touch after
    ``reported`` frames of the first two minutes. Reports under faults are the table `FAULTED`.
    """
    estimator, unknown, background = (
        cell.estimator(),
        study.unknown,
        usual_background(corpus, study.background),
    )
    train = corpus[fold.train]
    if unknown:  # training recordings must not have it either, so they are composed again
        train = train[train.gestures != unknown]
    composing = bool(unknown) and comes_from_recordings(train)
    recordings = (
        compose_recordings(*split_touch_and_background(train, background))
        if composing
        else make_recordings(train, background)
    )
    if study.background and comes_from_recordings(corpus):
        recordings = join_background(
            recordings, load_background(study.background, corpus), corpus.subjects[fold.test]
        )
    with limit_threads(threads):
        metrics = fit_timed(estimator, train)
        learning = cell.estimator, estimator, recordings, study.false_alarms
        watcher, settings = learn_watcher(study.part.make_object(), *learning)
        if unknown:
            watcher.reject = learn_reject(cell.estimator, train, recordings, watcher)
        test = make_recordings(corpus[fold.test], background)
        if unknown:
            test = replace(test, labelled=test.labelled.replace({"gesture": {unknown: UNKNOWN}}))
        evidence = watcher.collect_evidence(test.corpus)
        reports = watcher.report_touches(test.corpus, evidence)
        refused = watcher.count_refused(test.corpus, evidence)
        disturbed = (
            {FAULTED: watch_under_faults(watcher, test, study.under).assign(fold=fold.name)}
            if study.under
            else {}
        )
        effects = find_batch_effects(estimator, corpus, fold.test)
        if not effects:
            check_agreement(estimator, corpus, fold.test)
    subjects, shown = (
        test.subjects.astype(str),
        watcher.touch_probability(evidence[0]).assign(recording=0),
    )
    frames = pd.DataFrame(
        {"recording": np.arange(len(test)), "end": test.corpus.lengths, "refused": refused}
    )
    table = pd.concat(
        [
            part.assign(kind=kind, subject=subjects[part["recording"]])
            for kind, part in (
                ("recording", frames),
                ("touch", test.events),
                ("doubtful", test.doubtful),
                ("report", reports),
                ("curve", _sweep_by_subject(watcher, test, evidence)),
                ("probability", shown[shown["reported"] <= SHOWN_S * test.corpus.rate_hz]),
            )
        ],
        ignore_index=True,
    )
    with limit_threads(1):
        spent = _time_decisions(watcher, test)
    metrics |= memory_metrics(estimator, corpus) | pace_metrics(spent)
    metrics["flash_bytes"] += 4 * watcher.numbers  # in C it is stored beside the system
    return FoldResult(
        fold.name,
        table.assign(fold=fold.name),
        metrics,
        chosen=watcher.chosen,
        trials=settings,
        batch_effects=effects,
        tables=disturbed,
        times={
            "predict_ms": spent.ms,
            "decide_ms": spent.ms,
            "predict_wall_ms": spent.wall_ms,
            "decide_wall_ms": spent.wall_ms,
        },
    )


def run_numbers(
    folds: list[FoldResult], rate_hz: float, unknown: str
) -> tuple[dict[str, float], dict[str, pd.DataFrame]]:
    """Scores of touches as means over subjects, with intervals; tables of touches, reports, subjects and the curve."""
    table = concat_predictions(folds)
    touches, reports, background_s = match_tables(table, rate_hz)
    numbers = score_tables(table, rate_hz, people=True)
    hours = sum(background_s.values()) / 3600
    by_person = pool_sweeps(table[table["kind"] == "curve"])
    counts = by_person.groupby("offset").sum()
    missed, alarms = 1 - counts["hits"] / max(len(touches), 1), counts["alarms"] / (hours or np.nan)
    tables = {
        "predictions": table,
        "touches": touches,
        "reports": reports,
        "per_subject": summarise_by_subject(touches, reports, background_s),
        "curve": pd.DataFrame({"missed": missed, "false_alarms_per_hour": alarms}).reset_index(),
    }
    numbers |= missed_at(
        by_person, touches["subject"].value_counts(), pd.Series(background_s) / 3600
    )
    if unknown:
        numbers |= rejection_scores(
            table, {r.name: float(str(r.chosen["reject"])) for r in folds}, rate_hz
        )
    return drop_undefined(numbers | {"background_minutes": 60 * hours}) | combine_costs(
        folds
    ), tables


def _sweep_by_subject(watcher: TickWatcher, test: Recordings, evidence: list) -> pd.DataFrame:
    """The sweep of thresholds on the recordings of each subject, under the first of them."""
    parts = []
    for rows in pd.Series(range(len(test))).groupby(test.subjects.astype(str)).groups.values():
        parts.append(
            watcher.sweep_recordings(test[[*rows]], [evidence[i] for i in rows]).assign(
                recording=rows[0]
            )
        )
    return pd.concat(parts)


def _time_decisions(watcher: TickWatcher, test: Recordings) -> Times:
    """Times of some decisions on one thread."""
    recording = contract.blind_captures(watcher.system, test.corpus[[0]].detach())
    ends = np.linspace(1, recording.lengths[0], TIMED_CAPTURES + WARM_UP).astype(int)
    for end in ends[:WARM_UP]:
        watcher.decide(recording, end)
    return time_repeatedly(partial(watcher.decide, recording, end) for end in ends[WARM_UP:])
