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

GROUPS = "3"  # of subjects, each left out once
REJECTED = 0.05  # share of touches with a known gesture that may be labelled unknown


def learn_reject(
    make_system: Callable[[], contract.System],
    captures: Corpus,
    recordings: Recordings,
    watcher: TickWatcher,
) -> float:
    """The confidence below which a label is ``unknown`` (`TickWatcher.reject`), learned on training subjects.

    Each group of subjects is left out in turn; a system that is fitted to the captures of the others names the touches
    that the watcher's detector finds in the group's recordings. One in twenty of these may be rejected. Captures and
    recordings are those that the watcher was learned on, without the gesture that is left out.
    """
    subjects = recordings.subjects.astype(str)
    found = []
    for others, judged in split_subjects(subjects, GROUPS):
        train = captures[~np.isin(captures.subjects.astype(str), subjects[judged])]
        held = recordings[judged]
        reports = watcher.with_new_names(make_system, train, recordings[others]).report_touches(
            held.corpus
        )
        found.append(last_confidence(held.events, reports, held.corpus.rate_hz))
    confidence = np.concatenate(found)
    if not len(confidence):
        raise InputError(
            "unknown= learns a threshold from training touches, and none was found; leave unknown= out"
        )
    return float(np.quantile(confidence, REJECTED, method="lower"))


def last_confidence(
    truth: pd.DataFrame, reports: pd.DataFrame, rate_hz: float, doubtful: pd.DataFrame | None = None
) -> pd.Series:
    """Confidence of the last label of each touch that was found, by its row; arguments of `events.match_reports`."""
    reports = reports.assign(touch=assign_touches(truth, reports, rate_hz, doubtful))
    ordered = reports[reports["touch"] >= 0].sort_values(
        ["touch", "reported", "end"], kind="stable"
    )
    return ordered.drop_duplicates("touch", keep="last").set_index("touch")["confidence"]


def rejection_scores(
    table: pd.DataFrame, thresholds: dict[str, float], rate_hz: float
) -> dict[str, float]:
    """How well unknown gestures are rejected, of the touches found; NaN where there are no such touches.

    ``auroc`` is the probability that a known touch has a higher confidence than an unknown one, ties count half;
    ``rejected_unknown`` and ``rejected_known`` are shares of the touches. Confidences count from the learned threshold
    of each fold.
    """
    from sklearn.metrics import roc_auc_score

    margins, strange = [], []
    for name, part in table.groupby("fold", sort=False):
        truth, doubtful, reported = split_fold_table(part)
        above = last_confidence(truth, reported, rate_hz, doubtful) - thresholds[str(name)]
        margins.append(above)
        strange.append((truth["gesture"] == UNKNOWN).loc[above.index])
    margin, unknown = pd.concat(margins, ignore_index=True), pd.concat(strange, ignore_index=True)
    return {
        "auroc": float(roc_auc_score(~unknown, margin)) if unknown.nunique() == 2 else np.nan,
        "rejected_unknown": float((margin[unknown] < 0).mean()),
        "rejected_known": float((margin[~unknown] < 0).mean()),
    }
