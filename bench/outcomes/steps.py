"""The choice as a step function of one budget."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bench.measures import costs
from bench.outcomes.pick import People, fitting, pick, within


def steps(
    people: People, by: str, cost: str, budgets: Mapping[str, float], replays: Sequence[str] = ()
) -> list[tuple[float, int]]:
    """The chosen candidate for every budget of one cost, by the rule of one standard error.

    Args:
        people: scores and costs.
        by: name of the cost to minimise.
        cost: name of the cost with the budget.
        budgets: budgets of the other costs; one of this cost is ignored.
        replays: name of the replay of each candidate, or an empty text. Of one replay, only the candidate that takes
            most of the cost within its budget can be chosen.

    Returns:
        The tightest budget of each step, and its candidate, -1 if no candidate fits. Tighter budgets than that of the
        first step fit no candidate.
    """
    everyone = np.arange(people.scores.shape[1])[None]
    amounts = people.cost(cost, everyone)[0]
    turned = costs()[cost].burden
    least = turned(np.unique(turned(amounts[np.isfinite(amounts)])))  # the tightest first
    others = {name: most for name, most in budgets.items() if name != cost}
    if not len(least):
        return []
    allowed = np.stack([within(cost, amounts, most) for most in least.tolist()])  # [budgets, candidates]
    for replay in {*replays} - {""}:
        same = np.array(replays) == replay
        latest = np.where(allowed, turned(amounts), -np.inf)[:, same].max(axis=1, keepdims=True)
        allowed[:, same] &= turned(amounts)[same] == latest
    fits = allowed & fitting({name: people.cost(name, everyone) for name in others}, others, len(amounts))
    drawn = everyone.repeat(len(least), axis=0)
    chosen = pick(people.scores, drawn, fits, costs()[by].burden(people.cost(by, drawn)), None)[0]
    changes = np.flatnonzero(np.diff(chosen, prepend=-1))
    return [(float(least[i]), int(chosen[i])) for i in changes]
