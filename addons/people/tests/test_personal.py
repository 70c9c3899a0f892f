"""A new person: calibration captures are never tested, and nothing else of the person is used."""

from collections import Counter
from dataclasses import replace
from itertools import chain

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.errors import InputError
from bench.plan.grid import make_cells
from bench.plan.plan import Fold, make_folds, make_plans
from bench.running.circumstances.faults import Faults
from bench.running.evaluation import fitted_systems
from bench.running.fold import predict_to_table
from bench.running.loop import warnings_of_plan
from tests.conftest import random_corpus, with_other_values
from tests.corpora.made import copied
from tests.running.fakes import Level
from touchbench_people.personal import Personal


@given(
    st.integers(2, 4), st.integers(1, 7), st.integers(0, 4), st.integers(1, 3), st.integers(0, 5)
)
def test_each_draw_tests_every_capture_once_and_never_with_itself(
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
                half = Counter(corpus.gestures[np.setdiff1d(test, tested)])
                drawn_shots = Counter(corpus.gestures[calibration])
                assert drawn_shots == Counter({n: min(shots, c) for n, c in half.items()})


@given(st.integers(1, 4), st.integers(0, 20))
def test_calibrations_are_nested_and_the_tested_half_stays(shots, seed):
    corpus = random_corpus(3, 9, longest=3)
    kinds = [{"shots": shots}, {"shots": shots + 1}, {"unlabelled": True}]
    pairs = []
    for kind in kinds:
        folds = Personal(draws=3, seed=seed, **kind).calibrations(corpus)
        pairs.append([*chain.from_iterable(chain.from_iterable(folds))])
    few, more, without = pairs
    for (calibration, tested), (larger, tested_too) in zip(few, more, strict=True):
        assert set(calibration) < set(larger) and np.array_equal(tested, tested_too)
    assert {tuple(tested) for _, tested in few} == {tuple(tested) for _, tested in without}


SYSTEMS = {
    "adapts": {"model": "lda", "features": "touch"},
    "is fitted again": {"model": "svm", "features": "touch"},
    "pools": {"model": "adaptable", "features": "touch", "model.ways": "centre+scale+pool"},
    "last layer": {"model": "cnn85", "model.epochs": "1", "model.frames": "10"},
}


def personal_cell(**values):
    (cell,) = make_cells({"data": "synth", "protocol": "personal", "protocol.draws": "1"} | values)
    return cell


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("labelled", [True, False])
def test_no_other_label_and_no_frame_of_the_tested_half_is_used(system, labelled):
    corpus = random_corpus(4, 6, longest=60)
    protocol = {"protocol.unlabelled": "true"}
    if labelled:
        protocol = {"protocol.shots": "2", "protocol.weight": "3"}
    cell = personal_cell(**protocol, **SYSTEMS[system])
    fold = make_folds(cell, corpus)[0]
    shots, tested = fold.pairs[0]
    few = Fold(fold.name, fold.train, fold.test, [(shots, tested[:3])])
    changed = with_other_values(corpus, np.setdiff1d(fold.test, [*shots, *tested[:3]]))
    gestures = corpus.gestures.copy()
    secret = np.setdiff1d(fold.test, shots) if labelled else fold.test
    gestures[secret] = np.where(gestures[secret] == "pat", "rub", "pat")
    changed = changed.with_fields(captures=changed.captures.assign(gesture=gestures))
    tables = []
    for part in (corpus, changed):
        systems = fitted_systems(cell, part, few)
        found = [predict_to_table(one.estimator, part, "", one.tested) for one in systems]
        tables.append(pd.concat(found).filter(like="p_"))
    assert len(tables[0]) and np.array_equal(*tables)


def test_a_person_with_a_single_capture_is_tested_by_the_general_system(tmp_path):
    """The second of three tested people has no capture to learn from."""
    corpus = random_corpus(subjects=3, per_class=2, grid=(4, 4))
    train, test = (np.flatnonzero((corpus.subjects == "1") == own) for own in (False, True))
    alone, shots, rest = test[:1], test[1:3], test[3:]
    path = tmp_path / "my.py"
    path.write_text("from tests.running.fakes import Level\n")
    protocol = {"protocol.shots": "1", "protocol.weight": "2"}
    cell = personal_cell(model=f"{path}:Level", **protocol)
    fold = Fold("x", train, test, [(shots, rest[:1]), (shots[:0], alone), (shots, rest[1:])])
    fitted = [one.estimator.means_ for one in fitted_systems(cell, corpus, fold)]
    both = np.concatenate([train, np.repeat(shots, 2)])
    parts = [corpus[rows] for rows in (both, train, both)]
    expected = [Level().fit(part, part.gestures).means_ for part in parts]
    np.testing.assert_allclose(fitted, expected)


def test_the_same_capture_on_both_sides_is_a_warning_and_a_circumstance_is_refused(monkeypatch):
    corpus = copied(random_corpus(longest=20), [(0, 1), (2, 1)])
    monkeypatch.setattr("bench.plan.plan.open_corpus", lambda *_: corpus)
    cell = personal_cell(**{"data": "mine", "protocol.shots": "1"}, **SYSTEMS["adapts"])
    (plan,) = make_plans([cell], 1)
    assert {tested for tested, _ in plan.repeated_captures} == {0, 1, 2} and not plan.mixes_subjects
    assert sum("same frames" in line for line in warnings_of_plan(plan)) == 1
    with pytest.raises(InputError, match="under= tests one"):
        make_plans([replace(plan.cell, circumstances=(Faults(("noise",)),))], 1)
