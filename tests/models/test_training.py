"""The training loop, its optimisers, windows and votes: by hand and against loops."""

from contextlib import suppress

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from bench.corpora.corpus import Corpus
from bench.features.touch import SIGNALS
from bench.models.nets.cnn85 import RATES, SelectiveSGD
from bench.models.nets.touchnet import SignalWindows
from bench.models.nets.training import (
    Optimiser,
    Schedule,
    Sequences,
    Training,
    Windows,
    train_alone,
)
from bench.models.nets.window import vote_shares
from tests.conftest import random_corpus

PAPER = RATES["paper"]


@pytest.fixture(scope="module")
def windows():
    return Windows(random_corpus(subjects=1), 5, 5)


def linear():
    return nn.Sequential(nn.Flatten(), nn.Linear(320, 2))


def trained(net, windows, schedule, target=0, rate=0.0, judge=None):
    """The history of a training, by default of one that changes nothing."""
    optimiser = Optimiser(torch.optim.SGD(net.parameters(), rate))
    target = target + np.zeros(len(windows), dtype=int)
    training = Training(net, windows, target, optimiser, schedule, nn.Module.__call__, judge)
    return train_alone(training.iterate(), 0)


def test_an_epoch_is_a_new_order_of_whole_batches_in_training_mode(windows, monkeypatch):
    seen, batch, net = [], windows.make_batch, linear()
    monkeypatch.setattr(
        windows, "make_batch", lambda rows: seen.append([net.training, *rows]) or batch(rows)
    )
    trained(net, windows, Schedule(2, 16, 0), judge=lambda: float(net.eval().training))
    steps = np.array(seen).reshape(2, -1, 17)
    assert steps[..., 0].all() and steps.shape[1] == len(windows) // 16
    first, second = steps[..., 1:].reshape(2, -1).tolist()
    assert len(first) == len({*first}) == len({*second}) and first != second


def test_the_best_epoch_is_kept_and_training_stops_when_the_loss_stands_still(windows):
    net, judged, bias = linear(), iter([0.2, 0.7, 0.7, 0.1]), iter([1.0, 2.0, 3.0, 4.0])

    def judge():
        with torch.no_grad():
            net[1].bias.fill_(next(bias))
        return next(judged)

    history = trained(net, windows, Schedule(4, 8, 0), judge=judge)
    assert [row["held_accuracy"] for row in history] == [0.2, 0.7, 0.7, 0.1]
    assert net[1].bias.tolist() == [2.0, 2.0]
    assert len(trained(net, windows, Schedule(50, len(windows), 0, patience=3))) == 6


def test_loss_with_smoothing_by_hand(windows):
    """Mean cross-entropy against labels of which a share is spread over the classes."""
    net, target = linear(), np.arange(len(windows)) % 2
    (row,) = trained(net, windows, Schedule(1, len(windows), 0, smoothing=0.2), target)
    proba = net(windows.make_batch(np.arange(len(windows)))).softmax(1).detach().numpy()
    expected = np.eye(2)[target] * 0.8 + 0.1
    assert row == {
        "loss": pytest.approx(-(expected * np.log(proba)).sum(1).mean(), rel=1e-5),
        "rate": 0.0,
    }


def test_a_training_that_diverges_says_where_unless_an_epoch_was_judged(windows):
    with pytest.raises(FloatingPointError, match=r"epoch \d .*1e\+38"):
        trained(linear(), windows, Schedule(4, 8, 0), np.arange(len(windows)) % 2, rate=1e38)
    fresh = linear()

    def judge():  # after which the network can only diverge
        fresh.register_forward_hook(lambda *_: torch.full((8, 2), np.nan, requires_grad=True))
        return 0.5

    assert len(trained(fresh, windows, Schedule(4, 8, 0), judge=judge)) == 2
    assert torch.isfinite(fresh[1].weight).all()


def test_the_optimiser_of_cnn85_equals_the_update_rule_written_out():
    torch.manual_seed(0)
    net = nn.Linear(3, 2)
    expected = [p.detach().clone().numpy() for p in net.parameters()]
    momentum = [np.zeros_like(p) for p in expected]
    sgd = SelectiveSGD(net, PAPER)
    sgd.rate = 0.1
    for t in range(1, 5):
        sgd.zero_grad()
        net(torch.full((1, 3), float(t))).square().sum().backward()
        gradients = [p.grad.numpy().copy() for p in net.parameters()]
        sgd.step()
        for i, (decay, g) in enumerate(
            zip((1e-4, 0), gradients, strict=True)
        ):  # of weights, not of biases
            momentum[i] = 0.9 * momentum[i] - 0.1 * g - decay * expected[i]
            expected[i] = expected[i] + 0.1 * momentum[i] / (1 - 0.9**t)
        for p, value in zip(net.parameters(), expected, strict=True):
            np.testing.assert_allclose(p.detach().numpy(), value, rtol=1e-5)


