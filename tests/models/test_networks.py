"""The published networks: sizes, shapes and memory as printed, samples against loops, and what no network may do."""

import pickle
from functools import partial

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from sklearn.base import clone
from torch import nn

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from models.nets import ren2023
from models.nets.cnn85 import CNN85
from models.nets.hughes2017 import COST, HAART, Hughes2017AERNN, Hughes2017CNN, Hughes2017CNNRNN, Recurrent
from models.nets.last_layer import relearnt
from models.nets.ren2023 import Ren2023Transformer
from models.nets.time_blocks import TimeConv3d
from models.nets.touchnet import TouchNet
from models.nets.training import Sequences, Torch, Windows, _stands_still, activations, train
from models.nets.window import votes
from models.nets.zhou2016 import Zhou2016CNN2D, Zhou2016CNN3D, Zhou2016GMLSTM, Zhou2016LRCN
from tests.conftest import random_corpus, with_other_values

FOURTEEN = tuple("abcdefghijklmn")


SYSTEMS = {
    "hughes2017_cnn": lambda epochs=2, seed=0: Hughes2017CNN(epochs, 16, seed=seed),
    "hughes2017_cnn_rnn": lambda epochs=2, seed=0: Hughes2017CNNRNN(epochs, 8, seed=seed),
    "hughes2017_ae_rnn": lambda epochs=2, seed=0: Hughes2017AERNN(epochs, 1, 8, seed=seed),
    "zhou2016_3dcnn": lambda epochs=2, seed=0: Zhou2016CNN3D(16, 4, epochs, 16, seed=seed),
    "zhou2016_2dcnn": lambda epochs=2, seed=0: Zhou2016CNN2D(16, 4, epochs, 16, seed=seed),
    "zhou2016_lrcn": lambda epochs=2, seed=0: Zhou2016LRCN(16, 4, epochs, 16, seed=seed),
    "zhou2016_gm_lstm": lambda epochs=2, seed=0: Zhou2016GMLSTM(16, 4, epochs, 16, seed=seed),
    "ren2023_transformer": lambda epochs=2, seed=0: Ren2023Transformer(12, epochs, 16, seed=seed),
    "touchnet": lambda epochs=2, seed=0: TouchNet(0.2, 4, updates=10 * epochs, batch=16, seed=seed),
}


def at(rate, **kwargs):
    corpus = random_corpus(**kwargs)
    return corpus.changed(rate_hz=rate)


def fitted(system, rate, classes, longest=60):
    corpus = at(rate, gestures=FOURTEEN[:classes], per_class=1, subjects=2, longest=longest)
    return system(epochs=1).fit(corpus, corpus.gestures), corpus


@pytest.mark.parametrize(
    ("system", "rate", "classes", "parameters"),
    [
        (Hughes2017CNN, 135.0, 14, 11_204),
        (Hughes2017CNN, 54.0, 7, 17_157),
        (Hughes2017CNNRNN, 135.0, 14, 16_254),
        (Hughes2017CNNRNN, 54.0, 7, 22_207),
        (Hughes2017AERNN, 135.0, 14, 40_949),
        (Hughes2017AERNN, 54.0, 7, 40_767),
        (Ren2023Transformer, 54.0, 7, 6_415_291),  # printed as 6.42 million
        (Zhou2016CNN3D, 54.0, 7, 490_119),
    ],
)
def test_published_sizes(system, rate, classes, parameters):
    assert fitted(system, rate, classes)[0].parameters_ == parameters


@pytest.mark.parametrize(
    ("system", "rate", "classes", "pooled", "whole"),
    [
        (Hughes2017CNN, 54.0, 7, 4255, 24_095),  # Table VIII
        (Hughes2017CNN, 135.0, 14, 6494, 45_074),  # printed 80 too small
        (Hughes2017CNNRNN, 54.0, 7, 4305, 24_145),  # one more layer of 50
        (Hughes2017AERNN, 135.0, 14, 488, 488),
        (Hughes2017AERNN, 54.0, 7, 481, 481),
    ],
)
def test_published_memory(system, rate, classes, pooled, whole):
    model, corpus = fitted(system, rate, classes, longest=12)
    one = at(rate, subjects=1, per_class=1, longest=2)[:1]  # a capture of one frame: one window, one step
    assert activations(model.net_, model.samples(one).batch(np.arange(1))) == (whole, pooled)
    longest = corpus[np.argsort(-corpus.lengths)]
    assert system(epochs=1).fit(longest, longest.gestures).activations_ == whole  # of a step, however long it was


