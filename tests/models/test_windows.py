"""Windows of ragged captures against a loop, the training loop, and the published counts."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from bench.errors import InputError
from models.nets.cnn85 import CNN85, SelectiveSGD
from models.nets.cnn85 import RATES as LISTS
from models.nets.training import Windows, train
from tests.conftest import random_corpus

RATES = LISTS["paper"]


def loop(frames, length, hop, padding):
    """Start, frames seen and padded values of each window, by counting."""
    found, start = [], 0
    while True:
        piece = frames[start : start + length]
        padded = np.zeros((length, *frames.shape[1:])) if padding == "zero" else np.stack([frames[-1]] * length)
        padded[: len(piece)] = piece
        found.append((start, len(piece), padded))
        if start + length >= len(frames):
            return found
        start += hop


@given(
    st.integers(1, 30),
    st.integers(1, 30),
    st.integers(0, 1000),
    st.sampled_from([(8, 8), (2, 3)]),
    st.sampled_from(["zero", "edge"]),
)
def test_windows_equal_a_loop(length, hop, seed, grid, padding):
    hop = min(hop, length)
    corpus = random_corpus(subjects=1, per_class=2, seed=seed, grid=grid)[np.array([3, 0, 5])]
    windows = Windows(corpus, length, hop, padding)
    expected = [(i, *w) for i, frames in enumerate(corpus) for w in loop(frames, length, hop, padding)]
    assert [tuple(t) for t in zip(windows.capture, windows.start, windows.seen, strict=True)] == [
        e[:3] for e in expected
    ]
    order = np.random.default_rng(seed).permutation(len(windows))
    batch = windows.batch(order)
    assert batch.dtype == torch.float32 and batch.shape == (len(order), length, *grid)
    np.testing.assert_allclose(batch.numpy(), np.stack([expected[i][3] for i in order]) / 1023, rtol=1e-6)


@pytest.mark.parametrize(
    ("frames", "length", "hop", "count"),
    [
        (10, 45, 15, 1),
        (1297, 45, 15, 85),
        (1747, 45, 15, 115),
        (432, 27, 9, 46),
        (432, 85, 85, 6),
        (85, 85, 85, 1),
        (86, 85, 85, 2),
    ],
)
def test_published_window_counts(frames, length, hop, count):
    corpus = random_corpus(subjects=1, per_class=1)
    one = type(corpus).from_captures([np.zeros((frames, 8, 8), np.uint16)], corpus.captures[:1], 135.0)
    assert len(Windows(one, length, hop)) == count


def test_cnn85_has_the_published_size_and_shapes():
    net = CNN85().network(8, 8, 14)
    shapes, x = [], torch.zeros(1, 85, 8, 8)
    for layer in net:
        x = layer(x)
        shapes.append(tuple(x.shape[1:]))
    maps = [shapes[i] for i in (0, 2, 3, 5, 6, 8, 9)]
    assert maps == [(64, 8, 8), (64, 4, 4), (128, 5, 5), (128, 3, 3), (256, 3, 3), (256, 2, 2), (1024,)]
    assert sum(p.numel() for p in net.parameters()) == 909_070


def test_a_narrower_cnn85_has_fewer_parameters():
    net = CNN85(width=0.25).network(8, 8, 14)
    net(torch.zeros(1, 85, 8, 8))
    # filters 16, 32, 64 and 128 units; 4 x 64 values before the dense layer
    counted = (9 * 85 * 16 + 16) + (4 * 16 * 32 + 32) + (9 * 32 * 64 + 64) + (256 * 128 + 128) + (128 * 14 + 14)
    assert sum(p.numel() for p in net.parameters()) == counted
    with pytest.raises(InputError, match="model.width=0: give a share"):
        CNN85(width=0.0).check()


def small(seed=0, epochs=2, **parameters):
    return CNN85(frames=10, epochs=epochs, batch=16, seed=seed, **parameters)


def test_a_seed_gives_the_same_network_bit_for_bit(corpus):
    a, b, c = (small(seed).fit(corpus, corpus.gestures) for seed in (0, 0, 1))
    assert a.history_ == b.history_ and len(a.history_) == 2
    assert np.array_equal(a.predict_proba(corpus), b.predict_proba(corpus))
    assert not np.array_equal(a.predict_proba(corpus), c.predict_proba(corpus))


def test_capture_probabilities_are_means_over_windows(corpus):
    model = small().fit(corpus, corpus.gestures)
    table, proba = model.decide(corpus)
    expected = [proba[table["capture"] == i].mean(axis=0) for i in range(len(corpus))]
    np.testing.assert_allclose(model.predict_proba(corpus), expected, rtol=1e-5)
    alone = np.concatenate([model.predict_proba(corpus[i : i + 1]) for i in range(len(corpus))])
    np.testing.assert_allclose(alone, model.predict_proba(corpus), rtol=1e-4, atol=1e-6)


def test_it_learns_what_can_be_learnt(corpus):
    model = small(epochs=40).fit(corpus, corpus.gestures)
    assert model.score(corpus, corpus.gestures) > 0.7
    assert model.history_[-1]["loss"] < model.history_[0]["loss"]


def test_the_optimiser_equals_the_update_rule_written_out():
    torch.manual_seed(0)
    net = torch.nn.Linear(3, 2)
    weight, bias = net.weight.detach().clone().numpy(), net.bias.detach().clone().numpy()
    sgd = SelectiveSGD(net, RATES)
    sgd.rate = 0.1
    m_weight, m_bias = np.zeros_like(weight), np.zeros_like(bias)
    for t in range(1, 5):
        sgd.zero_grad()
        net(torch.full((1, 3), float(t))).square().sum().backward()
        g_weight, g_bias = net.weight.grad.numpy().copy(), net.bias.grad.numpy().copy()
        sgd.step()
        m_weight = 0.9 * m_weight - 0.1 * g_weight - 1e-4 * weight
        m_bias = 0.9 * m_bias - 0.1 * g_bias
        weight = weight + 0.1 * m_weight / (1 - 0.9**t)
        bias = bias + 0.1 * m_bias / (1 - 0.9**t)
        np.testing.assert_allclose(net.weight.detach().numpy(), weight, rtol=1e-5)
        np.testing.assert_allclose(net.bias.detach().numpy(), bias, rtol=1e-5)


class Valley:
    """A net of one number whose loss is its square; rates from 1 on throw it out of the valley."""

    def __init__(self):
        self.module = torch.nn.Linear(1, 1, bias=False)
        torch.nn.init.ones_(self.module.weight)
        self.sgd = SelectiveSGD(self.module, RATES)

    def step(self, rows):
        self.sgd.zero_grad()
        loss = 2 * self.module.weight.square().sum()
        loss.backward()
        self.sgd.step()
        return loss.item()


def test_the_search_keeps_the_rate_with_the_lowest_last_loss_and_discards_the_trial():
    losses = {}
    for rate in RATES:
        valley = Valley()
        valley.sgd.rate = rate
        losses[rate] = [valley.step(None) for _ in range(30)][-1]
    best = min(losses, key=losses.get)
    valley = Valley()
    valley.sgd.search(0, np.zeros((40, 2)), valley.step)
    assert valley.sgd.rate == best
    assert valley.module.weight.item() == 1 and valley.sgd.steps == 0 and not valley.sgd.momentum[0].any()
    assert valley.sgd.rates == tuple(r for r in RATES if r <= best)
    valley.sgd.rate = 0.123
    valley.sgd.search(1, np.zeros((40, 2)), valley.step)
    assert valley.sgd.rate == 0.123  # between the searches it stays


def test_the_hop_is_that_of_training_windows(corpus):
    model = CNN85(frames=10, hop=3)
    lengths = corpus.lengths
    assert len(model.training_samples(corpus)) == sum(max(1, -(-(n - 10) // 3) + 1) for n in lengths)
    assert len(model.samples(corpus)) == sum(-(-n // 10) for n in lengths)
    fitted = CNN85(frames=10, hop=3, epochs=1, batch=16).fit(corpus, corpus.gestures)
    assert len(fitted.decide(corpus)[0]) == len(model.samples(corpus))


def test_the_toolbox_tries_more_rates(corpus):
    model = CNN85(frames=10, rates="toolbox", epochs=1, batch=16).fit(corpus, corpus.gestures)
    assert model.history_[0]["rate"] in (1, 0.5, 0.1, 0.05, 0.01, 0.005, 0.001, 0.0005)
    with pytest.raises(InputError, match="model.padding=mirror: give zero or edge"):
        CNN85(padding="mirror").check()
    with pytest.raises(InputError, match="model.hop=40: frames between windows of 20"):
        CNN85(frames=20, hop=40).fit(corpus, corpus.gestures)


def test_an_epoch_leaves_out_only_the_incomplete_batch(corpus):
    windows = Windows(corpus, 10, 10)
    net = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(640, 3))
    seen = []
    original = windows.batch
    windows.batch = lambda rows: (seen.append(rows), original(rows))[1]
    train(net, windows, np.zeros(len(windows)), SelectiveSGD(net, RATES), epochs=3, batch=16, seed=0)
    per_epoch = len(windows) // 16
    assert len(seen) == 3 * per_epoch
    for epoch in range(3):
        rows = np.concatenate(seen[epoch * per_epoch : (epoch + 1) * per_epoch])
        assert len(set(rows)) == len(rows) == per_epoch * 16
