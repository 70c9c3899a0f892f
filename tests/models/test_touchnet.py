"""The network on signals: windows of ragged captures, mountings of the skin, and answers that stand alone."""

import numpy as np
import pandas as pd
import torch
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.corpus import Corpus
from bench.features.touch import OF_STEPS, SIGNALS, signals
from bench.models.nets import touchnet
from bench.models.nets.touchnet import Stretches


def corpus_of(arrays, rate=50.0):
    captures = pd.DataFrame({"subject": ["1"] * len(arrays), "gesture": ["pat"] * len(arrays)})
    return Corpus.from_captures(arrays, captures, rate)


def random_frames(seed, lengths, grid=(4, 4)):
    rng = np.random.default_rng(seed)
    return [rng.integers(0, 1023, (n, *grid)).astype(np.uint16) for n in lengths]


@given(st.lists(st.integers(1, 40), min_size=1, max_size=5), st.integers(1, 15), st.integers(0, 99))
def test_windows_equal_a_loop(lengths, frames, seed):
    arrays = random_frames(seed, lengths, (2, 3))
    hop = (frames + 1) // 2
    found = Stretches(corpus_of(arrays), frames, hop)
    expected = []
    for capture, array in enumerate(arrays):
        own = signals(array.astype(np.float32) / np.float32(1023))
        if len(own) > 1:
            own[0, [*OF_STEPS]] = own[1, [*OF_STEPS]]
        start = 0
        while start == 0 or start + frames <= len(array):
            expected.append((capture, start, own[start : start + frames]))
            start += hop
    assert [(c, s) for c, s, _ in expected] == list(zip(found.capture, found.start, strict=True))
    values, seen = found.batch(np.arange(len(found)))
    assert list(seen) == [len(own) for *_, own in expected] == list(found.seen)
    for window, count, (_, _, own) in zip(values.numpy(), seen, expected, strict=True):
        np.testing.assert_allclose(window[:count], own, rtol=1e-6, atol=1e-6)


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


def test_a_mounting_has_the_signals_of_a_turned_skin():
    (frames,) = random_frames(0, [9])
    turned = [np.rot90(f, k, axes=(1, 2)) for k in range(4) for f in (frames, frames[:, :, ::-1])]
    expected = [signals(f.astype(np.float32) / np.float32(1023)) for f in turned]
    own = torch.from_numpy(signals(frames.astype(np.float32) / np.float32(1023)).astype(np.float32))
    torch.manual_seed(0)
    found = touchnet._mounted(own.expand(400, *own.shape)).numpy()
    counts = np.zeros(8, dtype=int)
    for one in found:
        same = [np.allclose(one, other, rtol=1e-4, atol=1e-4) for other in expected]
        assert sum(same) == 1
        counts += same
    assert (counts > 20).all()  # each of the eight about 50 times
