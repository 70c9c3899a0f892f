"""A new person: calibration captures are never tested, and nothing else of the person is used."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.errors import HiddenError, InputError
from bench.plan.cells import make_cells
from bench.plan.plan import Fold, make_folds, make_plans
from bench.running.circumstances.faults import Faults
from bench.running.evaluation import folded, systems
from bench.running.fold import decisions
from bench.running.loop import warnings
from tests.conftest import random_corpus, with_other_values
from tests.corpora.made import copied
from tests.running.fakes import Level
from touchbench_people.personal import Personal


@given(
    st.integers(2, 4), st.integers(1, 7), st.integers(0, 4), st.integers(1, 3), st.integers(0, 5)
)
def test_every_capture_is_tested_once_per_draw_and_never_known_then(
    subjects, per_class, shots, draws, seed
):
    corpus = random_corpus(subjects, per_class, longest=3)
    protocol = Personal(shots, draws, seed=seed)
    folds = list(zip(protocol.split(corpus), protocol.calibrations(corpus), strict=True))
    assert len(folds) == subjects
    for (train, test, flat), drawn in folds:
        drawn = drawn or [[(test[:0], test)]]
        assert not set(corpus.subjects[train]) & set(corpus.subjects[test])
        assert len(drawn) == (draws if shots else 1) and len(flat) in (0, 2 * draws)
        for pairs in drawn:
            assert sorted(np.concatenate([tested for _, tested in pairs])) == test.tolist()
            for calibration, tested in pairs:
                assert not set(calibration) & set(tested) and set(calibration) <= set(test)
                for name in set(corpus.gestures):
                    of_class = corpus.gestures[calibration] == name
                    half = (corpus.gestures[test] == name).sum() - (
                        corpus.gestures[tested] == name
                    ).sum()
                    assert of_class.sum() == min(shots, half)


@given(st.integers(1, 4), st.integers(0, 20))
def test_calibrations_are_nested_and_the_tested_half_stays(shots, seed):
    corpus = random_corpus(3, 9, longest=3)
    kinds = [{"shots": shots}, {"shots": shots + 1}, {"unlabelled": True}]
    few, more, without = (
        [
            pair
            for fold in Personal(draws=3, seed=seed, **kind).calibrations(corpus)
            for draw in fold
            for pair in draw
        ]
        for kind in kinds
    )
    for (calibration, tested), (larger, tested_too) in zip(few, more, strict=True):
        assert set(calibration) < set(larger) and np.array_equal(tested, tested_too)
    assert {tuple(tested) for _, tested in few} == {tuple(tested) for _, tested in without}


SYSTEMS = {
    "adapts": {"model": "lda", "features": "touch"},
    "is fitted again": {"model": "svm", "features": "touch"},
    "pools": {"model": "adaptable", "features": "touch", "model.ways": "centre+scale+pool"},
    "last layer": {"model": "cnn85", "model.epochs": "1", "model.frames": "10"},
}


def cell_of(system, labelled):
    how = (
        {"protocol.shots": "2", "protocol.weight": "3"}
        if labelled
        else {"protocol.unlabelled": "true"}
    )
    return make_cells(
        {"data": "synth", "protocol": "personal", **how, "protocol.draws": "1"} | SYSTEMS[system]
    )[0]


@pytest.mark.parametrize("system, labelled", [("adapts", True), ("is fitted again", False)])
def test_a_person_with_one_capture_is_tested_by_the_general_system(system, labelled):
    corpus = random_corpus(4, 4, longest=60)
    corpus = corpus[
        np.setdiff1d(np.arange(len(corpus)), np.flatnonzero(corpus.subjects == "1")[1:])
    ]
    cell = cell_of(system, labelled)
    fold = make_folds(cell, corpus)[0]
    (one,) = systems(cell, corpus, fold)
    assert one.tested.tolist() == fold.test.tolist() == [0]
    assert np.isfinite(one.estimator.predict_proba(corpus[fold.test])).all()


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("labelled", [True, False])
def test_no_other_label_and_no_other_frame_of_the_tested_half_is_used(system, labelled):
    corpus = random_corpus(4, 6, longest=60)
    cell = cell_of(system, labelled)
    fold = make_folds(cell, corpus)[0]
    shots, tested = fold.pairs[0]
    few = Fold(fold.name, fold.train, fold.test, [(shots, tested[:3])])
    changed = with_other_values(corpus, np.setdiff1d(fold.test, [*shots, *tested[:3]]))
    gestures = corpus.gestures.copy()
    secret = np.setdiff1d(fold.test, shots) if labelled else fold.test
    gestures[secret] = np.where(gestures[secret] == "pat", "rub", "pat")
    changed = changed.changed(captures=changed.captures.assign(gesture=gestures))
    for one, other in zip(systems(cell, corpus, few), systems(cell, changed, few), strict=True):
        said = [
            decisions(s.estimator, c, "", s.tested) for s, c in ((one, corpus), (other, changed))
        ]
        assert np.array_equal(*(table.filter(like="p_") for table in said))


def test_the_next_person_is_learned_from_although_one_has_a_single_capture(tmp_path):
    """Of three tested people the second has no capture to learn from; the others' are learned from as labelled."""
    corpus = random_corpus(subjects=3, per_class=2, grid=(4, 4))
    train, test = (np.flatnonzero((corpus.subjects == "1") == own) for own in (False, True))
    alone, shots, rest = test[:1], test[1:3], test[3:]
    path = tmp_path / "my.py"
    path.write_text("from tests.running.fakes import Level\n")
    values = {
        "protocol": "personal",
        "protocol.shots": "1",
        "protocol.draws": "1",
        "protocol.weight": "2",
    }
    (cell,) = make_cells({"data": "synth", "model": f"{path}:Level"} | values)
    fold = Fold("x", train, test, [(shots, rest[:1]), (shots[:0], alone), (shots, rest[1:])])
    fitted = [one.estimator.means_ for one in systems(cell, corpus, fold)]
    both = np.concatenate([train, np.repeat(shots, 2)])
    expected = [
        Level().fit(corpus[rows], corpus.gestures[rows]).means_ for rows in (both, train, both)
    ]
    np.testing.assert_allclose(fitted, expected)


