"""Fewer training captures of each class: a whole circumstance, as an installed package would add it."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import pandas as pd

from bench.circumstances.base import Case, Circumstance, option
from bench.measures import Cost
from bench.reports.views.base import View
from bench.work.fitted import Fitted


@dataclass(frozen=True)
class Fewer(Circumstance):
    """The system is fitted on so many captures of each class, and labels the test captures as they are."""

    key: ClassVar[str] = "each"
    view: ClassVar[str] = "fewer:Shown"

    each: tuple[int, ...] = option((), "numbers of training captures of each class", type="counts")

    def cases(self, at: Fitted) -> Iterator[Case]:
        """A system fitted on the first captures of each class, for each number."""
        gestures = pd.Series(at.train.gestures)
        for number in self.each:
            first = (gestures.groupby(gestures).cumcount() < number).to_numpy()
            yield Case(level=number, system=at.refitted(at.fold.train[first]))


class Shown(View):
    noun = "captures of each class"
    heading = "Accuracy in percent by training captures of each class"
    costs = (
        Cost("each_loss", read="loss.each", times=100, unit="points", noun="loss to few captures",
             words="lost to few captures", help="largest mean loss with few training captures, in points",
             zero=True, column=False),
    )  # fmt: skip
