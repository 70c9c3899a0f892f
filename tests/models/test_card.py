"""The way of a card, on a processor: library layers, windows on the device, nothing waited for."""

import gc

import numpy as np
import pandas as pd
import pytest
import torch

from bench.models.nets import ren2023, training
from bench.models.nets.cnn85 import CNN85
from bench.models.nets.hughes2017 import Hughes2017AERNN, Hughes2017CNN, Hughes2017CNNRNN
from bench.models.nets.ren2023 import Ren2023Transformer
from bench.models.nets.touchnet import TouchNet
from bench.models.nets.zhou2016 import Zhou2016CNN2D, Zhou2016CNN3D, Zhou2016GMLSTM, Zhou2016LRCN
from tests.conftest import random_corpus

SMALL = {
    CNN85: {"frames": 10, "batch": 16, "width": 0.1},
    Hughes2017CNN: {"batch": 16},
    Hughes2017CNNRNN: {"batch": 4},
    Hughes2017AERNN: {"batch": 4},
    Zhou2016CNN3D: {"frames": 32, "batch": 8},
    Zhou2016CNN2D: {"frames": 32, "batch": 8},
    Zhou2016LRCN: {"frames": 32, "batch": 8},
    Zhou2016GMLSTM: {"frames": 32, "batch": 8},
    Ren2023Transformer: {"frames": 16, "batch": 8},
    TouchNet: {"seconds": 0.1, "width": 4, "batch": 16},
}


@pytest.fixture(scope="module")
def corpus():
    return random_corpus(subjects=3, per_class=4)


@pytest.fixture(autouse=True)
def small_attention(monkeypatch):
    monkeypatch.setattr(ren2023, "WIDTH", 32)
    monkeypatch.setattr(ren2023, "LAYERS", 2)


def with_card(system, **methods):
    """A kind of a system that takes the way of a card."""
    return type(system.__name__, (system,), {"on_card": True, **methods})


@pytest.mark.parametrize("system", SMALL)
def test_a_step_reads_nothing_from_the_device(system, corpus):
    """The device has no values here, so that reading one fails."""
    kind = with_card(system, check=lambda self: None, prepare=lambda *_: None)
    model = kind(device="meta", **SMALL[system])
    step = next(model.train_in_steps(corpus, corpus.gestures))
    assert step.training.learn(step.rows).device.type == "meta"


@pytest.mark.parametrize("system", SMALL)
def test_a_card_learns_what_a_processor_learns(system, corpus):
    losses, proba = [], []
    for kind in (system, with_card(system)):
        model = kind(**SMALL[system])
        steps = model.train_in_steps(corpus, corpus.gestures)
        torch.manual_seed(0)
        step = next(steps)
        losses.append([])
        for _ in range(5):
            losses[-1].append(float(step.training.learn(step.rows)))
            step = steps.send(torch.tensor(losses[-1][-1]))
        proba.append(model.predict_proba(corpus))
    np.testing.assert_allclose(losses[1], losses[0], rtol=1e-3)
    np.testing.assert_allclose(proba[1], proba[0], rtol=1e-3, atol=1e-4)


def test_frames_are_copied_to_a_device_once(corpus):
    device = torch.device("cpu")
    fresh = corpus[np.arange(len(corpus))].detach()
    windows = CNN85(frames=10)
    windows.window_ = 10
    first, second = (windows.samples(part).place(device) for part in (fresh, fresh[:5]))
    assert first._on_device is second._on_device
    before = len(training._frames_on_devices)
    del first, second, fresh
    gc.collect()
    assert len(training._frames_on_devices) == before - 1


FOLDS = [np.arange(36), np.arange(4, 36), np.arange(0, 28)]


class Doubles:
    """Networks in double precision, so that two orders of the same sums agree to many digits."""

    def prepare(self, net, samples):
        super().prepare(net, samples)
        net.double()

    def compute_logits(self, net, x):
        return net((x[0].double(), x[1]) if isinstance(x, tuple) else x.double())


@pytest.mark.parametrize("system", [kind for kind in SMALL if kind.stacks])
def test_networks_that_train_together_equal_those_that_train_alone(system, corpus, monkeypatch):
    """They have unequal numbers of captures and of steps in an epoch, and one another seed."""
    monkeypatch.setattr("bench.models.nets.window.count_activations", lambda *_: 0)
    length = {"updates": 12} if system is TouchNet else {"epochs": 2}
    kind = type(system.__name__, (Doubles, with_card(system)), {})
    parts = [corpus[fold] for fold in FOLDS]
    alone, together = ([kind(seed=s, **SMALL[system] | length) for s in (0, 0, 1)] for _ in "12")
    for model, part in zip(alone, parts, strict=True):
        model.fit(part, part.gestures)
    assert kind.fit_together(together, parts) == [None] * 3
    for one, other in zip(alone, together, strict=True):
        histories = (pd.DataFrame(model.history_) for model in (one, other))
        pd.testing.assert_frame_equal(*histories, rtol=1e-9)
        proba = (model.predict_proba(corpus) for model in (one, other))
        np.testing.assert_allclose(*proba, rtol=1e-6)


def test_a_pass_takes_as_many_networks_as_the_memory_holds(monkeypatch):
    passes, most = [], 2

    def learn(batches):
        passes.append(len(batches))
        if len(batches) > most:
            raise torch.OutOfMemoryError
        return [*batches]

    monkeypatch.setattr(training, "learn_together", learn)
    stack = training.Stack(5)
    assert stack.learn([*range(5)]) == stack.learn([*range(5)]) == [*range(5)]
    assert passes == [5, 2, 2, 1, 2, 2, 1]
    most = 0
    assert [type(loss) for loss in stack.learn([1, 2])] == [torch.OutOfMemoryError] * 2
