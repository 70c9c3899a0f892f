"""Detectors that decide tick by tick: nothing looks ahead, times are learned, reports cost, anybody can add one."""

import re

import numpy as np
import pandas as pd
import pytest

import bench
from bench.corpora.corpus import Corpus
from bench.corpora.recordings import Recordings, captures_in, event_table
from bench.corpora.synth_recordings import generate
from bench.endless.detectors.frames import Frames, Hysteresis, Times
from bench.endless.detectors.threshold import Threshold, TwoInARow
from bench.endless.detectors.ticks import best, signs_of
from bench.endless.page import watch_section
from bench.errors import InputError
from bench.features.touch import TouchFeatures
from bench.models.classic.lda import lda
from bench.outcomes.runs import every_result
from bench.outcomes.store import connect
from tests.conftest import SMALL, runs

MINE = """
from bench.endless.detectors.threshold import Threshold


class Mine(Threshold):
    pass
"""


@pytest.fixture(scope="module")
def recordings():
    """Three generated people with one touch of each gesture, at 30 frames a second."""
    return generate(subjects=3, variants=("normal",), rate_hz=30.0)


def of_one(lengths, events, rate_hz=8.0):
    """Recordings without pressure, with some events."""
    table = pd.DataFrame({"subject": "1", "gesture": [""] * len(lengths)})
    frames = [np.zeros((length, 2, 2), np.uint16) for length in lengths]
    return Recordings(Corpus.from_captures(frames, table, rate_hz), event_table(events))


@pytest.mark.parametrize("detector", [Frames(), Threshold()])
def test_a_later_frame_changes_no_report_and_no_first_label(detector, recordings):
    train = recordings[np.arange(2)]
    captures = captures_in(train)
    make = lambda: lda(TouchFeatures())  # noqa: E731
    watcher, _ = detector.learn(make, make().fit(captures, captures.gestures), captures, train, 60.0)
    whole = recordings[[2]].corpus
    reports = watcher.reports(whole)
    assert len(reports) >= 5
    for row in (1, len(reports) // 2, len(reports) - 1):
        seen = int(reports["reported"][row])
        cut = watcher.reports(whole.changed(lengths=np.array([seen]), digest="", path=None))
        same = ["recording", "reported", "first"]
        pd.testing.assert_frame_equal(cut[same], reports.loc[:row, same])
    (evidence,) = watcher.evidence(whole)
    fitted = watcher.detector
    signals = fitted.signals()
    each = np.stack(
        [
            signals.step(f)
            for f in whole[0][: len(evidence) * watcher.count]
            .reshape(-1, watcher.count, *whole.grid)
            .mean(axis=1, dtype=np.float64)
            .astype(np.float32)
        ]
    )
    for tick in (0, 5, 100, len(each) - 1):  # from the last ticks alone: memory does not grow
        ring = each[max(0, tick + 1 - fitted.memory) : tick + 1]
        np.testing.assert_allclose(fitted.evidence(ring)[-1], evidence[tick], rtol=1e-5, atol=1e-5)


def test_times_come_from_the_labels():
    quick = [(0, 10 * k, 10 * k + (1 if k < 3 else 8), "pat") for k in range(10)]  # gaps of 9 and 2 ticks
    assert Times.of(of_one([200], quick), 0.25, 1.0) == Times(wait=1, hold=1, fade=8)
    slow = [(0, 60 * k, 60 * k + 20, "pat") for k in range(3)]
    assert Times.of(of_one([200], slow), 0.25, 1.0) == Times(wait=2, hold=8, fade=8)


def test_a_touch_begins_above_the_level_and_a_new_one_after_a_dip():
    odds = [-5, 3, 3, 3, -1, 3, 3, -5, -5, 3]
    evidence = np.stack([odds, np.zeros(len(odds))], axis=1)
    signs = signs_of(Hysteresis(1.0, 1.5, Times(wait=2, hold=1, fade=9)), evidence)
    assert np.flatnonzero(signs[:, 2]).tolist() == [2, 6]
    assert signs[:, 1].astype(int).tolist() == [0, 1, 2, 3, 0, 1, 2, 0, 0, 1]
    never = np.stack([odds, np.full(len(odds), -9.0)], axis=1)  # the beginning was not seen
    assert not signs_of(Hysteresis(1.0, 1.5, Times(2, 1, 9)), never)[:, 2].any()
    signs = signs_of(TwoInARow(2.0), np.array([[0], [3], [3], [1.5], [3], [0.5], [3], [3]]))
    assert np.flatnonzero(signs[:, 2]).tolist() == [2, 7]


def test_a_threshold_that_reports_always_is_not_chosen():
    rows = [("always", 0, 1.0, 100, 1300), ("fair", 2, 0.9, 90, 99 + 2), ("many alarms", 500, 0.95, 95, 595)]
    table = pd.DataFrame([(n, a, 1.0, f, h, r) for n, a, f, h, r in rows])
    table.columns = ["level", "alarms", "hours", "found", "hits", "reports"]
    assert best(table, 5.0)["level"] == "fair"


def test_without_background_frames_says_so():
    full = of_one([20], [(0, 0, 20, "pat")])
    with pytest.raises(InputError, match="no background"):
        Frames().fit([np.ones((20, 8), np.float32)], full)


def test_a_detector_of_a_file_watches_like_any_other(tmp_path):
    file = tmp_path / "my.py"
    file.write_text(MINE)
    words = dict(word.split("=", 1) for word in SMALL) | {"model": "lda", "features": "touch"}
    bench.watch(**words, detector=[f"{file}:Mine", "threshold"], **{"detector.up": 30.0})
    mine, own = sorted(runs("watch")[1], key=lambda run: "my.py" not in run.data.params["watch.detector"])
    assert mine.data.params["watch.detector"] == f"{file}:Mine[up=30.0]"
    assert own.data.params["watch.detector"] == "threshold[up=30.0]"
    same = ("touches_found", "end_correct", "fragments", "missed_at_60")
    assert [mine.data.metrics[name] for name in same] == [own.data.metrics[name] for name in same]
    words = watch_section(every_result(connect()), tmp_path, {}).parts[0].sentences
    named = {re.search(r"detector=\S+", line)[0] for line in words[:2]}
    assert named == {"detector=my.py:Mine[up=30.0]", "detector=threshold[up=30.0]"}
