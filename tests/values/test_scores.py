"""Scores by hand and against scikit-learn and scipy; few people give no interval and no p value."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from sklearn.metrics import accuracy_score, f1_score, precision_score, recall_score

from bench.reading import statistics
from bench.reading.frame import runs_table
from bench.reports.comparison import comparison_table, score_rows
from bench.values import few, intervals, scores
from bench.values.columns import run_columns
from bench.values.intervals import ratio_interval
from tests.reading.results import make_run, predictions_with_hits

# Two subjects, three captures. Windows of capture 0 vote a, a, b; their mean probability says b.
PREDICTIONS = pd.DataFrame(
    [
        ("1", 0, 0, 10, "a", "1", 0.6, 0.4),
        ("1", 0, 10, 10, "a", "1", 0.6, 0.4),
        ("1", 0, 20, 5, "a", "1", 0.0, 1.0),
        ("1", 1, 0, 4, "b", "1", 0.3, 0.7),
        ("2", 2, 0, 10, "a", "2", 0.9, 0.1),
        ("2", 2, 10, 2, "a", "2", 0.2, 0.8),
    ],
    columns=["fold", "capture", "start", "frames", "true", "subject", "p_a", "p_b"],
)


def test_units_by_hand():
    assert list(scores.label_windows(PREDICTIONS)["predicted"]) == ["a", "a", "b", "b", "a", "b"]
    assert list(scores.label_captures(PREDICTIONS)["predicted"]) == ["b", "b", "a"]
    # Capture 2 has one vote each; its mean probability is .55 for a.
    assert list(scores.label_captures(PREDICTIONS, vote=True)["predicted"]) == ["a", "b", "a"]
    found = scores.run_scores(PREDICTIONS, rate_hz=100)
    assert found["pooled_accuracy"] == pytest.approx(2 / 3)
    assert found["vote_accuracy"] == found["vote_pooled_accuracy"] == 1
    assert found["window_pooled_accuracy"] == pytest.approx(4 / 6)
    assert found["window_accuracy"] == pytest.approx((3 / 4 + 1 / 2) / 2)
    assert (
        found["accuracy"] == scores.fold_accuracies(PREDICTIONS)["accuracy"] == pytest.approx(0.75)
    )
    assert found["subject_sd"] == pytest.approx(np.std([0.5, 1], ddof=1))
    assert found["window_macro_precision"] == pytest.approx((3 / 3 + 1 / 3) / 2)
    assert found["window_macro_recall"] == pytest.approx((3 / 5 + 1) / 2)
    assert found["observed_ms"] == pytest.approx(
        75
    )  # median of 10, 10, 5, 4, 10, 2 frames at 100 Hz
    assert found["capture_ms"] == pytest.approx(120)  # median of 25, 4, 12 frames


def test_scores_equal_scikit_learns():
    rng = np.random.default_rng(0)
    proba = rng.dirichlet(np.ones(4), 200)
    table = pd.DataFrame(proba, columns=[f"p_{c}" for c in "abcd"])
    table = table.assign(
        fold="1", capture=np.arange(200), start=0, frames=10, true=rng.choice(list("abc"), 200)
    )
    table["subject"] = rng.choice(list("vwxyz"), 200)
    predicted = np.array(list("abcd"))[proba.argmax(axis=1)]
    found = scores.run_scores(table, rate_hz=50)
    each = {"labels": list("abcd"), "average": "macro", "zero_division": 0}
    assert found["pooled_accuracy"] == pytest.approx(accuracy_score(table["true"], predicted))
    assert found["macro_f1"] == pytest.approx(f1_score(table["true"], predicted, **each))
    assert found["macro_precision"] == pytest.approx(
        precision_score(table["true"], predicted, **each)
    )
    assert found["macro_recall"] == pytest.approx(recall_score(table["true"], predicted, **each))
    assert "vote_accuracy" not in found and "window_accuracy" not in found
    low, high = found["pooled_accuracy_low"], found["pooled_accuracy_high"]
    means = pd.Series(table["true"] == predicted).groupby(table["subject"]).mean()
    assert means.min() <= low < found["pooled_accuracy"] < high <= means.max()
    ends = stats.t.interval(0.95, 4, means.mean(), stats.sem(means))
    assert (found["accuracy_low"], found["accuracy_high"]) == pytest.approx(ends)
    assert found["accuracy"] == pytest.approx(means.mean()) != found["pooled_accuracy"]


def test_interval_equals_a_loop_over_drawn_subjects():
    ten = pd.concat([PREDICTIONS, PREDICTIONS[:4]])
    table = scores.label_captures(ten.assign(capture=range(10), subject=list("1122334455")))
    draws = np.random.default_rng(0).integers(0, 5, (2000, 5))
    hit = (table["true"] == table["predicted"]).to_numpy().reshape(5, 2)
    expected = np.quantile([hit[d].mean() for d in draws], [0.025, 0.975])
    assert scores.pooled_accuracy_interval(table) == pytest.approx(tuple(expected))


def test_an_abstention_is_wrong_and_counted_by_hand():
    """Capture 0 abstains on its last window, capture 1 on its only one, capture 2 names b twice."""
    table = PREDICTIONS.assign(p_a=[0.6, 0.6, 0, 0, 0.1, 0.2], p_b=[0.4, 0.4, 0, 0, 0.9, 0.8])
    labelled = scores.label_captures(table)
    assert labelled["predicted"].tolist() == ["a", "", "b"]
    assert scores.label_captures(table, vote=True)["predicted"].tolist() == ["a", "", "b"]
    assert scores.label_windows(table)["predicted"].tolist() == ["a", "a", "", "", "b", "b"]
    found = scores.run_scores(table, rate_hz=100)
    assert (found["pooled_accuracy"], found["abstained"]) == (
        pytest.approx(1 / 3),
        pytest.approx(1 / 3),
    )
    assert found["macro_recall"] == pytest.approx((1 / 2 + 0) / 2)
    assert found["window_pooled_accuracy"] == pytest.approx(2 / 6)
    counts = scores.confusion_table(labelled, ["a", "b"])
    assert (
        counts.to_dict("split")["data"] == [[1, 1, 0], [0, 0, 1]]
        and counts.columns[-1] == "(abstained)"
    )
    assert "abstained" not in scores.run_scores(PREDICTIONS, rate_hz=100)


@pytest.mark.parametrize("people", [3, 4, 5, 6])
def test_below_five_people_there_is_no_interval_and_below_six_no_p(people):
    lacking = {3: "an interval", 4: "an interval", 5: "a p value", 6: ""}
    assert few.too_few_sentence(people).rpartition("too few for ")[2] == lacking[people]
    values = pd.DataFrame(np.random.default_rng(0).normal(60, 9, (3, people)), index=list("abc"))
    rows = statistics.compare_with_base(values, values, 0.5).iloc[1:]
    ends = ["nb_low", "nb_high", "dz_low", "dz_high"]
    assert rows[ends].notna().all(axis=None) == (people >= 5) == rows[ends].notna().any(axis=None)
    tested = ["low", "high", "p", "p_holm"]  # the interval of a difference is that of its test
    for table in (rows[[*tested, "nb_p"]], statistics.paired_tests(values)[tested]):
        assert table.notna().all(axis=None) == (people >= 6) == table.notna().any(axis=None)
    assert np.isfinite(statistics.friedman(values)[1]) == (people >= 6)
    counts = np.column_stack([np.arange(people), np.full(people, 9)])
    for ends in (ratio_interval(counts), intervals.mean_interval(counts[:, 0])):
        assert np.isfinite(ends).tolist() == [people >= 5] * 2


def test_the_accuracy_that_users_see_is_the_mean_over_subjects_with_its_t_interval():
    hits = [5, 20, 11, 8, 16]
    table = pd.concat(
        [
            predictions_with_hits(hits),
            predictions_with_hits([0, 0, 0, 0, 12], 12).query("subject == '5'").assign(fold="6"),
        ]
    )
    each = np.array([5, 20, 11, 8]) / 20
    each = 100 * np.append(each, 28 / 32)  # the fifth subject has more captures than the others
    run = make_run(predictions=table)
    ends = stats.t.interval(0.95, 4, each.mean(), stats.sem(each))
    assert run_columns()[0].value_of_row(run) == pytest.approx(
        (each.mean(), ends[0], min(ends[1], 100))
    )
    shown = runs_table([run]).iloc[0]
    assert shown[["accuracy", "low", "high"]].tolist() == pytest.approx(
        [each.mean(), ends[0], min(ends[1], 100)]
    )
    row = comparison_table(score_rows({"g": [run]})).iloc[0]
    assert row[["accuracy", "low"]].tolist() == pytest.approx([each.mean(), ends[0]])
    assert row["pooled_accuracy"] == pytest.approx(100 * 72 / 112) != row["accuracy"]
    assert row["interval"] == "95 % t-interval over subjects" and row[
        "subject_sd"
    ] == pytest.approx(each.std(ddof=1))
    people = scores.mean_over_subjects(scores.label_captures(table))
    assert 100 * people["accuracy"] == pytest.approx(each.mean()) and 100 * people[
        "low"
    ] == pytest.approx(ends[0])
