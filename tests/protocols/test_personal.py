"""A new person: calibration captures are never tested, and nothing else of the person is used."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.plan.cells import cells
from bench.plan.plan import Fold, folds_of
from bench.plan.splits import Calibration
from bench.protocols.personal import Personal
from bench.protocols.subjects import LOSO
from bench.work.fold import decisions
from bench.work.personal import met
from tests.conftest import random_corpus, with_other_values


def pairs_of(protocol, corpus):
    """Pairs of each fold and draw."""
    return [[pair for pair in draw] for fold in protocol.calibrations(corpus) for draw in fold]


@given(st.integers(2, 4), st.integers(1, 7), st.integers(0, 4), st.integers(1, 3), st.integers(0, 5))
def test_every_capture_is_tested_once_per_draw_and_never_known_then(subjects, per_class, shots, draws, seed):
    corpus = random_corpus(subjects, per_class, longest=3)
    protocol = Personal(shots, draws, seed=seed)
    folds = list(zip(protocol.split(corpus), protocol.calibrations(corpus), strict=True))
    assert len(folds) == subjects
    for (train, test), drawn in folds:
        assert not set(corpus.subjects[train]) & set(corpus.subjects[test])
        assert len(drawn) == (draws if shots else 1)
        for pairs in drawn:
            assert sorted(np.concatenate([tested for _, tested in pairs])) == test.tolist()
            for calibration, tested in pairs:
                assert not set(calibration) & set(tested) and set(calibration) <= set(test)
                for name in set(corpus.gestures):
                    of_class = corpus.gestures[calibration] == name
                    half = (corpus.gestures[test] == name).sum() - (corpus.gestures[tested] == name).sum()
                    assert of_class.sum() == min(shots, half)


@given(st.integers(1, 4), st.integers(0, 20))
def test_calibrationare_nested_and_the_tested_half_stays(shots, seed):
    corpus = random_corpus(3, 9, longest=3)
    few, more = (pairs_of(Personal(k, 3, seed=seed), corpus) for k in (shots, shots + 1))
    for (calibration, tested), (larger, tested_too) in zip(sum(few, []), sum(more, []), strict=True):
        assert set(calibration) < set(larger) and np.array_equal(tested, tested_too)
    without = pairs_of(Personal(unlabelled=True, seed=seed), corpus)
    halves = [{tuple(tested) for draw in draws for _, tested in draw} for draws in (without, few)]
    assert halves[0] == halves[1]


def test_without_calibrationit_is_leaving_one_subject_out():
    corpus = random_corpus(3, 4, longest=3)
    cell = cells({"data": "synth", "protocol": "personal", "model": "lda", "features": "touch"})[0]
    folds = folds_of(cell, corpus)
    for fold, (train, test) in zip(folds, LOSO().split(corpus), strict=True):
        assert fold.known is None and np.array_equal(fold.train, train) and np.array_equal(fold.test, test)


SYSTEMS = {
    "adapts": {"model": "lda", "features": "touch"},
    "windows": {"model": "lda", "features": "touch", "model.window": "0.1"},
    "is fitted again": {"model": "svm", "features": "touch"},
    "pools": {"model": "svm", "features": "touch", "model.person": "centre+scale+pool"},
    "last layer": {"model": "cnn85", "model.epochs": "1", "model.frames": "10"},
}


def cell_of(system):
    return cells({"data": "synth", "protocol": "personal"} | SYSTEMS[system])[0]


def fold_of(corpus, labelled):
    pairs = next((Personal(2, 1) if labelled else Personal(unlabelled=True)).calibrations(corpus))[0]
    train, test = next(LOSO().split(corpus))
    return Fold("1", train, test, Calibration((tuple(pairs),), labelled, 3))


def probabilities(system, corpus, fold):
    systems = met(cell_of(system), corpus, fold)
    return [decisions(one.estimator, corpus, one.name, one.tested).filter(like="p_") for one in systems]


@pytest.mark.parametrize("system", ["adapts", "is fitted again"])
@pytest.mark.parametrize("labelled", [True, False])
def test_a_person_with_one_capture_is_tested_by_the_general_system(system, labelled):
    corpus = random_corpus(4, 4, longest=60)
    corpus = corpus[np.setdiff1d(np.arange(len(corpus)), np.flatnonzero(corpus.subjects == "1")[1:])]
    fold = fold_of(corpus, labelled)
    (one,) = met(cell_of(system), corpus, fold)
    assert one.tested.tolist() == fold.test.tolist() == [0]
    assert np.isfinite(one.estimator.predict_proba(corpus[fold.test])).all()


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("labelled", [True, False])
def test_no_other_label_and_no_other_frame_of_the_tested_half_is_used(system, labelled):
    corpus = random_corpus(4, 6, longest=60)
    fold = fold_of(corpus, labelled)
    shots, tested = fold.known.draws[0][0]
    few = Fold(fold.name, fold.train, fold.test, replace(fold.known, draws=(((shots, tested[:3]),),)))
    changed = with_other_values(corpus, np.setdiff1d(fold.test, [*shots, *tested[:3]]))
    gestures = corpus.gestures.copy()
    secret = np.setdiff1d(fold.test, shots) if labelled else fold.test
    gestures[secret] = np.where(gestures[secret] == "pat", "rub", "pat")
    changed = changed.changed(captures=changed.captures.assign(gesture=gestures))
    for table, other in zip(probabilities(system, corpus, few), probabilities(system, changed, few), strict=True):
        assert np.array_equal(table, other)
