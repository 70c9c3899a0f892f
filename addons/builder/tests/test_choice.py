"""Accuracies to expect pay for the choice; bounds of rates; what nothing fits."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from bench.outcomes.candidates import People
from bench.outcomes.choice import Budget
from touchbench_builder.certificate import expected, most
from touchbench_builder.choice import _nested, _nothing_fits


def test_each_person_gets_the_system_that_the_others_choose():
    """Without 1, small is right in 10 and 10 %, large in 90 and 90 %: large. Without 2 or 3, both have 50: small."""
    scores = np.array([[90.0, 10, 10], [10, 90, 90]])
    table = pd.DataFrame({"system": ["small", "large"], "flash": [1.0, 2.0]})
    people = People(scores, np.empty((2, 0, 3)), np.empty((0, 2, 3)))
    labels = [
        pd.DataFrame(
            [(str(p + 1), "pat", "pat" if i < row[p] / 10 else "rub", p) for p in range(3) for i in range(10)],
            columns=["subject", "true", "predicted", "capture"],
        )
        for row in scores
    ]
    rule = SimpleNamespace(by="flash", budgets={}, margin=None)
    nested = _nested(rule, table, pd.DataFrame(scores, columns=["1", "2", "3"]), people, labels, 1)
    assert nested.groupby("subject")["system"].unique().explode().to_dict() == {
        "1": "large",
        "2": "small",
        "3": "small",
    }
    found = expected(nested)
    assert found["people"] == {"1": [1, 10], "2": [1, 10], "3": [1, 10]}  # small alone would have 37 %, large 63 %
    assert found["mean"] == 0.1 and found["mean_low"] is None and found["systems"] == {"small": 2, "large": 1}


@pytest.mark.parametrize("events", [0, 1, 7])
def test_the_bound_of_a_rate_is_that_of_poisson(events):
    assert most(events, 1.5) == pytest.approx(chi2.ppf(0.95, 2 * (events + 1)) / 2 / 1.5)
    assert most(0, 1.5) == pytest.approx(3 / 1.5, rel=0.002)  # the rule of three


def test_the_budget_that_is_missed_most_is_named_with_the_next_board():
    table = pd.DataFrame({"flash": [300.0, 400.0], "ram": [3.0, 2.0]})
    limits = [
        Budget(name, budget, 2, 0, None, None, np.nan, np.nan) for name, budget in (("flash", 64.0), ("ram", 1.9))
    ]
    words = _nothing_fits(table, limits)
    assert "flash is missed most: 300 kB at best, the budget is 64 kB" in words and "microbit2" in words  # 512 KiB
