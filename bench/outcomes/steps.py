"""The choice as a step function of one budget."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bench.outcomes.pick import People, fitting, pick, within


def steps(
    people: People, by: str, cost: str, budgets: Mapping[str, float], replays: Sequence[str] = ()
) -> list[tuple[float, int]]:
    """The chosen candidate for every budget of one cost, by the rule of one standard error.

    Args:
        people: scores and costs.
        by: name of the cost that is to be low.
        cost: name of the cost with the budget.
        budgets: the most of the other costs; one of this cost is ignored.
        replays: name of the replay of each candidate, or an empty text. Of one replay, only the candidate that takes
            most of the cost within its budget can be chosen.

    Returns:
        The smallest budget of each step, and its candidate, -1 if no candidate fits. Budgets below the first step fit
        no candidate.
    """
    everyone = np.arange(people.scores.shape[1])[None]
    amounts = people.cost(cost, everyone)[0]
    least = np.unique(amounts[np.isfinite(amounts)])
    others = {name: most for name, most in budgets.items() if name != cost}
    if not len(least):
        return []
    allowed = np.stack([within(amounts, most) for most in least.tolist()])  # [budgets, candidates]
    for replay in {*replays} - {""}:
        same = np.array(replays) == replay
        allowed[:, same] &= amounts[same] == np.where(allowed, amounts, -np.inf)[:, same].max(axis=1, keepdims=True)
    fits = allowed & fitting({name: people.cost(name, everyone) for name in others}, others, len(amounts))
    drawn = everyone.repeat(len(least), axis=0)
    chosen = pick(people.scores, drawn, fits, people.cost(by, drawn), None)[0]
    changes = np.flatnonzero(np.diff(chosen, prepend=-1))
    return [(float(least[i]), int(chosen[i])) for i in changes]
