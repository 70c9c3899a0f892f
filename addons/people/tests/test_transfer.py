"""Another skin: who is trained on, who is tested, and what of them is looked at."""

import numpy as np
import pytest

from bench.corpora.joined import brought, together
from bench.errors import InputError
from bench.plan.cells import cells
from bench.plan.plan import planned
from bench.running.evaluation import systems
from bench.running.fold import decisions
from tests.conftest import random_corpus, with_other_values
from tests.corpora.made import study
from touchbench_people.personal import Personal
from touchbench_people.skins import OWN, SOURCE, joined

FEW = {
    "data": "synth",
    "data.subjects": "3",
    "where": "gesture in ['pat', 'rub', 'grab'] and variant == 'normal'",
}
COARSE = "synth+subjects=4+rows=4+cols=5+rate_hz=40+gain=0.6+seed=3"
ARGUMENTS = FEW | {
    "protocol": "transfer",
    "protocol.source": COARSE,
    "model": "lda",
    "features": "touch",
}


def plan_of(**more):
    (plan,) = planned(cells(ARGUMENTS | {k.replace("__", "."): v for k, v in more.items()}), 1)
    return plan


def test_the_other_skin_is_trained_on_and_all_of_data_is_tested():
    plan = plan_of()
    (fold,) = plan.folds
    skin = plan.corpus.captures["skin"].to_numpy()
    assert (skin[fold.test] == OWN).all() and (skin[fold.train] != OWN).all()
    assert (
        len(fold.test) == 9
        and len(fold.train) == 36
        and len(plan.corpus) == 45
        and plan.corpus.grid == (4, 5)
    )
    assert plan.label == f"transfer from {COARSE} (4 subjects), 3 shared classes (3 subjects)"
    assert (
        not plan.mixes_subjects and plan.corpus.digest and plan_of().identity() == plan.identity()
    )
    alone = plan_of(
        where="subject == '2' and gesture in ['pat', 'rub', 'grab']", protocol__shots="1"
    )
    assert set(alone.corpus.subjects[alone.folds[0].test]) == {"2"}
    assert (
        plan_of(protocol__source=COARSE.replace("seed=3", "seed=4")).identity() != plan.identity()
    )


def test_shots_are_those_of_a_new_person_on_the_new_skin():
    plan = plan_of(
        protocol__shots="1", protocol__draws="2", where="gesture in ['pat', 'rub', 'grab']"
    )
    (fold,) = plan.folds
    expected = list(Personal(1, 2).calibrations(plan.corpus[fold.test]))
    assert len(fold.pairs) == 12 and "1 shots, 2 draws" in plan.label and "3 subjects" in plan.label
    assert len({one.name for one in systems(plan.cell, plan.corpus, fold)}) == 2
    for number, draw in enumerate((fold.pairs[:6], fold.pairs[6:])):
        by_person = [pair for person in expected for pair in person[number]]
        assert len(by_person) == 6
        for pair, positions in zip(draw, by_person, strict=True):
            assert [part.tolist() for part in pair] == [
                fold.test[part].tolist() for part in positions
            ]
            assert len(set(plan.corpus.subjects[np.concatenate(pair)])) == 1
        assert sorted(np.concatenate([tested for _, tested in draw])) == fold.test.tolist()


@pytest.mark.parametrize(
    "system", [{"model": "lda"}, {"model": "adaptable", "model.ways": "centre"}]
)
def test_values_and_labels_of_what_is_tested_change_nothing_that_is_learned(system):
    plan = plan_of(**system)
    (fold,) = plan.folds
    changed = with_other_values(plan.corpus, fold.test[3:])
    changed.captures.loc[fold.test, "gesture"] = "pat"
    tables = []
    for corpus in (plan.corpus, changed):
        (one,) = systems(plan.cell, corpus, fold)
        tables.append(
            decisions(one.estimator, corpus, "", fold.test[:3], ["grab", "pat", "rub"]).filter(
                like="p_"
            )
        )
    assert np.array_equal(*tables)


def test_both_are_brought_to_the_coarser_of_each():
    target = random_corpus(3, 4, longest=30).changed(rate_hz=100.0)
    source = study("other", classes=("PAT", "rub", "knock"))
    names = sorted(set(target.gestures))
    target.info["warnings"], source.info["warnings"] = ["ours"], ["theirs"]
    both = joined(target, source, {"PAT": names[0], "rub": names[1]})
    assert both.rate_hz == 40.0 and both.grid == (4, 5) and both.full_scale == target.full_scale
    assert (
        both.info["warnings"][1:] == ["ours", "other: theirs"]
        and "more than one" in both.info["warnings"][0]
    )
    mine, kept = both.captures["skin"] == OWN, np.flatnonzero(np.isin(target.gestures, names[:2]))
    assert both.captures["skin"].tolist() == [OWN] * len(kept) + [SOURCE] * 4
    assert both.gestures.tolist() == [*target.gestures[kept], *[names[0], names[1]] * 2]
    assert both.subjects[mine].tolist() == target.subjects[kept].tolist()
    assert (
        not set(both.subjects[mine]) & set(both.subjects[~mine])
        and len(set(both.subjects[~mine])) == 2
    )
    np.testing.assert_allclose(both[len(kept)], source[0] * target.full_scale, rtol=1e-6)
    np.testing.assert_allclose(
        both[0], brought(target[kept[:1]], 40.0, (4, 5), target.full_scale)[0]
    )


def test_the_same_people_are_not_trained_on():
    one = study("one").changed(digest="d" * 64)
    cut = study("two").changed(info={"format": "table", "unchanged": "d" * 64})
    both = together([one, study("three")])
    for target, source in (
        (one, cut),
        (cut, one),
        (both, cut),
        (cut, both),
        (both, both[:2].changed(name="four")),
    ):
        with pytest.raises(
            InputError, match=r"protocol=transfer: .* (same recordings|same captures)"
        ):
            joined(target, source, {})
    aligned, released = (
        study(name).changed(info={"format": "haart"}) for name in ("haart-aligned", "haart")
    )
    with pytest.raises(
        InputError, match="haart and haart-aligned are imports of the same recordings"
    ):
        joined(together([released, one]), aligned, {})
    assert len(joined(one, study("three"), {})) == 8  # other people
