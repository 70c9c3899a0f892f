"""A package: a model, a circumstance with its view, a command, and a key of other commands."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import pandas as pd
from sklearn.dummy import DummyClassifier
from sklearn.pipeline import make_pipeline

from bench.grammar.options import DATA, Command, Option, key_options, parse_arguments
from bench.reports.views.base import View
from bench.running.circumstances.base import Case, Circumstance, option
from bench.running.fitted import FittedFold
from bench.values.measures import Cost, to_percent


@dataclass(frozen=True)
class Fewer(Circumstance):
    """The system is fitted on few captures of each class; test captures are as they are."""

    key: ClassVar[str] = "each"
    view: ClassVar[str] = "example:Shown"

    each: tuple[int, ...] = option((), "numbers of training captures of each class", type="counts")

    def cases(self, at: FittedFold) -> Iterator[Case]:
        """A system fitted on the first captures of each class, for each number."""
        gestures = pd.Series(at.train.gestures)
        for number in self.each:
            first = (gestures.groupby(gestures).cumcount() < number).to_numpy()
            yield Case(level=number, system=at.fit_again(at.fold.train[first]))


class Shown(View):
    noun = "captures of each class"
    heading = "Accuracy in percent by training captures of each class"
    costs = (
        Cost(
            "each_loss",
            source="loss.each",
            scale=to_percent,
            unit="points",
            noun="loss to few captures",
            phrase="lost to few captures",
            help="largest mean loss with few training captures, in points",
            shows=(),
        ),
    )


def usual(features):
    """The most frequent class, whatever is touched."""
    return make_pipeline(features, DummyClassifier())


COUNT = Command(
    "more",
    "count letters",
    "Counts the letters of a name.",
    options=(DATA, Option("least", "count", 1, "least letters")),
    module="example",
)
LOUD = Option("loud", "yes", False, "yes: say so")


def count(arguments):
    """Print how many letters a name has."""
    print(len(parse_arguments(arguments, key_options("count"))["data"]), "letters")
    return 0