def test_the_search_keeps_the_rate_with_the_lowest_last_loss_and_discards_the_trial():
    """The loss is the square of the only weight; rates from 1 on throw it out of this valley."""
    net = nn.Linear(1, 1, bias=False)
    nn.init.ones_(net.weight)
    sgd, losses = SelectiveSGD(net, PAPER), {}

    def take_all(steps):
        with suppress(StopIteration):
            next(steps)
            while True:
                sgd.zero_grad()
                loss = 2 * net.weight.square().sum()
                loss.backward()
                sgd.step()
                losses[sgd.rate] = loss.item()  # the last one stays
                steps.send(loss.detach())

    for epoch, is_searched in ((0, True), (1, False), (10, True)):
        sgd.rate = 0.123
        take_all(sgd.before_epoch(epoch, [None] * 40))
        best = min(losses, key=losses.get)
        assert sgd.rate == (best if is_searched else 0.123)
        assert sgd.rates == tuple(rate for rate in PAPER if rate <= best)
        assert net.weight.item() == 1 and sgd.steps == 0 and not sgd.momentum[0].any()


# Windows


def loop(frames, length, hop, padding):
    """Start, frames seen and padded values of each window, by counting."""
    windows, start = [], 0
    while True:
        piece = frames[start : start + length]
        padded = (
            np.zeros((length, *frames.shape[1:]))
            if padding == "zero"
            else np.stack([frames[-1]] * length)
        )
        padded[: len(piece)] = piece
        windows.append((start, len(piece), padded))
        if start + length >= len(frames):
            return windows
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
    expected = [
        (i, *w) for i, frames in enumerate(corpus) for w in loop(frames, length, hop, padding)
    ]
    assert list(zip(windows.capture, windows.start, windows.seen, strict=True)) == [
        e[:3] for e in expected
    ]
    order = np.random.default_rng(seed).permutation(len(windows))
    batch = windows.make_batch(order)
    assert torch.equal(batch, windows.place(torch.device("cpu")).make_batch(order))
    assert batch.dtype == torch.float32 and batch.shape == (len(order), length, *grid)
    np.testing.assert_allclose(
        batch.numpy(), np.stack([expected[i][3] for i in order]) / 1023, rtol=1e-6
    )


@given(st.integers(1, 8), st.integers(1, 8), st.integers(1, 5), st.integers(0, 99))
def test_sequences_equal_a_loop(frames, hop, longest, seed):
    corpus = random_corpus(subjects=1, per_class=2, seed=seed)[np.array([3, 0, 5])]
    windows = Windows(corpus, frames, min(hop, frames))
    sequences = Sequences(windows, longest)
    expected = []
    for capture in range(3):
        mine = np.flatnonzero(windows.capture == capture)
        for piece in [mine[i : i + longest] for i in range(0, len(mine), longest)]:
            end = windows.start[piece[-1]] + windows.seen[piece[-1]]
            expected.append(
                (capture, windows.start[piece[0]], end - windows.start[piece[0]], len(piece), piece)
            )
    columns = zip(sequences.capture, sequences.start, sequences.seen, sequences.steps, strict=True)
    assert list(columns) == [e[:4] for e in expected]
    order = np.random.default_rng(seed).permutation(len(sequences))
    values, steps = sequences.make_batch(order)
    assert steps.tolist() == [expected[i][3] for i in order]
    assert torch.equal(values, windows.make_batch(np.concatenate([expected[i][4] for i in order])))


@given(st.lists(st.integers(1, 40), min_size=2, max_size=5), st.integers(0, 99))
def test_training_windows_of_signals_stay_within_their_captures(lengths, seed):
    arrays = [
        np.full((n, 2, 2), 100 + k, dtype=np.uint16) for k, n in enumerate(lengths)
    ]  # tell them by their total
    captures = pd.DataFrame({"subject": ["1"] * len(arrays), "gesture": ["pat"] * len(arrays)})
    corpus = Corpus.from_captures(arrays, captures, 50.0)
    drawn, total = SignalWindows(corpus, 12, 6, is_random=True), SIGNALS.index("total")
    totals = drawn.values[np.cumsum([0, *lengths[:-1]]), total]
    torch.manual_seed(seed)
    values, seen = drawn.make_batch(np.tile(np.arange(len(drawn)), 5))
    for window, count, capture in zip(
        values[..., total], seen, np.tile(drawn.capture, 5), strict=True
    ):
        assert 1 <= count <= lengths[capture] and (window[:count] == totals[capture]).all()


def test_votes_by_hand():
    proba = np.array([[0.9, 0.1], [0.4, 0.6], [0.4, 0.6], [0.2, 0.8], [0.7, 0.3]], dtype=np.float32)
    shares = vote_shares(proba, np.array([3, 2]))
    assert shares.argmax(axis=1).tolist() == [
        1,
        1,
    ]  # 2 of 3 against a higher mean; a tie by the mean
    np.testing.assert_allclose(shares.sum(axis=1), 1, rtol=1e-6)
    assert np.array_equal(vote_shares(proba, np.ones(5, dtype=int)), proba)
