"""The published networks: parameters and memory as printed, layers against loops."""

import pickle

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from bench.features.touch import frame_signals
from bench.models.nets import ren2023, touchnet
from bench.models.nets.cnn85 import CNN85
from bench.models.nets.hughes2017 import Hughes2017AERNN, Hughes2017CNN, Hughes2017CNNRNN, Recurrent
from bench.models.nets.ren2023 import Ren2023Transformer
from bench.models.nets.time_blocks import TimeConv3d, convolve_and_pool
from bench.models.nets.training import count_activations
from bench.models.nets.zhou2016 import Zhou2016CNN3D, Zhou2016GMLSTM
from tests.conftest import random_corpus

FOURTEEN = tuple("abcdefghijklmn")


def at(rate, **kwargs):
    return random_corpus(**kwargs).with_fields(rate_hz=rate)


def test_the_subject_who_chooses_the_epoch_is_not_trained_on(corpus, monkeypatch):
    seen, samples = [], Zhou2016GMLSTM.samples
    monkeypatch.setattr(
        Zhou2016GMLSTM, "samples", lambda self, c: seen.append(set(c.subjects)) or samples(self, c)
    )
    model = Zhou2016GMLSTM(frames=16, epochs=2, batch=16).fit(corpus, corpus.gestures)
    trained, judged = seen
    assert len(judged) == 1 and trained == set(corpus.subjects) - judged
    assert all("held_accuracy" in row for row in model.history_)


@pytest.mark.parametrize(
    ("system", "rate", "classes", "parameters", "memory"),
    [
        (
            Hughes2017CNN,
            135.0,
            14,
            11_204,
            6_494 + 30 * 26 * 7 * 7 + 10 * 9 * 2 * 2,
        ),  # printed 80 too small
        (
            Hughes2017CNN,
            54.0,
            7,
            17_157,
            4_255 + 30 * 18 * 6 * 6 + 20 * 5 * 2 * 2,
        ),  # Table VIII, and what is pooled
        (Hughes2017CNNRNN, 135.0, 14, 16_254, 45_124),
        (Hughes2017CNNRNN, 54.0, 7, 22_207, 24_145),  # one more layer of 50
        (Hughes2017AERNN, 135.0, 14, 40_949, 488),
        (Hughes2017AERNN, 54.0, 7, 40_767, 481),
    ],
)
def test_published_sizes_of_hughes2017(system, rate, classes, parameters, memory):
    corpus = at(rate, gestures=FOURTEEN[:classes], per_class=1, subjects=2, longest=12)
    model = system(epochs=1).fit(corpus, corpus.gestures)
    assert (model.parameters_, model.activations_) == (parameters, memory)
    longest = corpus[np.argsort(-corpus.lengths)]
    assert (
        system(epochs=1).fit(longest, longest.gestures).activations_ == memory
    )  # of a step, however long it was
    frames = at(rate, subjects=1, per_class=1, gestures=("pat",), longest=1400, seed=1).detach()
    steps = pickle.loads(pickle.dumps(model)).samples(frames).steps
    most = {
        Hughes2017CNN: 1,
        Hughes2017CNNRNN: 36 if rate > 100 else 46,
        Hughes2017AERNN: 270 if rate > 100 else 432,
    }
    assert frames.lengths[0] > 600 and steps.max() == most[system]


def test_published_sizes_of_the_others():
    one = torch.zeros(1, 144, 8, 8)
    attention = Ren2023Transformer().network(8, 8, 7).eval()
    layers = 144 * 64 + 144 * 512 + 144 * (128 + 16 + 4) + 7  # input, embedding, the head
    each = 5 * 144 * 512 + 8 * 144**2  # queries, keys, values, their mix, output; scores of 8 heads
    assert count_activations(attention, one) == layers + 6 * each
    for net, frames, size in (
        (attention, 144, 6_415_291),  # printed as 6.42 million
        (Zhou2016CNN3D().network(8, 8, 7), 432, 490_119),
        (CNN85().network(8, 8, 14), 85, 909_070),
    ):
        net.eval()(torch.zeros(1, frames, 8, 8))
        assert sum(p.numel() for p in net.parameters()) == size


def gradients(output, net, seed=0):
    """Of a weighted sum of an output."""
    weight = torch.rand(
        output.shape, generator=torch.Generator().manual_seed(seed), dtype=output.dtype
    )
    parameters = list(net.parameters())
    by_parameter = torch.autograd.grad((output * weight).sum(), parameters, allow_unused=True)
    return [
        torch.zeros_like(p) if g is None else g
        for p, g in zip(parameters, by_parameter, strict=True)
    ]


@given(st.tuples(*[st.integers(1, 6)] * 3), st.tuples(*[st.integers(0, 5)] * 3), st.integers(1, 3))
def test_blocks_of_time_convolve_as_the_library_does(kernel, more, batch):
    torch.manual_seed(0)
    layer = TimeConv3d(4, kernel).double()
    x = torch.rand(batch, *(k + m for k, m in zip(kernel, more, strict=True))).double()
    ours, library = convolve_and_pool(layer, x, (1, 1, 1)), layer(x)
    torch.testing.assert_close(ours, library)
    torch.testing.assert_close(gradients(ours, layer), gradients(library, layer))


@given(st.lists(st.integers(1, 6), min_size=1, max_size=5), st.integers(0, 99))
def test_the_recurrent_layer_equals_a_loop_over_each_sequence(counts, seed):
    torch.manual_seed(seed)
    net = Recurrent(nn.Flatten(), 3, nn.Linear(3, 2)).double()
    x, steps = torch.rand(sum(counts), 4).double(), torch.tensor(counts)
    ours, expected = net((x, steps)), []
    for sequence in x.split(counts):
        state = torch.zeros(3).double()
        for inputs in sequence:
            state = torch.tanh(
                net.input_layer.weight @ inputs
                + net.input_layer.bias
                + net.recurrent_layer.weight @ state
            )
            expected.append(net.head(state))
    expected = torch.stack(expected)
    torch.testing.assert_close(ours, expected)
    torch.testing.assert_close(gradients(ours, net), gradients(expected, net))


def test_attention_of_ones_own_is_that_of_the_library():
    torch.manual_seed(0)
    own = ren2023._SelfAttention(ren2023.WIDTH, ren2023.HEADS, batch_first=True)
    library = nn.MultiheadAttention(ren2023.WIDTH, ren2023.HEADS, batch_first=True)
    library.load_state_dict(own.state_dict())
    x = torch.randn(3, 7, ren2023.WIDTH)
    ours, theirs = own(x), library(x, x, x, need_weights=False)[0]
    torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(
        gradients(ours, own), gradients(theirs, library), rtol=1e-3, atol=1e-3
    )


def test_a_mounting_has_the_signals_of_a_turned_skin():
    frames = np.random.default_rng(0).random((9, 4, 4), dtype=np.float32)
    expected = [
        frame_signals(np.rot90(f, k, axes=(1, 2)))
        for k in range(4)
        for f in (frames, frames[:, :, ::-1])
    ]
    own = torch.from_numpy(frame_signals(frames).astype(np.float32))
    torch.manual_seed(0)
    found = touchnet._mount_randomly(own.expand(400, *own.shape)).numpy()
    same = np.array(
        [[np.allclose(one, other, rtol=1e-4, atol=1e-4) for other in expected] for one in found]
    )
    assert (same.sum(axis=1) == 1).all() and (
        same.sum(axis=0) > 20
    ).all()  # each of the eight about 50 times