def test_memory_of_attention_by_hand():
    model, _ = fitted(Ren2023Transformer, 54.0, 7)
    layers = 144 * 64 + 144 * 512 + 144 * (128 + 16 + 4) + 7  # input, embedding, the head
    attention = 5 * 144 * 512 + 8 * 144**2  # queries, keys, values, their mix, output; scores of 8 heads
    assert model.activations_ == layers + 6 * attention


@pytest.mark.parametrize(
    ("rate", "lengths", "chunks"), [(54.0, [432, 500], [432, 432, 68]), (135.0, [270, 600, 1], [270, 270, 270, 60, 1])]
)
def test_chunks_of_the_autoencoder_system(rate, lengths, chunks):
    frames = [np.ones((n, 8, 8), dtype=np.uint16) for n in lengths]
    about = pd.DataFrame({"subject": ["1"] * len(lengths), "gesture": ["pat", "rub", "pat"][: len(lengths)]})
    corpus = Corpus.from_captures(frames, about, rate)
    model = Hughes2017AERNN(epochs=1, pretraining=1).fit(corpus, corpus.gestures)
    assert model.samples(corpus).steps.tolist() == chunks


@pytest.mark.parametrize("system", [CNN85, Zhou2016GMLSTM, Ren2023Transformer])
def test_windows_in_seconds_follow_the_rate(system):
    for rate, frames in ((100.0, 8), (54.0, 4)):
        corpus = at(rate, longest=30)
        model = system(epochs=1, seconds=0.08).fit(corpus, corpus.gestures)
        assert model.samples(corpus).frames == frames
        assert np.array_equal(
            clone(model).set_params(seconds=0.0, frames=frames).fit(corpus, corpus.gestures).predict_proba(corpus),
            model.predict_proba(corpus),
        )
    with pytest.raises(InputError, match="model.seconds=-1: give a number above 0"):
        system(seconds=-1.0).check()
    with pytest.raises(InputError, match="model.frames=7 and model.seconds=0.5: give one"):
        system(seconds=0.5, frames=7).check()


@pytest.mark.parametrize("name", SYSTEMS)
def test_captures_of_one_frame(name):
    corpus = random_corpus(longest=2)
    assert set(corpus.lengths) == {1}
    model = SYSTEMS[name]().fit(corpus, corpus.gestures)
    assert np.isfinite(model.predict_proba(corpus)).all() and len(model.predict(corpus[:1])) == 1


def test_padding_changes_nothing_where_there_is_none(corpus):
    model = CNN85(frames=10, epochs=1, batch=16).fit(corpus, corpus.gestures)
    whole = Corpus.from_captures(
        [np.ones((n, 8, 8), dtype=np.uint16) * n for n in (10, 30)], corpus.captures[:2], corpus.rate_hz
    )
    ragged = Corpus.from_captures([np.ones((15, 8, 8), dtype=np.uint16) * 900], corpus.captures[:1], corpus.rate_hz)
    for part, same in ((whole, True), (ragged, False)):
        zero = model.set_params(padding="zero").predict_proba(part)
        assert np.array_equal(model.set_params(padding="edge").predict_proba(part), zero) == same


@pytest.mark.parametrize("values", [{"rate": -1.0}, {"rate": 0.0}, {"rate": float("nan")}, {"device": "meta"}])
def test_impossible_rates_and_devices_are_refused(values):
    with pytest.raises(InputError, match=f"model.{next(iter(values))}="):
        Hughes2017CNN(**values).check()


@pytest.mark.parametrize(
    ("design", "maps"),
    [
        (COST, [(30, 26, 7, 7), (30, 13, 3, 3), (10, 9, 2, 2), (10, 4, 1, 1), (40,)]),
        (HAART, [(30, 18, 6, 6), (30, 9, 3, 3), (20, 5, 2, 2), (20, 2, 1, 1), (40,)]),
    ],
)
def test_published_shapes(design, maps):
    model = Hughes2017CNN()
    model.design_ = design
    x, shapes = torch.zeros(1, design[1], 8, 8), []
    for layer in model.network(8, 8, 14)[:7]:
        x = layer(x)
        shapes.append(tuple(x.shape[1:]))
    assert [shapes[i] for i in (0, 1, 3, 4, 6)] == maps


