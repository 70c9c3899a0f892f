"""Watching recordings: a sensor that shows nothing, or nonsense, raises no event; a threshold that rejects labels."""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest

from bench.corpora import synth, synth_recordings
from bench.corpora.corpus import Corpus
from bench.corpora.recordings import Recordings, event_table
from bench.endless.broken import KINDS, broken, tared
from bench.endless.detector import Clock
from bench.endless.points import frontier, points_of
from bench.endless.watcher import UNKNOWN
from bench.endless.watcher_training import (
    broken_windows,
    joined,
    learn_reject,
    learned,
    reject_threshold,
)
from bench.errors import InputError
from bench.features.touch import TouchFeatures
from bench.models.classic.lda import lda
from bench.models.recipe import Recipe
from bench.outcomes.events import last_confidence, matched, report_table

SENSOR = {"rate_hz": 54.0, "seed": 1}
NORMAL = ("normal",)
FULL_SCALE = 1023


def make_system():
    return Recipe(lda(TouchFeatures()), 0.75)


@pytest.fixture(scope="module")
def people():
    """Captures and recordings of four people; the watcher is learned on the first three."""
    captures = synth.generate(subjects=3, repetitions=2, variants=NORMAL, **SENSOR)
    return captures, synth_recordings.generate(subjects=4, variants=NORMAL, **SENSOR)


@pytest.fixture(scope="module")
def watcher(people):
    captures, recordings = people
    return learned(make_system().fit(captures, captures.gestures), recordings[:3], false_alarms=5)[0]


def nonsense(kind, background):
    """Fifteen seconds without touch, or what a broken sensor shows of them."""
    rng = np.random.default_rng(3)
    frames = background.copy()
    if kind == "one stuck taxel":
        frames[:, 2, 5] = FULL_SCALE
    elif kind == "a taxel stuck halfway":
        frames[:, 0, 0] = 300
    elif kind.startswith("noise"):
        frames = rng.normal(0, float(kind.split()[1]), frames.shape)
    elif kind == "tared":
        frames = frames - np.median(frames, axis=0)
    elif kind == "half dead":
        frames[:, :, :4] = 0
    elif kind == "disconnected for five seconds":
        frames[270:540] = 0
    elif kind != "background":
        frames[:] = float(kind)
    return np.rint(frames).clip(0, FULL_SCALE).astype(np.uint16)


@pytest.mark.parametrize(
    "kind",
    [
        *("background", "0", "1", "5", "10", "100", "1023", "noise 0.5", "noise 1", "noise 2", "noise 5", "noise 50"),
        *("noise 300", "tared", "half dead", "one stuck taxel", "a taxel stuck halfway"),
        "disconnected for five seconds",
    ],
)
def test_no_event_without_touch_and_the_next_touch_is_found(kind, people, watcher):
    own = people[1][[3]]
    frames, events = own.corpus[0], own.events
    quiet = [frames[a:b] for a, b in zip([0, *events["end"]], [*events["start"], len(frames)], strict=True)]
    background = np.concatenate([gap[20:-20] for gap in quiet])[:810]
    touch = events[events["gesture"] == "massage"].iloc[0]
    parts = [nonsense(kind, background), frames[touch["start"] - 108 : touch["end"] + 54]]
    stream = Corpus.from_captures(
        [np.concatenate(parts)], pd.DataFrame({"subject": ["4"], "gesture": [""]}), 54.0, full_scale=FULL_SCALE
    )
    begins = len(parts[0]) + 108
    reports = watcher.reports(stream)
    assert len(reports) and (reports["reported"] > begins).all(), (kind, begins, reports)


def test_touches_are_found_on_a_sensor_with_a_stuck_taxel(people, watcher):
    own = people[1][[3]]
    frames = own.corpus[0].copy()
    frames[:, 2, 5] = FULL_SCALE
    stuck = own.corpus.changed(frames=frames, starts=np.zeros(1, np.int64), digest="", path=None)
    sound, broken_one = (
        matched(own.events, watcher.reports(corpus), 54.0)[0]["found"] for corpus in (own.corpus, stuck)
    )
    assert broken_one.sum() >= 0.8 * sound.sum() > 0


