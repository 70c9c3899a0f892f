"""The training loop, its optimisers, and trainings that go on after an interruption, on networks of a layer or two."""

import numpy as np
import pytest
import torch
from sklearn.base import clone
from torch import nn

from bench.corpora.library import open_corpus
from bench.models.adapters import FromTorch
from bench.models.nets import checkpoint
from bench.models.nets.checkpoint import Checkpoint
from bench.models.nets.cnn85 import CNN85, RATES, SelectiveSGD
from bench.models.nets.hughes2017 import Hughes2017AERNN, Hughes2017CNN, Hughes2017CNNRNN
from bench.models.nets.touchnet import OneCycle, TouchNet
from bench.models.nets.training import Optimiser, Schedule, Windows, train
from bench.models.nets.zhou2016 import Zhou2016GMLSTM
from bench.scratch import home
from tests.conftest import random_corpus

PAPER = RATES["paper"]
OPTIMISERS = {
    "adam": lambda net: Optimiser(torch.optim.Adam(net.parameters(), 1e-3)),
    "selective": lambda net: SelectiveSGD(net, PAPER),
    "cycle": lambda net: OneCycle(torch.optim.AdamW(net.parameters(), 1e-2), 1e-2, 100),
}


class Killed(BaseException):
    """What no code handles."""


def still(net):
    """Changes nothing."""
    return Optimiser(torch.optim.SGD(net.parameters(), 0.0))


