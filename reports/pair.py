"""Any two systems of one group of runs, paired over subjects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from bench import few
from bench.comparable import MARK, notes_on
from bench.errors import InputError, nearest
from bench.measures import Measure, p_value
from bench.outcomes import statistics
from bench.outcomes.frame import by_subject
from bench.result import Result
from bench.sentences import sentences

P = Measure("p", form=p_value)


@dataclass(frozen=True, repr=False)
class Compared:
    """Two systems on the same captures under the same protocol; prints as a sentence each.

    Attributes:
        system: the first one, as tables name it.
        other: the second one.
        on: data, subset and protocol, in words.
        accuracy: percent of correctly classified captures [subjects, 2], means over seeds; its columns are the two
            systems.
        difference: accuracy of the first system less that of the second, mean over subjects, in points.
        low: lower end of the 95 % t-interval of the difference over subjects; NaN for fewer than 5 subjects.
        high: upper end of it.
        p: p-value of the two-sided paired Wilcoxon test; not corrected, since it is one test. NaN for fewer than 6
            subjects.
        subjects: number of them.
        gain: subjects on whom the first system is more accurate.
        lose: subjects on whom the second system is more accurate.
    """

    system: str
    other: str
    on: str
    accuracy: pd.DataFrame
    difference: float
    low: float
    high: float
    p: float
    subjects: int
    gain: list[str]
    lose: list[str]

    def __repr__(self) -> str:
        notes = [note for name in (self.system, self.other) for note in notes_on(name, self.on.split(",")[0])]
        told = {"p": P.of({"p": self.p}), "few": few.too_few(self.subjects)}
        told["notes"] = [f"{note.rstrip('.')}." for note in dict.fromkeys(notes)]
        return "\n".join(sentences("bench.reports", "sentences", "pair", pair=self, **told))


def compared(sides: Sequence[tuple[str, Mapping[str, Sequence[Result]]]]) -> Compared:
    """Two systems on whole captures of the one group of runs that both have; of each its name and results by group."""
    groups = [_groups(name, runs) for name, runs in sides]
    both = [group for group in groups[0] if group in groups[1]]
    names = " and ".join(name for name, _ in sides)
    if not both:
        on = "; ".join(f"{name} on {', on '.join(each)}" for (name, _), each in zip(sides, groups, strict=True))
        raise InputError(f"{names} share no data, subset and protocol: {on}; run one of them where the other was run")
    if len(both) > 1:
        raise InputError(f"both have runs on {'; '.join(both)}; name one with data=, where=, target= or protocol=")
    tables = [by_subject([r for r in runs[both[0]] if _is(name, r.system)])[0] for name, runs in sides]
    (system, one), (other, two) = ((each[both[0]], t.iloc[0]) for each, t in zip(groups, tables, strict=True))
    if system == other:
        raise InputError(f"both are {system}; give two systems")
    if set(one.index) != set(two.index):
        raise InputError(f"{names} were tested on different subjects of {both[0]}; run the one that lacks some again")
    accuracy = pd.DataFrame({system: one, other: two})
    gained = (accuracy[system] - accuracy[other]).round(9)
    moved = {"gain": [*map(str, gained.index[gained > 0])], "lose": [*map(str, gained.index[gained < 0])]}
    numbers = statistics.paired(accuracy[system], accuracy[other]) | moved
    return Compared(system, other, both[0], accuracy, subjects=len(accuracy), **numbers)


def _groups(name: str, runs: Mapping[str, Sequence[Result]]) -> dict[str, str]:
    """Groups in which a system has a complete run, and its name there, with its marks."""
    groups, names = {}, set()
    for group, results in runs.items():
        systems = [*dict.fromkeys(r.system for r in results if r.complete)]
        names |= {*systems}
        if matching := [system for system in systems if _is(name, system)]:
            groups[group] = matching[0]
    if not groups:
        raise InputError(f"no complete run of {name!r} is tracked; {nearest(name, sorted(names))}")
    return groups


def _is(name: str, system: str) -> bool:
    """Whether a name means a system, with or without the marks that tables add."""
    return name in (system, system.removesuffix(f" {MARK}"), system.removesuffix(f" {MARK}").split(" (uses ")[0])
