"""A training that is killed between two epochs goes on from there and ends in the same network, bit for bit."""

import os
import shutil
import time

import numpy as np
import pytest
import torch

from bench.corpora.library import open_corpus
from bench.scratch import home
from models.adapters import FromTorch
from models.nets import checkpoint
from models.nets.checkpoint import Checkpoint
from models.nets.cnn85 import CNN85
from models.nets.hughes2017 import Hughes2017AERNN, Hughes2017CNN, Hughes2017CNNRNN
from models.nets.touchnet import TouchNet
from models.nets.zhou2016 import Zhou2016CNN3D, Zhou2016GMLSTM


class Killed(BaseException):
    """What no code handles."""


@pytest.fixture
def corpus(monkeypatch):
    monkeypatch.setattr(checkpoint, "OFTEN_S", 0.0)
    monkeypatch.setattr(checkpoint, "SHARE", 0.0)
    made = {"subjects": 3, "repetitions": 1, "variants": ("normal",)}
    return open_corpus("synth", made)[:30]


def small(frames, rows, cols, classes):
    return torch.nn.Sequential(
        torch.nn.Flatten(), torch.nn.Linear(frames * rows * cols, 8), torch.nn.Dropout(0.5), torch.nn.Linear(8, classes)
    )


SYSTEMS = [
    CNN85(frames=20, width=0.1, epochs=13, batch=16),  # which searches its rate again in the eleventh epoch
    Hughes2017CNN(epochs=3, batch=64),
    Hughes2017CNNRNN(epochs=3, batch=8),
    Hughes2017AERNN(epochs=3, pretraining=1),
    Zhou2016CNN3D(frames=40, epochs=3, batch=8),  # one subject chooses the epoch; dropout draws random numbers
    Zhou2016GMLSTM(frames=40, epochs=3, batch=8),
    FromTorch(small, frames=20, epochs=3),
    TouchNet(seconds=0.2, width=4, updates=30, batch=16),
]


def killed_after(epochs, model, corpus, y, monkeypatch):
    """Fit until so many epochs are kept."""
    write, count = Checkpoint.write, []

    def counted(self, state):
        write(self, state)
        count.append(1)
        if len(count) == epochs:
            raise Killed

    with monkeypatch.context() as patched, pytest.raises(Killed):
        patched.setattr(Checkpoint, "write", counted)
        model.fit(corpus, y)


def epochs_trained(model, corpus, y, monkeypatch):
    """Fit and count the epochs that are trained now."""
    write, count = Checkpoint.write, []
    with monkeypatch.context() as patched:
        patched.setattr(Checkpoint, "write", lambda self, state: (count.append(1), write(self, state)))
        model.fit(corpus, y)
    return len(count)


def same(one, other):
    pairs = zip(one.net_.state_dict().items(), other.net_.state_dict().items(), strict=True)
    return all(a == b and torch.equal(x, y) for (a, x), (b, y) in pairs) and one.history_ == other.history_


@pytest.mark.parametrize("model", SYSTEMS, ids=lambda model: type(model).__name__)
def test_it_goes_on_where_it_was_killed_and_ends_in_the_same_network(model, corpus, monkeypatch):
    unbroken = type(model)(**model.get_params()).fit(corpus, corpus.gestures)
    killed = sum("loss" in row for row in unbroken.history_) - 1
    assert killed
    assert not [*(home() / "training").glob("*")]  # nothing is left of it
    killed_after(killed, model, corpus, corpus.gestures, monkeypatch)
    assert epochs_trained(model, corpus, corpus.gestures, monkeypatch) == 1
    assert same(model, unbroken) and not [*(home() / "training").glob("*")]
    assert model.fit_seconds_[0] > 0 and not hasattr(unbroken, "fit_seconds_")
    model.fit(corpus, corpus.gestures)
    assert not hasattr(model, "fit_seconds_")  # of a training that was not killed


def test_another_training_begins_anew(corpus, monkeypatch):
    def killed():
        shutil.rmtree(home() / "training", ignore_errors=True)
        killed_after(2, Hughes2017CNN(epochs=4, batch=64), corpus, corpus.gestures, monkeypatch)

    others = np.roll(corpus.gestures, 1)
    for model, X, y in (
        (Hughes2017CNN(epochs=4, batch=64, seed=1), corpus, corpus.gestures),
        (Hughes2017CNN(epochs=4, batch=64, rate=1e-3), corpus, corpus.gestures),
        (Hughes2017CNN(epochs=4, batch=64), corpus[:29], corpus.gestures[:29]),
        (Hughes2017CNN(epochs=4, batch=64), corpus, others),
    ):
        killed()
        assert epochs_trained(model, X, y, monkeypatch) == 4
    killed()
    (path,) = (home() / "training").glob("*.pt")
    path.write_bytes(path.read_bytes()[:5000])  # cut off
    assert epochs_trained(Hughes2017CNN(epochs=4, batch=64), corpus, corpus.gestures, monkeypatch) == 4
    killed()
    path.write_bytes(b"")
    assert epochs_trained(Hughes2017CNN(epochs=4, batch=64), corpus, corpus.gestures, monkeypatch) == 4
    with monkeypatch.context() as patched:
        patched.setattr(checkpoint, "identity", lambda part: ["changed code"])
        killed()
    assert epochs_trained(Hughes2017CNN(epochs=4, batch=64), corpus, corpus.gestures, monkeypatch) == 4


