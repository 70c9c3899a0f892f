"""Choices for many drawings of people against the choice for one, and what to expect against loops and tables."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import nct, t

from bench.outcomes.choice import decide
from bench.outcomes.expected import detectable, expected, more_people, power
from bench.outcomes.pick import People, fitting, pick
from bench.outcomes.reactions import Reactions


def people_of(seed, candidates=5, subjects=6, faults=3):
    rng = np.random.default_rng(seed)
    skill = rng.uniform(60, 90, (candidates, 1)) * (rng.random((candidates, 1)) < 0.7) + 75
    scores = np.minimum(skill / 2 + rng.normal(40, 4, (candidates, subjects)), 100)
    alarms = np.stack([rng.poisson(2, scores.shape), rng.uniform(0.5, 1, scores.shape)])
    fixed = {"flash": np.append(rng.uniform(1, 50, candidates - 1), np.nan)}
    return People(scores, rng.normal(8, 5, (candidates, faults, subjects)), alarms.astype(float), fixed)


def costs_of(people, drawn):
    """The costs by loops."""
    scores, losses = people.scores[:, drawn], people.losses[:, :, drawn]
    alarms, hours = (people.alarms[k][:, drawn].sum(axis=1) for k in (0, 1))
    return {
        "flash": people.fixed["flash"],
        "fault_loss": np.array([losses[c].mean() for c in range(len(scores))]),
        "worst_fault": np.array([max(f.mean() for f in losses[c]) for c in range(len(scores))]),
        "worst_person": np.array([min(row) for row in scores]),
        "worst_tenth": np.array([min(row) for row in scores]),  # of fewer than eleven people
        "false_alarms": alarms / hours,
    }


def by_decide(people, drawn, by, budgets, margin):
    subjects = pd.DataFrame(people.scores[:, drawn])
    table = pd.DataFrame(costs_of(people, drawn)).assign(system="s", unit="capture", accuracy=subjects.mean(axis=1))
    return decide(table, subjects, by, budgets, margin).chosen


@pytest.mark.parametrize("margin", [None, 4.0])
@pytest.mark.parametrize(
    ("by", "budgets"),
    [("flash", {}), ("flash", {"worst_person": 70.0, "fault_loss": 8.0}), ("worst_fault", {"false_alarms": 3.0})],
)
def test_every_drawing_is_decided_as_if_it_were_alone(margin, by, budgets):
    different = set()
    for seed in range(8):
        people = people_of(seed)
        drawn = np.random.default_rng(seed).integers(0, 6, (70, 6))
        costs = {name: people.cost(name, drawn) for name in budgets}
        chosen = pick(
            people.scores, drawn, fitting(costs, budgets, 5) & np.ones((70, 1), bool), people.cost(by, drawn), margin
        )[0]
        for each, one in list(zip(drawn, chosen, strict=True))[::10]:
            alone = by_decide(people, each, by, budgets, margin)
            assert one == (-1 if alone is None else alone)
        different |= {*chosen.tolist()}
    assert len(different) > 2


def test_each_person_is_left_out_of_the_choice_and_of_nothing_else():
    for seed in range(8):
        people = people_of(seed)
        everyone = by_decide(people, np.arange(6), "flash", {"worst_person": 60.0}, None)
        if everyone is None:
            continue
        one = expected(people, everyone, "flash", {"worst_person": 60.0}, None)
        for person in range(6):
            others = [k for k in range(6) if k != person]
            chosen = by_decide(people, others, "flash", {"worst_person": 60.0}, None)
            assert one.without[person] == (-1 if chosen is None else chosen)
            assert (
                np.isnan(one.scores[person]) if chosen is None else one.scores[person] == people.scores[chosen, person]
            )
        assert one.shares.sum() <= 1 + 1e-9 and one.rival != everyone
    assert expected(people_of(0, subjects=4), 0, "flash", {}, None) is None
    five = expected(people_of(0, subjects=5), 0, "flash", {}, None)
    assert np.isfinite(five.difference) and np.isnan(five.smallest)


def test_scores_of_the_person_left_out_change_nothing_in_the_choice_for_this_person():
    people = people_of(3)
    other = People(people.scores.copy(), people.losses.copy(), people.alarms.copy(), people.fixed)
    other.scores[:, 2], other.losses[:, :, 2], other.alarms[0][:, 2] = 0, 99, 999
    budgets = {"fault_loss": 9.0, "worst_person": 55.0, "false_alarms": 9.0}
    one, two = (expected(each, 0, "flash", budgets, None) for each in (people, other))
    assert one.without[2] == two.without[2] >= 0 and one.without.tolist() != two.without.tolist()


def test_power_equals_the_noncentral_t_distribution_and_textbook_numbers_of_people():
    for people, difference in ((5, 1.3), (10, 0.5), (31, 0.4)):
        limit = t.ppf(0.975, people - 1)
        against = nct(people - 1, difference * people**0.5)
        assert power(difference, 1.0, people) == pytest.approx(against.sf(limit) + against.cdf(-limit), abs=1e-9)
        assert power(detectable(2.0, people), 2.0, people) == pytest.approx(0.8)
    for difference, people in ((0.2, 199), (0.5, 34), (0.8, 15)):  # as G*Power gives them
        assert detectable(1.0, people) <= difference < detectable(1.0, people - 1)


def test_the_gain_of_more_people_extends_the_learning_curve():
    rows = [
        (n, s, "pat", "pat" if k < 60 - 80 / n + s else "rub") for n in (2, 4, 8) for s in range(5) for k in range(100)
    ]
    table = pd.DataFrame(rows, columns=["train_subjects", "subject", "true", "predicted"]).assign(
        circumstance="", fold="1"
    )
    table.loc[table.index[::7], "true"] = "pat"
    most, gains = more_people(table, Reactions())
    assert most == 8 and gains["more"].tolist() == [5, 10, 20]
    assert gains["gain"].tolist() == pytest.approx([80 / 8 - 80 / (8 + m) for m in (5, 10, 20)])
    assert more_people(table[table["train_subjects"] > 2], Reactions()) is None
