"""What a search may try for a parameter: a list of values, or a range; and how it is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypedDict

if TYPE_CHECKING:
    from optuna import Trial


@dataclass(frozen=True)
class Range:
    """Values from low to high, whole numbers if both are; ``log`` spreads them over orders of magnitude."""

    low: float
    high: float
    log: bool = False


Space = dict[str, Range | Sequence]


def suggested(trial: Trial, key: str, values: Range | Sequence) -> object:
    """A value that a trial of Optuna draws."""
    if not isinstance(values, Range):
        return trial.suggest_categorical(key, list(values))
    if isinstance(values.low, int) and isinstance(values.high, int):
        return trial.suggest_int(key, values.low, values.high, log=values.log)
    return trial.suggest_float(key, values.low, values.high, log=values.log)


class How(TypedDict, total=False):
    """How a search goes: arguments of `models.search.tuning.Search`, and ``over`` of `bench choose`."""

    inner: str
    trials: int
    budget: float
    objective: str
    over: str
    seed: int | None


class Tuning(How):
    """The same with what is searched."""

    space: Space
