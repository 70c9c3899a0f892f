"""Measures: every number that is tracked, printed or chosen by, with all that is known of it, once.

A `Measure` is a column of tables; a `Cost` is one by which systems are chosen. `all_costs` has all costs: those of
circumstances and studies stand in their views. Budgets, ``by=``, help, scene files, chart axes, sentences and columns
read them. Nothing heavy is imported, so that help comes at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

from bench.errors import InputError
from bench.ground.registry import views_of_circumstances, views_of_runs
from bench.ground.typed import UNITS, parse_amount

Row = Mapping[str, Any]  # of a run or of a table: values by name; nan or None for what is unknown
UNKNOWN = "-"  # printed for an unknown value
OUTPUTS = ("terminal", "page", "latex", "csv")
TEXT, CODE = "text", "code"  # forms of what is no number
EVERY = ("captures", "studies")  # what runs are on


class Interval(NamedTuple):
    """A number with the ends of its 95 % confidence interval; without a lower end, the other is an upper limit."""

    value: float
    low: float | None
    high: float


Value = float | int | str | Interval | tuple[float | None, ...] | None  # None: unknown
Form = str | Callable[[float], str]


def to_percent(value: float) -> float:
    """A share in percent."""
    return 100 * value


def to_thousands(value: float) -> float:
    """A number in thousands: by division, as 90.064 is not 90064 * 0.001."""
    return value / 1000


@dataclass(frozen=True)
class Measure:
    """A column: a number of a run, or of a row of a table, and how it is shown."""

    key: str  # name in tables of numbers (CSV, Python)
    heading: str = ""  # heading of its column; empty for the key
    # name of the value in a row, several names, or a function of the row; empty for the key
    source: str | tuple[str, ...] | Callable[[Any], Value] = ""
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
    # unit of the shown number, where its key does not name it; one of `bench.ground.typed.UNITS` is typed with budgets
    unit: str = ""
    meaning: str = ""  # meaning of a number that runs track, in words; empty for any other

    @property
    def name(self) -> str:
        """Heading of its column."""
        return self.heading or self.key

    @property
    def source_name(self) -> str:
        """Name of the one stored value that it reads; empty where it reads several."""
        return (self.source or self.key) if isinstance(self.source, str) else ""

    @property
    def is_text(self) -> bool:
        """True for text, which is aligned left."""
        return self.form in (TEXT, CODE)

    def value_of_row(self, row: Row) -> Value:
        """Its value in a row, in the shown unit; None if it is unknown."""
        if isinstance(self.source, tuple):
            values = tuple(self._scale(row.get(name)) for name in self.source)
            return None if all(v is None for v in values) else values
        if not isinstance(self.source, str):
            return value_or_none(self.source(row))
        value = self._scale(row.get(self.source_name))
        if value is None or not self.ends:
            return value
        low, high = (self._scale(row.get(f"{self.ends}_{side}")) for side in ("low", "high"))
        return value if high is None else Interval(value, low, high)

    def format_value(self, cell: Value) -> str:
        """A value as text."""
        if cell is None:
            return UNKNOWN
        if isinstance(cell, str):
            return cell
        if isinstance(cell, Interval):
            low = "at most " if cell.low is None else f"{self._format_number(cell.low)}, "
            return f"{self._format_number(cell.value)} [{low}{self._format_number(cell.high)}]"
        if isinstance(cell, tuple):
            cell = (
                cell[:1] if all(v is None for v in cell[1:]) else cell
            )  # such as a mean without its SD
            return self.join.join(UNKNOWN if v is None else self._format_number(v) for v in cell)
        return self._format_number(cell)

    def as_text(self, row: Row) -> str:
        """Its value in a row as text."""
        return self.format_value(self.value_of_row(row))

    def _scale(self, stored: Any) -> Any:
        value = value_or_none(stored)
        return (
            value
            if value is None or isinstance(value, str) or self.scale is None
            else self.scale(value)
        )

    def _format_number(self, value: float | str) -> str:
        if isinstance(value, str):
            return value
        return format(value, self.form) if isinstance(self.form, str) else self.form(value)


@dataclass(frozen=True)
class Cost(Measure):
    """A measure by which systems are chosen, with its budget: ``max_<key>``, or ``min_<key>`` if more is better."""

    help: str = ""  # help of its budget
    better: str = "low"  # ``low`` or ``high``
    noun: str = ""  # name in a sentence; empty for the key with spaces
    phrase: str = ""  # words behind an amount of it; empty for "of" and the noun
    axis: str = ""  # label of its axis in figures; empty for the noun and the unit
    why_unknown: str = "it was not measured"  # reason why it may be unknown
    section: str = "budget"  # section of its budget in a scene file; with another key than this one, ``section.key``
    # runs that have it: those on ``captures``, of all ``studies``, or of those that it names
    measured_on: tuple[str, ...] = EVERY
    command: str = ""  # command that measures it, with its arguments; empty for any. ``{faults}`` are those that count
    # its amount [candidates] of a cost that depends on which people `bench.reading.candidates.Candidates` has
    of_people: Callable[[Any], Any] | None = None
    at_clock: str = ""  # cost to which its thousands add milliseconds at the clock of the target in MHz; empty for none

    def __post_init__(self) -> None:
        """Fill in the words that were left out."""
        noun = self.noun or self.title
        axis = f"{noun} ({self.unit})" if self.unit else noun
        for name, usual in (("noun", noun), ("phrase", f"of {noun}"), ("axis", axis)):
            object.__setattr__(self, name, getattr(self, name) or usual)  # the class is frozen

    @property
    def title(self) -> str:
        """Its name in tables and verdicts."""
        return self.key.replace("_", " ")

    @property
    def budget_key(self) -> str:
        """Key of its budget."""
        return f"{'max' if self.better == 'low' else 'min'}_{self.key}"

    @property
    def best_word(self) -> str:
        """The best amount in words."""
        return "lowest" if self.better == "low" else "highest"

    @property
    def scene_line(self) -> tuple[str, str]:
        """Section and key of its line in a scene file."""
        section, _, key = self.section.partition(".")
        return section, key or self.key

    @property
    def is_fault_loss(self) -> bool:
        """True for points lost, which are taken over the faults of the choice."""
        return self.scene_line[0] == "faults"

    @property
    def is_linear(self) -> bool:
        """True for a linear axis in figures, and a budget that may be 0."""
        return self.unit in ("%", "points")

    def parse_budget(self, given: object) -> float:
        """A typed budget; an `InputError` if it is no amount of this cost."""
        value = parse_amount(self.budget_key, given, self.unit, self.is_linear)
        if self.unit == "%" and value > 100:
            raise InputError(f"{self.budget_key}={given}: give a number from 0 to 100")
        return value

    def format_budget(self, value: float) -> str:
        """A budget as it is typed."""
        return f"{self.budget_key}={value:g}{self.unit if self.unit in UNITS else ''}"

    def as_burden(self, amount: Any) -> Any:
        """An amount, or an array of them, turned so that less is better."""
        return amount if self.better == "low" else -amount

    def format_amount(self, value: float) -> str:
        """An amount with its unit, as people read it."""
        if not abs(value) < float("inf"):
            return UNKNOWN
        return (
            f"{value:.3g} {self.unit}".rstrip()
            if value < 100
            else f"{value:.0f} {self.unit}".rstrip()
        )

    def format_two_amounts(self, one: float, other: float) -> tuple[str, str]:
        """Two amounts with enough digits to differ."""
        texts, digits = (self.format_amount(one), self.format_amount(other)), 4
        while texts[0] == texts[1] and one != other and digits < 17:
            texts = (
                f"{one:.{digits}g} {self.unit}".rstrip(),
                f"{other:.{digits}g} {self.unit}".rstrip(),
            )
            digits += 1
        return texts


def value_or_none(value: Any) -> Any:
    """A value, or None for one that is unknown: None, NaN, or a missing value of pandas."""
    try:
        return None if value is None or value != value else value
    except TypeError:  # pandas.NA is neither equal nor unequal to itself
        return None


def percent_measure(key: str, heading: str = "", source: str = "", **more: Any) -> Measure:
    """A stored share, shown in percent."""
    return Measure(key, heading, source, scale=to_percent, unit="%", **more)


def text_measure(
    key: str, heading: str = "", source: str | Callable[[Any], Value] = "", **more: Any
) -> Measure:
    """Text, aligned left."""
    return Measure(key, heading, source, TEXT, **more)


def format_p_value(value: float) -> str:
    """A p-value."""
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def format_thousands(value: float) -> str:
    """A whole number with spaces between the thousands."""
    return f"{value:,.0f}".replace(",", " ")


def format_three_digits(value: float) -> str:
    """A number with three digits that count."""
    return f"{value:.3g}" if value < 100 else format_thousands(value)


_PERSON: dict[str, Any] = {"unit": "%", "better": "high", "section": "people", "shows": ()}
_PERSON |= {"why_unknown": "a person has no score"}
OF_SYSTEMS = (  # costs of every run
    Cost(
        "flash",
        "flash kB",
        "flash_bytes",
        format_three_digits,
        to_thousands,
        unit="kB",
        axis="kB of flash (learnt and stored numbers; in C, linked code)",
        why_unknown="their size cannot be counted",
        meaning="four bytes for each learnt number, or one with `model.bits=8`",
        help="largest flash, such as 256kB or 256KiB",
        shows=OUTPUTS,
    ),
    Cost(
        "ram",
        "RAM kB",
        "ram_bytes",
        format_three_digits,
        to_thousands,
        unit="kB",
        noun="RAM",
        axis="kB of RAM during one decision",
        why_unknown="their memory cannot be counted",
        meaning="four bytes for each number in memory during one prediction",
        help="largest RAM, such as 32kB",
        shows=("page", "csv"),
    ),
    Cost(
        "predict",
        source="predict_ms_p50",
        unit="ms",
        noun="computing time",
        axis="ms to compute a label (p50, one thread)",
        why_unknown="exported C is not timed",
        help="longest computing time per label on this machine when quiet, such as 2ms",
        spare=4,
        shows=(),
    ),
)
WORST_PEOPLE = {  # key: whose accuracy it is, and how many people of some are counted
    "worst_person": ("the worst person", lambda people: 1),
    "worst_tenth": ("the worst tenth of people", lambda people: -(-people.subjects.shape[1] // 10)),
}
OF_PEOPLE = tuple(
    Cost(
        key,
        **_PERSON,
        noun=f"accuracy of {who}",
        phrase=f"correct for {who}",
        axis=f"% of captures correct for {who}",
        help=f"lowest {'mean ' * ('people' in who)}accuracy of {who}, in percent",
        of_people=lambda people, count=count: people.lowest(count(people)),
    )
    for key, (who, count) in WORST_PEOPLE.items()
)


@cache
def all_costs() -> dict[str, Cost]:
    """All costs by name: of every run, of circumstances, of people and of studies."""
    of_circumstances, of_runs = (
        [cost for view in each for cost in view.costs]
        for each in (views_of_circumstances(), views_of_runs().values())
    )
    every: dict[str, Cost] = {}
    for cost in (*OF_SYSTEMS, *of_circumstances, *OF_PEOPLE, *of_runs):
        if cost.key in every or cost.scene_line in {other.scene_line for other in every.values()}:
            raise InputError(
                f"two costs have the key {cost.key} or its line in scenes; remove the package of one"
            )
        every[cost.key] = cost
    return every


def costs_of_study(study: str) -> dict[str, Cost]:
    """The costs of the runs of a study, or of those on captures."""
    named = {study, "studies"} if study else {"captures"}
    return {k: c for k, c in all_costs().items() if named & {*c.measured_on}}


def costs_by_budget() -> dict[str, Cost]:
    """Costs by the key of their budget."""
    return {cost.budget_key: cost for cost in all_costs().values()}
