"""The confidence below which a touch is labelled unknown, learned on training subjects."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.models.search.inner_folds import split_subjects
from touchbench_streams.detectors.base import UNKNOWN
from touchbench_streams.detectors.ticks import TickWatcher
from touchbench_streams.events import assign_touches, split_fold_table
from touchbench_streams.recordings import Recordings

GROUPS = "3"  # of subjects, each of which is left out once
REJECTED = 0.05  # share of touches with a known gesture that may be labelled unknown


def learn_reject(
    make_system: Callable[[], contract.System],
    captures: Corpus,
    recordings: Recordings,
    watcher: TickWatcher,
) -> float:
    """Learn the confidence below which a label is ``unknown`` (`TickWatcher.reject`).

    Each group of training subjects is left out in turn. A system that is fitted to the captures of
    the others names the touches that the watcher's detector finds in the group's recordings. One in
    twenty of these may be rejected. Captures and recordings are those that the watcher learned
    from, without the unknown gesture.
    """
    subjects = recordings.subjects.astype(str)
    parts = []
    for others, left_out in split_subjects(subjects, GROUPS):
        train = captures[~np.isin(captures.subjects.astype(str), subjects[left_out])]
        renamed = watcher.with_new_names(make_system, train, recordings[others])
        tested = recordings[left_out]
        reports = renamed.report_touches(tested.corpus)
        parts.append(last_confidence(tested.events, reports, tested.corpus.rate_hz))
    confidence = np.concatenate(parts)
    if not len(confidence):
        raise InputError(
            "unknown= learns a threshold from training touches, and none was found; "
            "leave unknown= out"
        )
    return float(np.quantile(confidence, REJECTED, method="lower"))


def last_confidence(
    truth: pd.DataFrame, reports: pd.DataFrame, rate_hz: float, doubtful: pd.DataFrame | None = None
) -> pd.Series:
    """Confidence of the last label of each touch found, by its row.

    The arguments are those of `events.match_reports`.
    """
    reports = reports.assign(touch=assign_touches(truth, reports, rate_hz, doubtful))
    hits = reports[reports["touch"] >= 0]
    hits = hits.sort_values(["touch", "reported", "end"], kind="stable")
    return hits.drop_duplicates("touch", keep="last").set_index("touch")["confidence"]


def rejection_scores(
    table: pd.DataFrame, thresholds: dict[str, float], rate_hz: float
) -> dict[str, float]:
    """Scores of the rejection of unknown gestures among touches found; NaN without such touches.

    ``auroc`` is the probability that a known touch has a higher confidence than an unknown one,
    with ties counted half; ``rejected_unknown`` and ``rejected_known`` are shares of the touches.
    Confidences are relative to the learned threshold of each fold.
    """
    from sklearn.metrics import roc_auc_score

    margins, are_unknown = [], []
    for name, part in table.groupby("fold", sort=False):
        truth, doubtful, reported = split_fold_table(part)
        margins.append(last_confidence(truth, reported, rate_hz, doubtful) - thresholds[str(name)])
        are_unknown.append((truth["gesture"] == UNKNOWN).loc[margins[-1].index])
    margin = pd.concat(margins, ignore_index=True)
    unknown = pd.concat(are_unknown, ignore_index=True)
    auroc = np.nan
    if unknown.nunique() == 2:
        auroc = float(roc_auc_score(~unknown, margin))
    return {
        "auroc": auroc,
        "rejected_unknown": float((margin[unknown] < 0).mean()),
        "rejected_known": float((margin[~unknown] < 0).mean()),
    }
