import numpy as np
import pytest
from sklearn.model_selection import GroupKFold, KFold, LeaveOneGroupOut, StratifiedKFold, StratifiedShuffleSplit

from bench.errors import InputError
from bench.plan.splits import label, official_split
from protocols.captures import CaptureKFold, Holdout
from protocols.challenge import Challenge
from protocols.subjects import LOSO, SubjectKFold
from tests.conftest import random_corpus


def pairs(folds):
    return sorted((tuple(train), tuple(test)) for train, test in folds)


def test_loso_is_scikit_learns_leave_one_group_out_in_natural_order():
    corpus = random_corpus(subjects=12)
    ours = list(LOSO().split(corpus))
    assert pairs(ours) == pairs(LeaveOneGroupOut().split(corpus, groups=corpus.subjects))
    assert [corpus.subjects[test[0]] for _, test in ours] == [str(i) for i in range(1, 13)]


def test_folds_equal_scikit_learns(corpus):
    y, groups = corpus.gestures, corpus.subjects
    assert pairs(SubjectKFold(3, seed=5).split(corpus)) == pairs(
        GroupKFold(3, shuffle=True, random_state=5).split(y, groups=groups)
    )
    assert pairs(CaptureKFold(4, seed=5).split(corpus)) == pairs(
        StratifiedKFold(4, shuffle=True, random_state=5).split(y, y)
    )
    assert pairs(Holdout(seed=5).split(corpus)) == pairs(
        StratifiedShuffleSplit(1, test_size=0.35, random_state=5).split(y, y)
    )


@pytest.mark.parametrize(
    ("protocol", "mixed"),
    [(LOSO(), False), (SubjectKFold(3), False), (Challenge(), False), (CaptureKFold(3), True), (Holdout(), True)],
)
def test_subjects_are_apart_where_the_name_promises_it(protocol, mixed, corpus):
    folds = list(protocol.split(corpus, corpus.gestures, corpus.subjects))
    assert len(folds) == protocol.get_n_splits(corpus, corpus.gestures, corpus.subjects)
    for train, test in folds:
        assert len(train) and len(test) and not set(train) & set(test)
        assert bool(set(corpus.subjects[train]) & set(corpus.subjects[test])) == mixed
    assert ("subjects mixed" in protocol.label(corpus)) == mixed


def test_a_plain_splitter_is_named_after_its_class_and_what_it_mixes(corpus):
    assert label(KFold(3), corpus, True, "KFold[n_splits=3]") == "KFold[n_splits=3], subjects mixed"
    assert label(GroupKFold(), corpus, False, "GroupKFold") == "GroupKFold"
    assert label(CaptureKFold(3, 1), corpus, True, "kfold", 1) == "3-fold, subjects mixed, seed 1"
    assert official_split(KFold(3), corpus) is None and official_split(Challenge(), corpus) is False
    assert official_split(Challenge(), declared(corpus, ["1", "3"], ["4"])) is True


@pytest.mark.parametrize("protocol", [LOSO(), SubjectKFold(4), CaptureKFold(3)])
def test_every_capture_is_tested_once(protocol, corpus):
    tested = np.concatenate([test for _, test in protocol.split(corpus)])
    assert sorted(tested) == list(range(len(corpus)))


def declared(corpus, train, test):
    split = np.where(np.isin(corpus.subjects, train), "train", np.where(np.isin(corpus.subjects, test), "test", ""))
    corpus.captures["split"] = split
    return corpus


def test_challenge_uses_the_declared_split(corpus):
    corpus = declared(corpus, ["1", "3"], ["4"])
    ((train, test),) = Challenge().split(corpus)
    assert set(corpus.subjects[train]) == {"1", "3"} and set(corpus.subjects[test]) == {"4"}
    assert Challenge().label(corpus) == "challenge split, declared (18 / 9 captures)"


def test_challenge_refuses_a_split_with_a_subject_on_both_sides(corpus):
    corpus.captures["split"] = ["train", "test"] * 18
    with pytest.raises(InputError, match="both parts"):
        list(Challenge().split(corpus))
    corpus.captures["split"] = "train"
    with pytest.raises(InputError, match="0 test"):
        list(Challenge().split(corpus))


def test_challenge_draws_subjects_where_nothing_is_declared():
    corpus = random_corpus(subjects=9)
    folds = list(Challenge(repeats=3, seed=7).split(corpus))
    assert [len(set(corpus.subjects[train])) for train, _ in folds] == [6, 6, 6]
    assert len({tuple(test) for _, test in folds}) > 1
    assert pairs(folds) == pairs(Challenge(repeats=3, seed=7).split(corpus))
    assert "not the official split" in Challenge().label(corpus)


def test_challenge_on_cost_without_its_split_takes_21_subjects_gentle_and_normal():
    corpus = random_corpus(subjects=31, gestures=("pat", "rub"), per_class=3, info={"format": "cost"})
    corpus.captures["variant"] = ["gentle", "normal", "rough"] * (len(corpus) // 3)
    for train, test in Challenge().split(corpus):
        assert len(set(corpus.subjects[train])) == 21 and len(set(corpus.subjects[test])) == 10
        assert set(corpus.captures["variant"].iloc[np.r_[train, test]]) == {"gentle", "normal"}
    assert "21 / 10" in Challenge().label(corpus)


@pytest.mark.parametrize(
    "protocol",
    [SubjectKFold(5), SubjectKFold(1), CaptureKFold(13), CaptureKFold(1), Holdout(0.0), Holdout(0.01), Challenge(0)],
)
def test_impossible_splits_are_one_line(protocol, corpus):
    with pytest.raises(InputError) as error:
        list(protocol.split(corpus))
    assert "\n" not in str(error.value)


def test_one_subject_cannot_be_left_out():
    with pytest.raises(InputError, match="two subjects"):
        list(LOSO().split(random_corpus(subjects=1)))
