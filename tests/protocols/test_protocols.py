import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.model_selection import (
    GroupKFold,
    LeaveOneGroupOut,
    LeaveOneOut,
    RepeatedStratifiedKFold,
    StratifiedKFold,
    StratifiedShuffleSplit,
)

from bench.errors import InputError
from bench.protocols.captures import CaptureKFold, Holdout, LeaveOneCapture, RepeatedKFold, Within
from bench.protocols.challenge import Challenge
from bench.protocols.subjects import LOSO, Sessions, SubjectKFold
from tests.conftest import random_corpus


def pairs(folds):
    return sorted((tuple(train), tuple(test)) for train, test in folds)


def ragged(seed):
    """Some captures of random subjects, in random order, at least three of each gesture."""
    corpus, rng = random_corpus(subjects=5, per_class=4, seed=seed), np.random.default_rng(seed)
    kept = rng.permutation(len(corpus))[: rng.integers(20, len(corpus))]
    return corpus[kept] if pd.Series(corpus.gestures[kept]).value_counts().min() > 2 else corpus


@given(seed=st.integers(0, 500))
def test_captures_of_ragged_subjects_are_split_as_scikit_learn_does(seed):
    corpus = ragged(seed)
    y, shuffled = corpus.gestures, {"shuffle": True, "random_state": seed}
    for protocol, splitter, groups in (
        (LOSO(), LeaveOneGroupOut(), corpus.subjects),
        (SubjectKFold(3, seed), GroupKFold(3, **shuffled), corpus.subjects),
        (CaptureKFold(3, seed), StratifiedKFold(3, **shuffled), None),
        (Holdout(seed=seed), StratifiedShuffleSplit(1, test_size=0.35, random_state=seed), None),
        (LeaveOneCapture(), LeaveOneOut(), None),
        (
            RepeatedKFold(3, 2, seed),
            RepeatedStratifiedKFold(n_splits=3, n_repeats=2, random_state=seed),
            None,
        ),
    ):
        assert pairs(protocol.split(corpus)) == pairs(splitter.split(y, y, groups))


def test_sessions_of_a_person_are_tested_with_other_people_in_other_sessions():
    corpus = random_corpus(subjects=3, per_class=4)
    session = np.array(["a", "b", "c"])[np.arange(len(corpus)) % 3]
    corpus = corpus.with_fields(captures=corpus.captures.assign(day=session))
    folds = list(Sessions("day").split(corpus))
    tested = [(corpus.subjects[test[0]], session[test[0]]) for _, test in folds]
    assert tested == [(person, day) for person in "123" for day in "abc"]
    for train, test in folds:
        apart = (corpus.subjects != corpus.subjects[test[0]]) & (session != session[test[0]])
        np.testing.assert_array_equal(train, np.flatnonzero(apart))
    np.testing.assert_array_equal(
        np.sort(np.concatenate([test for _, test in folds])), np.arange(len(corpus))
    )
    with pytest.raises(InputError, match="no such column"):
        next(Sessions().split(corpus))
    with pytest.raises(InputError, match="one day here"):
        next(Sessions("day").split(corpus[session == "a"]))


def test_loso_leaves_subjects_out_in_natural_order():
    corpus = random_corpus(subjects=12)
    assert [corpus.subjects[test[0]] for _, test in LOSO().split(corpus)] == [
        str(i) for i in range(1, 13)
    ]


@pytest.mark.parametrize(
    ("protocol", "mixed", "covers"),
    [
        (LOSO(), False, True),
        (SubjectKFold(3), False, True),
        (Challenge(), False, False),
        (CaptureKFold(3), True, True),
        (Holdout(), True, False),
        (LeaveOneCapture(), True, True),
        (RepeatedKFold(3, 1), True, True),
        (RepeatedKFold(3, 2), True, False),  # covers twice
        (Within(3), True, True),
    ],
)
def test_subjects_are_apart_where_the_name_promises_it(protocol, mixed, covers, corpus):
    folds = list(protocol.split(corpus, corpus.gestures, corpus.subjects))
    assert len(folds) == protocol.get_n_splits(corpus, corpus.gestures, corpus.subjects)
    for train, test in folds:
        assert len(train) and len(test) and not set(train) & set(test)
        assert bool(set(corpus.subjects[train]) & set(corpus.subjects[test])) == mixed
    assert ("subjects mixed" in protocol.label(corpus)) == mixed
    assert (
        sorted(np.concatenate([test for _, test in folds])) == list(range(len(corpus)))
    ) == covers


