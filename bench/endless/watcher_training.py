"""What a watcher learns from recordings of training subjects: its detector, and when to report a touch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus, storage
from bench.corpora.recordings import Recordings
from bench.corpora.steps import Scale
from bench.endless.broken import FEELING, KINDS, broken
from bench.endless.detector import BACKGROUND, BROKEN, Clock, Detector, SubjectSums, cut, windows_of
from bench.endless.detectors.base import Watches
from bench.endless.points import frontier, points_of
from bench.endless.watcher import Watcher, bias_table
from bench.errors import InputError
from bench.features.touch import TouchFeatures
from bench.models.recipe import behind, taken
from bench.models.search.inner_folds import inner_folds
from bench.outcomes.events import last_confidence

RARE = 8  # one of so many training windows is also learned as broken sensors show it
STRONG = (np.inf, 40.0, 30.0, 25.0, 20.0, 16.0, 14.0, 12.0, 10.0)  # log-odds of short touches, one is learned
PRICE = 0.01  # share of touches that one false alarm per hour too many is worth, where none too many is impossible
LASTS = 3  # times the longest training touch: what lasts longer is refused, as a sensor that shakes looks like that
GROUPS = "3"  # of subjects, each left out once for the threshold of unknown gestures
REJECTED = 0.05  # share of touches with a known gesture that may be labelled unknown
NEARLY = 0.005  # share of touches that is given for a lower bias
Windowed = tuple[np.ndarray, np.ndarray, np.ndarray]  # features, labels and events of windows


def learned(system: contract.System, recordings: Recordings, false_alarms: float) -> tuple[Watcher, pd.DataFrame]:
    """A watcher whose detector and post-processing are learned from training recordings.

    Each subject is left out in turn; a detector that is fitted to the others watches the subject's recordings. The bias
    that finds most touches is taken, less `PRICE` for each false alarm per hour above ``false_alarms``, counting one
    more than there were; of biases that find nearly as many (`NEARLY`), the lowest. Then so is the threshold for short
    touches (`STRONG`), of which the highest is taken.

    Args:
        system: fitted to captures of the same subjects.
        recordings: recordings of training subjects.
        false_alarms: accepted false alarms per hour of background.

    Returns:
        The watcher, and the `bias_table` of all biases.

    Raises:
        InputError: fewer than two subjects, or no touch.
    """
    if not len(recordings.events):
        raise InputError("detector=filter: the training recordings have no touch; record some")
    steps, _ = behind(system)
    corpus = taken(recordings.corpus, steps)[0]
    clock = Clock.of(system, corpus.rate_hz)
    seen = [windows_of(corpus[[i]], clock) for i in range(len(corpus))]
    whole = storage(recordings.corpus)[0].dtype.kind in "iu" and not any(isinstance(step, Scale) for step in steps)
    people = recordings.subjects.astype(str)
    windows: dict[str, list[Windowed]] = {person: [] for person in people}
    for i, person in enumerate(people):
        windows[person].append(training_windows(recordings[i], seen[i][0], clock))
        windows[person] += broken_windows(recordings[i], corpus[[i]], clock, whole)
    both = {person: joined(parts) for person, parts in windows.items()}
    taught = {person: SubjectSums.of(*parts) for person, parts in both.items() if len(parts[0])}
    odds: list[np.ndarray] = [np.zeros(0)] * len(seen)
    for train, judged in inner_folds(people, "loso"):
        detector = Detector(clock.detect).fit([part for person, part in taught.items() if person in people[train]])
        for i in judged:
            odds[i] = detector.decisions(*seen[i]).odds
    settings = bias_table(recordings, odds, clock)
    bias = float(best(settings, false_alarms)["bias"])
    short = bias_table(recordings, odds, clock, np.array([bias], np.float32), STRONG)
    chosen = best(short, false_alarms)
    gestures = set(recordings.events["gesture"])
    background = tuple(sorted(set(np.asarray(system.classes_).astype(str)) - gestures))
    detector = Detector(clock.detect).fit([*taught.values()])
    strong = float(chosen["strong"])
    longest = -(-LASTS * int((recordings.events["end"] - recordings.events["start"]).max()) // clock.hop)
    watcher = Watcher(system, background, clock, detector, bias, int(chosen["tail"]), strong, longest)
    some = np.union1d(frontier(settings.rename(columns={"bias": "threshold"}))["threshold"], [bias])
    tried = bias_table(recordings, odds, clock, some.astype(np.float32), (strong,))
    watcher.points = points_of(tried.rename(columns={"bias": "threshold"}), bias, rising=True)
    return watcher, settings


def best(settings: pd.DataFrame, false_alarms: float) -> pd.Series:
    """The first row of `bias_table` that is nearly the best; see `learned`."""
    hours = settings["hours"].replace(0, np.nan)  # without background, rates are unknown
    excess = (settings["alarms"] + 1) / hours - false_alarms
    worth = settings["found"] - PRICE * excess.fillna(0).clip(lower=0)
    return settings[worth >= worth.max() - NEARLY].iloc[0]


def training_windows(recording: Recordings, table: np.ndarray, clock: Clock) -> Windowed:
    """Every second window of one recording that lies within one event or one gap: features, label, number of it."""
    chosen, labels, number = _inside(recording, clock)
    return table[chosen], labels, number


def broken_windows(recording: Recordings, seen: Corpus, clock: Clock, whole: bool) -> list[Windowed]:
    """Some windows of one recording as broken sensors show them, a part for each kind of broken sensor.

    Background becomes a class of its own for each kind; touch stays touch, where a broken sensor still feels it.

    Args:
        recording: one recording with its events.
        seen: the same after the steps before the system.
        clock: timing of the windows.
        whole: True if readings after the steps are whole numbers.
    """
    chosen, labels, number = _inside(recording, clock)
    parts = []
    for quiet, kinds in ((True, KINDS), (False, FEELING)):
        some = np.flatnonzero((labels == BACKGROUND) == quiet)[::RARE]
        windows = cut(seen, clock.detect + clock.hop * chosen[some], clock.detect)
        for kind in kinds if len(some) else ():
            frames = broken(windows, kind, whole, f"{recording.subjects[0]}, {'background' if quiet else 'touch'}")
            table = TouchFeatures().transform(frames).to_numpy(dtype=np.float32)
            names = np.full(len(some), BROKEN + kind.__name__) if quiet else labels[some]
            parts.append((table, names, np.arange(len(some)) if quiet else number[some]))
    return parts


def _inside(recording: Recordings, clock: Clock) -> Windowed:
    """Every second window of one recording that lies within one event or one gap: position, label, number of it."""
    ends = np.arange(clock.detect, int(recording.corpus.lengths[0]) + 1, clock.hop)
    starts = recording.events["start"].to_numpy()
    edges = np.unique(np.append(starts, recording.events["end"].to_numpy()))
    number = np.searchsorted(edges, ends - 1, side="right")
    inside = number == np.searchsorted(edges, ends - clock.detect, side="right")
    inside[1::2] = False
    labels = recording.frame_labels()[ends - 1]
    return np.flatnonzero(inside), np.where(labels == "", BACKGROUND, labels)[inside].astype(str), number[inside]


def joined(parts: list[Windowed]) -> Windowed:
    """Windows of several parts together; events of different parts stay apart."""
    firsts = np.cumsum([0, *(number.max(initial=0) + 1 for _, _, number in parts)])
    events = [number + first for (_, _, number), first in zip(parts, firsts[:-1], strict=True)]
    table, labels = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    return table, labels, np.concatenate(events)


def learn_reject(
    make_system: Callable[[], contract.System],
    captures: Corpus,
    recordings: Recordings,
    watcher: Watches,
) -> float:
    """The confidence below which a label is ``unknown`` (`Watcher.reject`), learned on training subjects.

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
