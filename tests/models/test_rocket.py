"""Random convolutions and ridge: the ridge against scikit-learn, series against a loop, and what no system may do."""

import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import log_softmax, softmax
from sklearn.base import clone
from sklearn.linear_model import Ridge as SklearnRidge
from sklearn.linear_model import RidgeClassifier
from sklearn.model_selection import LeaveOneGroupOut

from bench.cli import main
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.work.pool import pool
from models import rocket
from models.rocket import PENALTIES, Ridge, Rocket
from models.series import Series
from models.sizes import sizes
from tests.conftest import random_corpus, with_other_values

BOTH = pytest.mark.parametrize("transform", ["minirocket", "multirocket_hydra"])


def small(transform="minirocket", **kwargs):
    return Rocket(transform, **{"kernels": 200, **kwargs})


def with_arrays(arrays, captures):
    return Corpus.from_captures(arrays, captures[: len(arrays)], 100.0)


@given(st.integers(3, 30), st.integers(1, 40), st.integers(2, 5), st.sampled_from(PENALTIES), st.integers(0, 99))
def test_ridge_and_what_it_predicts_for_left_out_groups_equal_scikit_learn(captures, width, groups, penalty, seed):
    rng = np.random.default_rng(seed)
    features = rng.standard_normal((captures, width)).astype(np.float32)
    features -= features.mean(axis=0)
    targets = np.where(rng.random((captures, 3)) < 0.4, 1.0, -1.0)
    group = np.concatenate([[0, 1], rng.integers(0, groups, captures - 2)])
    ours, exact = Ridge(features, targets), features.astype(np.float64)
    whole = SklearnRidge(alpha=penalty).fit(exact, targets)
    np.testing.assert_allclose(exact.T @ ours.dual(penalty), whole.coef_.T, rtol=1e-4, atol=1e-6)
    expected = np.empty_like(targets)
    for train, test in LeaveOneGroupOut().split(features, groups=group):
        expected[test] = SklearnRidge(alpha=penalty).fit(exact[train], targets[train]).predict(exact[test])
    parts = [np.flatnonzero(group == g) for g in np.unique(group)]
    np.testing.assert_allclose(ours.left_out(penalty, parts), expected, rtol=1e-4, atol=1e-5)


@BOTH
def test_penalty_and_temperature_are_those_of_a_plain_loop_over_subjects(transform, corpus):
    names = np.where(np.random.default_rng(2).random(36) < 0.4, "tap", corpus.gestures)  # else nothing is uncertain
    model = small(transform, seed=3).fit(corpus, names)
    features = model._features(corpus)
    model._scale(features)
    features, targets = features.astype(np.float64), np.where(model.classes_ == names[:, None], 1.0, -1.0)
    codes, found = targets.argmax(axis=1), {}
    for penalty in PENALTIES:
        scores = np.empty_like(targets)
        for train, test in LeaveOneGroupOut().split(features, groups=corpus.subjects):
            ridge = SklearnRidge(alpha=penalty).fit(features[train], targets[train])
            scores[test] = ridge.predict(features[test])
        for temperature in np.exp(np.linspace(-5, 5, 401)):
            found[penalty, temperature] = -log_softmax(scores / temperature, axis=1)[np.arange(36), codes].mean()
    penalty, temperature = min(found, key=found.get)
    assert model.penalty_ == penalty
    assert model.temperature_ == pytest.approx(temperature, rel=0.03)
    whole = RidgeClassifier(alpha=penalty).fit(features, names)
    expected = softmax(whole.decision_function(features) / model.temperature_, axis=1)
    np.testing.assert_allclose(model.predict_proba(corpus), expected, atol=1e-4)


@given(st.integers(1, 4), st.integers(1, 5), st.integers(1, 30), st.integers(0, 99))
def test_series_equal_a_loop(rows, cols, longest, seed):
    corpus = random_corpus(subjects=2, per_class=1, grid=(rows, cols), longest=longest + 1, seed=seed)
    order = np.random.default_rng(seed).permutation(len(corpus))[:4]
    corpus = corpus[order]
    model = Series("both", length=12).fit(corpus)
    values = []
    for frames in corpus:
        for frame in frames.astype(float):
            total = frame.sum()
            row = sum((r + 1) * frame[r].sum() for r in range(rows)) / total if total else (rows + 1) / 2
            col = sum((c + 1) * frame[:, c].sum() for c in range(cols)) / total if total else (cols + 1) / 2
            values.append([*frame.ravel(), total, row, col, frame.max(), (frame > 0.05 * 1023).mean()])
    values = np.array(values)
    sd = np.where(values.std(axis=0) > 1e-9, values.std(axis=0), 1)
    values, place = (values - values.mean(axis=0)) / sd, 0
    for found, length in zip(model.each(corpus), corpus.lengths, strict=True):
        for t in range(12):
            at = t * (length - 1) / 11
            before, share = min(int(at), length - 1), at - int(at)
            after = min(before + 1, length - 1)
            expected = (1 - share) * values[place + before] + share * values[place + after]
            np.testing.assert_allclose(found[:, t], expected, rtol=1e-4, atol=1e-4)
        place += length


