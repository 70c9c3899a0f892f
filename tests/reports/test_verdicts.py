"""Published numbers beside ours: which run stands beside which number, with what interval and verdict."""

import numpy as np
import pandas as pd
import pytest

from bench.outcomes import runs, scores
from bench.outcomes.runs import tracked
from reports import reproduction as verdicts
from reports.comparison import published
from reports.layout import Text
from reports.papers import published_blocks
from tests.reports.store import made_up, tracked_run

HAART = {"data": "haart", "synthetic": "false"}


@pytest.fixture
def beside(store):
    return lambda *about: _beside(store, about)


def _beside(store, about):
    for each in about:
        predictions = each.pop("predictions")
        tracked_run(store, each.pop("system"), predictions, **HAART | each)
    return verdicts.against(published(), tracked(store), store).set_index("id")


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [
        (50, 60, "within interval"),
        (55, 60, "within interval"),
        (50, 55, "within interval"),
        (55.1, 60, "above"),
        (50, 54.9, "below"),
        (np.nan, np.nan, "no interval"),
    ],
)
def test_verdicts(low, high, said):
    assert verdicts.verdict(55.0, low, high) == said


def test_every_published_row_has_a_verdict_and_every_correction_a_row(beside):
    papers = published()
    found = beside({"system": "ta2015_rf", "predictions": made_up(3), "protocol": "challenge"})
    assert set(found.index) == set(papers["id"])
    assert set(verdicts.corrections().index) <= set(papers["id"])
    assert (found.loc[found["data"] == "cost", "verdict"] == "data not here").all()
    assert found.loc["zhou2016-haart-3dcnn", "verdict"] == "not run"
    assert "not published" in found.loc["almashhadani2021-haart", "note"]
    row = found.loc["ta2015-haart-test"]
    assert row["verdict"] in ("within interval", "above", "below") and "3 subjects: " in row["note"]
    assert row["difference"] == pytest.approx(row["ours"] - 70.91)


@pytest.mark.parametrize(("data", "told"), [("haart", True), ("arm", False)])
def test_runs_on_haart_are_pointed_to_the_results_that_ship(store, data, told):
    tracked_run(store, "svm · jung54", made_up(4), **HAART | {"data": data})
    found = published_blocks(verdicts.against(published(), tracked(store), store))
    said = " ".join(block.text for block in found if isinstance(block, Text))
    assert "None of the tracked runs has a published number" in said
    assert ("bench leaderboard" in said and "docs/leaderboard.md" in said) is told


def test_table_4_of_cnn85_is_complete():
    numbers = verdicts.corrections()["table4"].dropna()
    printed = [53, 46, 54, 53, 54, 55.6, 59, 58, 56, 60.5, 60.8, 57, 48, 60, 59, 42.34, 52.86, 33.52, 63.7]
    assert sorted(numbers) == sorted(printed)


def test_seeds_are_rows_and_other_parameters_other_systems(beside):
    seeds = [
        {"system": "ta2015_rf", "predictions": made_up(8, seed=s), "protocol": "challenge", "seed": s} for s in (2, 0)
    ]
    other = {"system": "hughes2017_cnn[epochs=3]", "predictions": made_up(windows=3), "protocol": "challenge"}
    found = beside(*seeds, other)
    assert list(found.loc["ta2015-haart-test", "seed"]) == ["0", "2"]
    assert found.loc["hughes2017-haart-cnn", "verdict"] == "not run"
    assert "hughes2017_cnn[epochs=3]" in found.loc["hughes2017-haart-cnn", "note"]


def test_units_and_their_intervals(beside):
    predictions = made_up(6, windows=3, skill=0.5)
    papers = published()
    run = {"system": "cnn85", "data": "cost", "protocol": "loso", "predictions": predictions}
    found = beside(run)
    decided = scores.windows(predictions)
    table = scores.per_class(decided, scores.classes_of(predictions))
    assert found.loc["albawi2018-headline", "ours"] == pytest.approx(100 * table["precision"].mean())
    assert found.loc["albawi2018-pooled", "ours"] == pytest.approx(
        100 * (decided["true"] == decided["predicted"]).mean()
    )
    low, high = scores.subject_interval(decided)
    assert found.loc["albawi2018-pooled", ["low", "high"]].tolist() == pytest.approx([100 * low, 100 * high])
    row = found.loc["albawi2018-headline"]
    assert row["low"] < row["ours"] < row["high"] and "macro precision" in row["note"]
    assert len(papers) == len(found)


def test_a_vote_is_the_capture_where_there_is_one_decision(beside):
    found = beside({"system": "hughes2017_ae_rnn", "predictions": made_up(8), "protocol": "challenge"})
    assert np.isfinite(found.loc["hughes2017-haart-ae-rnn", "ours"])


def test_macro_intervals_by_a_plain_loop():
    labelled = scores.captures(made_up(5, skill=0.4, seed=3))
    classes = ["pat", "rub", "tap"]
    draws = np.random.default_rng(0).multinomial(5, np.full(5, 0.2), 20)
    names = sorted(labelled["subject"].unique())
    for metric, column in (("macro_precision", "precision"), ("macro_recall", "recall")):
        values = []
        for times in draws:
            parts = [labelled[labelled["subject"] == n] for n, k in zip(names, times, strict=True) for _ in range(k)]
            values.append(scores.per_class(pd.concat(parts), classes)[column].mean())
        found = verdicts.macro_interval(labelled, classes, metric, draws=20)
        assert found == pytest.approx(tuple(np.quantile(values, [0.025, 0.975])))
    one = labelled[labelled["subject"] == "1"]
    assert all(np.isnan(verdicts.macro_interval(one, classes, "macro_recall")))


def test_synthetic_incomplete_and_single_subject_runs_get_no_false_verdict(beside):
    runs = [
        {"system": "ta2015_rf", "predictions": made_up(8), "protocol": "challenge", "synthetic": "true"},
        {"system": "gaus2015_rf", "predictions": made_up(8), "protocol": "challenge", "failed": 2},
        {"system": "hughes2015_softmax", "predictions": made_up(1), "protocol": "challenge"},
    ]
    found = beside(*runs)
    assert found.loc["ta2015-haart-test", "verdict"] == "not run" and np.isnan(found.loc["ta2015-haart-test", "ours"])
    assert found.loc["gaus2015-haart-test", "verdict"] == "not run"
    assert "lacks folds: 8 of 10" in found.loc["gaus2015-haart-test", "note"]
    assert found.loc["hughes2015-haart-test", "verdict"] == "no interval"


def test_artifacts_are_read_where_they_lie(store):
    tracked_run(store, "a", made_up(3))
    (run,) = tracked(store).to_dict("records")
    accuracy = runs.subject_accuracy(store, run)
    labelled = scores.captures(runs.predictions(store, run))
    expected = scores.per_subject(labelled).set_index("subject")["accuracy"] * 100
    assert accuracy == pytest.approx(expected.to_dict())
    assert runs.artifact(store, run | {"artifacts": "file://" + run["artifacts"]}, "per_class.csv").is_file()
    assert runs.artifact(store, run, "none.csv") is None and runs.predictions(store, run | {"artifacts": "x"}) is None
    folds = store.fold_accuracy(run["run_id"])
    assert list(folds) == ["1", "2", "3"] and folds["1"] == pytest.approx(accuracy["1"])
