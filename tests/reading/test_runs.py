"""Stored runs as results: which of equal ones counts, what they hold, and tables that are gone."""

import pytest

from bench.errors import InputError
from bench.reading.runs import (
    NothingTracked,
    load_results,
    load_results_on_captures,
    one_run_per_system,
    parse_selection,
    select_or_fail,
    select_runs,
    warn_of_missing_runs,
)
from bench.store.tables import table_file
from bench.values.result import FOLD_COUNTS
from tests.reading.results import make_predictions, make_result, make_run
from tests.reports.store import keep


def test_the_newest_of_equal_runs_counts_and_complete_ones_first(store):
    keep(store, make_run("a", make_predictions(3)))
    whole = keep(store, make_run("a", make_predictions(3)))
    keep(store, make_run("a", make_predictions(3), failed=1))  # newer, and hides no complete one
    broken = keep(store, make_run("b", make_predictions(3), failed=1))
    keep(store, make_result("c", metrics=dict.fromkeys(FOLD_COUNTS, 0)))  # every fold failed
    found = load_results_on_captures(store)
    assert [r["run_id"] for r in found] == [whole, broken] and [r.is_complete for r in found] == [
        True,
        False,
    ]
    assert [r["run_id"] for r in load_results(store)] == [whole, broken]


def test_of_a_system_in_several_circumstances_one_result_is_plain(store):
    """The newest of those in the fewest circumstances; a complete one comes first."""
    faults = {"faults": "noise"}
    both = keep(store, make_run("a", make_predictions(3), train_subjects="2", **faults))
    fewer = keep(store, make_run("a", make_predictions(3), **faults))
    newer = keep(store, make_run("a", make_predictions(3), train_subjects="2"))
    assert [r["run_id"] for r in load_results_on_captures(store)] == [newer]
    keep(store, make_run("a", make_predictions(3), failed=1))
    assert [r["run_id"] for r in load_results_on_captures(store)] == [newer]
    alone = keep(store, make_run("a", make_predictions(3)))
    assert [r["run_id"] for r in load_results_on_captures(store)] == [alone]
    assert [r["run_id"] for r in one_run_per_system(load_results(store))] == [alone]
    assert {both, fewer, newer, alone} == {r["run_id"] for r in load_results(store)}


def test_a_table_that_is_damaged_or_gone_is_named(store):
    run_id = keep(store, make_run("lda", make_predictions(3)))
    (one,) = load_results_on_captures(store)
    path = store.artifact_path(run_id, one["artifacts"], table_file("predictions"))
    path.write_bytes(path.read_bytes()[:-100])
    told = f"predictions of lda .run {run_id}. "
    with pytest.raises(InputError, match=f"{told}.*parquet is damaged; restore it") as error:
        one.tables["predictions"]
    assert "\n" not in str(error.value)
    path.unlink()
    assert one.tables.get("predictions") is None
    with pytest.raises(InputError, match=f"{told}is missing"):
        one.tables["predictions"]


def test_keys_select_runs_and_latest_the_newest_parameters(store):
    """All seeds of the newest parameters; searches and protocols are settings of their own."""
    trial = keep(store, make_run("svm[C=1] · jung54", make_predictions(3), model_name="svm"))
    seeds = [
        keep(store, make_run("svm · jung54", make_predictions(3), model_name="svm", seed=seed))
        for seed in (0, 1)
    ]
    tuned = keep(
        store,
        make_run(
            "tuned svm", make_predictions(3), model_name="svm", **{"touchbench.command": "tune"}
        ),
    )
    kfold = keep(
        store,
        make_run("svm[C=1] · jung54", make_predictions(3), model_name="svm", protocol="kfold"),
    )
    failed = keep(
        store, make_run("svm[C=9] · jung54", make_predictions(3), model_name="svm", failed=1)
    )
    other = keep(
        store,
        make_run(
            "svm[C=1]", make_predictions(3), model_name="svm", data="haart", corpus_digest="e" * 64
        ),
    )
    every = load_results(store)

    def ids(**values):
        return [r["run_id"] for r in select_runs(every, parse_selection(values))]

    assert ids(latest="yes") == [*seeds, tuned, kfold, other]
    assert ids(latest="no") == ids() == [trial, *seeds, tuned, kfold, failed, other]
    assert ids(data="haart") == [other] and ids(protocol=["kfold"], model="svm") == [kfold]
    assert ids(run=f"{trial},{kfold}") == [trial, kfold] and ids(run=trial, latest=True) == [trial]
    with pytest.raises(NothingTracked, match="data=haar;"):
        select_or_fail(every, parse_selection({"data": "haar"}))
    with pytest.raises(InputError, match="model.C="):
        parse_selection({"model.C": "1"})


def test_a_model_of_a_file_goes_by_its_file_and_by_its_name(tmp_path):
    names = [str(tmp_path / "mine.py:near"), "svm", str(tmp_path / "svm.py:svm")]
    results = [make_run(name, model=name, features_name="touch") for name in names]
    for name, row in {
        "mine.py:near": 0,
        "near": 0,
        names[0]: 0,
        "svm": 1,
        "svm.svm": 2,
        "svm.py:svm": 2,
    }.items():
        assert select_runs(results, {"model": [name]}) == [results[row]], name
    asked = {"model": ["other.py:near", "near", "rf"], "features": ["touch", "balli"]}
    assert warn_of_missing_runs(results, asked) == [
        "features=balli",
        "model=other.py:near",
        "model=rf",
    ]
