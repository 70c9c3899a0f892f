"""A detector is learned once for all systems, and equals one that is learned alone."""

from dataclasses import replace

import numpy as np
import pytest

from bench.features.touch import TouchFeatures
from bench.ground.scratch import data_folder
from bench.models.classic.lda import lda
from bench.models.classic.softmax import softmax
from bench.models.recipe import Recipe
from touchbench_streams.detectors import learning
from touchbench_streams.detectors.frames import Frames
from touchbench_streams.detectors.threshold import Threshold
from touchbench_streams.detectors.ticks import learn_watcher, steps_of_detector
from touchbench_streams.recordings import cut_into_captures
from touchbench_streams.synth_recordings import generate


@pytest.fixture
def train():
    return generate(subjects=2, variants=("normal",), rate_hz=30.0)


@pytest.fixture
def learned(monkeypatch):
    """Each detector that is learned, not loaded."""
    made, learn = [], learning.learn_detector
    monkeypatch.setattr(learning, "learn_detector", lambda *of: made.append(learn(*of)) or made[-1])
    return made


def watch_with(model, train, detector=None, false_alarms=60.0, repair=()):
    captures = cut_into_captures(train)
    make = lambda: Recipe(model(TouchFeatures()), repair=repair)  # noqa: E731
    system = make().fit(captures, captures.gestures)
    return learn_watcher(detector or Frames(), make, system, train, false_alarms)


def test_a_shared_detector_equals_one_that_is_learned_alone(train, learned):
    repair = ("stuck", "noise")
    watcher, sweep = watch_with(lda, train, repair=repair)
    other, same_sweep = watch_with(softmax, train, repair=repair)
    assert len(learned) == 1 and other.detector is not watcher.detector
    steps = [*steps_of_detector(other.system)], other.system.prediction_steps()
    alone = learning.learn_detector(Frames(), train, *steps, 60.0)
    np.testing.assert_array_equal(
        replace(other, detector=alone.detector).sense(train.corpus).evidence[1],
        other.sense(train.corpus).evidence[1],
    )
    assert other.level == alone.level and sweep.equals(alone.sweep) and same_sweep.equals(sweep)
    for name in ("places", "weights", "bias"):
        np.testing.assert_array_equal(getattr(other.pace, name), getattr(alone.pace, name))
    np.testing.assert_array_equal([*vars(other.limits).values()], [*vars(alone.limits).values()])
    assert other.names is not watcher.names


def test_whatever_differs_is_learned_anew(train, learned):
    watch_with(lda, train, Threshold())
    frames = train.corpus.frames.copy()
    frames[-1, 0, 0] += 1
    labelled = train.labelled.copy()
    labelled.loc[0, "end"] -= 1
    captures = train.corpus.captures.assign(subject="both")
    others = [
        (train, Threshold(tick=0.25)),
        (replace(train, corpus=train.corpus.with_fields(frames=frames)), Threshold()),
        (replace(train, corpus=train.corpus.with_fields(captures=captures)), Threshold()),
        (replace(train, labelled=labelled), Threshold()),
        (train[[1, 0]], Threshold()),
    ]
    for number, (recordings, detector) in enumerate(others, 2):
        watch_with(lda, recordings, detector)
        assert len(learned) == number
    watch_with(lda, train, Threshold(), false_alarms=30.0)
    watch_with(lda, train, Threshold(), repair=("dead",))
    assert len(learned) == 8
    watch_with(softmax, train, Threshold())
    assert len(learned) == 8


def test_a_damaged_file_is_learned_anew(train, learned):
    level = watch_with(lda, train, Threshold())[0].level
    (file,) = (data_folder() / "detectors").iterdir()
    file.write_bytes(file.read_bytes()[:-1])
    assert watch_with(lda, train, Threshold())[0].level == level and len(learned) == 2
