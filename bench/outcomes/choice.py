"""The choice of a system: the cheapest within one standard error of the best one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from bench import few
from bench.comparable import MIXED, Row
from bench.measures import costs
from bench.outcomes.pick import fitting, pick, within
from bench.paired import mean_and_error
from bench.sentences import sentences
from bench.table import rows_of


@dataclass(frozen=True)
class Budget:
    """The effect of one budget on the candidates.

    Attributes:
        cost: name of the cost.
        budget: largest or smallest allowed amount.
        over: number of candidates outside of it.
        unknown: number of candidates with unknown cost.
        least: index of the candidate with the best amount, None if no cost is measured.
        without: index of the best one that fits all the other budgets, None if none does.
        gain: accuracy of that candidate minus that of the best one that fits all budgets, mean over subjects in points;
            NaN if none does.
        error: the standard error of that.
    """

    cost: str
    budget: float
    over: int
    unknown: int
    least: int | None
    without: int | None
    gain: float
    error: float


@dataclass(frozen=True)
class Choice:
    """The result of a choice.

    Attributes:
        table: candidates with ``loss`` (mean over subjects of best minus own accuracy, in points), ``error`` (its
            standard error) and ``verdict``, cheapest first; those with unknown cost come last.
        chosen: index in it, None if no candidate fits the budgets.
        best: index of the most accurate one that fits them.
        costlier: index of the next costlier one that fits them and is more accurate than the chosen, None if there is
            none.
        unranked: indices of those that fit the budgets but have an unknown cost, most accurate first.
        budgets: effect of each budget.
    """

    table: pd.DataFrame
    chosen: int | None
    best: int | None
    costlier: int | None
    unranked: list[int] = field(default_factory=list)
    budgets: list[Budget] = field(default_factory=list)


def decide(
    table: pd.DataFrame, subjects: pd.DataFrame, by: str, budgets: dict[str, float], margin: float | None
) -> Choice:
    """Take the cheapest candidate whose score is not below that of the best (`bench.outcomes.pick.pick`).

    The best one is sought among those that fit the budgets; a candidate whose cost is not known fits no budget of it.
    One whose cost ``by`` is not known cannot be the cheapest, so neither chosen nor the best is such a one; its loss is
    told.

    Args:
        table: candidates with ``accuracy`` and a column per cost, as `bench.outcomes.candidates` gives them.
        subjects: scores in percent [candidates, subjects].
        by: the cost to minimise.
        budgets: budget of each cost.
        margin: points that do not matter, or None for the rule of one standard error.
    """
    accuracy = table["accuracy"].round(9)  # equal sums in another order are ties
    verdicts = [_excess(row, budgets) for row in rows_of(table)]
    table = table.assign(verdict=verdicts, loss=np.nan, error=np.nan, accuracy=accuracy)
    fits, cost = table["verdict"] == "", costs()[by]
    unranked = [int(i) for i in table[fits & table[by].isna()].sort_values("accuracy", ascending=False).index]
    chosen, best, near = _picked(table, subjects, by, budgets, margin)
    limits = [_limit(table, subjects, by, budgets, cost, best) for cost in budgets]
    if best is None or chosen is None:
        table.loc[unranked, "verdict"] = f"{cost.title} unknown"
        return Choice(table.sort_values(by, key=cost.burden), None, None, None, unranked, limits)
    for i in table.index[fits]:
        table.loc[i, ["loss", "error"]] = mean_and_error((subjects.loc[best] - subjects.loc[i]).to_numpy())
    fitting = [int(i) for i in table.index[fits]]
    burden = cost.burden(table[by])
    order = pd.DataFrame({"burden": burden, "accuracy": table["accuracy"]})
    table = table.loc[order.sort_values(["burden", "accuracy"], ascending=[True, False]).index]
    dearer = [i for i in table.index if i in fitting and burden[i] > burden[chosen]]
    for i in fitting:
        verdict = "the best" if i == best else "near the best" if near[i] else "below the best"
        if i in unranked:
            verdict += f", {cost.title} unknown"
        elif near[i]:
            verdict += ", costlier" if i in dearer else ", equally cheap"
        table.loc[i, "verdict"] = "chosen" if i == chosen else verdict
    costlier = next((i for i in dearer if accuracy[i] > accuracy[chosen]), None)
    return Choice(table, chosen, best, costlier, unranked, limits)


def _picked(
    table: pd.DataFrame, subjects: pd.DataFrame, by: str, budgets: Mapping[str, float], margin: float | None = None
) -> tuple[int | None, int | None, np.ndarray]:
    """The chosen and the best candidate, and which are not below the best."""
    fits = fitting({name: table[name].to_numpy(float) for name in budgets}, budgets, len(table))
    everyone = np.arange(subjects.shape[1])[None]
    scores, burdens = subjects.to_numpy(float), costs()[by].burden(table[by].to_numpy(float))
    chosen, best, near = (each[0] for each in pick(scores, everyone, fits[None], burdens[None], margin))
    return (None, None, near) if best < 0 else (int(chosen), int(best), near)


def _excess(row: Row, budgets: Mapping[str, float]) -> str:
    """By which budgets a candidate is ruled out, with amounts if it is one; empty for none."""
    over = [costs()[name] for name, budget in budgets.items() if not within(name, row[name], budget)]
    if len(over) > 1:
        return "ruled out: " + ", ".join(cost.title for cost in over)
    for cost in over:
        amounts = cost.apart(row[cost.key], budgets[cost.key])
        sign = ">" if cost.better == "low" else "<"
        return f"ruled out: {cost.title} " + (f" {sign} ".join(amounts) if np.isfinite(row[cost.key]) else "unknown")
    return ""


def _limit(
    table: pd.DataFrame, subjects: pd.DataFrame, by: str, budgets: dict[str, float], cost: str, best: int | None
) -> Budget:
    """What one of the budgets does."""
    amounts = table[cost].dropna()
    least = int(amounts.index[int(costs()[cost].burden(amounts).argmin())]) if len(amounts) else None
    without = _picked(table, subjects, by, {k: v for k, v in budgets.items() if k != cost})[1]
    gain = error = np.nan
    if best is not None and without is not None:
        gain, error = mean_and_error((subjects.loc[without] - subjects.loc[best]).to_numpy())
    over = int((~within(cost, amounts.to_numpy(), budgets[cost])).sum())
    return Budget(cost, budgets[cost], over, len(table) - len(amounts), least, without, gain, error)


def points(mean: float, error: float = np.nan) -> str:
    """A difference in points with its standard error, which a single subject does not have."""
    text = f"{mean:.1f}" if round(mean, 1) or abs(mean) < 1e-9 else f"{mean:.1g}"
    return text if np.isnan(error) else f"{text} ± {error:.1f}"


def named(row: Mapping[Any, Any], comma: str = "") -> str:
    """A candidate: the system, and in brackets or behind a comma its unit, unless that is whole captures."""
    unit = "one window" if row["unit"] == "window" else row["unit"]
    words = f"{comma}{unit}" if comma else f" ({unit})"
    return str(row["system"]) + ("" if unit == "capture" else words)


def said(block: str, **values: object) -> list[str]:
    """Sentences of a block of ``templates/choice.jinja``."""
    return sentences("bench.outcomes", "choice", block, named=named, points=points, **values)


def reasons(choice: Choice, by: str, margin: float | None, subjects: int, mixed: bool = False) -> list[str]:
    """The choice, its reason, the cost of the next better system and of each budget, and its scope.

    Arguments are those of `verdict` and `scope`.
    """
    lines = [*verdict(choice, by, margin, subjects), *details(choice, by, subjects)]
    return lines if choice.chosen is None else [*lines, *scope(subjects, mixed)]


def verdict(choice: Choice, by: str, margin: float | None, subjects: int, told: str = "") -> list[str]:
    """The choice and its reason; the first sentence alone if nothing can be chosen.

    Args:
        choice: result of `decide`.
        by: the cost to minimise.
        margin: points of accuracy that do not matter, or None.
        subjects: number of them.
        told: sentence on the chosen candidate, which stands between the two; empty for none.
    """
    return said("verdict", **_told(choice, by), margin=margin, subjects=subjects, told=told)


def details(choice: Choice, by: str, subjects: int) -> list[str]:
    """What the choice loses to the best system, the next better system, systems of unknown cost, and each budget."""
    lines = [] if choice.chosen is None else said("details", **_told(choice, by), subjects=subjects)
    return [*lines, *prices(choice)]


def prices(choice: Choice, binding: bool = False) -> list[str]:
    """What each budget costs, or where nothing fits, how far the systems are from it.

    Args:
        choice: result of `decide`.
        binding: True to leave out budgets that rule out no system.
    """
    rows = _rows(choice)
    kept = [limit for limit in choice.budgets if limit.over or limit.unknown or not binding]
    limits = [(limit, costs()[limit.cost], rows[limit.without], rows[limit.least]) for limit in kept]
    return said("prices", limits=limits, best=rows[choice.best], candidates=len(choice.table))


def scope(subjects: int, mixed: bool) -> list[str]:
    """The limits of the conclusion.

    Args:
        subjects: number of them.
        mixed: True if training and test captures share subjects.
    """
    return said("scope", few=few.too_few(subjects), mixed=MIXED if mixed else "")


def _told(choice: Choice, by: str) -> dict[str, object]:
    """What sentences on a choice name."""
    rows = _rows(choice)
    named_by = {name: rows[i] for name, i in (("chosen", choice.chosen), ("best", choice.best))}
    unranked = [rows[i] for i in choice.unranked]
    return named_by | {"better": rows[choice.costlier], "unranked": unranked, "cost": costs()[by], "by": by}


def _rows(choice: Choice) -> dict[int | None, Row | None]:
    """The candidates by index; None has none."""
    return {None: None, **dict(zip(choice.table.index, rows_of(choice.table), strict=True))}
