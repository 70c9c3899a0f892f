"""Values of a choice: what is wished, and the ways in which a run labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from bench.words import SEVERITIES

if TYPE_CHECKING:
    import pandas as pd

EARLY = "early"  # mark of a candidate that decides before the end of a capture


@dataclass(frozen=True)
class Losses:
    """The faults over which losses are taken.

    Attributes:
        names: names of the faults.
        severity: highest severity; lower ones count, too.
    """

    names: tuple[str, ...]
    severity: int = SEVERITIES

    @property
    def circumstances(self) -> list[tuple[str, int]]:
        """Every fault at every severity."""
        return [(name, severity) for name in self.names for severity in range(1, self.severity + 1)]


@dataclass(frozen=True)
class Wish:
    """What a choice asks of the ways in which a run labels.

    Attributes:
        reactions: reactions that are scored (`bench.outcomes.reactions.Reactions`).
        most: ms of touch until a decision: the latest that is soon enough counts; with inf each; with None only whole
            captures do.
        windows: True for single windows instead of captures.
        plain: False if another run of the system gives the labels of the captures as they are.
    """

    reactions: Any
    most: float | None = None
    windows: bool = False
    plain: bool = True


@dataclass(frozen=True)
class Candidate:
    """A way in which a run labels.

    Attributes:
        unit: words for what is labelled; candidates of one system and unit are its seeds.
        scores: score in percent by subject.
        stored: names of stored values that its costs read in place of their own; empty for a cost that it has not.
        costs: costs that no stored value has, by name.
        apart: values that keep it apart from another one of the same system and unit.
        counts: further numbers by subject, which costs of people are computed from.
        mark: name of its look in charts; empty for none.
        linked: True if its bytes are linked, with code.
        whole: True if losses in a circumstance are also its losses.
        shipped: keys of ``bench fit`` that save it as it was measured, besides those of its run.
    """

    unit: str
    scores: pd.Series
    stored: Mapping[str, str] = field(default_factory=dict)
    costs: Mapping[str, float] = field(default_factory=dict)
    apart: tuple[str, ...] = ()
    counts: Sequence[pd.Series] = ()
    mark: str = ""
    linked: bool = False
    whole: bool = False
    shipped: Mapping[str, str] = field(default_factory=dict)
