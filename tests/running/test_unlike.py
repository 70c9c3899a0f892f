"""Captures that look unlike all training captures."""

import numpy as np
import pandas as pd
import pytest

from bench.corpora.corpus import Corpus
from bench.corpora.synth import generate
from bench.running.unlike import LEVEL, is_unlike_training, reading_statistics, usual_range


def corpus_of(*captures, full_scale=1023.0):
    table = pd.DataFrame({"subject": "a", "gesture": "tap"}, index=range(len(captures)))
    return Corpus.from_captures(
        [np.asarray(c, np.float32) for c in captures], table, 50.0, full_scale=full_scale
    )


def test_looks_of_a_capture_by_hand():
    frames = [[[0, 2, 4], [8, 0, 0]], [[10, 10, 10], [10, 0, 20]]]
    # rows differ by 2, 2, 8, 0 and 0, 0, 10, 20; columns by 8, 2, 4 and 0, 10, 10
    mean, across, down = 0.74 / 12, 0.42 / 8 + LEVEL, 0.34 / 6 + LEVEL
    expected = [mean, 0.2, 0.14 / 6, across / (mean + LEVEL), down / (mean + LEVEL), across / down]
    expected = np.log([*(np.array(expected) + LEVEL), 1 + 4 / 12])
    np.testing.assert_allclose(
        reading_statistics(corpus_of(frames, full_scale=100.0))[0], expected, rtol=1e-6
    )


@pytest.mark.parametrize("shape", [(1, 4), (4, 1), (1, 1)])
def test_a_sensor_of_one_row_or_column_is_told_from_its_inverse(shape):
    frames = np.random.default_rng(0).integers(0, 300, (3, 20, *shape))
    captures = corpus_of(*frames)
    assert not is_unlike_training(captures, usual_range(captures)).any()
    assert is_unlike_training(corpus_of(*(1023 - frames)), usual_range(captures)).all()


def test_a_left_out_person_is_usual_and_other_readings_are_not():
    corpus = generate(subjects=6, rows=5, cols=5)
    left_out = corpus.subjects == "1"
    range_, rest = usual_range(corpus[np.flatnonzero(~left_out)]), corpus[np.flatnonzero(left_out)]
    assert is_unlike_training(rest, range_).mean() <= 0.05
    for change in (lambda f: 1023 - f, lambda f: f // 8):
        assert is_unlike_training(rest.with_fields(frames=change(rest.frames)), range_).mean() > 0.9
