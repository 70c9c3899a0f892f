"""The choice as a step function of one budget, against a loop over ``decide`` at every amount."""

import numpy as np
import pandas as pd
import pytest

from bench.measures import costs
from bench.outcomes.choice import decide
from bench.outcomes.pick import People
from bench.outcomes.steps import steps

COSTS = ("flash", "decision", "fault_loss", "worst_person")


def made(seed, candidates=9, subjects=6):
    """Rounded scores and costs, so that some are equal; one flash is unknown."""
    rng = np.random.default_rng(seed)
    scores = np.minimum(
        rng.integers(5, 9, (candidates, 1)) * 10 + rng.integers(-2, 3, (candidates, subjects)) * 5.0, 100
    )
    fixed = {"flash": rng.integers(1, 6, candidates).astype(float), "decision": rng.integers(1, 9, candidates) / 10}
    fixed["flash"][rng.integers(candidates)] = np.nan
    people = People(scores, rng.normal(8, 5, (candidates, 3, subjects)), np.empty((2, 0, 0)), fixed)
    everyone = np.arange(subjects)[None]
    table = pd.DataFrame({cost: people.cost(cost, everyone)[0] for cost in COSTS})
    return people, table.assign(system="s", unit="capture", accuracy=scores.mean(axis=1))


def by_loop(people, table, cost, budgets, replays):
    """The choice at each amount; of one replay, candidates but the last that fits are made to fit no budget."""
    found, before, turned = [], None, costs()[cost].burden
    for least in sorted({*table[cost].dropna()}, key=turned):
        earlier = [
            any(
                replays[j] == replays[i] != "" and turned(table[cost][i]) < turned(table[cost][j]) <= turned(least)
                for j in table.index
            )
            for i in table.index
        ]
        kept = table.assign(**{cost: table[cost].mask(earlier)})
        chosen = decide(kept, pd.DataFrame(people.scores), "flash", budgets | {cost: least}, None).chosen
        if chosen != before:
            found.append((least, -1 if chosen is None else chosen))
        before = chosen
    return found


@pytest.mark.parametrize("budgets", [{}, {"flash": 3.0, "worst_person": 55.0}])
@pytest.mark.parametrize("replays", [[""] * 9, ["", "a", "a", "a", "a", "b", "b", "b", ""]])
def test_steps_are_the_choices_at_every_amount(budgets, replays):
    counts = []
    for seed in range(6):
        people, table = made(seed)
        for cost in COSTS:
            expected = by_loop(people, table, cost, budgets, replays)
            assert steps(people, "flash", cost, budgets, replays) == expected, (seed, cost)
            counts.append(len(expected))
    assert max(counts) > 2 and min(counts) < 2


def test_a_cost_that_is_unknown_has_no_steps():
    people, _ = made(0)
    nothing = People(people.scores, np.empty((9, 0, 6)), people.alarms, people.fixed)
    assert steps(nothing, "flash", "fault_loss", {}) == []
