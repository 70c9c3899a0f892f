"""Designs of the skin, compared: what each costs and loses, and the choice for a new person.

The choice for a person is made on others. Each of these was tested by systems that saw neither of
the two (``protocol=pairs``), so nothing of the person decides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.values.intervals import mean_and_error, mean_interval, within_one_standard_error
from bench.values.measures import Cost, all_costs
from bench.values.pareto import front_corners, is_on_front
from bench.values.result import Result
from bench.values.scores import label_captures

RECORDED = "as recorded"
HOW = ("curve", "sampling")  # options that only say how others do it


def format_design(options: Mapping[str, object]) -> str:
    """A design in words: its changed options, or that it is the recorded one."""
    return ", ".join(f"{name}={value}" for name, value in options.items()) or RECORDED


def changed_property(options: Mapping[str, object]) -> str:
    """The only property that a design changes; "" if it changes several, or none."""
    names = [name for name in options if name not in HOW] or [*options]
    return names[0] if len(names) == 1 else ""


def pair_accuracies(result: Result, people: Sequence[str]) -> np.ndarray:
    """Accuracy on each person in percent by who else was left out: [left out, tested].

    Args:
        result: a run of ``protocol=pairs``; persons that are no pair of it are NaN.
        people: their names.
    """
    labelled = label_captures(result.tables["predictions"]).astype({"subject": str})
    is_right = labelled["true"].astype(str) == labelled["predicted"].astype(str)
    shares = is_right.groupby([labelled["fold"], labelled["subject"]], observed=True).mean()
    accuracies = np.full((len(people), len(people)), np.nan)
    for _, pair in shares.groupby(level=0):
        one, other = (people.index(name) for name in pair.index.get_level_values(1))
        accuracies[[other, one], [one, other]] = 100 * pair
    return accuracies


def best_half(accuracy: np.ndarray, burden: np.ndarray) -> np.ndarray:
    """The better half of points, front after front: bool [points]. The first always stays."""
    is_kept = np.arange(len(accuracy)) == 0
    while 2 * is_kept.sum() < len(accuracy):
        rest = np.flatnonzero(~is_kept)
        is_kept[rest[is_on_front(accuracy[rest], burden[rest])]] = True
    return is_kept


def cheapest_design(accuracy: np.ndarray, burden: np.ndarray) -> int:
    """The cheapest design within one standard error of the first, the most accurate of several.

    Args:
        accuracy: [designs, people].
        burden: [designs]; less is better.
    """
    mean = accuracy.mean(axis=1)
    fits = np.flatnonzero(within_one_standard_error(accuracy[0] - accuracy))
    return int(fits[np.lexsort((-mean[fits], burden[fits]))[0]])


@dataclass(frozen=True)
class Designs:
    """Designs of the skin that one system was trained on and tested with; the first is recorded.

    Attributes:
        options: changed options of each design.
        results: run of each design that leaves one person out.
        cost: what is to be low.
        amounts: its amount for each design.
        choices: place of the design chosen for each person on others.
    """

    options: Sequence[Mapping[str, object]]
    results: Sequence[Result]
    cost: Cost
    amounts: np.ndarray
    choices: np.ndarray

    @property
    def accuracy(self) -> np.ndarray:
        """Accuracy in percent [designs, people]."""
        return np.array([[*r.accuracy_by_subject.values()] for r in self.results])

    @property
    def chosen(self) -> int:
        """The cheapest within one standard error of the recorded one, chosen on all people."""
        return cheapest_design(self.accuracy, self.burden)

    @property
    def burden(self) -> np.ndarray:
        """Amounts of the cost, less is better [designs]."""
        return self.cost.as_burden(self.amounts)

    @property
    def front(self) -> np.ndarray:
        """Places of the designs on the Pareto front, the cheapest first."""
        return front_corners(self.accuracy.mean(axis=1), self.burden)

    def row(self, i: int, property_name: str = "") -> dict[str, Any]:
        """Numbers of a design: accuracy with its interval, and points against the recorded one."""
        accuracy = self.accuracy
        low, high = np.clip(mean_interval(accuracy[i]), 0, 100)
        points, error = mean_and_error(accuracy[i] - accuracy[0])
        numbers = {"mean": accuracy[i].mean(), "mean_low": low, "mean_high": high}
        words = {"design": format_design(self.options[i]), "property": property_name}
        return {**self.results[i], **words, **numbers, "points": points, "error": error}

    def single_changes(self) -> dict[str, list[int]]:
        """Places of the designs that change one property alone, by property, the finest first."""
        places: dict[str, list[int]] = {}
        bits = [all_costs()["bits_per_s"].value_of_row(result) for result in self.results]
        for i in np.argsort(-np.array(bits, float), kind="stable").tolist():
            if name := changed_property(self.options[i]):
                places.setdefault(name, []).append(i)
        return places

    def same_at_full(self, i: int) -> int:
        """Place of the design with the curve and sampling of another alone; 0 without one."""
        how = {name: value for name, value in self.options[i].items() if name in HOW}
        return self.options.index(how) if how in self.options else 0

    def new_person(self) -> tuple[np.ndarray, np.ndarray]:
        """Accuracy on each person with the design chosen on others, and with the recorded one."""
        accuracy = self.accuracy
        return accuracy[self.choices, np.arange(accuracy.shape[1])], accuracy[0]


@dataclass(frozen=True)
class TaxelOrder:
    """The order in which taxels were added or removed, chosen on some people.

    Attributes:
        people: people on whom it was chosen.
        verb: ``added`` or ``removed``.
        order: number of the step that changed each taxel, from 1; 0 if none did [rows, cols].
        wired: number of wired taxels after each step.
        accuracy: percent on each of the other people after each step [steps, people].
    """

    people: Sequence[str]
    verb: str
    order: np.ndarray
    wired: Sequence[int]
    accuracy: np.ndarray

    def lines(self) -> list[str]:
        """A map of the skin, and the accuracy after each step."""
        title = f"Taxels in the order in which they are {self.verb}, chosen on people "
        rows = ["  " + " ".join(f"{step or '.':>2}" for step in row) for row in self.order]
        steps = zip(self.wired, self.accuracy.mean(axis=1), strict=True)
        shares = ", ".join(f"{share:.1f} % ({count})" for count, share in steps)
        return [title + ", ".join(self.people), *rows, f"on the other people, by taxels: {shares}"]