@given(st.tuples(*[st.integers(1, 6)] * 3), st.tuples(*[st.integers(0, 5)] * 3), st.integers(1, 3))
def test_blocks_of_time_convolve_as_the_library_does(kernel, more, batch):
    torch.manual_seed(0)
    layer = TimeConv3d(4, kernel)
    x = torch.rand(batch, *(k + m for k, m in zip(kernel, more, strict=True)))
    expected = nn.functional.conv3d(x[:, None], layer.weight, layer.bias)
    found = layer(x)
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5)
    weight = torch.rand_like(expected)
    gradients = [torch.autograd.grad((y * weight).sum(), [layer.weight, layer.bias]) for y in (found, expected)]
    for ours, theirs in zip(*gradients, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-4)


@given(st.sampled_from([COST, HAART]), st.integers(1, 9), st.integers(1, 9), st.integers(0, 99))
def test_the_pooled_first_layer_equals_the_layers(design, rows, cols, seed):
    torch.manual_seed(seed)
    model = Hughes2017CNN()
    model.design_ = design
    net = model.network(rows, cols, 7).double()
    x = torch.randint(0, 3, (3, design[1], rows, cols)).double() / 4  # with ties
    weight = torch.rand(3, 7).double()
    outputs, gradients = [], []
    for forward in (net, lambda x: model.forward(net, x)):
        net.zero_grad()
        outputs.append(forward(x))
        (outputs[-1] * weight).sum().backward()
        gradients.append([p.grad for p in net.parameters()])
    torch.testing.assert_close(*outputs)
    for a, b in zip(*gradients, strict=True):
        torch.testing.assert_close(a, b)


@given(st.integers(1, 8), st.integers(1, 8), st.integers(1, 5), st.integers(0, 99))
def test_sequences_equal_a_loop(frames, hop, longest, seed):
    hop = min(hop, frames)
    corpus = random_corpus(subjects=1, per_class=2, seed=seed)[np.array([3, 0, 5])]
    windows = Windows(corpus, frames, hop)
    sequences = Sequences(windows, longest)
    expected = []
    for capture in range(3):
        mine = np.flatnonzero(windows.capture == capture)
        for piece in [mine[i : i + longest] for i in range(0, len(mine), longest)]:
            end = windows.start[piece[-1]] + windows.seen[piece[-1]]
            expected.append((capture, windows.start[piece[0]], end - windows.start[piece[0]], len(piece), piece))
    told = zip(sequences.capture, sequences.start, sequences.seen, sequences.steps, strict=True)
    assert list(told) == [e[:4] for e in expected]
    order = np.random.default_rng(seed).permutation(len(sequences))
    values, steps = sequences.batch(order)
    assert steps.tolist() == [expected[i][3] for i in order]
    assert torch.equal(values, windows.batch(np.concatenate([expected[i][4] for i in order])))


@pytest.mark.parametrize(("frames", "longest", "count"), [(1297, 36, 3), (525, 36, 1), (1747, 36, 4), (10, 36, 1)])
def test_published_sequence_counts(frames, longest, count):
    """CoST's captures of up to 36 windows are one sample, longer ones two to four."""
    corpus = random_corpus(subjects=1, per_class=1)
    one = type(corpus).from_captures([np.zeros((frames, 8, 8), np.uint16)], corpus.captures[:1], 135.0)
    assert len(Sequences(Windows(one, 45, 15), longest)) == count


@pytest.mark.parametrize(("rate", "count"), [(135.0, 3), (54.0, 4)])
def test_a_network_that_was_stored_cuts_the_same_sequences(rate, count):
    model, _ = fitted(Hughes2017CNNRNN, rate, 7, longest=12)
    corpus = random_corpus(subjects=1, per_class=1)
    one = type(corpus).from_captures([np.zeros((1297, 8, 8), np.uint16)], corpus.captures[:1], rate)
    assert len(model.samples(one)) == len(pickle.loads(pickle.dumps(model)).samples(one)) == count


@given(st.lists(st.integers(1, 6), min_size=1, max_size=5), st.integers(0, 99))
def test_the_recurrent_layer_equals_a_loop_over_each_sequence(counts, seed):
    torch.manual_seed(seed)
    net = Recurrent(nn.Flatten(), 3, nn.Linear(3, 2))
    x, steps = torch.rand(sum(counts), 4).double(), torch.tensor(counts)
    net.double()((x, steps))  # gives the lazy layer its size
    found, expected, place = net((x, steps)), [], 0
    for count in counts:
        state = torch.zeros(3).double()
        for t in range(count):
            state = torch.tanh(net.into.weight @ x[place + t] + net.into.bias + net.within.weight @ state)
            expected.append(net.head(state))
        place += count
    expected = torch.stack(expected)
    torch.testing.assert_close(found, expected)
    weight = torch.rand_like(found)
    parameters = list(net.parameters())
    gradients = [torch.autograd.grad((y * weight).sum(), parameters, allow_unused=True) for y in (found, expected)]
    for ours, theirs, p in zip(*gradients, parameters, strict=True):
        torch.testing.assert_close(ours, torch.zeros_like(p) if theirs is None else theirs)


