"""Features by hand, whatever lies beside a capture, and on a sensor of one row."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.corpus import Corpus
from bench.corpora.synth import generate
from bench.features.touch import TouchFeatures
from tests.features.captures import corpus_of, ragged, row_of

GRIDS = [(8, 8), (1, 2), (3, 5), (1, 1), (6, 6), (4, 1), (2, 2)]


def one(frames, rate=54.0, full_scale=1024.0):
    return row_of(TouchFeatures(), frames, rate, full_scale)


def test_by_hand_on_a_fingertip_that_taps_and_moves():
    frames = np.zeros((3, 4, 4), np.uint16)
    frames[0, 1, 1], frames[1, 1, 2], frames[2, 1, 2] = 512, 512, 256
    row = one(frames)
    assert row["row_mean"] == 1.5 / 4 and row["col_range"] == 0.25 and row["half_area_q50"] == 1 / 16
    assert row["concentration_mean"] == pytest.approx(1 / 16) and row["peak_q50"] == pytest.approx(np.log(0.5 + 1e-4))
    assert row["spread_mean"] == row["elongation_mean"] == 0
    # changes 1 and -1/4 of full scale in sum; the first frame has the value of the second
    assert row["relative_change_mean"] == pytest.approx((1 + 1 + 1 / 3) / 3)
    assert row["net_change_q5"] == pytest.approx(-1 / 3 * 0.9) and row["one_way_mean"] == pytest.approx(1 / 3)
    assert row["likeness_q95"] == pytest.approx(0.9) and row["likeness_mean"] == pytest.approx(1 / 3)
    assert row["taxels_most_0"] == row["taxels_most_1"] == pytest.approx(np.log(0.5 + 1e-4))
    assert row["taxels_mean_2"] == pytest.approx(np.log(1e-4))


@given(st.integers(0, 1000), st.sampled_from(GRIDS))
def test_neighbours_of_a_capture_change_nothing(seed, grid):
    before, capture, after = ragged(seed, grid)
    row = TouchFeatures().transform(corpus_of([capture], None, 12.0))
    captures = pd.DataFrame({"subject": ["1"], "gesture": ["pat"]})
    for others in ([before], [capture, capture], []):
        frames, start = np.concatenate([*others, capture, after]), sum(map(len, others))
        corpus = Corpus(frames, np.array([start]), np.array([len(capture)]), captures, 12.0, full_scale=1023.0)
        assert TouchFeatures().transform(corpus).equals(row)


def test_columns_that_only_rounding_moves_are_constant():
    """On one row the centre lies in the middle of it, wherever it is pressed."""
    rng = np.random.default_rng(0)
    arrays = [rng.integers(0, 1000, (n, 1, 7)).astype(np.uint16) for n in (2, 3, 40, 41)]
    table = TouchFeatures().extract(corpus_of(arrays, None, 50.0))
    still = table[["row_crossings", "row_turns", "row_sd", "row_step", "row_range", "row_skewness"]]
    assert still.eq(0).all(axis=None) and table["row_mean"].round(6).eq(0.5).all()
    varied = TouchFeatures().transform(generate(subjects=1, repetitions=1))
    assert (varied.std() > 1e-6).all()  # generated gestures differ in every column
