"""What a search may try for a parameter: a list of values, or a range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Range:
    """Values from low to high, whole numbers if both are; ``log`` spreads them over orders of magnitude."""

    low: float
    high: float
    log: bool = False


Space = dict[str, Range | Sequence]
