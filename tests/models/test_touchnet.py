"""The network on signals: windows of ragged captures, mountings of the skin, and answers that stand alone."""

import numpy as np
import pandas as pd
import torch
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.corpus import Corpus
from bench.features.touch import SIGNALS
from bench.models.nets.touchnet import Stretches


def corpus_of(arrays, rate=50.0):
    captures = pd.DataFrame({"subject": ["1"] * len(arrays), "gesture": ["pat"] * len(arrays)})
    return Corpus.from_captures(arrays, captures, rate)


@given(st.lists(st.integers(1, 40), min_size=2, max_size=5), st.integers(0, 99))
def test_training_windows_stay_within_their_captures(lengths, seed):
    arrays = [np.full((n, 2, 2), 100 + k, dtype=np.uint16) for k, n in enumerate(lengths)]  # tell them by their total
    drawn = Stretches(corpus_of(arrays), 12, 6, drawn=True)
    totals = drawn.values[np.cumsum([0, *lengths[:-1]]), SIGNALS.index("total")]
    torch.manual_seed(seed)
    for _ in range(5):
        values, seen = drawn.batch(np.arange(len(drawn)))
        for window, count, capture in zip(values[..., SIGNALS.index("total")], seen, drawn.capture, strict=True):
            assert 1 <= count <= lengths[capture] and (window[:count] == totals[capture]).all()