def test_challenge_uses_the_declared_split(corpus):
    corpus.captures["split"] = (
        pd.Series(corpus.subjects).map({"1": "train", "3": "train", "4": "test"}).fillna("")
    )
    ((train, test),) = Challenge().split(corpus)
    assert set(corpus.subjects[train]) == {"1", "3"} and set(corpus.subjects[test]) == {"4"}
    assert Challenge().official_split(corpus)
    assert Challenge().label(corpus) == "challenge split, declared (18 / 9 captures)"


def test_challenge_draws_subjects_where_nothing_is_declared():
    corpus = random_corpus(subjects=9)
    drawn = [pairs(Challenge(repeats=3, seed=7).split(corpus)) for _ in range(2)]
    assert drawn[0] == drawn[1] and [
        len(set(corpus.subjects[[*train]])) for train, _ in drawn[0]
    ] == [6, 6, 6]
    assert len(
        {test for _, test in drawn[0]}
    ) > 1 and "not the official split" in Challenge().label(corpus)


def test_challenge_on_cost_without_its_split_takes_21_subjects_gentle_and_normal():
    corpus = random_corpus(
        subjects=31, gestures=("pat", "rub"), per_class=3, info={"format": "cost"}
    )
    corpus.captures["variant"] = ["gentle", "normal", "rough"] * (len(corpus) // 3)
    for train, test in Challenge().split(corpus):
        assert len(set(corpus.subjects[train])) == 21 and len(set(corpus.subjects[test])) == 10
        assert set(corpus.captures["variant"].iloc[np.r_[train, test]]) == {"gentle", "normal"}
    assert "21 / 10" in Challenge().label(corpus)


@pytest.mark.parametrize(
    ("protocol", "subjects", "split"),
    [
        (SubjectKFold(5), 4, None),
        (CaptureKFold(13), 4, None),
        (Holdout(0.0), 4, None),
        (Holdout(0.01), 4, None),
        (RepeatedKFold(13), 4, None),
        (RepeatedKFold(3, 0), 4, None),
        (Within(4), 4, None),
        (Within(1), 4, None),
        (LOSO(), 1, None),
        (LeaveOneCapture(), 1, None),
        (Challenge(), 1, None),
        (Challenge(0), 4, None),
        (Challenge(), 4, ["train", "test"] * 18),  # subjects on both sides
        (Challenge(), 4, ["train"] * 36),
    ],
)
def test_impossible_splits_are_one_line(protocol, subjects, split):
    corpus = random_corpus(subjects, per_class=3 if subjects > 1 else 1)
    if split:
        corpus.captures["split"] = split
    with pytest.raises(InputError) as error:
        list(protocol.split(corpus))
    assert "protocol" in str(error.value) and "\n" not in str(error.value)


@given(seed=st.integers(0, 500))
def test_within_trains_and_tests_one_person_with_stratified_folds_of_their_own(seed):
    corpus = ragged(seed)
    people = pd.crosstab(corpus.subjects, corpus.gestures)
    corpus = corpus[np.flatnonzero(np.isin(corpus.subjects, people.index[people.min(axis=1) > 1]))]
    own = {}
    for train, test in Within(2, seed).split(corpus):
        (person,) = set(corpus.subjects[train]) | set(corpus.subjects[test])
        own.setdefault(person, []).append((train, test))
    assert set(own) == set(corpus.subjects)
    for person, folds in own.items():
        captures = np.flatnonzero(corpus.subjects == person)
        y = corpus.gestures[captures]
        splitter = StratifiedKFold(2, shuffle=True, random_state=seed)
        assert pairs(folds) == pairs((captures[a], captures[b]) for a, b in splitter.split(y, y))