def test_a_system_in_an_unlabelled_run_predicts_blind(tmp_path, monkeypatch):
    corpus = random_corpus(subjects=3, per_class=2, grid=(4, 4))
    monkeypatch.setattr("bench.plan.plan.open_corpus", lambda *_: corpus)
    path = tmp_path / "my.py"
    path.write_text("from tests.running.test_blind import Mean as Good, Reads as Bad\n")
    unlabelled = {"protocol": "personal", "protocol.unlabelled": "true"}
    good, bad = (
        make_plans(make_cells({"model": f"{path}:{name}"} | unlabelled), 1)[0]
        for name in ("Good", "Bad")
    )
    assert not folded(good.cell, corpus, good.folds[0], 1).batch_effects
    with pytest.raises(HiddenError, match="X.captures is hidden"):
        folded(bad.cell, corpus, bad.folds[0], 1)


def test_the_same_capture_on_both_sides_is_a_warning_and_a_circumstance_is_refused(monkeypatch):
    corpus = copied(random_corpus(longest=20), [(0, 1), (2, 1)])
    monkeypatch.setattr("bench.plan.plan.open_corpus", lambda name, parameters: corpus)
    values = {
        "data": "mine",
        "protocol": "personal",
        "protocol.shots": "1",
        "model": "lda",
        "features": "touch",
    }
    (plan,) = make_plans(make_cells(values), 1)
    assert {tested for tested, _ in plan.repeated_captures} == {0, 1, 2} and not plan.mixes_subjects
    assert sum("same frames" in line for line in warnings(plan)) == 1
    with pytest.raises(InputError, match="under= tests one"):
        make_plans([replace(plan.cell, circumstances=(Faults(("noise",)),))], 1)