def test_broken_windows_of_background_are_their_own_classes_and_those_of_touch_stay_touch():
    frames = np.random.default_rng(0).integers(0, 9, (2000, 4, 4)).astype(np.uint16)
    whole = Corpus.from_captures([frames], pd.DataFrame({"subject": ["1"], "gesture": [""]}), 54.0, full_scale=100)
    recording = Recordings(whole, event_table([(0, 1000, 2000, "pat")]))
    clock = Clock(hop=5, detect=25, name=40, wait=10, hold=15)
    # Windows of 25 frames that end at 25, 35, ... 995 are background, at 1025, 1035, ... 1995 touch: 98 each.
    parts = broken_windows(recording, whole, clock, whole=True)
    assert [labels.tolist() for _, labels, _ in parts] == [
        *([f" {kind.__name__}"] * 13 for kind in KINDS),
        *[["pat"] * 13] * 2,
    ]
    assert all(table.shape == (13, 427) for table, _, _ in parts)
    assert all(len({*number}) == (1 if "pat" in labels else 13) for _, labels, number in parts)
    table, labels, number = joined(parts)
    assert len(table) == len(labels) == 9 * 13 and len({*number}) == 7 * 13 + 2


def windows(frames):
    """Captures of one subject, as float32 or as whole numbers 0..100."""
    captures = pd.DataFrame({"subject": "1", "gesture": ["", ""]})
    return Corpus.from_captures(list(frames), captures, 54.0, full_scale=100)


@pytest.mark.parametrize("whole", [True, False])
def test_broken_windows_are_readings_of_the_same_sensor(whole):
    frames = np.random.default_rng(0).integers(5, 9, (2, 25, 4, 3)).astype(np.uint16)
    changed = {kind.__name__: broken(windows(frames), kind, whole, "a") for kind in KINDS}
    for kind, corpus in changed.items():
        values = np.stack(list(corpus))
        assert values.shape == frames.shape and values.dtype == np.float32
        assert values.min() >= 0 and values.max() <= 100
        assert not np.array_equal(values, frames), kind
        assert not whole or np.array_equal(values, np.rint(values)), kind
    differs = np.stack(list(changed["stuck"])) != frames
    assert differs.any(axis=1).sum(axis=(1, 2)).tolist() == [1, 1]  # one taxel of each window
    expected = [
        [[max(v - m, 0) for v, m in zip(frame, middle, strict=True)] for frame in taxels]
        for taxels, middle in (
            (w.reshape(25, 12).tolist(), np.median(w.reshape(25, 12), axis=0).tolist()) for w in frames
        )
    ]
    found = np.stack(list(changed["tared"])).reshape(2, 25, 12)
    np.testing.assert_allclose(found, np.rint(expected) if whole else expected, atol=1e-4)
    for kind in KINDS:
        again, other = (np.stack(list(broken(windows(frames), kind, whole, seed))) for seed in "ab")
        assert np.array_equal(again, np.stack(list(changed[kind.__name__])))
        assert np.array_equal(again, other) == (kind is tared), kind


def test_the_confidence_of_a_touch_is_that_of_its_last_label():
    touches = event_table([(0, 0, 100, "pat"), (0, 200, 300, "rub"), (1, 0, 100, "pat")])
    reports = report_table(
        [
            (0, 250, 290, "rub", "rub", 0.3),
            (0, 50, 60, "pat", "pat", 0.9),
            (0, 80, 100, "pat", "rub", 0.4),  # the same touch once more
            (0, 400, 450, "pat", "pat", 0.2),  # no touch
        ]
    )
    assert last_confidence(touches, reports, 100.0).to_dict() == {0: 0.4, 1: 0.3}


