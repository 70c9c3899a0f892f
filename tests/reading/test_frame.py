"""The table of runs: what its rows are called, which may be compared, and their numbers."""

import numpy as np
import pytest

from bench.reading.frame import accuracy_by_subject, group_results, name_rows, runs_table
from tests.reading.results import make_result, make_run, predictions_with_hits

OTHER = {"corpus_digest": "e" * 64}
ROWS = [  # tags of runs of a system, and what is told beside its name
    ([{"seed": 0}, {"seed": 1}], [", seed 0", ", seed 1"]),
    (
        [{"watch.detector": "frames"}, {"watch.detector": "none"}],
        [", detector frames", ", detector none"],
    ),
    ([{}, {"faults": "noise, shift"}], ["", ", faults noise, shift"]),
    ([{}, OTHER], [", corpus dddddddd", ", corpus eeeeeeee"]),
    ([{}, OTHER | {"touchbench.changes": "grid 4x4"}], ["", ", grid 4x4"]),
    (
        [{}, {"seed": 1}, {"seed": 1, "faults": "noise"}],
        [", seed 0", ", seed 1", ", seed 1, faults noise"],
    ),
]


def test_a_name_tells_what_differs_from_rows_of_the_same_system():
    for runs, told in ROWS:
        assert name_rows([make_result("svm", **tags) for tags in runs]) == [
            f"svm{words}" for words in told
        ]
    runs = [make_result("svm"), make_result("svm", protocol="kfold")]
    assert name_rows(runs) == ["svm", "svm"] and name_rows(runs, context=True) == [
        "svm, protocol loso",
        "svm, protocol kfold",
    ]
    one, two = name_rows([make_result("svm"), make_result("svm")])  # made again by other code
    assert one != two and one.startswith("svm, run ")


def test_runs_on_the_same_captures_under_the_same_protocol_are_a_group():
    runs = [
        make_result("a"),
        make_result("b", seed=1),
        make_result("c", protocol_label="KFold"),
        make_result("d", corpus_digest="e" * 64),
    ]
    groups = group_results(runs)
    assert [[r["system"] for r in members] for members in groups.values()] == [
        ["a", "b"],
        ["c"],
        ["d"],
    ]
    first, other, last = groups
    assert (
        first == "synth (synthetic), all, LOSO, corpus dddddddd"
        and last.endswith("eeeeeeee")
        and "KFold" in other
    )
    starts = [make_result("a", **{"stream.start": start}) for start in ("onset", "middle")]
    assert len(group_results(starts)) == 1
    assert [*group_results(starts, {"stream.start": ("from the {}", "onset")})] == [
        "synth (synthetic), all, LOSO",
        "synth (synthetic), all, LOSO, from the middle",
    ]


def test_a_row_holds_what_a_run_is():
    run = make_run("svm", predictions_with_hits([20, 10]), **{"model.C": 8.0})
    (row,) = runs_table([run]).to_dict("records")
    assert (
        row["accuracy"] == pytest.approx(75)
        and row["flash_bytes"] == 4000
        and row["run_id"] == run["run_id"]
    )
    assert (
        row["parameters"] == "model.C=8.0"
        and row["name"] == row["system"] == "svm"
        and row["complete"]
    )
    assert row["folds"] == "2/2" and row["data"] == "synth (synthetic)"
    assert not runs_table([make_run("svm", failed=2)])["complete"][0] and runs_table([]).empty


def test_accuracy_by_subject_is_of_complete_results_of_all_subjects():
    results = [
        make_run("worse", predictions_with_hits([10, 12])),
        make_run("better", predictions_with_hits([20, 16]), seed=0),
        make_run("better", predictions_with_hits([18, 20]), seed=1),
        make_run("cut", predictions_with_hits([20, 20]), failed=1),
        make_run("one", predictions_with_hits([20])),
    ]
    table, seeds = accuracy_by_subject(results)
    assert table.index.tolist() == ["better", "worse"] and seeds.tolist() == [2, 1]
    np.testing.assert_allclose(table.to_numpy(), [[95, 90], [50, 60]])
