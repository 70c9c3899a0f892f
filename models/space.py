"""What a search may try for a parameter: a list of values, or a range; and how it is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypedDict


@dataclass(frozen=True)
class Range:
    """Values from low to high, whole numbers if both are; ``log`` spreads them over orders of magnitude."""

    low: float
    high: float
    log: bool = False


Space = dict[str, Range | Sequence]


class How(TypedDict, total=False):
    """How a search goes: arguments of `models.tuning.Search`, and ``over`` of `bench choose`."""

    inner: str
    trials: int
    budget: float
    objective: str
    over: str
    seed: int | None


class Tuning(How):
    """The same with what is searched."""

    space: Space
