"""Plans: folds by name, facts of their protocols, and the arguments that make a cell."""

import shlex

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.model_selection import GroupKFold, KFold, PredefinedSplit

from bench.errors import InputError
from bench.grammar.options import RUN_KEYS, parse_arguments
from bench.ground.registry import (
    PART_GROUPS,
    load_part,
    parameter_defaults,
    registered_parts,
    required_parameters,
)
from bench.plan.cells import Part
from bench.plan.grid import make_cells
from bench.plan.plan import (
    Fold,
    Plan,
    make_folds,
    make_plans,
    mixes_subjects,
    ratio_of_test_to_training,
)
from bench.running.loop import warnings_of_plan
from tests.conftest import random_corpus
from tests.corpora.made import copied


def plan_of(corpus, **values):
    (cell,) = make_cells(values)
    return Plan(cell, corpus, tuple(make_folds(cell, corpus)), 1, 1)


def test_folds_are_named_after_their_subject_where_each_is_tested_once():
    corpus = random_corpus(subjects=2)
    assert [f.name for f in plan_of(corpus).folds] == ["1", "2"]
    for protocol in (KFold(5), "challenge"):  # whose five draws test the same subject
        assert [f.name for f in plan_of(corpus, protocol=protocol).folds] == [
            f"fold{i:02d}" for i in range(1, 6)
        ]


def test_facts_are_texts_and_say_whether_a_split_is_official():
    """4 subjects of 9 captures, of which each of five draws tests one."""
    facts = {
        "mixes_subjects": "false",
        "test_over_train": repr(5 * 9 / (5 * 27)),
        "official_split": "false",
    }
    assert facts.items() <= plan_of(random_corpus(), protocol="challenge").facts.items()
    assert plan_of(random_corpus()).facts["official_split"] == ""
    partly = Fold("1", np.array([0]), np.array([1, 10]))  # one of two tested subjects trains
    assert mixes_subjects(random_corpus(), [partly])


def test_a_plain_splitter_is_a_protocol_and_says_whom_it_mixes(corpus):
    assert plan_of(corpus, protocol=GroupKFold(2)).label == "GroupKFold[n_splits=2]"
    seeded = KFold(3, shuffle=True, random_state=1)
    assert (
        plan_of(corpus, protocol=seeded).label
        == "KFold[n_splits=3, shuffle=True, random_state=1], subjects mixed"
    )
    listed = [
        plan_of(corpus, protocol=PredefinedSplit(np.arange(len(corpus)) % n)).label
        for n in (2, 2, 3)
    ]
    assert listed[0] == listed[1] != listed[2] and len(listed[0]) < 80


def test_the_arguments_of_a_cell_make_it_again():
    line = """data=synth data.subjects=12 data.variants=rough+gentle where="variant == 'rough'"
    target=gesture+variant protocol=kfold protocol.folds=5 model=svm model.C=8.0 features=jung28
    features.area=capture"""
    (cell,) = make_cells(parse_arguments(shlex.split(line), RUN_KEYS))
    again = [f"{k}={v}" for k, v in cell.arguments().items()]
    assert make_cells(parse_arguments(again, RUN_KEYS)) == [cell] and {*again} == {
        *shlex.split(line)
    }


def with_seed(room):
    """Registered parts that have a seed."""
    return [
        name
        for name in registered_parts(room)
        if "seed" in parameter_defaults(load_part(room, name))
    ]


@given(
    protocol=st.sampled_from(list(registered_parts("protocols"))),
    model=st.sampled_from(list(registered_parts("models"))),
    features=st.sampled_from([*with_seed("features"), "jung28"]),
    seeds=st.dictionaries(
        st.sampled_from(["seed", "protocol.seed", "model.seed", "features.seed"]),
        st.integers(0, 2),
        max_size=4,
    ),
)
def test_the_arguments_of_a_cell_repeat_every_seed(protocol, model, features, seeds):
    """Of registered parts; which of the seeds a part takes is seen from its signature."""
    takes = [
        key
        for key, room, name in zip(
            PART_GROUPS, PART_GROUPS.values(), (protocol, features, model), strict=True
        )
        if "seed" in parameter_defaults(load_part(room, name))
    ]
    typed = {k: str(v) for k, v in seeds.items() if "." not in k or k.split(".")[0] in takes}
    values = {"protocol": protocol, "model": model} | typed
    if required_parameters(load_part("models", model)):
        values["features"] = features
    else:
        values.pop("features.seed", None)
    (cell,) = make_cells(values)
    again = parse_arguments([f"{k}={v}" for k, v in cell.arguments().items()], RUN_KEYS)
    assert make_cells(again) == [cell] and make_cells(again)[0].arguments() == cell.arguments()
    assert (make_cells(again)[0].system_name(), make_cells(again)[0].seed) == (
        cell.system_name(),
        cell.seed,
    )


