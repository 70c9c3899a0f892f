"""A new person: what is known of them is never tested, and nothing but that is looked at."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.errors import InputError
from bench.plan.cells import cells
from bench.plan.plan import Fold, folds_of
from bench.plan.splits import Calibration
from bench.work.fold import decisions
from bench.work.personal import met
from protocols.personal import Personal
from protocols.subjects import LOSO
from tests.conftest import random_corpus, with_other_values


def pairs_of(protocol, corpus):
    """Of each fold and draw."""
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
            for known, tested in pairs:
                assert not set(known) & set(tested) and set(known) <= set(test)
                for name in set(corpus.gestures):
                    of_class = corpus.gestures[known] == name
                    half = (corpus.gestures[test] == name).sum() - (corpus.gestures[tested] == name).sum()
                    assert of_class.sum() == min(shots, half)


@given(st.integers(1, 4), st.integers(0, 20))
def test_shots_are_nested_and_the_tested_half_stays(shots, seed):
    corpus = random_corpus(3, 9, longest=3)
    few, more = (pairs_of(Personal(k, 3, seed=seed), corpus) for k in (shots, shots + 1))
    without = pairs_of(Personal(unlabelled=True, seed=seed), corpus)
    for one, other in zip(few, more, strict=True):
        for (known, tested), (known_too, tested_too) in zip(one, other, strict=True):
            assert set(known) < set(known_too) and np.array_equal(tested, tested_too)
    halves = {tuple(tested) for pairs in without for _, tested in pairs}
    assert {tuple(tested) for pairs in few for _, tested in pairs} == halves


def test_draws_differ_and_repeat_themselves():
    corpus = random_corpus(3, 9, longest=3)
    drawn = [[k.tolist() for pair in pairs_of(Personal(2, 3, seed=s), corpus) for k, _ in pair] for s in (0, 0, 1)]
    assert drawn[0] == drawn[1] != drawn[2]
    assert len({tuple(known) for known in drawn[0]}) > len(drawn[0]) // 2


def test_other_people_change_nothing_of_what_is_drawn():
    corpus = random_corpus(4, 6, longest=3)
    fewer = corpus[corpus.subjects != "4"]
    for whole, part in zip(pairs_of(Personal(2, 2), corpus), pairs_of(Personal(2, 2), fewer), strict=False):
        assert [k.tolist() for k, _ in whole] == [k.tolist() for k, _ in part]


def test_without_shots_it_is_leaving_one_subject_out():
    corpus = random_corpus(3, 4, longest=3)
    cell = cells({"data": "synth", "protocol": "personal", "model": "lda", "features": "touch"})[0]
    folds = folds_of(cell, corpus)
    for fold, (train, test) in zip(folds, LOSO().split(corpus), strict=True):
        assert fold.known is None and np.array_equal(fold.train, train) and np.array_equal(fold.test, test)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"shots": -1}, "protocol.shots=-1: give 0 or more"),
        ({"draws": 0}, "protocol.draws=0: give 1 or more"),
        ({"seed": -1}, "protocol.seed=-1: give 0 or more"),
        ({"weight": 0}, "protocol.weight=0: give 1 or more"),
        ({"shots": 2, "unlabelled": True}, "protocol.shots=2: shots have labels"),
    ],
)
def test_what_cannot_be_is_one_line(wrong, message):
    with pytest.raises(InputError, match=message):
        list(Personal(**wrong).split(random_corpus(2, 2, longest=3)))


def test_it_says_whether_conditions_are_shared():
    corpus = random_corpus(2, 8, longest=3)
    assert "conditions" not in Personal(1).label(corpus)
    alone = corpus.changed(captures=corpus.captures.assign(cover=np.arange(len(corpus)).astype(str)))
    assert "under other conditions" in Personal(1).label(alone)
    same = corpus.changed(captures=corpus.captures.assign(cover="fur"))
    assert "under the same conditions" in Personal(1).label(same)
    assert Personal(3, 2).label(corpus) == "personal, 3 shots, 2 draws (2 subjects)"


def test_what_changes_numbers_is_in_the_label():
    corpus = random_corpus(3, 8, longest=3)
    protocols = [Personal(2), Personal(2, weight=3), Personal(2, seed=1), Personal(2, 2), Personal(1)]
    protocols += [Personal(unlabelled=True), Personal(unlabelled=True, seed=1), Personal(5)]
    assert len({p.label(corpus) for p in protocols}) == len(protocols)
    assert "up to 5 shots" in Personal(5).label(corpus) and "up to" not in Personal(4).label(corpus)


@pytest.mark.parametrize("system", ["model=lda", "model=svm"])
@pytest.mark.parametrize("labelled", [True, False])
def test_a_person_with_one_capture_is_tested_by_the_general_system(system, labelled):
    corpus = random_corpus(4, 4, longest=60)
    own = np.flatnonzero(corpus.subjects == "1")
    corpus = corpus[np.setdiff1d(np.arange(len(corpus)), own[1:])]
    protocol = Personal(unlabelled=True) if not labelled else Personal(2, 1)
    pairs = next(protocol.calibrations(corpus))[0]
    train, test = next(LOSO().split(corpus))
    fold = Fold("1", train, test, Calibration((tuple(pairs),), labelled, 3))
    cell = cells({"data": "synth", "protocol": "personal", "features": "touch", "model": system[6:]})[0]
    (one,) = met(cell, corpus, fold)
    assert one.tested.tolist() == test.tolist() and np.isfinite(one.estimator.predict_proba(corpus[test])).all()


SYSTEMS = {
    "adapts": {"model": "lda", "features": "touch"},
    "windows": {"model": "lda", "features": "touch", "model.window": "0.1"},
    "is fitted anew": {"model": "svm", "features": "touch"},
    "pools": {"model": "svm", "features": "touch", "model.person": "centre+scale+pool"},
    "last layer": {"model": "cnn85", "model.epochs": "1", "model.frames": "10"},
}


def told(system, corpus, fold):
    cell = cells({"data": "synth", "protocol": "personal"} | SYSTEMS[system])[0]
    return [decisions(one.estimator, corpus, one.name, one.tested).filter(like="p_") for one in met(cell, corpus, fold)]


def fold_of(corpus, labelled):
    (pairs,) = next(Personal(2, 1).calibrations(corpus))
    (train, test) = next(LOSO().split(corpus))
    return Fold("1", train, test, Calibration((tuple(pairs),), labelled, 3))


@pytest.mark.parametrize("system", SYSTEMS)
def test_no_label_and_no_other_frame_of_the_tested_half_is_seen(system):
    corpus = random_corpus(4, 6, longest=60)
    fold = fold_of(corpus, labelled=True)
    known, tested = fold.known.draws[0][0]
    only = replace(fold, known=replace(fold.known, draws=(((known, tested[:3]),),)))
    others = np.setdiff1d(fold.test, [*known, *tested[:3]])
    changed = with_other_values(corpus, others)
    gesture = changed.captures["gesture"].copy()
    gesture.iloc[np.concatenate([others, tested])] = "pat"
    changed = changed.changed(captures=changed.captures.assign(gesture=gesture))
    for mine, other in zip(told(system, corpus, only), told(system, changed, only), strict=True):
        assert np.array_equal(mine, other)


@pytest.mark.parametrize("system", SYSTEMS)
def test_labels_that_are_not_known_change_nothing(system):
    corpus = random_corpus(4, 6, longest=60)
    fold = fold_of(corpus, labelled=False)
    gesture = corpus.captures["gesture"].copy()
    gesture.iloc[fold.test] = np.random.default_rng(0).permutation(gesture.iloc[fold.test])
    changed = corpus.changed(captures=corpus.captures.assign(gesture=gesture))
    for mine, other in zip(told(system, corpus, fold), told(system, changed, fold), strict=True):
        assert np.array_equal(mine, other)


def test_a_shot_counts_as_often_as_is_asked_where_nothing_adapts():
    corpus = random_corpus(4, 6, longest=60)
    fold = fold_of(corpus, labelled=True)
    (known, tested), _ = fold.known.draws[0]
    cell = cells({"data": "synth", "protocol": "personal", "model": "svm", "features": "touch"})[0]
    by_hand = np.concatenate([fold.train, known, known, known])
    expected = cell.estimator().fit(corpus[by_hand], corpus.gestures[by_hand]).predict_proba(corpus[tested])
    one = next(iter(met(cell, corpus, fold)))
    np.testing.assert_allclose(one.estimator.predict_proba(corpus[tested]), expected)


@pytest.mark.parametrize("system", ["adapts", "windows"])
def test_what_adapts_knows_its_person_better(system):
    """A person whose touches are all much harder: their own mean tells the classes apart, that of others does not."""
    corpus = random_corpus(4, 6, longest=60)
    frames = corpus.frames.copy()
    for i in np.flatnonzero(corpus.subjects == "1"):
        frames[corpus.starts[i] : corpus.starts[i] + corpus.lengths[i]] += 120
    harder = corpus.changed(frames=frames)
    fold = fold_of(harder, labelled=True)
    cell = cells({"data": "synth", "protocol": "personal"} | SYSTEMS[system])[0]
    right = lambda one: np.mean(one.estimator.predict(harder[one.tested]) == harder.gestures[one.tested])  # noqa: E731
    general = np.mean([right(one) for one in met(cell, harder, replace(fold, known=None))])
    adapted = np.mean([right(one) for one in met(cell, harder, fold)])
    assert adapted > general + 0.2
