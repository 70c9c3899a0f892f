"""Values of a choice: what is wished, and the ways in which a run labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from bench.ground.words import SEVERITIES

if TYPE_CHECKING:
    import pandas as pd

EARLY = "early"  # mark of a candidate that decides before the end of a capture


@dataclass(frozen=True)
class Losses:
    """The faults over which losses are taken."""

    names: tuple[str, ...]  # names of the faults
    severity: int = SEVERITIES  # highest severity; lower ones count, too

    @property
    def circumstances(self) -> list[tuple[str, int]]:
        """Every fault at every severity."""
        return [(name, severity) for name in self.names for severity in range(1, self.severity + 1)]


@dataclass(frozen=True)
class Wish:
    """What a choice asks of the ways in which a run labels."""

    reactions: Any  # reactions that are scored (`bench.reading.reactions.Reactions`)
    # ms of touch until a decision: the latest that is soon enough counts; with inf each; with None only whole captures
    # do
    most: float | None = None
    windows: bool = False  # True for single windows instead of captures
    plain: bool = (
        True  # False if another run of the system gives the labels of the captures as they are
    )


@dataclass(frozen=True)
class Candidate:
    """A way in which a run labels."""

    unit: str  # words for what is labelled; candidates of one system and unit are its seeds
    scores: Mapping[str, float] | pd.Series  # score in percent by subject
    # names of stored values that its costs read in place of their own; empty for a cost that it has not
    stored: Mapping[str, str] = field(default_factory=dict)
    costs: Mapping[str, float] = field(
        default_factory=dict
    )  # costs that no stored value has, by name
    apart: tuple[
        str, ...
    ] = ()  # values that keep it apart from another one of the same system and unit
    counts: Sequence[
        pd.Series
    ] = ()  # further numbers by subject, which costs of people are computed from
    mark: str = ""  # name of its look in charts; empty for none
    linked: bool = False  # True if its bytes are linked, with code
    whole: bool = False  # True if losses in a circumstance are also its losses
    # keys of ``bench fit`` that save it as it was measured, besides the keys of its run
    shipped: Mapping[str, str] = field(default_factory=dict)