@pytest.mark.parametrize(
    ("confidence", "threshold"),
    [([0.5], 0.5), ([0.3, 0.2, 0.9], 0.2), ([i / 100 for i in range(41)], 0.02), ([i / 100 for i in range(40)], 0.01)],
)
def test_a_threshold_rejects_at_most_one_known_touch_in_twenty(confidence, threshold):
    assert reject_threshold(np.array(confidence)) == threshold
    assert sum(c < threshold for c in confidence) <= 0.05 * len(confidence)


def test_a_threshold_needs_touches():
    with pytest.raises(InputError, match="none was found"):
        reject_threshold(np.zeros(0))


@dataclass
class Told:
    """A watcher whose reports tell who its system was fitted to: a confidence for each held-out subject."""

    system: object
    reject: float = 0.5

    def renamed(self, make_system, captures, recordings):
        assert {*recordings.subjects.tolist()} == {*captures.subjects.tolist()}
        return Told(make_system().fit(captures, captures.gestures), 0.0)

    def reports(self, corpus):
        assert self.reject == 0
        subjects = corpus.subjects.tolist()
        assert not {*subjects} & self.system.subjects_ and len(self.system.subjects_) == 6 - len(subjects)
        return report_table([(i, 5, 8, "pat", "pat", float(s) / 10) for i, s in enumerate(subjects)])


class Fitted:
    def fit(self, X, y):
        assert y.tolist() == X.gestures.tolist()
        self.subjects_ = {*X.subjects.tolist()}
        return self


def test_the_threshold_is_learned_on_subjects_whom_the_system_has_not_seen():
    names = [str(i + 1) for i in range(6)]
    frames = [np.zeros((10, 1, 1), np.uint16)] * 6
    captures = Corpus.from_captures(frames * 2, pd.DataFrame({"subject": names * 2, "gesture": "pat"}), 54.0)
    whole = Corpus.from_captures(frames, pd.DataFrame({"subject": names, "gesture": ""}), 54.0)
    recordings = Recordings(whole, event_table([(i, 0, 9, "pat") for i in range(6)]))
    assert learn_reject(Fitted, captures, recordings, Told(None)) == 0.1  # of 0.1, 0.2, ... 0.6


def test_a_watcher_rejects_below_its_threshold(people, watcher):
    captures, recordings = people
    threshold = learn_reject(make_system, captures, recordings[:3], watcher)
    assert 1 / 14 < threshold < 1
    plain = watcher.reports(recordings[[3]].corpus)
    rejecting = replace(watcher, reject=threshold).reports(recordings[[3]].corpus)
    pd.testing.assert_series_equal(plain["confidence"], rejecting["confidence"])
    expected = [UNKNOWN if c < threshold else g for g, c in zip(plain["label"], plain["confidence"], strict=True)]
    assert rejecting["label"].tolist() == expected


def test_operating_points_find_more_with_more_alarms():
    rows = [
        (-9.0, 0, 0.2),
        (-8.0, 0, 0.5),
        (-7.0, 0, 0.5),
        (-5.0, 3, 0.5),
        (-3.0, 2, 0.8),
        (1.0, 6, 0.7),
        (2.0, 9, 0.9),
    ]
    table = pd.DataFrame(rows, columns=["threshold", "alarms", "found"]).assign(hours=0.5)
    assert frontier(table)["threshold"].tolist() == [-7.0, -3.0, 2.0]
    assert points_of(table, 1.0, rising=True) == (
        (-7.0, 0.0, 0.5),
        (-3.0, 4.0, 0.8),
        (1.0, 12.0, 0.7),
        (2.0, 18.0, 0.9),
    )
    falling = points_of(table, 1.0, rising=False)  # from the strictest to the most eager
    assert [threshold for threshold, _, _ in falling] == [2.0, 1.0, -3.0, -7.0]
