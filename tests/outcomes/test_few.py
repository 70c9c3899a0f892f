"""Few people give no interval, p value or forecast, and one sentence says so; what all others see is one interval."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from bench import few, intervals, scores
from bench.columns import run_columns
from bench.intervals import ratio_interval
from bench.outcomes import statistics
from bench.reports.comparison import comparison, scored
from tests.results import evaluated, with_hits


def test_the_sentence_says_what_people_are_too_few_for():
    assert [few.too_few(n) for n in (1, 4, 5, 6)] == [
        "1 subject: too few for an interval",
        "4 subjects: too few for an interval",
        "5 subjects: too few for a p value",
        "",
    ]


@pytest.mark.parametrize("people", [3, 4, 5, 6])
def test_below_five_people_there_is_no_interval_and_below_six_no_p(people):
    values = pd.DataFrame(np.random.default_rng(0).normal(60, 9, (3, people)), index=list("abc"))
    rows = statistics.against_best(values, values, 0.5).iloc[1:]
    ends = ["nb_low", "nb_high", "dz_low", "dz_high"]
    assert rows[ends].notna().all(axis=None) == (people >= 5) == rows[ends].notna().any(axis=None)
    tested = ["low", "high", "p", "p_holm"]  # the interval of a difference is that of its test
    for table in (rows[[*tested, "nb_p"]], statistics.pairs(values)[tested]):
        assert table.notna().all(axis=None) == (people >= 6) == table.notna().any(axis=None)
    assert np.isfinite(statistics.friedman(values)[1]) == (people >= 6)
    counts = np.column_stack([np.arange(people), np.full(people, 9)])
    for ends in (ratio_interval(counts), intervals.interval(counts[:, 0])):
        assert np.isfinite(ends).tolist() == [people >= 5] * 2


def test_the_accuracy_that_users_see_is_the_mean_over_subjects_with_its_t_interval():
    hits = [5, 20, 11, 8, 16]
    table = pd.concat([with_hits(hits), with_hits([0, 0, 0, 0, 12], 12).query("subject == '5'").assign(fold="6")])
    each = np.array([5, 20, 11, 8]) / 20
    each = 100 * np.append(each, 28 / 32)  # the fifth subject has more captures than the others
    run = evaluated(predictions=table)
    ends = stats.t.interval(0.95, 4, each.mean(), stats.sem(each))
    assert run_columns()[0].cell(run) == pytest.approx((each.mean(), ends[0], min(ends[1], 100)))
    row = comparison(scored({"g": [run]})).iloc[0]
    assert row[["accuracy", "low"]].tolist() == pytest.approx([each.mean(), ends[0]])
    assert row["pooled_accuracy"] == pytest.approx(100 * 72 / 112) != row["accuracy"]
    assert row["interval"] == "95 % t-interval over subjects" and row["subject_sd"] == pytest.approx(each.std(ddof=1))
    people = scores.over_people(scores.captures(table))
    assert 100 * people["accuracy"] == pytest.approx(each.mean()) and 100 * people["low"] == pytest.approx(ends[0])
