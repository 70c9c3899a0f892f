"""Measures: each number that is tracked, printed or chosen by, described once.

A `Measure` is a column of tables. A `Cost` is a measure by which systems are chosen: budgets,
``by=``, help, scene files, chart axes, sentences and columns read it. `all_costs` also has those
that views of circumstances declare. Nothing heavy is imported, so that help comes at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

from bench.errors import InputError
from bench.ground.registry import views_of_circumstances, views_of_runs
from bench.ground.typed import UNITS, parse_amount
from bench.values.result import Row as Row

UNKNOWN = "-"  # printed for an unknown value
OUTPUTS = ("terminal", "page", "latex", "csv")
TEXT, CODE = "text", "code"  # forms of values that are no numbers
EVERY = ("captures", "studies")  # all kinds of run


class Interval(NamedTuple):
    """A number with its 95 % confidence interval; ``low`` is None if ``high`` is an upper limit."""

    value: float
    low: float | None
    high: float


Value = float | int | str | Interval | tuple[float | None, ...] | None  # None: unknown
Form = str | Callable[[float], str]


def to_percent(value: float) -> float:
    """Convert a share to percent."""
    return 100 * value


def to_thousands(value: float) -> float:
    """Convert to thousands, by division, as 90.064 is not 90064 * 0.001."""
    return value / 1000


@dataclass(frozen=True)
class Measure:
    """A column of a table: a value of each run, and its format."""

    key: str  # name in tables of numbers (CSV, Python)
    heading: str = ""  # heading of its column; empty for the key
    # name of the value in a row, several names, or a function of the row; empty for the key
    source: str | tuple[str, ...] | Callable[[Any], Value] = ""
    # format of a number, a function that formats it, or ``text`` or ``code`` (a command)
    form: Form = ".1f"
    scale: Callable[[float], float] | None = None  # turns the stored into the shown number
    ends: str = ""  # its interval is ``<ends>_low`` and ``<ends>_high``; empty without one
    join: str = " / "  # text between several numbers
    # 0: every table shows it; else a narrow terminal leaves out the highest first, and a column
    # without any value is not shown
    spare: int = 0
    shows: tuple[str, ...] = ("terminal", "page")  # its outputs, some of `OUTPUTS`
    # unit of the shown number, if its key does not name it; one of `bench.ground.typed.UNITS` is
    # typed with budgets
    unit: str = ""
    meaning: str = ""  # of a number that runs track; empty for any other

    @property
    def name(self) -> str:
        """Heading of its column."""
        return self.heading or self.key

    @property
    def source_name(self) -> str:
        """Name of the stored value that it reads; empty if it reads several or none."""
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

    def value_as_text(self, value: Value) -> str:
        """Format a value."""
        if isinstance(value, Interval):
            low = "at most " if value.low is None else f"{self._format_number(value.low)}, "
            return f"{self._format_number(value.value)} [{low}{self._format_number(value.high)}]"
        if isinstance(value, tuple):
            if all(number is None for number in value[1:]):  # such as a mean without its SD
                value = value[:1]
            return self.join.join(map(self._format_number, value))
        return self._format_number(value)

    def as_text(self, row: Row) -> str:
        """Format its value in a row."""
        return self.value_as_text(self.value_of_row(row))

    def _scale(self, stored: Any) -> Any:
        value = value_or_none(stored)
        if value is None or isinstance(value, str) or self.scale is None:
            return value
        return self.scale(value)

    def _format_number(self, value: float | str | None) -> str:
        if value is None:
            return UNKNOWN
        if isinstance(value, str):
            return value
        return format(value, self.form) if isinstance(self.form, str) else self.form(value)


@dataclass(frozen=True)
class Cost(Measure):
    """A measure by which systems are chosen; its budget is ``max_<key>``, or ``min_<key>``."""

    help: str = ""  # of its budget
    better: str = "low"  # ``low`` or ``high``
    noun: str = ""  # name in a sentence; empty for the key with spaces
    phrase: str = ""  # words behind an amount; empty for "of" and the noun
    axis: str = ""  # label of its axis in figures; empty for the noun and the unit
    why_unknown: str = "it was not measured"
    section: str = "budget"  # of its line in a scene file; ``section.key`` for another key there
    # runs that have it: those on ``captures``, those of all other kinds (``studies``), or the named
    measured_on: tuple[str, ...] = EVERY
    # command that measures it, with its arguments; empty for any; ``{faults}``: those that count
    command: str = ""
    # from `bench.reading.candidates.Candidates` to amounts [candidates], of a cost of its people
    of_people: Callable[[Any], Any] | None = None
    # cost to which its thousands add milliseconds, by the clock of the target in MHz
    at_clock: str = ""

    def __post_init__(self) -> None:
        """Fill in the words that were left out."""
        noun = self.noun or self.title
        axis = f"{noun} ({self.unit})" if self.unit else noun
        for name, usual in (("noun", noun), ("phrase", f"of {noun}"), ("axis", axis)):
            object.__setattr__(self, name, getattr(self, name) or usual)  # the class is frozen

    @property
    def title(self) -> str:
        """Name in tables and verdicts."""
        return self.key.replace("_", " ")

    @property
    def budget_key(self) -> str:
        """Key of its budget."""
        return f"{'max' if self.better == 'low' else 'min'}_{self.key}"

    @property
    def best_word(self) -> str:
        """Adjective of the best amount."""
        return "lowest" if self.better == "low" else "highest"

    @property
    def scene_line(self) -> tuple[str, str]:
        """Section and key of its line in a scene file."""
        section, _, key = self.section.partition(".")
        return section, key or self.key

    @property
    def is_fault_loss(self) -> bool:
        """True for points lost under faults, which a choice selects."""
        return self.scene_line[0] == "faults"

    @property
    def is_linear(self) -> bool:
        """True if its axis in figures is linear and its budget may be 0."""
        return self.unit in ("%", "points")

    def parse_budget(self, value: object) -> float:
        """Read a typed budget; an `InputError` if it is no amount of this cost."""
        budget = parse_amount(self.budget_key, value, self.unit, self.is_linear)
        if self.unit == "%" and budget > 100:
            raise InputError(f"{self.budget_key}={value}: give a number from 0 to 100")
        return budget

    def format_budget(self, value: float) -> str:
        """Write a budget as it is typed."""
        return f"{self.budget_key}={value:g}{self.unit if self.unit in UNITS else ''}"

    def as_burden(self, amount: Any) -> Any:
        """Turn an amount, or an array of them, so that less is better."""
        return amount if self.better == "low" else -amount

    def format_amount(self, value: float) -> str:
        """Write an amount with its unit for people."""
        if not abs(value) < float("inf"):
            return UNKNOWN
        number = f"{value:.3g}" if value < 100 else f"{value:.0f}"
        return f"{number} {self.unit}".rstrip()

    def format_two_amounts(self, one: float, other: float) -> tuple[str, str]:
        """Write two amounts with enough digits to differ."""
        first, second, digits = self.format_amount(one), self.format_amount(other), 4
        while first == second and one != other and digits < 17:
            first = f"{one:.{digits}g} {self.unit}".rstrip()
            second = f"{other:.{digits}g} {self.unit}".rstrip()
            digits += 1
        return first, second


def value_or_none(value: Any) -> Any:
    """Replace an unknown value, such as NaN or a missing value of pandas, by None."""
    try:
        return None if value is None or value != value else value
    except TypeError:  # pandas.NA is neither equal nor unequal to itself
        return None


def percent_measure(key: str, heading: str = "", source: str = "", **more: Any) -> Measure:
    """A measure of a stored share, shown in percent."""
    return Measure(key, heading, source, scale=to_percent, unit="%", **more)


def text_measure(
    key: str, heading: str = "", source: str | Callable[[Any], Value] = "", **more: Any
) -> Measure:
    """A measure of text, aligned left."""
    return Measure(key, heading, source, TEXT, **more)


def format_p_value(value: float) -> str:
    """Write a p-value."""
    return "< 0.001" if value < 0.001 else f"{value:.3f}"


def format_thousands(value: float) -> str:
    """Write a whole number with spaces between the thousands."""
    return f"{value:,.0f}".replace(",", " ")


def format_three_digits(value: float) -> str:
    """Write a number with three significant digits."""
    return f"{value:.3g}" if value < 100 else format_thousands(value)


_PERSON: dict[str, Any] = {"unit": "%", "better": "high", "section": "people", "shows": ()}
_PERSON |= {"why_unknown": "a person has no score"}
_SKIN: dict[str, Any] = {"form": format_three_digits, "section": "skin", "shows": ("csv",)}


def processor_ms_per_s(row: Row) -> float | None:
    """Milliseconds that labels of captures take per second of touch; None if they are unknown."""
    numbers = (value_or_none(row.get(name)) for name in ("predict_ms_p50", "capture_ms"))
    predict_ms, capture_ms = numbers
    return 1000 * predict_ms / capture_ms if predict_ms is not None and capture_ms else None


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
    Cost(
        "taxels",
        **_SKIN,
        phrase="taxels",
        meaning="wired taxels of the skin",
        help="most taxels",
    ),
    Cost(
        "wires",
        **_SKIN,
        phrase="wires",
        meaning="the fewer of rows and columns of a matrix, and a wire per taxel and one for all",
        help="most wires to the taxels",
    ),
    Cost(
        "values_per_s",
        **_SKIN,
        noun="values per second",
        phrase="values per second",
        meaning="taxels times frames per second",
        help="most values per second from the skin",
    ),
    Cost(
        "bits_per_s",
        **_SKIN,
        noun="bits per second",
        phrase="bits per second",
        meaning="values per second times bits of the converter; 16 bits for decimals",
        help="most bits per second from the skin",
    ),
    Cost(
        "frame",
        source="frame_bytes",
        scale=to_thousands,
        **_SKIN,
        unit="kB",
        noun="RAM of a frame",
        meaning="one or two bytes for each taxel, by the bits of the converter",
        help="largest RAM of a frame, such as 32B",
    ),
    Cost(
        "processor",
        source=processor_ms_per_s,
        **_SKIN | {"shows": ()},
        unit="ms",
        noun="processor time per second of touch",
        why_unknown="exported C is not timed",
        help="longest processor time per second of touch on this machine when quiet, such as 5ms",
    ),
)
WORST_PEOPLE = {  # key: whose accuracy it is, and how many people they are
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
        of_people=lambda people, count=count: people.mean_of_lowest(count(people)),
    )
    for key, (who, count) in WORST_PEOPLE.items()
)


@cache
def all_costs() -> dict[str, Cost]:
    """All costs by key: of every run, of circumstances, of people and of other kinds of run."""
    of_circumstances = [cost for view in views_of_circumstances() for cost in view.costs]
    of_runs = [cost for view in views_of_runs().values() for cost in view.costs]
    costs: dict[str, Cost] = {}
    for cost in (*OF_SYSTEMS, *of_circumstances, *OF_PEOPLE, *of_runs):
        if cost.key in costs or cost.scene_line in {c.scene_line for c in costs.values()}:
            raise InputError(
                f"two costs have the key {cost.key} or its line in scenes; remove the package of "
                "one"
            )
        costs[cost.key] = cost
    return costs


def costs_of_run_kind(kind: str) -> dict[str, Cost]:
    """Costs that runs of a kind measure; without a kind, those of runs on captures."""
    names = {kind, "studies"} if kind else {"captures"}
    return {k: c for k, c in all_costs().items() if names & {*c.measured_on}}


def costs_by_budget() -> dict[str, Cost]:
    """All costs by the key of their budget."""
    return {cost.budget_key: cost for cost in all_costs().values()}
