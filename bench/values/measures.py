"""Measures: every number that is tracked, printed or chosen by, with all that is known of it, once.

A `Measure` is a column of tables; a `Cost` is one by which systems are chosen. `costs` has all costs: those of
circumstances and studies stand in their views. Budgets, ``by=``, help, scene files, chart axes, sentences and columns
read them. Nothing heavy is imported, so that help comes at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

from bench.errors import InputError
from bench.ground.registry import circumstance_views, run_views
from bench.ground.words import UNITS, quantity

Row = Mapping[str, Any]  # of a run or of a table: values by name; nan or None for what is unknown
NONE = "-"  # printed for an unknown value
OUTPUTS = ("terminal", "page", "latex", "csv")
TEXT, CODE = "text", "code"  # forms of what is no number
EVERY = ("captures", "studies")  # what runs are on


class Interval(NamedTuple):
    """A number with the ends of its 95 % confidence interval; without a lower end, the other is an upper limit."""

    value: float
    low: float | None
    high: float


Cell = float | int | str | Interval | tuple[float | None, ...] | None  # None: unknown
Form = str | Callable[[float], str]


def in_percent(value: float) -> float:
    """A share in percent."""
    return 100 * value


def in_thousands(value: float) -> float:
    """A number in thousands: by division, as 90.064 is not 90064 * 0.001."""
    return value / 1000


@dataclass(frozen=True)
class Measure:
    """A column: a number of a run, or of a row of a table, and how it is shown."""

    key: str  # name in tables of numbers (CSV, Python)
    heading: str = ""  # heading of its column; empty for the key
    # name of the value in a row, several names, or a function of the row; empty for the key
    read: str | tuple[str, ...] | Callable[[Any], Cell] = ""
    # format of a number, a function that writes it, or ``text`` or ``code`` (a command), which stand left
    form: Form = ".1f"
    scale: Callable[[float], float] | None = None  # turns the stored into the shown number
    ends: str = ""  # beginning of the names ``<ends>_low`` and ``<ends>_high`` of its interval; empty without one
    join: str = " / "  # text between several numbers
    # 0 for a column that every table shows; else a narrow terminal leaves out the highest first, and a column without
    # any value is not shown
    spare: int = 0
    shows: tuple[str, ...] = (
        "terminal",
        "page",
    )  # outputs that have this column: terminal, page, latex, csv
    # unit of the shown number, where its key does not name it; one of `bench.ground.words.UNITS` is typed with budgets
    unit: str = ""
    meaning: str = ""  # meaning of a number that runs track, in words; empty for any other

    @property
    def name(self) -> str:
        """Heading of its column."""
        return self.heading or self.key

    @property
    def source(self) -> str:
        """Name of the one stored value that it reads; empty where it reads several."""
        return (self.read or self.key) if isinstance(self.read, str) else ""

    @property
    def left(self) -> bool:
        """True for text, which is aligned left."""
        return self.form in (TEXT, CODE)

    def cell(self, row: Row) -> Cell:
        """Its value in a row, in the shown unit; None if it is unknown."""
        if isinstance(self.read, tuple):
            values = tuple(self._shown(row.get(name)) for name in self.read)
            return None if all(v is None for v in values) else values
        if not isinstance(self.read, str):
            return known(self.read(row))
        value = self._shown(row.get(self.source))
        if value is None or not self.ends:
            return value
        low, high = (self._shown(row.get(f"{self.ends}_{side}")) for side in ("low", "high"))
        return value if high is None else Interval(value, low, high)

    def text(self, cell: Cell) -> str:
        """A value as text."""
        if cell is None:
            return NONE
        if isinstance(cell, str):
            return cell
        if isinstance(cell, Interval):
            low = "at most " if cell.low is None else f"{self._number(cell.low)}, "
            return f"{self._number(cell.value)} [{low}{self._number(cell.high)}]"
        if isinstance(cell, tuple):
            cell = (
                cell[:1] if all(v is None for v in cell[1:]) else cell
            )  # such as a mean without its SD
            return self.join.join(NONE if v is None else self._number(v) for v in cell)
        return self._number(cell)

    def of(self, row: Row) -> str:
        """Its value in a row as text."""
        return self.text(self.cell(row))

    def _shown(self, stored: Any) -> Any:
        value = known(stored)
        return (
            value
            if value is None or isinstance(value, str) or self.scale is None
            else self.scale(value)
        )

    def _number(self, value: float | str) -> str:
        if isinstance(value, str):
            return value
        return format(value, self.form) if isinstance(self.form, str) else self.form(value)


@dataclass(frozen=True)
class Cost(Measure):
    """A measure by which systems are chosen, with its budget: ``max_<key>``, or ``min_<key>`` if more is better."""

    help: str = ""  # help of its budget
    better: str = "low"  # ``low`` or ``high``
    noun: str = ""  # name in a sentence; empty for the key with spaces
    words: str = ""  # words behind an amount of it; empty for "of" and the noun
    axis: str = ""  # label of its axis in figures; empty for the noun and the unit
    unknown: str = "it was not measured"  # reason why it may be unknown
    section: str = "budget"  # section of its budget in a scene file; with another key than this one, ``section.key``
    # runs that have it: those on ``captures``, of all ``studies``, or of those that it names
    on: tuple[str, ...] = EVERY
    command: str = ""  # command that measures it, with its arguments; empty for any. ``{faults}`` are those that count
    # its amount [candidates] of a cost that depends on which people `bench.reading.candidates.Candidates` has
    among: Callable[[Any], Any] | None = None
    at_clock: str = ""  # cost to which its thousands add milliseconds at the clock of the target in MHz; empty for none

    def __post_init__(self) -> None:
        """Fill in the words that were left out."""
        noun = self.noun or self.title
        axis = f"{noun} ({self.unit})" if self.unit else noun
        for name, usual in (("noun", noun), ("words", f"of {noun}"), ("axis", axis)):
            object.__setattr__(self, name, getattr(self, name) or usual)  # the class is frozen

    @property
    def title(self) -> str:
        """Its name in tables and verdicts."""
        return self.key.replace("_", " ")

    @property
    def budget(self) -> str:
        """Key of its budget."""
        return f"{'max' if self.better == 'low' else 'min'}_{self.key}"

    @property
    def extreme(self) -> str:
        """The best amount in words."""
        return "lowest" if self.better == "low" else "highest"

    @property
    def line(self) -> tuple[str, str]:
        """Section and key of its line in a scene file."""
        section, _, key = self.section.partition(".")
        return section, key or self.key

    @property
    def losses(self) -> bool:
        """True for points lost, which are taken over the faults of the choice."""
        return self.line[0] == "faults"

    @property
    def linear(self) -> bool:
        """True for a linear axis in figures, and a budget that may be 0."""
        return self.unit in ("%", "points")

    def typed(self, given: object) -> float:
        """A typed budget; an `InputError` if it is no amount of this cost."""
        value = quantity(self.budget, given, self.unit, self.linear)
        if self.unit == "%" and value > 100:
            raise InputError(f"{self.budget}={given}: give a number from 0 to 100")
        return value

    def argument(self, value: float) -> str:
        """A budget as it is typed."""
        return f"{self.budget}={value:g}{self.unit if self.unit in UNITS else ''}"

    def burden(self, amount: Any) -> Any:
        """An amount, or an array of them, turned so that less is better."""
        return amount if self.better == "low" else -amount

    def amount(self, value: float) -> str:
        """An amount with its unit, as people read it."""
        if not abs(value) < float("inf"):
            return NONE
        return (
            f"{value:.3g} {self.unit}".rstrip()
            if value < 100
            else f"{value:.0f} {self.unit}".rstrip()
        )

    def apart(self, one: float, other: float) -> tuple[str, str]:
        """Two amounts with enough digits to differ."""
        texts, digits = (self.amount(one), self.amount(other)), 4
        while texts[0] == texts[1] and one != other and digits < 17:
            texts = (
                f"{one:.{digits}g} {self.unit}".rstrip(),
                f"{other:.{digits}g} {self.unit}".rstrip(),
            )
            digits += 1
        return texts


def known(value: Any) -> Any:
    """A value, or None for one that is unknown: None, NaN, or a missing value of pandas."""
    try:
        return None if value is None or value != value else value
    except TypeError:  # pandas.NA is neither equal nor unequal to itself
        return None


def percent(key: str, heading: str = "", read: str = "", **more: Any) -> Measure:
    """A stored share, shown in percent."""
    return Measure(key, heading, read, scale=in_percent, unit="%", **more)


def text(
    key: str, heading: str = "", read: str | Callable[[Any], Cell] = "", **more: Any
) -> Measure:
    """Text, aligned left."""
    return Measure(key, heading, read, TEXT, **more)


def p_value(value: float) -> str:
    """A p-value."""
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def whole(value: float) -> str:
    """A whole number with spaces between the thousands."""
    return f"{value:,.0f}".replace(",", " ")


def three(value: float) -> str:
    """A number with three digits that count."""
    return f"{value:.3g}" if value < 100 else whole(value)


_PERSON: dict[str, Any] = {"unit": "%", "better": "high", "section": "people", "shows": ()}
_PERSON |= {"unknown": "a person has no score"}
OF_SYSTEMS = (  # costs of every run
    Cost(
        "flash",
        "flash kB",
        "flash_bytes",
        three,
        in_thousands,
        unit="kB",
        axis="kB of flash (learnt and stored numbers; in C, linked code)",
        unknown="their size cannot be counted",
        meaning="four bytes for each learnt number, or one with `model.bits=8`",
        help="largest flash, such as 256kB or 256KiB",
        shows=OUTPUTS,
    ),
    Cost(
        "ram",
        "RAM kB",
        "ram_bytes",
        three,
        in_thousands,
        unit="kB",
        noun="RAM",
        axis="kB of RAM during one decision",
        unknown="their memory cannot be counted",
        meaning="four bytes for each number in memory during one prediction",
        help="largest RAM, such as 32kB",
        shows=("page", "csv"),
    ),
    Cost(
        "predict",
        read="predict_ms_p50",
        unit="ms",
        noun="computing time",
        axis="ms to compute a label (p50, one thread)",
        unknown="exported C is not timed",
        help="longest computing time per label on this machine when quiet, such as 2ms",
        spare=4,
        shows=(),
    ),
)
PEOPLE = {  # key: whose accuracy it is, and how many people of some are counted
    "worst_person": ("the worst person", lambda people: 1),
    "worst_tenth": ("the worst tenth of people", lambda people: -(-people.subjects.shape[1] // 10)),
}
OF_PEOPLE = tuple(
    Cost(
        key,
        **_PERSON,
        noun=f"accuracy of {who}",
        words=f"correct for {who}",
        axis=f"% of captures correct for {who}",
        help=f"lowest {'mean ' * ('people' in who)}accuracy of {who}, in percent",
        among=lambda people, count=count: people.lowest(count(people)),
    )
    for key, (who, count) in PEOPLE.items()
)


@cache
def costs() -> dict[str, Cost]:
    """All costs by name: of every run, of circumstances, of people and of studies."""
    of_circumstances, of_runs = (
        [cost for view in each for cost in view.costs]
        for each in (circumstance_views(), run_views().values())
    )
    every: dict[str, Cost] = {}
    for cost in (*OF_SYSTEMS, *of_circumstances, *OF_PEOPLE, *of_runs):
        if cost.key in every or cost.line in {other.line for other in every.values()}:
            raise InputError(
                f"two costs have the key {cost.key} or its line in scenes; remove the package of one"
            )
        every[cost.key] = cost
    return every


def costs_of(study: str) -> dict[str, Cost]:
    """The costs of the runs of a study, or of those on captures."""
    named = {study, "studies"} if study else {"captures"}
    return {k: c for k, c in costs().items() if named & {*c.on}}


def budgets() -> dict[str, Cost]:
    """Costs by the key of their budget."""
    return {cost.budget: cost for cost in costs().values()}