def network(activation):
    def made(frames, rows, cols, classes):
        return torch.nn.Sequential(
            torch.nn.Flatten(), torch.nn.Linear(frames * rows * cols, 8), activation(), torch.nn.Linear(8, classes)
        )

    return made


class Made:
    """A factory whose name does not tell what it makes."""

    def __call__(self, frames, rows, cols, classes):
        return small(frames, rows, cols, classes)


def test_what_has_no_name_of_its_own_is_never_taken_for_another(corpus, monkeypatch):
    monkeypatch.setattr(checkpoint, "LONG_S", 0.0)
    FromTorch(network(torch.nn.ReLU), frames=20, epochs=2).fit(corpus, corpus.gestures)
    other = FromTorch(network(torch.nn.Tanh), frames=20, epochs=2)
    assert epochs_trained(other, corpus, corpus.gestures, monkeypatch) == 2
    for module in (Made(), Made().__call__, lambda *sizes: small(*sizes)):
        assert epochs_trained(FromTorch(module, frames=20, epochs=2), corpus, corpus.gestures, monkeypatch) == 2
    assert not (home() / "training").exists()
    FromTorch(small, frames=20, epochs=2).fit(corpus, corpus.gestures)
    assert epochs_trained(FromTorch(small, frames=20, epochs=2), corpus, corpus.gestures, monkeypatch) == 0


def test_a_readable_file_of_another_kind_costs_only_the_resuming(corpus, monkeypatch):
    unbroken = Zhou2016CNN3D(frames=40, epochs=2, batch=8).fit(corpus, corpus.gestures)
    model = Zhou2016CNN3D(frames=40, epochs=2, batch=8)
    killed_after(1, model, corpus, corpus.gestures, monkeypatch)
    (path,) = (home() / "training").glob("*.pt")
    good = torch.load(path, weights_only=True)
    weights = {name: value.flatten()[:1] for name, value in good["state"]["net"].items()}
    for state, seconds in (
        ([1], (1.0, 1.0)),
        ({"x": 1}, (1.0, 1.0)),
        (good["state"], ("a", "b")),
        (good["state"], (float("nan"), -5.0)),
        (good["state"] | {"net": weights}, (1.0, 1.0)),
        (good["state"] | {"history": "hello"}, (1.0, 1.0)),
        (good["state"] | {"order": {"bit_generator": "none"}}, (1.0, 1.0)),
    ):
        torch.save({"state": state, "seconds": seconds}, path)
        assert epochs_trained(model, corpus, corpus.gestures, monkeypatch) == 2, state
        assert same(model, unbroken) and not hasattr(model, "fit_seconds_")


def test_a_full_disk_only_costs_the_resuming(corpus, monkeypatch):
    def full(*given):
        raise RuntimeError("[enforce fail at inline_container.cc:672] . unexpected pos 12864 vs 12808")

    monkeypatch.setattr(torch, "save", full)
    assert len(Hughes2017CNN(epochs=2, batch=64).fit(corpus, corpus.gestures).history_) == 2
    assert not [*(home() / "training").glob("*")]


def test_what_nobody_has_touched_for_a_month_goes(corpus, monkeypatch):
    monkeypatch.setattr(checkpoint, "LONG_S", 0.0)
    folder = home() / "training"
    folder.mkdir(parents=True)
    for name, days in (("old", 31), ("new", 29)):
        (folder / f"{name}.pt").write_bytes(b"")
        os.utime(folder / f"{name}.pt", (time.time() - days * 86400,) * 2)
    Hughes2017CNN(epochs=1, batch=64).fit(corpus, corpus.gestures)
    assert not (folder / "old.pt").exists() and (folder / "new.pt").exists() and len([*folder.glob("*.pt")]) == 2


def test_a_long_training_is_not_done_twice(corpus, monkeypatch):
    monkeypatch.setattr(checkpoint, "LONG_S", 0.0)
    for model in (Hughes2017CNN(epochs=2, batch=64), Zhou2016CNN3D(frames=40, epochs=2, batch=8)):
        first = type(model)(**model.get_params()).fit(corpus, corpus.gestures)
        assert epochs_trained(model, corpus, corpus.gestures, monkeypatch) == 0
        assert same(model, first) and np.array_equal(model.predict_proba(corpus), first.predict_proba(corpus))
        assert model.fit_seconds_[0] > 0 and not hasattr(first, "fit_seconds_")
        other = type(model)(**model.get_params() | {"seed": 1})
        assert epochs_trained(other, corpus, corpus.gestures, monkeypatch) == 2


def test_a_folder_that_cannot_be_written_only_costs_the_resuming(corpus, monkeypatch):
    (home() / "training").write_text("a file stands in the way", encoding="utf-8")
    model = Hughes2017CNN(epochs=2, batch=64).fit(corpus, corpus.gestures)
    assert len(model.history_) == 2


def test_captures_in_memory_are_trained_without_a_file(corpus):
    Hughes2017CNN(epochs=2, batch=64).fit(corpus.detached(), corpus.gestures)
    assert not (home() / "training").exists()