def test_votes_by_hand():
    proba = np.array([[0.9, 0.1], [0.4, 0.6], [0.4, 0.6], [0.2, 0.8], [0.7, 0.3]], dtype=np.float32)
    found = votes(proba, np.array([3, 2]))
    assert found.argmax(axis=1).tolist() == [1, 1]  # 2 of 3 against a higher mean; a tie by the mean
    np.testing.assert_allclose(found.sum(axis=1), 1, rtol=1e-6)
    assert np.array_equal(votes(proba, np.ones(5, dtype=int)), proba)


@pytest.mark.parametrize("name", SYSTEMS)
def test_contract_of_a_network(name, corpus):
    train_part = corpus[corpus.subjects != "4"]
    a, b, c = (SYSTEMS[name](seed=seed).fit(train_part, train_part.gestures) for seed in (0, 0, 1))
    proba = a.predict_proba(corpus)
    assert np.array_equal(proba, b.predict_proba(corpus)) and a.history_ == b.history_
    assert not np.array_equal(proba, c.predict_proba(corpus))
    np.testing.assert_allclose(proba.sum(axis=1), 1, rtol=1e-5)
    assert clone(a).get_params() == a.get_params()
    # a capture alone gets what it gets among others: nothing of a batch, its padding or its order leaks in
    for i in (0, 7, 20):
        np.testing.assert_allclose(a.predict_proba(corpus[i : i + 1])[0], proba[i], rtol=1e-3, atol=1e-5)
    for grid in ((3, 5), (1, 2)):
        other = random_corpus(grid=grid, per_class=1)
        assert SYSTEMS[name](epochs=1).fit(other, other.gestures).predict(other[:1]).shape == (1,)


@pytest.mark.parametrize("name", SYSTEMS)
def test_test_subjects_change_nothing_that_is_learned(name, corpus):
    train_part, test = np.flatnonzero(corpus.subjects != "2"), np.flatnonzero(corpus.subjects == "2")
    other = with_other_values(corpus, test)
    probe = random_corpus(seed=9)
    found = [SYSTEMS[name](epochs=1).fit(c[train_part], c.gestures[train_part]) for c in (corpus, other)]
    assert np.array_equal(*(model.predict_proba(probe) for model in found))


@pytest.mark.parametrize("name", [n for n in SYSTEMS if n.startswith(("zhou", "ren"))])
def test_the_subject_who_chooses_the_epoch_is_not_trained_on(name, corpus, monkeypatch):
    model, seen = SYSTEMS[name](), []
    real = type(model).samples
    monkeypatch.setattr(type(model), "samples", lambda self, c: seen.append(set(c.subjects)) or real(self, c))
    model.fit(corpus, corpus.gestures)
    trained, judged = seen[0], set().union(*seen[1:])
    assert len(judged) == 1 and not trained & judged and trained | judged == set(corpus.subjects)
    with pytest.raises(InputError, match="train on two or more"):
        SYSTEMS[name]().fit(corpus[corpus.subjects == "1"], corpus.gestures[corpus.subjects == "1"])


def test_the_best_epoch_is_kept_and_training_stops_when_the_loss_stands_still():
    class Still:
        rate = 0.0
        zero_grad = step = staticmethod(lambda: None)

    corpus = random_corpus(subjects=1)
    windows = Windows(corpus, 5, 5)
    target = np.zeros(len(windows), dtype=int)
    net = nn.Sequential(nn.Flatten(), nn.Linear(320, 2))
    judged = iter([0.2, 0.7, 0.7, 0.1])
    bias = iter([1.0, 2.0, 3.0, 4.0])

    def judge():
        with torch.no_grad():
            net[1].bias.fill_(next(bias))
        return next(judged)

    history = train(net, windows, target, Still(), 4, 8, 0, judge=judge)
    assert [row["held_accuracy"] for row in history] == [0.2, 0.7, 0.7, 0.1]
    assert net[1].bias.tolist() == [2.0, 2.0]
    assert len(train(net, windows, target, Still(), 50, len(windows), 0, patience=3)) == 6


