"""Exported C of hughes2017_cnn: after every frame it says what a plain computation of its windows says."""

import ctypes
import subprocess
from copy import deepcopy
from functools import cache

import numpy as np
import pandas as pd
import pytest
import torch
from torch.nn import functional

from bench.cli import main
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.export.write import files_of
from models.nets.cnn85 import CNN85
from models.nets.hughes2017 import Hughes2017AERNN, Hughes2017CNN, Hughes2017CNNRNN, in_bits
from models.quantised import rounded
from models.recipe import Recipe
from tests.export.compiled import STRICT, fitted, lacking, written

pytestmark = pytest.mark.skipif(bool(lacking("gcc")), reason=lacking("gcc"))
LENGTHS = (1, 5, 9, 10, 11, 26, 27, 28, 36, 44, 45, 46, 60, 75, 101)
GRIDS = {  # kernels and pools of both layers; cut to one row, two, three; windows of 45 frames
    "haart": (8, 8, 54.0),
    "wide": (5, 7, 40.0),
    "odd": (7, 6, 54.0),
    "rows of three": (4, 3, 54.0),
    "two by three": (2, 3, 20.0),
    "one taxel": (1, 1, 20.0),
    "cost": (8, 8, 135.0),
    "cost, narrow": (2, 5, 120.0),
}
EVERY = """#include "touch.c"
static touch_t t;
int every(const float *frames, int n, int ask, float *proba, int *ready)
{
    if (touch_init(&t))
        return 1;
    for (int i = 0; i < n; i++) {
        ready[i] = touch_push(&t, frames + (long)i * TAXELS);
        if (ready[i] < 0 || ((ask || i == n - 1) && touch_label(&t, proba + (long)i * CLASSES, 0) < 0))
            return 1;
    }
    return 0;
}
"""


@cache
def noise(name):
    """Captures of noise that swells and fades, slowly or fast."""
    rows, cols, rate_hz = GRIDS[name]
    rng = np.random.default_rng(rows)
    arrays = []
    for i, n in enumerate(LENGTHS):
        strength = 0.5 + 0.5 * np.sin(np.arange(n)[:, None, None] / (3 + 5 * (i % 3)) + rng.normal(0, 1, (rows, cols)))
        arrays.append((rng.integers(0, 1024, (n, rows, cols)) * strength).astype(np.uint16))
    gestures = [f"g{i % 3}" for i in range(len(arrays))]
    return Corpus.from_captures(arrays, pd.DataFrame({"subject": "1", "gesture": gestures}), rate_hz)


@cache
def made(name):
    """A system that has learnt a little of noise, its last layer such that classes are about equal and far apart."""
    corpus = noise(name)
    found = fitted(Hughes2017CNN(epochs=3, batch=8, rate=1e-3), corpus)
    scores = np.log(found.estimator.decide(corpus)[1])
    last = found.estimator.net_[-1]
    with torch.no_grad():
        last.bias -= torch.from_numpy(scores.mean(axis=0))
        for parameter in (last.weight, last.bias):
            parameter /= float(scores.std(axis=0).mean())
    return corpus, found


def every(found, folder, bits=32):
    """A function from frames to probabilities after each, and whether there was a new decision."""
    written(found, folder, bits)
    (folder / "every.c").write_text(EVERY)
    call = ["gcc", *STRICT, "-shared", "-fPIC", str(folder / "every.c"), "-lm", "-o", str(folder / "every.so")]
    subprocess.run(call, check=True, capture_output=True, text=True)
    run = ctypes.CDLL(str(folder / "every.so")).every

    def asked(frames, ask=True):
        given = np.ascontiguousarray(frames.reshape(len(frames), -1), dtype=np.float32)
        proba, ready = np.zeros((len(frames), len(found.classes)), np.float32), np.zeros(len(frames), np.int32)
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (given, proba, ready)]
        assert run(pointers[0], len(given), int(ask), *pointers[1:]) == 0
        return proba, ready

    return asked


def by_hand(net, frames, full_scale, window, hop):
    """Probabilities of a capture: windows, 0s where it has ended; PyTorch's convolutions, pools and linear layers."""
    starts = [s for s in range(0, len(frames), hop) if s == 0 or s - hop + window < len(frames)]
    told = []
    for start in starts:
        part = frames[start : start + window].astype(np.float64) / full_scale
        x = torch.zeros(1, 1, window, *frames.shape[1:], dtype=torch.float64)
        x[0, 0, : len(part)] = torch.from_numpy(part)
        for conv in (net[0], net[3]):
            x = functional.conv3d(x, conv.weight.double(), conv.bias.double())
            x = functional.max_pool3d(x, [min(2, n) for n in x.shape[2:]]).relu()
        x = functional.linear(x.flatten(1), net[7].weight.double(), net[7].bias.double()).relu()
        told.append(functional.linear(x, net[9].weight.double(), net[9].bias.double()).softmax(1))
    return torch.cat(told).mean(0).detach().numpy()


