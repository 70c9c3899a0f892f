"""The table of runs: what its rows are called, which may be compared, and their numbers."""

import numpy as np
import pytest
from scipy import stats

from bench.errors import InputError
from bench.outcomes.frame import by_subject, frame, grouped, names, tables
from tests.results import evaluated, made_up, result, with_hits

DETECTORS = ("frames", "threshold")


def test_a_name_tells_what_differs_from_rows_of_the_same_system():
    for runs, expected in {
        ("seeds", tuple(result("svm", seed=s) for s in (0, 1, 2))): ["svm, seed 0", "svm, seed 1", "svm, seed 2"],
        ("detectors", tuple(result("lda", "watch", **{"watch.detector": d}) for d in DETECTORS)): [
            "lda, detector frames",
            "lda, detector threshold",
        ],
        ("circumstances", (result("lda"), result("lda", faults="noise, shift"))): ["lda", "lda, faults noise, shift"],
        ("corpora", (result("svm"), result("svm", corpus_digest="e" * 64))): [
            "svm, corpus dddddddd",
            "svm, corpus eeeeeeee",
        ],
        ("changes", (result("svm"), result("svm", corpus_digest="e" * 64, **{"touchbench.changes": "grid 4x4"}))): [
            "svm",
            "svm, grid 4x4",
        ],
        ("two", (result("svm"), result("svm", seed=1), result("svm", seed=1, faults="noise"))): [
            "svm, seed 0",
            "svm, seed 1",
            "svm, seed 1, faults noise",
        ],
    }.items():
        assert names(runs[1]) == expected, runs[0]
    runs = [result("svm"), result("svm", protocol="kfold")]
    assert names(runs) == ["svm", "svm"] and names(runs, context=True) == ["svm, protocol loso", "svm, protocol kfold"]
    one, two = names([result("svm"), result("svm")])  # made again by other code
    assert one != two and one.startswith("svm, run ")


def test_runs_on_the_same_captures_under_the_same_protocol_are_a_group():
    runs = [result("a"), result("b", seed=1), result("c", protocol_label="KFold"), result("d", corpus_digest="e" * 64)]
    groups = grouped(runs)
    assert [[r["system"] for r in members] for members in groups.values()] == [["a", "b"], ["c"], ["d"]]
    first, other, last = groups
    assert first == "synth (synthetic), all, LOSO, corpus dddddddd" and last.endswith("eeeeeeee") and "KFold" in other
    starts = [result("a", **{"stream.start": start}) for start in ("onset", "middle")]
    assert len(grouped(starts)) == 1
    assert [*grouped(starts, {"stream.start": ("from the {}", "onset")})] == [
        "synth (synthetic), all, LOSO",
        "synth (synthetic), all, LOSO, from the middle",
    ]


def test_a_row_holds_what_a_run_is_and_its_numbers():
    predictions = made_up(subjects=6, per_class=4)
    run = evaluated("svm", predictions, **{"model.C": 8.0})
    (row,) = frame([run]).to_dict("records")
    proba = predictions.filter(like="p_")
    hits = proba.idxmax(axis=1).str[2:] == predictions["true"]
    people = 100 * hits.groupby(predictions["subject"]).mean()
    low, high = stats.ttest_1samp(people, 0).confidence_interval(0.95)
    assert (row["accuracy"], row["low"], row["high"]) == pytest.approx((people.mean(), low, min(high, 100)))
    assert row["pooled_accuracy"] == pytest.approx(100 * hits.mean()) and row["flash_bytes"] == 4000
    assert row["parameters"] == "model.C=8.0" and row["name"] == row["system"] == "svm" and row["complete"]
    assert row["run_id"] == run["run_id"] and row["folds"] == "6/6" and row["data"] == "synth (synthetic)"
    assert not frame([evaluated("svm", failed=2)])["complete"][0] and frame([]).empty


def test_tables_of_runs_are_one_table():
    runs = [evaluated("svm", made_up(seed=s), seed=s) for s in (0, 1)]
    labels = tables(runs)
    assert labels["name"].unique().tolist() == ["svm, seed 0", "svm, seed 1"] and len(labels) == 2 * len(made_up())
    assert np.allclose(labels.filter(like="p_").sum(axis=1), 1)
    assert {*tables(runs, "per_subject")["run_id"]} == {r["run_id"] for r in runs}
    with pytest.raises(InputError, match="did you mean per_subject"):
        tables(runs, "per_subjct")


def test_accuracy_by_subject_is_of_complete_results_of_all_subjects():
    results = [
        evaluated("worse", with_hits([10, 12])),
        evaluated("better", with_hits([20, 16]), seed=0),
        evaluated("better", with_hits([18, 20]), seed=1),
        evaluated("cut", with_hits([20, 20]), failed=1),
        evaluated("one", with_hits([20])),
    ]
    table, seeds = by_subject(results)
    assert table.index.tolist() == ["better", "worse"] and seeds.tolist() == [2, 1]
    np.testing.assert_allclose(table.to_numpy(), [[95, 90], [50, 60]])
