"""Every network, interrupted after each of its epochs, goes on from there and ends the same, bit for bit."""

import pytest
import torch
from sklearn.base import clone

from bench.corpora.library import open_corpus
from bench.scratch import home
from models.adapters import FromTorch
from models.nets.checkpoint import Checkpoint
from models.nets.cnn85 import CNN85
from models.nets.hughes2017 import Hughes2017AERNN, Hughes2017CNN, Hughes2017CNNRNN
from models.nets.touchnet import TouchNet
from models.nets.zhou2016 import Zhou2016CNN3D, Zhou2016GMLSTM
from tests.models.test_training import Killed, always, small  # noqa: F401

pytestmark = pytest.mark.nightly


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


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: type(system).__name__)
def test_it_goes_on_where_it_was_interrupted_and_ends_in_the_same_network(system, always, monkeypatch):  # noqa: F811
    corpus = open_corpus("synth", {"subjects": 3, "repetitions": 1, "variants": ("normal",)})[:30]
    unbroken = clone(system).fit(corpus, corpus.gestures)
    write, count = Checkpoint.write, []

    def killing(self, state):
        write(self, state)
        count.append(1)
        raise Killed

    monkeypatch.setattr(Checkpoint, "write", killing)
    model = clone(system)
    while True:  # one epoch more each time
        try:
            model.fit(corpus, corpus.gestures)
            break
        except Killed:
            assert len([*(home() / "training").glob("*.pt")]) == 1
        if len(count) == sum("loss" in row for row in unbroken.history_):
            monkeypatch.setattr(Checkpoint, "write", write)
    for (_, one), (_, other) in zip(model.net_.state_dict().items(), unbroken.net_.state_dict().items(), strict=True):
        assert torch.equal(one, other)
    assert model.history_ == unbroken.history_ and model.fit_seconds_[0] > 0
    assert not [*(home() / "training").glob("*")]
