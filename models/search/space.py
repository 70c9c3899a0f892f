"""The values of a parameter in a search: a list, or a range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypedDict

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


def distribution(values: Range | Sequence) -> BaseDistribution:
    """The values as Optuna has them."""
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    if not isinstance(values, Range):
        return CategoricalDistribution(list(values))
    if isinstance(values.low, int) and isinstance(values.high, int):
        return IntDistribution(values.low, values.high, log=values.log)
    return FloatDistribution(values.low, values.high, log=values.log)


def suggested(draft: Draft, name: str, values: Range | Sequence) -> object:
    """A value that a trial of Optuna draws."""
    if not isinstance(values, Range):
        return draft.suggest_categorical(name, list(values))
    if isinstance(values.low, int) and isinstance(values.high, int):
        return draft.suggest_int(name, values.low, values.high, log=values.log)
    return draft.suggest_float(name, values.low, values.high, log=values.log)


class How(TypedDict, total=False):
    """Settings of a search: of `bench.models.search.tuning.Search`, and ``smallest`` of `bench tune`."""

    inner: str
    trials: int
    seconds: float
    objective: str
    smallest: str
    seed: int | None


class Tuning(How):
    """The same with the search space."""

    space: Space