def test_single_epochs_with_a_high_loss_neither_stop_training_nor_keep_it_going():
    falling = [1.5, 1.4, 1.3, 1.2, 1.1, 1.0]
    assert not _stands_still([*falling[:5], 9.0], 3)  # the mean of the last three rises
    assert _stands_still([1.0, 9.0, 1.0, 1.0, 1.0, 1.0], 3)  # the mean falls
    assert not _stands_still(falling, 3) and not _stands_still([1.0] * 5, 3)


def poison(net, accuracy):
    """What a judge returns, after which the network can only diverge; what it judged was kept before."""
    if accuracy == 0.5:
        net.register_forward_hook(lambda *_: torch.full((8, 2), np.nan, requires_grad=True))
    return accuracy


def test_a_training_that_diverges_says_where():
    corpus = random_corpus(subjects=1)
    windows = Windows(corpus, 5, 5)
    net = nn.Sequential(nn.Flatten(), nn.Linear(320, 2))
    sgd = Torch(torch.optim.SGD(net.parameters(), 1e38))
    judged = iter([0.5, 0.1, 0.1, 0.1])
    fresh = nn.Sequential(nn.Flatten(), nn.Linear(320, 2))
    late = Torch(torch.optim.SGD(fresh.parameters(), 1e-9))
    history = train(
        fresh, windows, np.arange(len(windows)) % 2, late, 4, 8, 0, judge=lambda: poison(fresh, next(judged))
    )
    assert len(history) == 2 and torch.isfinite(fresh[1].weight).all()  # the first epoch, which was judged, is kept
    with pytest.raises(FloatingPointError, match=r"the loss of epoch \d is not finite at a learning rate of 1e\+38"):
        train(net, windows, np.arange(len(windows)) % 2, sgd, 4, 8, 0)


def test_a_device_that_is_not_there():
    with pytest.raises(InputError, match="model.device=cuda:99: .*give cpu"):
        Hughes2017CNN(device="cuda:99").check()


def test_attention_of_ones_own_is_that_of_the_library():
    torch.manual_seed(0)
    own = ren2023._SelfAttention(ren2023.WIDTH, ren2023.HEADS, batch_first=True)
    library = torch.nn.MultiheadAttention(ren2023.WIDTH, ren2023.HEADS, batch_first=True)
    library.load_state_dict(own.state_dict())
    mine, theirs = torch.randn(2, 3, 7, ren2023.WIDTH).unbind()
    theirs = mine.clone().requires_grad_()
    mine.requires_grad_()
    found, expected = own(mine), library(theirs, theirs, theirs, need_weights=False)[0]
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5)
    for output in (found, expected):
        output.square().sum().backward()
    torch.testing.assert_close(mine.grad, theirs.grad, rtol=1e-3, atol=1e-4)
    for name, parameter in own.named_parameters():
        torch.testing.assert_close(parameter.grad, library.get_parameter(name).grad, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(
    "system",
    [
        partial(Ren2023Transformer, 12, epochs=2, batch=16),
        partial(CNN85, 10, epochs=2, batch=16),
        *(
            partial(kind, 16, 4, epochs=1, batch=16)
            for kind in (Zhou2016CNN3D, Zhou2016CNN2D, Zhou2016LRCN, Zhou2016GMLSTM)
        ),
    ],
    ids=lambda system: system.func.__name__,
)
def test_products_of_half_the_bits_learn_nearly_the_same(system):
    corpus = random_corpus(per_class=2)
    whole, half = (system(precision=precision).fit(corpus, corpus.gestures) for precision in ("float32", "bfloat16"))
    assert all(p.dtype == torch.float32 for p in half.net_.parameters())
    difference = np.abs(whole.predict_proba(corpus) - half.predict_proba(corpus)).max()
    assert 0 < difference < 0.05  # it is not the same, and not another network
    with pytest.raises(InputError, match="model.precision=half: give float32 or bfloat16"):
        system(precision="half").check()


def test_a_person_is_learnt_from_what_the_layer_is_given_when_it_decides():
    class Brighter(CNN85):
        def forward(self, net, x):
            return net(4 * x)

    corpus = random_corpus(per_class=2)
    model = Brighter(10, epochs=1, batch=16).fit(corpus, corpus.gestures)
    codes = np.searchsorted(model.classes_, corpus.gestures)
    learnt = [model.adapt(corpus, corpus.gestures).net_]
    learnt += [
        relearnt(model.net_, model.samples(corpus), codes, 16, how) for how in (model.forward, nn.Module.__call__)
    ]
    as_it_decides, by_hand, otherwise = (net[-1].weight for net in learnt)
    assert torch.equal(as_it_decides, by_hand) and not torch.allclose(as_it_decides, otherwise)
