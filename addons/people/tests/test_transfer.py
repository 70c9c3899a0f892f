"""Another skin: training captures, tested captures, and conversion of both."""

import numpy as np
import pytest

from bench.corpora.joined import convert_captures, join_corpora
from bench.errors import InputError
from bench.plan.grid import make_cells
from bench.plan.plan import make_plans
from bench.running.evaluation import fitted_systems
from bench.running.fold import predict_to_table
from tests.conftest import random_corpus, with_other_values
from tests.corpora.made import study
from touchbench_people.personal import Personal
from touchbench_people.skins import SOURCE_SKIN, TARGET_SKIN, join_skins

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


def make_plan(**values):
    values = {name.replace("__", "."): value for name, value in values.items()}
    (plan,) = make_plans(make_cells(ARGUMENTS | values), 1)
    return plan


def test_the_other_skin_is_trained_on_and_all_of_data_is_tested():
    plan = make_plan()
    (fold,) = plan.folds
    skin = plan.corpus.captures["skin"].to_numpy()
    assert (skin[fold.test] == TARGET_SKIN).all() and (skin[fold.train] != TARGET_SKIN).all()
    assert (len(fold.test), len(fold.train), len(plan.corpus)) == (9, 36, 45)
    assert plan.corpus.grid == (4, 5)
    assert plan.label == f"transfer from {COARSE} (4 subjects), 3 shared classes (3 subjects)"
    assert not plan.mixes_subjects and plan.corpus.digest
    assert make_plan().identity() == plan.identity()
    other_source = make_plan(protocol__source=COARSE.replace("seed=3", "seed=4"))
    assert other_source.identity() != plan.identity()
    where = "subject == '2' and gesture in ['pat', 'rub', 'grab']"
    alone = make_plan(where=where, protocol__shots="1")
    assert set(alone.corpus.subjects[alone.folds[0].test]) == {"2"}


def test_shots_are_those_of_a_new_person_on_the_new_skin():
    where = "gesture in ['pat', 'rub', 'grab']"
    plan = make_plan(protocol__shots="1", protocol__draws="2", where=where)
    (fold,) = plan.folds
    expected = list(Personal(1, 2).calibrations(plan.corpus[fold.test]))
    assert len(fold.pairs) == 12 and "1 shots, 2 draws" in plan.label and "3 subjects" in plan.label
    assert len({one.name for one in fitted_systems(plan.cell, plan.corpus, fold)}) == 2
    for number, draw in enumerate((fold.pairs[:6], fold.pairs[6:])):
        by_person = [pair for person in expected for pair in person[number]]
        assert len(by_person) == 6
        for pair, positions in zip(draw, by_person, strict=True):
            for part, position in zip(pair, positions, strict=True):
                assert part.tolist() == fold.test[position].tolist()
            assert len(set(plan.corpus.subjects[np.concatenate(pair)])) == 1
        assert sorted(np.concatenate([tested for _, tested in draw])) == fold.test.tolist()


@pytest.mark.parametrize(
    "system", [{"model": "lda"}, {"model": "adaptable", "model.ways": "centre"}]
)
def test_tested_frames_and_labels_change_nothing_that_is_learned(system):
    plan = make_plan(**system)
    (fold,) = plan.folds
    changed = with_other_values(plan.corpus, fold.test[3:])
    changed.captures.loc[fold.test, "gesture"] = "pat"
    tables = []
    for corpus in (plan.corpus, changed):
        (one,) = fitted_systems(plan.cell, corpus, fold)
        classes = ["grab", "pat", "rub"]
        table = predict_to_table(one.estimator, corpus, "", fold.test[:3], classes)
        tables.append(table.filter(like="p_"))
    assert np.array_equal(*tables)


def test_both_are_converted_to_the_coarser_of_each():
    target = random_corpus(3, 4, longest=30).with_fields(rate_hz=100.0)
    source = study("other", classes=("PAT", "rub", "knock"))
    names = sorted(set(target.gestures))
    target.info["warnings"], source.info["warnings"] = ["ours"], ["theirs"]
    both = join_skins(target, source, {"PAT": names[0], "rub": names[1]})
    assert both.rate_hz == 40.0 and both.grid == (4, 5) and both.full_scale == target.full_scale
    first, *others = both.info["warnings"]
    assert "more than one" in first and others == ["ours", "other: theirs"]
    mine = both.captures["skin"] == TARGET_SKIN
    kept = np.flatnonzero(np.isin(target.gestures, names[:2]))
    assert both.captures["skin"].tolist() == [TARGET_SKIN] * len(kept) + [SOURCE_SKIN] * 4
    assert both.gestures.tolist() == [*target.gestures[kept], *[names[0], names[1]] * 2]
    assert both.subjects[mine].tolist() == target.subjects[kept].tolist()
    others = set(both.subjects[~mine])
    assert len(others) == 2 and not others & set(both.subjects[mine])
    np.testing.assert_allclose(both[len(kept)], source[0] * target.full_scale, rtol=1e-6)
    (converted,) = convert_captures(target[kept[:1]], 40.0, (4, 5), target.full_scale)
    np.testing.assert_allclose(both[0], converted)


def test_the_same_people_are_not_trained_on():
    one = study("one").with_fields(digest="d" * 64)
    cut = study("two").with_fields(info={"format": "table", "unchanged": "d" * 64})
    both = join_corpora([one, study("three")])
    part = both[:2].with_fields(name="four")
    haart, aligned = (
        study(f"haart{end}").with_fields(info={"format": "haart"}) for end in ("", "-aligned")
    )
    pairs = [(one, cut), (cut, one), (both, cut), (cut, both), (both, part)]
    for target, source in [*pairs, (join_corpora([haart, one]), aligned)]:
        with pytest.raises(InputError, match="protocol=transfer: .* same (recordings|captures)"):
            join_skins(target, source, {})
    assert len(join_skins(one, study("three"), {})) == 8  # other people