def test_a_part_is_shown_with_what_is_not_the_default(tmp_path):
    (tmp_path / "mine.py").write_text(
        "class Mine:\n    def __init__(self, a=1, seed=0):\n        self.a = a\n"
    )
    assert str(Part("models", f"{tmp_path}/mine.py:Mine", {"a": 2, "seed": 5})) == "Mine[a=2]"
    (tmp_path / "fold.py").write_text(
        "class Mine:\n    def __init__(self, seed=7):\n        self.seed = seed\n"
    )
    assert str(Part("protocols", f"{tmp_path}/fold.py:Mine", {"seed": 7})) == "Mine"
    assert str(Part("protocols", f"{tmp_path}/fold.py:Mine", {"seed": 0})) == "Mine[seed=0]"


def copies(monkeypatch, pairs, **values):
    """The plan on a corpus with copied captures, given as (position, copied one)."""
    corpus = copied(random_corpus(longest=20), pairs)
    monkeypatch.setattr("bench.plan.plan.open_corpus", lambda *_: corpus)
    (plan,) = make_plans(
        make_cells({"data": "mine", "model": "lda", "features": "touch", **values}), 1
    )
    return plan


@pytest.mark.parametrize("protocol", ["loso", "challenge"])
def test_the_same_capture_of_two_subjects_is_refused_where_they_are_apart(protocol, monkeypatch):
    """Captures 9 to 17 are those of subject 2."""
    with pytest.raises(InputError) as refused:
        copies(monkeypatch, [(10, 1)], protocol=protocol, where="repetition < 3")
    message = str(refused.value)
    count = 1 if protocol == "challenge" else 2  # its five draws test one of the two
    facts = [
        f"protocol={protocol}",
        "bench data show mine",
        f" {count}",
        "1 (subject 1)",
        "10 (subject 2)",
    ]
    assert all(fact in message for fact in facts) and "\n" not in message
    where = message.split('where="')[1].split('"')[0]
    plan = copies(monkeypatch, [(10, 1)], protocol=protocol, where=where)
    assert (
        set(range(36)) - set(plan.corpus.index) - set(range(2, 36, 3)) in ({1}, {10})
        and not plan.repeated_captures
    )


def test_the_same_capture_is_a_warning_where_subjects_are_mixed_or_the_same(monkeypatch):
    mixed = copies(monkeypatch, [(10, 1), (5, 4)], protocol="kfold", **{"protocol.folds": "3"})
    expected = (
        set()
    )  # by loops: tested captures with their frames in the training part of the same fold
    for fold in mixed.folds:
        expected |= {
            i
            for i in fold.test
            for j in fold.train
            if np.array_equal(mixed.corpus[int(i)], mixed.corpus[j])
        }
    assert {tested for tested, _ in mixed.repeated_captures} == expected and expected
    assert any(
        f"{len(expected)} test captures have the same frames as a training" in line
        for line in warnings_of_plan(mixed)
    )


def test_cells_on_the_same_captures_and_protocol_share_their_plan(monkeypatch):
    asked, computed, corpus = [], [], random_corpus(longest=20)
    monkeypatch.setattr("bench.plan.plan.open_corpus", lambda *given: asked.append(given) or corpus)
    monkeypatch.setattr(
        "bench.plan.plan.ratio_of_test_to_training",
        lambda folds: computed.append(folds) or ratio_of_test_to_training(folds),
    )
    every = {
        "data": "mine",
        "model": "lda,bayes",
        "features": "touch,jung28",
        "protocol": "loso,holdout",
    }
    plans = make_plans(make_cells(every), 1)
    assert len({repr(plan.identity()) for plan in plans}) == 8 and len(asked) == 2
    assert (
        len({id(plan.folds) for plan in plans})
        == len({repr(plan.facts) for plan in plans})
        == 2
        == len(computed)
    )
    assert [make_plans([plan.cell], 1)[0].identity() for plan in plans] == [
        plan.identity() for plan in plans
    ]


@given(st.data())
def test_facts_are_those_of_sets(data):
    """Subjects mixed, and the ratio, by sets of positions."""
    corpus = random_corpus(subjects=3, per_class=1, longest=5)
    side = st.lists(st.integers(0, len(corpus) - 1), min_size=1, max_size=4).map(np.array)
    folds = tuple(
        Fold(str(i), *pair)
        for i, pair in enumerate(data.draw(st.lists(st.tuples(side, side), max_size=4)))
    )
    train, who = [set(fold.train.tolist()) for fold in folds], corpus.subjects
    mixed = any({who[i] for i in fold.train} & {who[i] for i in fold.test} for fold in folds)
    assert mixes_subjects(corpus, folds) == mixed
    shared = any(a & b for i, a in enumerate(train) for b in train[:i])
    tested = sum(len(f.test) for f in folds) / sum(len(f.train) for f in folds) if shared else None
    assert ratio_of_test_to_training(folds) == tested


def test_a_splitter_may_give_masks():
    corpus = random_corpus(subjects=2)

    class Halves:
        def split(self, X, y, groups):
            yield groups == "1", groups == "2"

    (fold,) = plan_of(corpus, protocol=Halves()).folds
    assert (
        corpus.subjects[fold.train].tolist() == ["1"] * len(fold.train)
        and len(fold.train) == len(fold.test) > 0
    )
