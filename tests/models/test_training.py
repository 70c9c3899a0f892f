"""The training loop and its optimisers, on networks of a layer or two."""

import numpy as np
import pytest
import torch
from torch import nn

from bench.models.nets.cnn85 import RATES, SelectiveSGD
from bench.models.nets.training import Optimiser, Schedule, Windows, train
from tests.conftest import random_corpus

PAPER = RATES["paper"]


def still(net):
    """Changes nothing."""
    return Optimiser(torch.optim.SGD(net.parameters(), 0.0))


@pytest.fixture(scope="module")
def windows():
    return Windows(random_corpus(subjects=1), 5, 5)


def dropping(units=8):
    torch.manual_seed(0)
    return nn.Sequential(nn.Flatten(), nn.Linear(320, units), nn.ReLU(), nn.Dropout(0.5), nn.Linear(units, 2))


def test_an_epoch_is_a_new_order_without_the_incomplete_batch_with_dropout(windows, monkeypatch):
    seen, modes, batch, net = [], set(), windows.batch, dropping()

    def noted(rows):
        seen.append(rows)
        modes.add(net.training)
        return batch(rows)

    monkeypatch.setattr(windows, "batch", noted)
    for size, batches in ((16, len(windows) // 16), (10_000, 1)):
        seen.clear()
        evaluated = lambda: float(net.eval().training)  # noqa: E731
        train(net, windows, np.zeros(len(windows)), still(net), Schedule(3, size, 0), judge=evaluated)
        epochs = np.array(seen).reshape(3, batches * min(size, len(windows)))
        assert len(seen) == 3 * batches and modes == {True}
        assert all(len(set(rows)) == len(rows) for rows in epochs) and not np.array_equal(epochs[0], epochs[1])


def test_the_best_epoch_is_kept_and_training_stops_when_the_loss_stands_still(windows):
    target = np.zeros(len(windows), dtype=int)
    net = nn.Sequential(nn.Flatten(), nn.Linear(320, 2))
    judged, bias = iter([0.2, 0.7, 0.7, 0.1]), iter([1.0, 2.0, 3.0, 4.0])

    def judge():
        with torch.no_grad():
            net[1].bias.fill_(next(bias))
        return next(judged)

    history = train(net, windows, target, still(net), Schedule(4, 8, 0), judge=judge)
    assert [row["held_accuracy"] for row in history] == [0.2, 0.7, 0.7, 0.1]
    assert net[1].bias.tolist() == [2.0, 2.0]
    assert len(train(net, windows, target, still(net), Schedule(50, len(windows), 0, patience=3))) == 6


def test_loss_with_smoothing_and_several_decisions_by_hand(windows):
    """Mean cross-entropy against labels of which a share is spread over the classes."""
    net = nn.Sequential(nn.Flatten(), nn.Linear(320, 2))
    target = np.arange(len(windows)) % 2
    (row,) = train(net, windows, target, still(net), Schedule(1, len(windows), 0, smoothing=0.2))
    proba = net(windows.batch(np.arange(len(windows)))).softmax(1).detach().numpy()
    expected = np.eye(2)[target] * 0.8 + 0.1
    assert row == {"loss": pytest.approx(-(expected * np.log(proba)).sum(1).mean(), rel=1e-5), "rate": 0.0}


def test_a_training_that_diverges_says_where_unless_an_epoch_was_judged(windows):
    target = np.arange(len(windows)) % 2
    net = nn.Sequential(nn.Flatten(), nn.Linear(320, 2))
    with pytest.raises(FloatingPointError, match=r"epoch \d .*1e\+38"):
        train(net, windows, target, Optimiser(torch.optim.SGD(net.parameters(), 1e38)), Schedule(4, 8, 0))
    fresh = nn.Sequential(nn.Flatten(), nn.Linear(320, 2))

    def judge():  # after which the network can only diverge
        fresh.register_forward_hook(lambda *_: torch.full((8, 2), np.nan, requires_grad=True))
        return 0.5

    history = train(fresh, windows, target, still(fresh), Schedule(4, 8, 0), judge=judge)
    assert len(history) == 2 and torch.isfinite(fresh[1].weight).all()


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
        for i, (decay, g) in enumerate(zip((1e-4, 0), gradients, strict=True)):  # of weights, not of biases
            momentum[i] = 0.9 * momentum[i] - 0.1 * g - decay * expected[i]
            expected[i] = expected[i] + 0.1 * momentum[i] / (1 - 0.9**t)
        for p, value in zip(net.parameters(), expected, strict=True):
            np.testing.assert_allclose(p.detach().numpy(), value, rtol=1e-5)


class Valley:
    """A net of one number whose loss is its square; rates from 1 on throw it out of the valley."""

    def __init__(self):
        self.module = nn.Linear(1, 1, bias=False)
        nn.init.ones_(self.module.weight)
        self.sgd = SelectiveSGD(self.module, PAPER)

    def step(self, rows):
        self.sgd.zero_grad()
        loss = 2 * self.module.weight.square().sum()
        loss.backward()
        self.sgd.step()
        return loss.item()


def test_the_search_keeps_the_rate_with_the_lowest_last_loss_and_discards_the_trial():
    losses = {}
    for rate in PAPER:
        valley = Valley()
        valley.sgd.rate = rate
        losses[rate] = [valley.step(None) for _ in range(30)][-1]
    best = min(losses, key=losses.get)
    valley, batches = Valley(), np.zeros((40, 2))
    valley.sgd.before_epoch(0, batches, valley.step)
    assert valley.sgd.rate == best and valley.sgd.rates == tuple(r for r in PAPER if r <= best)
    assert valley.module.weight.item() == 1 and valley.sgd.steps == 0 and not valley.sgd.momentum[0].any()
    valley.sgd.rate = 0.123
    valley.sgd.before_epoch(1, batches, valley.step)
    assert valley.sgd.rate == 0.123  # between the searches it stays
    valley.sgd.before_epoch(10, batches, valley.step)
    assert valley.sgd.rate == best
