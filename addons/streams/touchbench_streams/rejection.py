"""The confidence below which a touch is labelled unknown, learned on training subjects."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bench import contract
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.models.search.inner_folds import inner_folds
from touchbench_streams.detectors.base import Watches
from touchbench_streams.events import last_confidence
from touchbench_streams.recordings import Recordings

GROUPS = "3"  # of subjects, each left out once
REJECTED = 0.05  # share of touches with a known gesture that may be labelled unknown


def learn_reject(
    make_system: Callable[[], contract.System],
    captures: Corpus,
    recordings: Recordings,
    watcher: Watches,
) -> float:
    """The confidence below which a label is ``unknown`` (`Watches.reject`), learned on training subjects.

    Each group of subjects is left out in turn; a system that is fitted to the captures of the others names the touches
    that the watcher's detector finds in the group's recordings.

    Args:
        make_system: factory of the watcher's system, not fitted.
        captures: training captures, without the gesture that is left out.
        recordings: recordings of training subjects, without that gesture.
        watcher: watcher that was learned on the same captures and recordings.

    Raises:
        InputError: fewer than two subjects, or no touch is found.
    """
    subjects = recordings.subjects.astype(str)
    confidence = []
    for others, judged in inner_folds(subjects, GROUPS):
        train = captures[~np.isin(captures.subjects.astype(str), subjects[judged])]
        held = recordings[judged]
        reports = watcher.renamed(make_system, train, recordings[others]).reports(held.corpus)
        confidence.append(last_confidence(held.events, reports, held.corpus.rate_hz))
    return reject_threshold(np.concatenate(confidence))


def reject_threshold(confidence: np.ndarray, share: float = REJECTED) -> float:
    """Threshold that rejects at most a share of touches with known gestures.

    Args:
        confidence: confidence of the label of each training touch with a known gesture [touches].
        share: share of them that may lie below the threshold.

    Raises:
        InputError: there are no touches.
    """
    if not len(confidence):
        raise InputError("unknown= learns a threshold from training touches, and none was found; leave unknown= out")
    return float(np.quantile(confidence, share, method="lower"))
