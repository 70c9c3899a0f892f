"""Positions that travel come back as they were, and those of neighbours are short."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.stretches import positions_of, stretches_of
from bench.plan.plan import Fold

runs = st.lists(st.tuples(st.integers(0, 10_000), st.integers(1, 9)), max_size=12)


@given(runs=runs, kind=st.sampled_from([np.int32, np.int64]))
def test_positions_come_back(runs, kind):
    positions = np.array([first + i for first, count in runs for i in range(count)], dtype=kind)
    back = positions_of(*stretches_of(positions))
    assert back.dtype == kind and back.tolist() == positions.tolist()


@pytest.mark.parametrize("position", [0, 7])
def test_one_position_and_none(position):
    assert positions_of(*stretches_of(np.array([position]))).tolist() == [position]
    assert positions_of(*stretches_of(np.array([], dtype=np.int64))).tolist() == []


def test_a_person_left_out_of_a_million_captures_travels_in_a_few_words():
    every = np.arange(1_000_000, dtype=np.int32)
    fold = Fold("7", np.concatenate([every[:700], every[800:]]), every[700:800])
    sent = pickle.dumps(fold)
    assert len(sent) < 1000
    back = pickle.loads(sent)
    assert back.name == "7" and (back.train == fold.train).all() and (back.test == fold.test).all()
