import numpy as np
import pandas as pd
import pytest
from scipy import stats
from sklearn.metrics import accuracy_score, f1_score, precision_score, recall_score

from bench import scores

# Two subjects, three captures, classes a and b. Capture 0 has three windows that vote a, a, b but whose mean says b.
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
    assert list(scores.windows(PREDICTIONS)["predicted"]) == ["a", "a", "b", "b", "a", "b"]
    assert list(scores.captures(PREDICTIONS)["predicted"]) == ["b", "b", "a"]
    # Capture 2 has one vote each; its mean probability is .55 for a.
    assert list(scores.captures(PREDICTIONS, vote=True)["predicted"]) == ["a", "b", "a"]
    found = scores.summary(PREDICTIONS, rate_hz=100)
    assert found["pooled_accuracy"] == pytest.approx(2 / 3)
    assert found["vote_accuracy"] == found["vote_pooled_accuracy"] == 1
    assert found["window_pooled_accuracy"] == pytest.approx(4 / 6)
    assert found["window_accuracy"] == pytest.approx((3 / 4 + 1 / 2) / 2)
    assert found["accuracy"] == scores.accuracies(PREDICTIONS)["accuracy"] == pytest.approx(0.75)
    assert found["subject_sd"] == pytest.approx(np.std([0.5, 1], ddof=1))
    assert found["window_macro_precision"] == pytest.approx((3 / 3 + 1 / 3) / 2)
    assert found["window_macro_recall"] == pytest.approx((3 / 5 + 1) / 2)
    assert found["observed_ms"] == pytest.approx(75)  # median of 10, 10, 5, 4, 10, 2 frames at 100 Hz
    assert found["capture_ms"] == pytest.approx(120)  # median of 25, 4, 12 frames


def test_scores_equal_scikit_learns():
    rng = np.random.default_rng(0)
    proba = rng.dirichlet(np.ones(4), 200)
    table = pd.DataFrame(proba, columns=[f"p_{c}" for c in "abcd"])
    table = table.assign(fold="1", capture=np.arange(200), start=0, frames=10, true=rng.choice(list("abc"), 200))
    table["subject"] = rng.choice(list("vwxyz"), 200)
    predicted = np.array(list("abcd"))[proba.argmax(axis=1)]
    found = scores.summary(table, rate_hz=50)
    each = {"labels": list("abcd"), "average": "macro", "zero_division": 0}
    assert found["pooled_accuracy"] == pytest.approx(accuracy_score(table["true"], predicted))
    assert found["macro_f1"] == pytest.approx(f1_score(table["true"], predicted, **each))
    assert found["macro_precision"] == pytest.approx(precision_score(table["true"], predicted, **each))
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
    table = scores.captures(ten.assign(capture=range(10), subject=list("1122334455")))
    draws = np.random.default_rng(0).integers(0, 5, (2000, 5))
    hit = (table["true"] == table["predicted"]).to_numpy().reshape(5, 2)
    expected = np.quantile([hit[d].mean() for d in draws], [0.025, 0.975])
    assert scores.subject_interval(table) == pytest.approx(tuple(expected))


def test_an_abstention_is_wrong_and_counted_by_hand():
    """Capture 0 abstains on its last window, capture 1 on its only one, capture 2 names b twice."""
    table = PREDICTIONS.assign(p_a=[0.6, 0.6, 0, 0, 0.1, 0.2], p_b=[0.4, 0.4, 0, 0, 0.9, 0.8])
    labelled = scores.captures(table)
    assert labelled["predicted"].tolist() == ["a", "", "b"]
    assert scores.captures(table, vote=True)["predicted"].tolist() == ["a", "", "b"]
    assert scores.windows(table)["predicted"].tolist() == ["a", "a", "", "", "b", "b"]
    found = scores.summary(table, rate_hz=100)
    assert (found["pooled_accuracy"], found["abstained"]) == (pytest.approx(1 / 3), pytest.approx(1 / 3))
    assert found["macro_recall"] == pytest.approx((1 / 2 + 0) / 2)
    assert found["window_pooled_accuracy"] == pytest.approx(2 / 6)
    counts = scores.confusion(labelled, ["a", "b"])
    assert counts.to_dict("split")["data"] == [[1, 1, 0], [0, 0, 1]] and counts.columns[-1] == "(abstained)"
    assert "abstained" not in scores.summary(PREDICTIONS, rate_hz=100)
