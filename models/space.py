"""The values of a parameter in a search: a list, or a range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from optuna import Trial as Draft
    from optuna.distributions import BaseDistribution


@dataclass(frozen=True)
class Range:
    """Values from low to high, whole numbers if both are; ``log`` spreads them over orders of magnitude."""

    low: float
    high: float
    log: bool = False


Space = dict[str, Range | Sequence]
Trial = dict[str, object]  # a value of each parameter
Tuning = dict[
    str, Any
]  # of a cell: its space, arguments of `bench.models.search.tuning.Search`, and smallest=


def make_distribution(values: Range | Sequence) -> BaseDistribution:
    """The values as Optuna has them."""
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    if not isinstance(values, Range):
        return CategoricalDistribution(list(values))
    whole = isinstance(values.low, int) and isinstance(values.high, int)
    return (IntDistribution if whole else FloatDistribution)(
        values.low, values.high, log=values.log
    )


def suggest_value(draft: Draft, name: str, values: Range | Sequence) -> object:
    """A value that a trial of Optuna draws."""
    if not isinstance(values, Range):
        return draft.suggest_categorical(name, list(values))
    whole = isinstance(values.low, int) and isinstance(values.high, int)
    return (draft.suggest_int if whole else draft.suggest_float)(
        name, values.low, values.high, log=values.log
    )
