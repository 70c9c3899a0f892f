"""Exhibits of the page: sets of comparable results, and what the section on faults shows."""

import pandas as pd

from bench.ground.registry import load_views
from bench.reports.failures import changed_labels, failing_groups, fault_ranks
from bench.reports.sections import comparable_groups
from tests.reading.results import make_run, make_stress_run, rows_of_case

BOTH = {"noise": 0.1, "shift": 0.234}


def test_each_system_has_its_run_under_most_faults_then_the_newest_with_its_lowest_seed(tmp_path):
    results = [
        make_stress_run("svm", 0.5, BOTH),
        full := make_stress_run("svm", 0.6, BOTH, {"half_margin.shift": 2.25}),
        make_stress_run("svm", 0.6, {"noise": 0.3}),
        make_stress_run("svm", 0.9, BOTH, status="FAILED"),
        make_stress_run("svm", 0.9, BOTH, seed="1"),
        forest := make_stress_run("rf", 0.7, {"noise": 0.05}),
        make_stress_run("rf", 0.7, BOTH, subset="cover == 'none'"),
        make_stress_run("rf", 0.7, BOTH, data="synth", synthetic="true"),
    ]
    (first, runs), *rest = comparable_groups(results, more="loss.")
    assert runs == [forest, full] and first.endswith("only the lowest seed of each system")
    assert ["cover" in name for name, _ in rest] == [True, False] and "(synthetic)" in rest[1][0]
    exhibit, *_ = load_views()["under"].make_exhibits(results, tmp_path)
    drawing = exhibit.picture.path.read_text()
    for text in ("23", "10", "5", "-", "svm (60 % clean)", "rf (70 % clean)"):
        assert f">{text}</text>" in drawing
    rows = {row["system"]: row for row in exhibit.table.texts}
    assert [*rows] == ["rf", "svm"] and rows["svm"]["worst subject"] == "30.0"
    assert rows["svm"]["half of the margin is lost at"] == "shift 2.2"
    assert rows["svm"]["failing of tested groups"] == "3 of 40"


def test_groups_of_several_corpora_and_words_of_shared_parameters():
    runs = [
        make_run("svm", corpus_digest=digest, **{"dim.mode": mode})
        for digest in "ab"
        for mode in ("up", "down")
    ]
    groups = comparable_groups(runs, {"dim.mode": ("pressed {}", "up")})
    assert ["pressed down" in words for words, _ in groups] == [True, False, True]
    assert len({words for words, _ in groups}) == 3 and not any(
        "up" in words for words, _ in groups
    )
    assert [members for _, members in comparable_groups(runs)] == [[runs[3]], [runs[1]]]


def test_ranks_under_faults_and_their_order():
    """The order turns under noise; under shift all are equal."""
    lost = [dict(zip(BOTH, each, strict=True)) for each in ((0.3, 0.1), (0.1, 0.05), (0.0, 0.0))]
    clean = zip("abc", (0.7, 0.65, 0.6), strict=True)
    runs = [make_stress_run(name, accuracy, {}) for name, accuracy in clean]
    rows = {row["fault"]: row for row in fault_ranks(runs, lost).texts}
    assert [rows["clean"][name] for name in "abc"] == ["1", "2", "3"]
    assert [rows["noise"][name] for name in "abc"] == ["3", "2", "1"]
    assert [rows["shift"][name] for name in "abc"] == ["2", "2", "2"]
    assert [row["Kendall's tau"] for row in rows.values()] == ["1.00", "-1.00", "-"]
    assert not len(fault_ranks(runs[:1], lost[:1]))


def test_failing_groups_and_labels_that_change_with_the_seed():
    slices = pd.DataFrame(
        {
            "slice": ["subject 1", "subject 2", "noise 1", "subject 3"],
            "fault": ["", "", "noise", ""],
        }
    ).assign(failing=[True, True, True, False], gap=[0.1, 0.3, 0.5, 0.9], right=2, captures=10)
    slices = slices.assign(subjects=1, accuracy=0.2, p_corrected=0.01)
    table = failing_groups([make_stress_run("svm", 0.6, BOTH, tables={"slices": slices})])
    assert [row["group"] for row in table.texts] == ["subject 2", "subject 1"]
    assert table.texts[0]["correct"] == "2 of 10" and table.groups == ["svm"] * 2
    runs = []
    for seed, labels in enumerate(("aabb", "abba")):
        captures = pd.DataFrame({"fold": "1", "capture": range(4), "predicted": [*labels]})
        runs.append(
            make_stress_run("rf", 0.6, BOTH, tables={"labels": rows_of_case(captures)}, seed=seed)
        )
    assert changed_labels(runs).texts == [
        {"system": "rf", "seeds": "0, 1", "changed labels": "2 of 4"}
    ]
    assert not len(changed_labels(runs[:1])) and not len(failing_groups([make_run("a")]))
