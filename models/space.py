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
    """Values from low to high, integers if both are; ``log`` draws them by order of magnitude."""

    low: float
    high: float
    log: bool = False

    @property
    def is_integer(self) -> bool:
        """True if both ends are integers."""
        return isinstance(self.low, int) and isinstance(self.high, int)


Space = dict[str, Range | Sequence]
Trial = dict[str, Any]  # a value of each parameter
# Of a cell: its space, arguments of `bench.models.search.tuning.Search`, and smallest=.
Tuning = dict[str, Any]


def make_distribution(values: Range | Sequence) -> BaseDistribution:
    """Optuna's distribution of the values."""
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    if not isinstance(values, Range):
        return CategoricalDistribution(list(values))
    distribution = IntDistribution if values.is_integer else FloatDistribution
    return distribution(values.low, values.high, log=values.log)


def suggest_value(draft: Draft, name: str, values: Range | Sequence) -> object:
    """Value that a trial of Optuna draws."""
    if not isinstance(values, Range):
        return draft.suggest_categorical(name, list(values))
    suggest = draft.suggest_int if values.is_integer else draft.suggest_float
    return suggest(name, values.low, values.high, log=values.log)
