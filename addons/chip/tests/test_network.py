"""Exported C of hughes2017_cnn agrees after every frame with a plain computation."""

from copy import deepcopy
from functools import cache
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch
from torch.nn import functional

from addons.chip.tests.compiled import Library, describe_missing, fit_recogniser
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.models.nets.cnn85 import CNN85
from bench.models.nets.hughes2017 import Hughes2017CNN, round_network
from touchbench_chip.tables import collect_contents

pytestmark = pytest.mark.skipif(bool(describe_missing("gcc")), reason=describe_missing("gcc"))
LENGTHS = (1, 5, 9, 10, 11, 26, 27, 28, 36, 44, 45, 46, 60, 75, 101)
GRIDS = {  # kernels and pools of both layers; cut to one row, three; windows of 45 frames
    "wide": (5, 7, 40.0),
    "rows of three": (4, 3, 54.0),
    "one taxel": (1, 1, 20.0),
    "cost": (8, 8, 135.0),
}


@cache
def noise_captures(name):
    """Captures of noise that swells and fades, slowly or fast."""
    rows, cols, rate_hz = GRIDS[name]
    rng = np.random.default_rng(rows)
    arrays = []
    for i, n in enumerate(LENGTHS):
        strength = 0.5 + 0.5 * np.sin(
            np.arange(n)[:, None, None] / (3 + 5 * (i % 3)) + rng.normal(0, 1, (rows, cols))
        )
        arrays.append((rng.integers(0, 1024, (n, rows, cols)) * strength).astype(np.uint16))
    gestures = [f"g{i % 3}" for i in range(len(arrays))]
    return Corpus.from_captures(
        arrays, pd.DataFrame({"subject": "1", "gesture": gestures}), rate_hz
    )


@cache
def fit_to_noise(name):
    """Fit to noise, then change the last layer so that classes are about equal and far apart."""
    corpus = noise_captures(name)
    recogniser = fit_recogniser(Hughes2017CNN(epochs=3, batch=8, rate=1e-3), corpus)
    scores = np.log(recogniser.estimator.decide(corpus)[1])
    last = recogniser.estimator.net_[-1]
    with torch.no_grad():
        last.bias -= torch.from_numpy(scores.mean(axis=0))
        for parameter in (last.weight, last.bias):
            parameter /= float(scores.std(axis=0).mean())
    return corpus, recogniser


def predict_by_hand(net, frames, full_scale, window, hop):
    """Probabilities of a capture by PyTorch: windows, with 0s after its end."""
    starts = [s for s in range(0, len(frames), hop) if s == 0 or s - hop + window < len(frames)]
    parts = [frames[start : start + window].astype(np.float64) / full_scale for start in starts]
    x = torch.zeros(len(parts), 1, window, *frames.shape[1:], dtype=torch.float64)
    for i, part in enumerate(parts):
        x[i, 0, : len(part)] = torch.from_numpy(part)
    for conv in (net[0], net[3]):
        x = functional.conv3d(x, conv.weight.double(), conv.bias.double())
        x = functional.max_pool3d(x, [min(2, n) for n in x.shape[2:]]).relu()
    x = functional.linear(x.flatten(1), net[7].weight.double(), net[7].bias.double()).relu()
    proba = functional.linear(x, net[9].weight.double(), net[9].bias.double()).softmax(1)
    return proba.mean(0).detach().numpy()


def last_probabilities(library, captures):
    """Probabilities after each capture, asked for at its end only."""
    return np.array([library(frames).proba[-1] for frames in captures])


@pytest.mark.parametrize("name", GRIDS)
def test_after_every_frame_it_is_what_pytorch_says(name):
    corpus, recogniser = fit_to_noise(name)
    window, hop = recogniser.estimator.design_[1:3]
    library = Library(recogniser)
    frames = corpus[len(corpus) - 1]
    answer = library(frames, every=True)
    expected = [
        predict_by_hand(recogniser.estimator.net_, frames[: n + 1], 1023, window, hop)
        for n in range(101)
    ]
    assert np.ptp(expected, axis=0).max() > 0.05  # there is something to be classified
    np.testing.assert_allclose(answer.proba, expected, atol=2e-5)
    assert np.flatnonzero(answer.ready).tolist() == list(range(window - 1, 101, hop))
    for frames, proba in zip(
        corpus, last_probabilities(library, corpus), strict=True
    ):  # that a label was taken changes nothing
        np.testing.assert_array_equal(library(frames, every=True).proba[-1], proba)


def test_in_8_bits_it_has_the_probabilities_and_labels_of_python():
    corpus, recogniser = fit_to_noise("cost")
    in_python = deepcopy(recogniser)
    round_network(in_python.estimator.net_, 8)
    table = in_python.label(corpus)
    proba = last_probabilities(Library(recogniser, 8), corpus)
    np.testing.assert_allclose(proba, table.filter(like="p_"), atol=2e-5)
    assert [recogniser.classes[label] for label in proba.argmax(axis=1)] == table["label"].tolist()


def test_other_saved_networks_have_no_c():
    with pytest.raises(InputError, match="^CNN85 has no C"):
        collect_contents(SimpleNamespace(estimator=CNN85()), 32)