def test_a_feature_of_minirocket_by_hand(corpus):
    """The share of frames above its bias of one convolution, whose weights are -1 but for three 2."""
    model = small(channels="signals", kernels=84 * 3).fit(corpus, corpus.gestures)
    counts, chosen, dilations, each, biases = model.transforms_[0].parameters
    series = next(model.series_.each(corpus[4:5]))
    features, position, place, kernel = model._features(corpus[4:5])[0], 0, 0, 0
    for step, dilation in enumerate(dilations):
        for number in range(84):
            a, b, c = model.transforms_[0]._indices[number]
            weights = np.full(9, -1.0)
            weights[[a, b, c]] = 2
            picked = series[chosen[place : place + counts[kernel]]].astype(float).sum(axis=0)
            padded = np.pad(picked, 4 * dilation)
            found = [padded[t : t + 8 * dilation + 1 : dilation] @ weights for t in range(len(picked))]
            if (step + number) % 2:
                found = found[4 * dilation : -4 * dilation]
            for bias in biases[position : position + each[step]]:
                assert features[position] == pytest.approx(np.mean(np.array(found) > bias), abs=2 / len(found))
                position += 1
            place, kernel = place + counts[kernel], kernel + 1
    assert position == len(features)


@BOTH
def test_contract(transform, corpus):
    train_part = corpus[corpus.subjects != "4"]
    a, b, c = (small(transform, seed=seed).fit(train_part, train_part.gestures) for seed in (0, 0, 1))
    proba = a.predict_proba(corpus)
    assert np.array_equal(proba, b.predict_proba(corpus))
    assert np.array_equal(proba, pickle.loads(pickle.dumps(a)).predict_proba(corpus))
    assert not np.array_equal(proba, c.predict_proba(corpus))
    np.testing.assert_allclose(proba.sum(axis=1), 1, rtol=1e-5)
    assert clone(a).get_params() == a.get_params()
    assert (a.predict(corpus[corpus.subjects == "4"]) == corpus.gestures[corpus.subjects == "4"]).mean() > 0.7
    for some in ([0], [7], [20], [5, 3, 30]):  # to the last bit, whoever else is in the batch
        assert np.array_equal(a.predict_proba(corpus[some]), proba[some])


@BOTH
@pytest.mark.parametrize("channels", ["signals", "taxels", "both"])
def test_any_grid_and_any_length(transform, channels):
    for grid in ((3, 5), (1, 2)):
        corpus = random_corpus(grid=grid, per_class=1, longest=14)
        model = small(transform, channels=channels, kernels=84).fit(corpus, corpus.gestures)
        assert np.isfinite(model.predict_proba(corpus)).all()
        assert sizes(model, grid[0] * grid[1], 40)["ram_bytes"] > 0


@BOTH
def test_captures_of_one_frame_and_captures_that_never_change(transform, corpus):
    frames = [frames[:1] for frames in corpus]
    for arrays in (
        frames,
        [np.zeros((25, 8, 8), np.uint16) for _ in frames],
        [np.repeat(f, 30, axis=0) for f in frames],
    ):
        one = with_arrays(arrays, corpus.captures)
        proba = small(transform).fit(one, one.gestures).predict_proba(one)
        assert np.isfinite(proba).all()
        np.testing.assert_allclose(proba.sum(axis=1), 1, rtol=1e-5)
    model = small(transform).fit(corpus, corpus.gestures)
    assert np.isfinite(model.predict_proba(one)).all()


def test_captures_as_long_as_the_median_are_taken_as_they_are(corpus):
    model = small().fit(corpus, corpus.gestures)
    assert model.series_.length_ == int(np.median(corpus.lengths))
    frames = np.random.default_rng(0).integers(0, 1023, (model.series_.length_, 8, 8)).astype(np.uint16)
    one = with_arrays([frames], corpus.captures)
    (series,) = model.series_.each(one)
    total = frames.sum(axis=(1, 2), dtype=float)
    np.testing.assert_allclose(
        series[0] * model.series_.level_.scale_[0] + model.series_.level_.mean_[0], total, rtol=1e-5
    )


