"""Another skin: who is trained on, who is tested, and what of them is looked at."""

import numpy as np
import pytest

from bench.corpora.skins import OWN
from bench.plan.cells import cells
from bench.plan.plan import planned
from bench.protocols.personal import Personal
from bench.work.fold import decisions
from bench.work.personal import met
from tests.conftest import with_other_values

FEW = {"data": "synth", "data.subjects": "3", "where": "gesture in ['pat', 'rub', 'grab'] and variant == 'normal'"}
COARSE = "synth+subjects=4+rows=4+cols=5+rate_hz=40+gain=0.6+seed=3"
ARGUMENTS = FEW | {"protocol": "transfer", "protocol.source": COARSE, "model": "lda", "features": "touch"}


def plan_of(**more):
    (plan,) = planned(cells(ARGUMENTS | {k.replace("__", "."): v for k, v in more.items()}), 1)
    return plan


def test_the_other_skin_is_trained_on_and_all_of_data_is_tested():
    plan = plan_of()
    (fold,) = plan.folds
    skin = plan.corpus.captures["skin"].to_numpy()
    assert (skin[fold.test] == OWN).all() and (skin[fold.train] != OWN).all()
    assert len(fold.test) == 9 and len(fold.train) == 36 and len(plan.corpus) == 45 and plan.corpus.grid == (4, 5)
    assert plan.label == f"transfer from {COARSE} (4 subjects), 3 shared classes (3 subjects)"
    assert not plan.mixes_subjects and plan.corpus.digest and plan_of().identity() == plan.identity()
    alone = plan_of(where="subject == '2' and gesture in ['pat', 'rub', 'grab']", protocol__shots="1")
    assert set(alone.corpus.subjects[alone.folds[0].test]) == {"2"}
    assert plan_of(protocol__source=COARSE.replace("seed=3", "seed=4")).identity() != plan.identity()


def test_shots_are_those_of_a_new_person_on_the_new_skin():
    plan = plan_of(protocol__shots="1", protocol__draws="2", where="gesture in ['pat', 'rub', 'grab']")
    (fold,) = plan.folds
    expected = list(Personal(1, 2).calibrations(plan.corpus[fold.test]))
    assert len(fold.known.draws) == 2 and "1 shots, 2 draws" in plan.label and "3 subjects" in plan.label
    for number, draw in enumerate(fold.known.draws):
        by_person = [pair for person in expected for pair in person[number]]
        assert len(by_person) == 6
        for pair, positions in zip(draw, by_person, strict=True):
            assert [part.tolist() for part in pair] == [fold.test[part].tolist() for part in positions]
            assert len(set(plan.corpus.subjects[np.concatenate(pair)])) == 1
        assert sorted(np.concatenate([tested for _, tested in draw])) == fold.test.tolist()


@pytest.mark.parametrize("system", [{"model": "lda"}, {"model": "svm", "model.person": "centre"}])
def test_values_and_labels_of_what_is_tested_change_nothing_that_is_learned(system):
    plan = plan_of(**system)
    (fold,) = plan.folds
    changed = with_other_values(plan.corpus, fold.test[3:])
    changed.captures.loc[fold.test, "gesture"] = "pat"
    tables = []
    for corpus in (plan.corpus, changed):
        (one,) = met(plan.cell, corpus, fold)
        tables.append(decisions(one.estimator, corpus, "", fold.test[:3], ["grab", "pat", "rub"]).filter(like="p_"))
    assert np.array_equal(*tables)
