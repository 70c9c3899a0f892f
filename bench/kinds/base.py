"""A kind of run, producer and consumer in one: its options, its fold, and how its results are shown and chosen by.

Members that are named in ``consumers`` read what is stored, or warn. They are no part of a run's identity, so a changed
caption keeps all stored runs. Nothing heavy is imported at the top of this file or of a kind's.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from bench.amounts import text_of
from bench.arguments import value_of
from bench.errors import InputError
from bench.measures import Cost, Measure
from bench.options import Command, Option
from bench.result import Result
from bench.table import Table
from bench.words import Values, items
from bench.work.experiment import Experiment

if TYPE_CHECKING:
    import pandas as pd

    from bench.candidate import Candidate, Wish
    from bench.plan.cells import Cell
    from bench.reports.part import Section

CONSUMERS = frozenset(
    {
        "commands",
        "heading",
        "ranked",
        "searches",
        "shown",
        "costs",
        "sheets",
        "seen",
        "_learned",
        "alike",
        "noun",
        "shows",
        "printed",
        "write",
        "figure",
        "section",
        "brief",
        "candidates",
        "lends",
        "lost",
        "then",
        "title",
        "words_of",
        "holds",
        "score",
        "unit",
        "recordings",
        "made_by",
        "views",
        "warnings",
        "unseen",
        "held",
        "tracked",
        "offers",
        "gestures",
        "other",
        "meaning",
        "chosen",
        "_without",
        "consumers",
        "chooses",
    }
)


def option(default: Any, help: str, values: tuple[str, ...] = (), type: str = "text", alias: str = "") -> Any:
    """A field that is an option: a key of the command with its only default.

    A tuple takes all values between commas; of any other, several values are several runs.

    Args:
        default: value without the key.
        help: text of the help.
        values: allowed values, if they can be listed.
        type: one of `bench.options.Option`.
        alias: its key in the commands that spell it otherwise.
    """
    return dataclasses.field(
        default=default, metadata={"option": Option("", "", type, default, help, values), "alias": alias}
    )


@dataclass(frozen=True)
class Spelling:
    """A command that makes runs.

    Attributes:
        command: its help.
        keys: its options, besides those of ``bench run``.
        given: options that it gives where they are not typed.
        out: folder of ``out=``, with its help; empty if the command writes nothing.
    """

    command: Command
    keys: tuple[str, ...] = ()
    given: Mapping[str, str] = dataclasses.field(default_factory=dict)
    out: tuple[str, str] = ("", "")


class Shown:
    """How results are shown and chosen by: the consumer side of a kind of run, and of a circumstance.

    Attributes:
        heading: heading of the table of results.
        shown: columns of that table, after system, data, subset and protocol.
        ranked: True if the most accurate result of several is marked in it.
        searches: True if what a search has chosen in each fold is printed.
        score: number by which results are ranked.
        costs: costs by which systems are chosen, besides those of every run.
        alike: parameters that two results share if they may be compared: words with ``{}`` for the value, and the
            usual value, which needs no words.
    """

    consumers: ClassVar[frozenset[str]] = CONSUMERS
    commands: ClassVar[Mapping[str, Spelling]] = {}
    heading: ClassVar[str] = ""
    shown: ClassVar[tuple[Measure, ...]] = ()
    ranked: ClassVar[bool] = False
    searches: ClassVar[bool] = False
    score: ClassVar[str] = "accuracy"
    costs: ClassVar[tuple[Cost, ...]] = ()
    alike: ClassVar[Mapping[str, tuple[str, str]]] = {}

    @classmethod
    def shows(cls, results: Sequence[Result]) -> Sequence[Measure]:
        """Columns of the table of some results, after system, data, subset and protocol."""
        return cls.shown

    @classmethod
    def title(cls, results: Sequence[Result]) -> str:
        """Heading of the table of some results."""
        return cls.heading

    @classmethod
    def printed(cls, results: Sequence[Result]) -> Iterator[str | Table]:
        """What a command prints behind the table of its results."""
        return iter(())

    @classmethod
    def write(cls, results: Sequence[Result], folder: Path) -> list[str]:
        """Write tables and figures of scored results into the folder of ``out=``; lines that say so.

        Raises:
            InputError: the folder cannot be written.
        """
        return []

    @classmethod
    def then(cls, results: Sequence[Result]) -> str:
        """The next command to type."""
        return "bench report"

    @classmethod
    def section(cls, results: Sequence[Result], folder: Path) -> Section | None:
        """Section of the page; figures are written into a folder."""
        return None

    @classmethod
    def brief(cls, results: Sequence[Result]) -> tuple[str, str] | None:
        """Topic and sentence for the main results of the page."""
        return None

    @classmethod
    def sheets(cls, results: Sequence[Result]) -> dict[str, pd.DataFrame]:
        """CSV files of the report, by name."""
        return {}

    @classmethod
    def candidates(cls, result: Result, wish: Wish) -> Iterable[Candidate]:
        """The ways in which a run labels, for a choice."""
        return ()

    @classmethod
    def offers(cls, result: Result, wish: Wish) -> bool:
        """Whether a run has a candidate."""
        return True

    @classmethod
    def lends(cls, result: Result) -> dict[str, float]:
        """Numbers that hold for the system in other runs, too."""
        return {}


@dataclass(frozen=True)
class Options:
    """Fields made by `option`, which are read from typed values."""

    @classmethod
    def fields(cls) -> dict[str, tuple[Option, str]]:
        """Each option by its key, with its alias."""
        made = {f.name: f for f in dataclasses.fields(cls) if "option" in f.metadata}
        return {
            name: (dataclasses.replace(f.metadata["option"], key=name), f.metadata["alias"]) for name, f in made.items()
        }

    @classmethod
    def of(cls, values: Values) -> list[Self]:
        """Every combination of the typed values.

        Raises:
            InputError: a value cannot be used.
        """
        choices: dict[str, list] = {}
        for name, (one, alias) in cls.fields().items():
            if key := next((k for k in (name, alias) if k in values), ""):
                given = [read(dataclasses.replace(one, key=key), each) for each in items(key, values[key])]
                choices[name] = (
                    [tuple(dict.fromkeys(given))] if isinstance(one.default, tuple) else list(dict.fromkeys(given))
                )
        return [cls(**dict(zip(choices, each, strict=True))) for each in itertools.product(*choices.values())]

    def changed(self) -> dict[str, str]:
        """The options as typed; defaults are left out."""
        given = {name: getattr(self, name) for name in self.fields()}
        usual = {name: one.default for name, (one, _) in self.fields().items()}
        return {name: typed_as(value) for name, value in given.items() if value != usual[name]}


def read(one: Option, value: object) -> Any:
    """A typed value of an option.

    Raises:
        InputError: it is no such value.
    """
    if one.type == "counts":
        number = value_of(dataclasses.replace(one, type="count", default=4), value)
        if number < 1:
            raise InputError(f"{one.key}={number}: give whole numbers of at least 1")
        return number
    if isinstance(one.default, tuple):
        one = dataclasses.replace(one, default=next(iter(one.default), False if one.type == "yes" else ""))
    return value_of(one, value)


def typed_as(value: object) -> str:
    """A value as it is typed."""
    if isinstance(value, tuple):
        return ",".join(map(typed_as, value))
    return text_of(value).removesuffix(".0") if isinstance(value, float) else text_of(value)


@dataclass(frozen=True)
class Kind(Experiment, Options, Shown):
    """A kind of run; a new one is one file and an entry in `bench.kinds`, or an entry point ``touchbench.kinds``."""

    other: ClassVar[str] = ""
    meaning: ClassVar[str] = ""  # of the score, in a sentence
    unit: ClassVar[str] = ""
    recordings: ClassVar[bool] = False

    @classmethod
    def holds(cls, result: Result) -> bool:
        """Whether a run has labels of its captures as they are, or of its recordings."""
        return result.kind == cls.tag

    @classmethod
    def tracked(cls) -> tuple[str, ...]:
        """Names of its options as parameters of a run."""
        return tuple(f"{cls.tag}.{name}" for name in cls.fields())

    @classmethod
    def made_by(cls) -> dict[str, tuple[type[Kind], type[Shown], Spelling]]:
        """The commands that make runs of this kind: the kind, the class that shows them, and their options."""
        return {name: (cls, cls, spelling) for name, spelling in cls.commands.items()}

    @classmethod
    def chosen(cls, row: Mapping[str, Any]) -> str:
        """What to say of a chosen candidate, by its costs."""
        return ""

    @classmethod
    def gestures(cls, result: Result) -> tuple[str, ...]:
        """All gestures of the captures or recordings of a run."""
        raise NotImplementedError

    @classmethod
    def unseen(cls, results: Sequence[Result]) -> list[tuple[type[Shown], list[Result]]]:
        """Classes that only the page shows, and which results each shows."""
        return []

    @classmethod
    def views(cls, results: Sequence[Result]) -> list[tuple[type[Shown], list[Result]]]:
        """The classes that show results, and which each shows."""
        return [(cls, [*results])]

    @classmethod
    def ready(cls, cells: list[Cell]) -> list[Cell]:
        """The cells as this kind takes them.

        Raises:
            InputError: one cannot be used.
        """
        return cells

    def options(self) -> dict[str, object]:
        """Tracked as parameters: the fields under ``<tag>.``."""
        return {f"{self.tag}.{name}": getattr(self, name) for name in self.fields()}

    def arguments(self) -> dict[str, str]:
        """The options as typed; defaults are left out."""
        return self.changed()

    def command(self, cell: Cell) -> str:
        """The command that makes a run of a cell."""
        return next(iter(self.commands))