def test_biases_come_from_a_sample_where_memory_is_short(corpus, monkeypatch):
    model = small().fit(corpus, corpus.gestures)
    assert len(model._sample(corpus)) == len(corpus)
    monkeypatch.setattr(rocket, "SAMPLE", 7 * 5 * model.series_.length_)
    assert model._sample(corpus).shape == (7, 5, model.series_.length_)
    other = small().fit(corpus, corpus.gestures)
    assert not np.array_equal(other.transforms_[0].parameters[-1], model.transforms_[0].parameters[-1])
    assert np.array_equal(other.predict(corpus), model.predict(corpus))


@BOTH
def test_test_subjects_change_nothing_that_is_learned(transform, corpus):
    train_part, test = np.flatnonzero(corpus.subjects != "2"), np.flatnonzero(corpus.subjects == "2")
    other, probe = with_other_values(corpus, test), random_corpus(seed=9)
    found = [small(transform, channels="both").fit(c[train_part], c.gestures[train_part]) for c in (corpus, other)]
    assert np.array_equal(*(model.predict_proba(probe) for model in found))
    assert found[0].penalty_ == found[1].penalty_ and found[0].temperature_ == found[1].temperature_


@BOTH
def test_nothing_of_the_process_is_changed(transform, corpus):
    threads = torch.get_num_threads()
    np.random.seed(5)
    torch.manual_seed(5)
    expected = np.random.random(), torch.rand(1).item()
    np.random.seed(5)
    torch.manual_seed(5)
    small(transform).fit(corpus, corpus.gestures).predict(corpus)
    assert (np.random.random(), torch.rand(1).item()) == expected
    assert torch.get_num_threads() == threads


def test_workers_have_as_many_numba_threads_as_they_were_given():
    assert pool(1, 1).submit(os.getenv, "NUMBA_NUM_THREADS").result() == "1"


def test_sizes(corpus):
    model = small(kernels=168).fit(corpus, corpus.gestures)
    counts, chosen, dilations, each, biases = model.transforms_[0].parameters
    assert len(biases) == 168
    drawn = len(counts) + len(chosen) + len(dilations) + len(each) + 168
    numbers = drawn + 2 * 5 + 2 * 168 + 168 * 3 + 3 + 1
    memory = (13 * 5 + 1) * model.series_.length_ + 168 + 3
    found = sizes(model, 64, 40)
    assert (found["parameters"], found["flash_bytes"], found["ram_bytes"]) == (numbers, 4 * numbers, 4 * memory)
    hydra = small("multirocket_hydra", kernels=84).fit(corpus, corpus.gestures)
    dilated = len(hydra.transforms_[1]._hydra.dilations)
    drawn = sum(np.size(a) for a in (*hydra.transforms_[0].parameter, *hydra.transforms_[0].parameter1))
    drawn += dilated * 2 * 256 * 9 + dilated * 2 * 32 * 2  # two channels for each of 32 groups
    width = 2 * 84 * 4 + dilated * 2 * 2 * 256
    assert hydra.parameters_ == drawn + 2 * 5 + 2 * width + width * 3 + 3 + 1


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"transform": "rocket"}, "model.transform=rocket: give minirocket or multirocket_hydra"),
        ({"channels": "all"}, "model.channels=all: give signals or taxels or both"),
        ({"kernels": 83}, "model.kernels=83: give at least 84"),
    ],
)
def test_what_cannot_be_is_refused(wrong, told):
    with pytest.raises(InputError, match=told):
        Rocket(**wrong).check()


def test_one_training_subject_is_refused(corpus):
    alone = corpus[corpus.subjects == "1"]
    with pytest.raises(InputError, match="there is 1; train on more"):
        small().fit(alone, alone.gestures)


def test_without_aeon_one_line_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setattr(rocket, "find_spec", lambda name: None)
    assert main(["run", "protocol=loso", "model=svm,rocket"]) == 2
    out, err = capsys.readouterr()
    assert not out and err.strip().count("\n") == 0
    assert "model=rocket needs the package aeon" in err and "pip install 'touchbench[rocket]'" in err
    assert not os.path.exists("mlflow.db")


def test_aeon_is_imported_by_no_command_that_does_not_need_it():
    code = (
        "import sys; sys.modules['aeon'] = None; from bench.cli import main; from bench.plan.cells import cells\n"
        "assert main(['run', '--help']) == main(['systems']) == 0\n"
        "cells({'model': 'rocket,svm'})[0].estimator(); assert 'numba' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