@pytest.mark.parametrize("name", GRIDS)
def test_after_every_frame_it_is_what_pytorch_says(name, tmp_path):
    corpus, found = made(name)
    window, hop = found.estimator.design_[1:3]
    asked = every(found, tmp_path / "c")
    frames = corpus[len(corpus) - 1]
    proba, ready = asked(frames)
    expected = [by_hand(found.estimator.net_, frames[: n + 1], corpus.full_scale, window, hop) for n in range(101)]
    assert np.ptp(expected, axis=0).max() > 0.05  # there is something to be told
    np.testing.assert_allclose(proba, expected, atol=2e-5)
    assert np.flatnonzero(ready).tolist() == list(range(window - 1, 101, hop))


@pytest.mark.parametrize("bits", [32, 8])
@pytest.mark.parametrize("name", ["haart", "wide", "two by three", "cost"])
def test_captures_have_the_probabilities_and_labels_of_python(name, bits, tmp_path):
    corpus, found = made(name)
    rounded_too = deepcopy(found)
    if bits == 8:
        in_bits(rounded_too.estimator.net_, 8)
    told = rounded_too.label(corpus)
    asked = every(found, tmp_path / "c", bits)
    proba = np.array([asked(frames, ask=False)[0][-1] for frames in corpus])
    np.testing.assert_allclose(proba, told.filter(like="p_"), atol=2e-5)
    assert [found.classes[label] for label in proba.argmax(axis=1)] == told["label"].tolist()


def test_asking_changes_nothing(tmp_path):
    corpus, found = made("haart")
    asked = every(found, tmp_path / "c")
    for frames in corpus:
        np.testing.assert_array_equal(asked(frames)[0][-1], asked(frames, ask=False)[0][-1])


def test_eight_bits_are_steps_of_each_filter_and_unit():
    corpus = noise("haart")
    plain, few = (Hughes2017CNN(epochs=1, bits=bits).fit(corpus, corpus.gestures).net_ for bits in (32, 8))
    for before, after in zip(plain.parameters(), few.parameters(), strict=True):
        if before.ndim == 1:
            assert torch.equal(before, after)
            continue
        for one, other in zip(before.detach().flatten(1).numpy(), after.detach().flatten(1).numpy(), strict=True):
            step = np.abs(one).max() / 127
            np.testing.assert_allclose(other, np.round(one / step) * step, rtol=1e-5)
            assert len(np.unique(other)) > 2 or len(one) < 3
        whole = [rounded(p.detach().flatten(1).numpy(), 8)[0] for p in (before, after)]
        np.testing.assert_array_equal(*whole)  # twice as once


def test_repair_and_a_person_go_along(tmp_path):
    corpus, found = made("haart")
    own = corpus[:6]
    person = deepcopy(found)
    person.estimator = found.estimator.adapt(own, own.gestures[::-1])
    frames = corpus.frames.copy()
    frames[:, 1, 2] = 1023
    stuck = corpus.changed(frames=frames)
    repaired = fitted(Recipe(Hughes2017CNN(epochs=1, batch=8), repair=("stuck", "dead")), stuck)
    for each, seen, name in ((person, corpus, "person"), (repaired, stuck, "repaired")):
        told = each.label(seen).filter(like="p_").to_numpy()
        asked = every(each, tmp_path / name)
        proba = np.array([asked(frames, ask=False)[0][-1] for frames in seen])
        np.testing.assert_allclose(proba, told, atol=1e-5)
    assert np.abs(person.label(corpus)["confidence"] - found.label(corpus)["confidence"]).max() > 1e-3


@pytest.mark.parametrize(
    "model",
    [Hughes2017CNNRNN(epochs=1, batch=8), Hughes2017AERNN(epochs=1, pretraining=1), CNN85(frames=10, epochs=1)],
    ids=["cnn_rnn", "ae_rnn", "cnn85"],
)
def test_other_networks_are_refused_in_a_line(model, tmp_path, capsys):
    import mlflow

    corpus = made("haart")[0]
    found = fitted(model, corpus)
    with pytest.raises(InputError, match="has no C: of networks hughes2017_cnn has"):
        files_of(found, 32, "a test")
    if isinstance(model, CNN85):
        mlflow.pyfunc.save_model("rec", **found.model([], corpus[0][:2]))
        capsys.readouterr()
        assert main(["export", "rec", "out=c"]) == 2
        said = capsys.readouterr().err
        assert "CNN85 has no C" in said and len(said.strip().splitlines()) == 1
