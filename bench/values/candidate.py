"""A way in which a run labels captures. `bench choose` compares these."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

EARLY = "early"  # mark of a candidate that decides before the end of a capture


@dataclass(frozen=True)
class Candidate:
    """A way in which a run labels captures.

    Args:
        unit: words for what is labelled; candidates of one system and unit are its seeds.
        scores: score in percent by subject.
        stored: names of stored values that costs read instead of their own, by cost; empty for a
            cost that it lacks.
        costs: costs that no stored value has, by name.
        apart: values that distinguish it from another one of the same system and unit.
        counts: events and hours by subject, for costs that are rates.
        mark: name of its symbol in charts; empty for the symbol of its model.
        whole: True if points lost in circumstances are also its losses.
        fit_keys: keys of ``bench fit`` that save it as it was measured, besides those of its run.
    """

    unit: str
    scores: Mapping[str, float] | pd.Series
    stored: Mapping[str, str] = field(default_factory=dict)
    costs: Mapping[str, float] = field(default_factory=dict)
    apart: tuple[str, ...] = ()
    counts: Sequence[pd.Series] = ()
    mark: str = ""
    whole: bool = False
    fit_keys: Mapping[str, str] = field(default_factory=dict)