@pytest.fixture(scope="module")
def windows():
    return Windows(random_corpus(subjects=1), 5, 5)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """Twelve captures that have a digest, as those of corpora in the data folder."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("TOUCHBENCH_HOME", str(tmp_path_factory.mktemp("home")))
        return open_corpus("synth", {"subjects": 3, "repetitions": 1, "variants": ("normal",)})[::4]


@pytest.fixture
def always(monkeypatch):
    """Every epoch is kept."""
    monkeypatch.setattr(checkpoint, "OFTEN_S", 0.0)
    monkeypatch.setattr(checkpoint, "SHARE", 0.0)


def dropping(units=8):
    torch.manual_seed(0)
    return nn.Sequential(nn.Flatten(), nn.Linear(320, units), nn.ReLU(), nn.Dropout(0.5), nn.Linear(units, 2))


def counted(monkeypatch, last=None):
    """The epochs that are trained from now on; after the last one, the process is killed."""
    write, epochs = Checkpoint.write, []

    def counting(self, state):
        write(self, state)
        epochs.append(len(state["history"]))
        if len(epochs) == last:
            raise Killed

    monkeypatch.setattr(Checkpoint, "write", counting)
    return epochs


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


@pytest.mark.parametrize("kind", OPTIMISERS)
@pytest.mark.parametrize("last", [1, 11])
def test_an_interrupted_training_ends_in_the_same_network(kind, last, windows, tmp_path, always, monkeypatch):
    target, accuracies = np.arange(len(windows)) % 2, [0.1, 0.4, *[0.3] * 10]

    def trained(kept, first):
        net, judged = dropping(), iter(accuracies[first:])
        torch.manual_seed(1 + first)  # what is drawn in between makes no difference
        history = train(
            net, windows, target, OPTIMISERS[kind](net), Schedule(12, 8, 0), judge=lambda: next(judged), kept=kept
        )
        return history, [p.tolist() for p in net.parameters()]

    path = tmp_path / "state.pt"
    with monkeypatch.context() as patched, pytest.raises(Killed):
        counted(patched, last)
        trained(Checkpoint(path), 0)
    epochs, again = counted(monkeypatch), Checkpoint(path)
    assert trained(again, last) == trained(None, 0)
    assert again.resumed and epochs[0] == last + 1 and not path.exists()


def test_a_file_of_another_kind_costs_only_the_resuming(windows, tmp_path, always, monkeypatch):
    target, path = np.arange(len(windows)) % 2, tmp_path / "state.pt"

    def trained():
        net, kept = dropping(), Checkpoint(path)
        train(net, windows, target, OPTIMISERS["adam"](net), Schedule(3, 8, 0), kept=kept)
        return [p.tolist() for p in net.parameters()], kept.resumed

    expected, _ = trained()
    with monkeypatch.context() as patched, pytest.raises(Killed):
        counted(patched, 2)
        trained()
    content = path.read_bytes()
    state = torch.load(path, weights_only=True)["state"]
    wider = {"net": dropping(9).state_dict()}
    broken = (state | wider, {"history": state["history"]} | wider, state | {"order": {"bit_generator": "none"}}, [1])
    for wrong in (content[:5000], b"", *broken):
        if isinstance(wrong, bytes):
            path.write_bytes(wrong)
        else:
            torch.save({"state": wrong, "seconds": (1.0, 1.0)}, path)
        assert trained() == (expected, False)


def small(frames, rows, cols, classes):
    return nn.Sequential(nn.Flatten(), nn.LazyLinear(classes))


def test_a_state_has_the_name_of_all_that_the_training_depends_on(stored, monkeypatch):
    name = lambda model, X=stored, y=stored.gestures: checkpoint.checkpoint(model, X, y).path  # noqa: E731
    paths = [
        name(Hughes2017CNN()),
        name(Hughes2017CNN(seed=1)),
        name(Hughes2017CNN(rate=1e-3)),
        name(Hughes2017CNN(), stored[:9], stored.gestures[:9]),
        name(Hughes2017CNN(), stored, np.roll(stored.gestures, 1)),
        name(FromTorch(small)),
    ]
    assert len(set(paths)) == len(paths) and paths[0] == name(Hughes2017CNN()) and None not in paths
    assert paths[0].parent == home() / "training"
    monkeypatch.setattr(checkpoint, "identity", lambda part: ["changed code"])
    assert name(Hughes2017CNN()) != paths[0]
    assert name(Hughes2017CNN(), stored.detached()) is None  # captures in memory
    assert name(FromTorch(lambda *sizes: small(*sizes))) is None


SYSTEMS = [
    CNN85(frames=20, width=0.1, epochs=12, batch=16),  # which searches its rate again in the eleventh epoch
    Hughes2017CNNRNN(epochs=3, batch=8),
    Hughes2017AERNN(epochs=3, pretraining=1),
    FromTorch(small, frames=20, epochs=3),
    TouchNet(seconds=0.2, width=4, updates=30, batch=16),
]


@pytest.mark.parametrize(
    "system",
    [Zhou2016GMLSTM(frames=40, epochs=3, batch=8), *(pytest.param(s, marks=pytest.mark.nightly) for s in SYSTEMS)],
    ids=lambda system: type(system).__name__,
)
def test_a_system_goes_on_and_a_long_training_is_not_done_twice(system, stored, always, monkeypatch):
    with monkeypatch.context() as patched:
        every = counted(patched)
        unbroken = clone(system).fit(stored, stored.gestures)
    assert not hasattr(unbroken, "fit_seconds_") and not [*(home() / "training").glob("*")]
    with monkeypatch.context() as patched, pytest.raises(Killed):
        counted(patched, len(every) - 1)
        clone(system).fit(stored, stored.gestures)
    monkeypatch.setattr(checkpoint, "LONG_S", 0.0)
    epochs = counted(monkeypatch)
    for trained in (1, 1):  # the last epoch, then none
        model = clone(system).fit(stored, stored.gestures)
        assert len(epochs) == trained and model.fit_seconds_[0] > 0 and model.history_ == unbroken.history_
        assert np.array_equal(model.predict_proba(stored), unbroken.predict_proba(stored))
    clone(system).set_params(seed=1).fit(stored, stored.gestures)
    assert len(epochs) == 1 + len(every)


def test_a_folder_that_cannot_be_written_or_is_full_costs_only_the_resuming(windows, tmp_path, always, monkeypatch):
    def full(*_):
        raise RuntimeError("unexpected pos 12864 vs 12808")

    (tmp_path / "file").write_text("stands in the way", encoding="utf-8")
    for path, save in ((tmp_path / "file" / "state.pt", torch.save), (tmp_path / "state.pt", full)):
        monkeypatch.setattr(torch, "save", save)
        net, kept = dropping(), Checkpoint(path)
        assert len(train(net, windows, np.zeros(len(windows)), still(net), Schedule(2, 8, 0), kept=kept)) == 2
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
