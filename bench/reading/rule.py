"""The rule of a choice: the cheapest candidate within one standard error of the best that fits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from bench.values.intervals import (
    TOLERANCE,
    loss_is_below_margin,
    mean_and_error,
    within_one_standard_error,
)
from bench.values.measures import all_costs
from bench.values.result import Row
from bench.values.table import rows_of_frame


def meets_budget(name: str, amounts: np.ndarray, budget: float) -> np.ndarray:
    """Whether amounts of a cost meet a budget; NaN do not, and rounding is no excess."""
    if all_costs()[name].better == "high":
        return amounts >= budget * (1 - TOLERANCE)
    return amounts <= budget * (1 + TOLERANCE)


def pick_candidate(
    table: pd.DataFrame,
    scores: np.ndarray,
    by: str,
    budgets: Mapping[str, float],
    margin: float | None = None,
) -> tuple[int | None, int | None, np.ndarray]:
    """Pick the cheapest candidate within all budgets whose score is not below that of the best one.

    Not below means: the mean over people of the difference is at most its standard error; or, with
    a margin, a one-sided paired t-test shows it to be smaller than the margin (p < 0.05), which
    needs `bench.values.few.FEWEST_FOR_TEST` people. A candidate whose cost ``by`` is unknown is
    neither picked nor the best; one whose cost with a budget is unknown does not fit.

    Returns:
        Row of the picked candidate and row of the best one, None where none fits, and the
        candidates that fit and are not below the best, bool [candidates].
    """
    fits = np.ones(len(table), bool)
    for name, budget in budgets.items():
        fits &= meets_budget(name, table[name].to_numpy(float), budget)
    burden = all_costs()[by].as_burden(table[by].to_numpy(float))
    # Equal sums in another order are ties.
    means = pd.DataFrame(scores).mean(axis=1).round(9).to_numpy()
    eligible = fits & np.isfinite(burden) & np.isfinite(means)
    if not eligible.any():
        return None, None, np.zeros(len(scores), bool)
    best = int(np.lexsort((burden, -np.where(eligible, means, -np.inf)))[0])
    lost = scores[best] - scores
    if margin is None:
        near = fits & within_one_standard_error(lost)
    else:
        near = fits & loss_is_below_margin(lost, margin)
    near[best] = True
    cheapest = np.lexsort((-means, np.where(eligible & near, burden, np.inf)))
    return int(cheapest[0]), best, near


def judge_candidates(
    table: pd.DataFrame,
    scores: np.ndarray,
    by: str,
    budgets: Mapping[str, float],
    margin: float | None,
) -> dict[str, Any]:
    """Pick a candidate (`pick_candidate`), with a verdict on each.

    Returns:
        ``table``, ``chosen``, ``best``, ``costlier`` and ``unranked`` of
        `bench.reading.choice.Choice`.
    """
    chosen, best, near = pick_candidate(table, scores, by, budgets, margin)
    verdicts = [_describe_excess(row, budgets) for row in rows_of_frame(table)]
    fits = np.array([not verdict for verdict in verdicts])
    burden = all_costs()[by].as_burden(table[by].to_numpy(float))
    losses = np.full((len(table), 2), np.nan)
    for i in np.flatnonzero(fits):
        words = []
        if best is not None:
            losses[i] = mean_and_error(scores[best] - scores[i])
            standing = "near the best" if near[i] else "below the best"
            words = ["the best" if i == best else standing]
        if np.isnan(burden[i]):
            words.append(f"{all_costs()[by].title} unknown")
        elif near[i]:
            words.append("costlier" if burden[i] > burden[chosen] else "equally cheap")
        verdicts[i] = "chosen" if i == chosen else ", ".join(words)
    accuracy = table["accuracy"].round(9)
    table = table.assign(verdict=verdicts, loss=losses[:, 0], error=losses[:, 1])
    table = table.assign(accuracy=accuracy, burden=burden)
    unknown = table[fits & np.isnan(burden)].sort_values("accuracy", ascending=False)
    order, costlier = table.sort_values("burden"), None
    if chosen is not None:
        order = table.sort_values(["burden", "accuracy"], ascending=[True, False])
        better = fits & (burden > burden[chosen]) & (accuracy > accuracy[chosen])
        costlier = next((int(i) for i in order.index if better[i]), None)
    judged = {"table": order.drop(columns="burden"), "chosen": chosen, "best": best}
    return judged | {"costlier": costlier, "unranked": [int(i) for i in unknown.index]}


def _describe_excess(row: Row, budgets: Mapping[str, float]) -> str:
    """The budgets that rule a candidate out, with amounts if it is one; empty for none."""
    costs = [all_costs()[n] for n, budget in budgets.items() if not meets_budget(n, row[n], budget)]
    if len(costs) != 1:
        titles = ", ".join(cost.title for cost in costs)
        return f"ruled out: {titles}" if costs else ""
    (cost,) = costs
    if not np.isfinite(row[cost.key]):
        return f"ruled out: {cost.title} unknown"
    amount, limit = cost.format_two_amounts(row[cost.key], budgets[cost.key])
    return f"ruled out: {cost.title} {amount} {'>' if cost.better == 'low' else '<'} {limit}"
