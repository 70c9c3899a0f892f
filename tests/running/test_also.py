"""Runs whose training has people of another corpus, too: what they test, store and compare with."""

import numpy as np
import pytest

import bench
from bench.corpora.folder import content_digest, write_folder
from bench.errors import InputError
from bench.ground.scratch import data_folder
from bench.plan.grid import make_cells
from bench.plan.plan import make_plans
from bench.reading.frame import group_results
from bench.reading.runs import load_all_runs
from bench.reports.summary import summarise_group
from bench.running.circumstances.subjects import captures_of_subjects
from bench.store.client import connect
from tests.conftest import random_corpus

ON = {"data": "one", "features": "jung28", "model": "bayes"}


def store_corpus(name, seed, **fields):
    corpus = random_corpus(subjects=7, per_class=2, longest=12, seed=seed)
    corpus = corpus.with_fields(name=name, info={"format": "table"}, **fields)
    digest, folder = content_digest(corpus), data_folder() / "corpora" / name
    write_folder(corpus, folder / digest[:16], digest)
    (folder / "current").write_text(digest[:16])
    return corpus


@pytest.fixture
def studies():
    return store_corpus("one", 1), store_corpus("two", 2, rate_hz=20.0, full_scale=2046.0)


def test_a_run_with_added_people_is_another_run_on_the_same_captures(studies):
    one, two = studies
    plain, added = make_plans(make_cells(ON | {"also": "none,two"}), 1)
    assert plain.key != added.key and plain.label == added.label
    assert [f.name for f in plain.folds] == [f.name for f in added.folds]
    for mine, other in zip(plain.folds, added.folds, strict=True):
        assert np.array_equal(mine.test, other.test)
        assert np.array_equal(mine.train, other.train[: len(mine.train)])
        assert len(other.train) == len(mine.train) + len(two)
        assert np.array_equal(added.corpus[other.test].frames, one[mine.test].frames)
        few = captures_of_subjects(added.corpus, other.train, other.test, 2, 0)
        assert len({*added.corpus[few].subjects}) == 2 + 7
    assert plain.facts["touchbench.captures"] == added.facts["touchbench.captures"]
    (part,) = make_plans(make_cells(ON | {"also": "two", "where": "subject != '1'"}), 1)
    assert "1" not in part.corpus.subjects and "two 1" in part.corpus.subjects


def test_tables_the_page_and_compare_set_it_against_the_plain_run(studies):
    bench.run(also=["none", "two"], **ON)
    runs = load_all_runs(connect())
    assert {r.system for r in runs} == {"bayes · jung28", "bayes · jung28 · also two"}
    (name, members), *others = group_results(runs).items()
    assert not others and len(members) == 2
    people = {r.system: r.accuracy_by_subject for r in runs}
    plain, added = (people[name] for name in ("bayes · jung28", "bayes · jung28 · also two"))
    by_hand = np.mean([added[who] - plain[who] for who in plain])
    compared = bench.compare("bayes · jung28 · also two", "bayes · jung28")
    assert compared.difference == pytest.approx(by_hand) and compared.subjects == 7
    summary = summarise_group(name, members, runs, {})
    text = " ".join(summary.sentences)
    word = "gains" if by_hand >= 0 else "loses"
    assert f"With the people of two in training, bayes · jung28 {word} {abs(by_hand):.1f}" in text
    assert f"{compared.low:+.1f} to {compared.high:+.1f}" in text
    assert any("joined corpora" in line for line in summary.lines)


@pytest.mark.parametrize(
    "values",
    [
        {"also": "one"},
        {"also": "two+two"},
        {"also": "three"},
        {"also": "two", "target": "subject"},
        {"also": "two", "skin.bits": "4"},
        {"also": "two", "protocol": "windows"},
    ],
)
def test_what_cannot_be_added_is_one_clear_line(studies, values):
    with pytest.raises(InputError) as refused:
        make_plans(make_cells(ON | values), 1)
    message = str(refused.value)
    assert "\n" not in message and ("also=" in message or "three: not imported" in message)


def test_a_saved_system_reads_the_sensor_of_data_as_it_is(studies):
    one, _ = studies
    fitted = bench.fit(**ON | {"model": "perceptron", "model.updates": 3}, also="two")
    (cell,) = make_cells(ON | {"model": "perceptron", "model.updates": "3", "also": "two"})
    (plan,) = make_plans([cell], 1)
    system = cell.estimator().fit(plan.corpus, plan.corpus.gestures)
    expected = system.classes_[system.predict_proba(one.blind()).argmax(axis=1)]
    assert fitted.recogniser.label(one)["label"].tolist() == expected.tolist()
