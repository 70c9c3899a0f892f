"""Labelled captures of a new person: accuracy against their number.

The protocols ``personal`` and ``transfer`` draw them, because the tested captures depend on them; here they are shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from bench.circumstances.base import Circumstance

if TYPE_CHECKING:
    import pandas as pd

    from bench.reports.part import Section
    from bench.result import Result


@dataclass(frozen=True)
class Shots(Circumstance):
    """A system meets a new person, with some of their captures."""

    key: ClassVar[str] = "shots"
    tracked: ClassVar[tuple[str, ...]] = ("protocol.shots", "protocol.unlabelled")
    views: ClassVar[bool] = False
    chooses: ClassVar[bool] = False

    @classmethod
    def section(cls, results: Sequence[Result], folder: Path) -> Section | None:
        """A figure and a table for each set of comparable runs."""
        from bench.reports.new_person import new_person_section

        return new_person_section(results, folder)

    @classmethod
    def brief(cls, results: Sequence[Result]) -> tuple[str, str] | None:
        """What shots gain."""
        from bench.reports.new_person import gained

        return gained(results)

    @classmethod
    def sheets(cls, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """None: ``comparison.csv`` has a row for each number of shots."""
        return {}
