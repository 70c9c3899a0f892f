"""Options and their values: text between commas or objects of Python, amounts with units; commands as typed."""

from __future__ import annotations

import dataclasses
import itertools
import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

from bench.errors import InputError, suggest_names

Values = Mapping[str, object]  # text; from Python also numbers, objects, and lists of these
WIDTH = 100  # columns of help
SMALL_SYSTEM = "model=lda features=touch model.window=1.0 model.repair=stuck+dead"  # a small system, accurate on real touch
DEFAULTS = {  # of the keys of a run
    "data": "synth",
    "protocol": "loso",
    "model": "svm",
    "features": "jung54",
    "seed": "0",
    "where": "",
    "target": "gesture",
}
UNITS = {  # typed units, by the unit in which an amount is kept
    "k": {"k": 1, "M": 1e3},
    "kB": {"B": 1e-3, "kB": 1, "KiB": 1.024, "MB": 1e3, "MiB": 1048.576},
    "ms": {"ms": 1, "s": 1e3},
    "MHz": {"kHz": 1e-3, "MHz": 1, "GHz": 1e3},
}
LARGEST, LARGEST_SEED = (
    10**6,
    2**32 - 1,
)  # of a whole number, of a seed, which NumPy and scikit-learn bound
ROOM = re.compile(r"{([\w.]+)}")  # in the help of an option
FEW = 3  # values that a refusal lists
BOOLEANS = {"true": True, "yes": True, "false": False, "no": False}
READERS: dict[type, tuple[str, Callable[[str], object]]] = {
    bool: ("yes or no", lambda text: BOOLEANS[text.lower()]),
    int: ("a whole number", int),
    float: ("a number", float),
    tuple: ("names joined by +", lambda text: tuple(text.split("+"))),
    str: ("text", str),
}


def split_values(key: str, value: object) -> list:
    """The values between commas, or of a list."""
    if isinstance(value, str):
        if key == "where":  # a condition may hold commas
            return [value]
        values = value.split(",")
        if not all(values):
            raise InputError(
                f"{key}={value}: a value is missing beside a comma; add it or remove the comma"
            )
        return values
    several = isinstance(value, list) or (
        isinstance(value, tuple) and "." not in key
    )  # a parameter may be a tuple
    if several and not value:
        raise InputError(f"{key}=[]: give at least one value")
    return [*value] if several else [value]  # type: ignore[misc]


def format_command(command: str, arguments: Mapping[str, str]) -> str:
    """A command as it is typed."""
    return f"bench {command} {format_arguments(arguments)}".rstrip()


def format_arguments(arguments: Mapping[str, str]) -> str:
    """Arguments as they are typed."""
    return " ".join(f"{key}={quote_value(value)}" for key, value in arguments.items())


def arguments_of_label(key: str, label: str) -> dict[str, str]:
    """``personal[shots=3]``, as tables name a part, as it is typed."""
    name, _, rest = label.rstrip("]").partition("[")
    return {key: name} | {
        f"{key}.{k}": v for k, _, v in (part.partition("=") for part in rest.split(", ") if part)
    }


def quote_value(value: str) -> str:
    """A value as a shell takes it: in double quotes where it has single ones, as conditions have."""
    double = "'" in value and not set('"$`\\!') & set(value)
    return f'"{value}"' if double else shlex.quote(value)


def parse_amount(
    key: str, given: object, unit: str = "", zero: bool = False, prefix: str = ""
) -> float:
    """A typed amount above 0 in its unit: ms, kB (1000 bytes; KiB are 1024), thousands, MHz or a plain number."""
    text = str(given)
    number = text.rstrip("BkKiMmsGHz ")
    units = UNITS.get(unit, {"": 1.0})
    try:
        value = float(number) * units[text[len(number) :].strip()]
        if not (0 < value < float("inf") or (zero and value == 0)):
            raise ValueError(text)
    except (ValueError, KeyError) as e:
        words = f" and {' or '.join(units)}" if "" not in units else ""
        raise InputError(f"{prefix}{key}={text}: give a number above 0{words}") from e
    return value


def parse_value(key: str, given: object, default: object) -> Any:
    """Text as a value of the type of the default; a default of None takes None or a whole number.

    What is no text (an API call) is taken as it is, if it is of that type.
    """
    if isinstance(given, tuple) and not given and isinstance(default, tuple):
        return given
    text = given if isinstance(given, str) else format_value(given)
    if text == "None" and default is None:
        return None
    if text == "None" and isinstance(default, tuple):
        raise InputError(f"{key}=None: give a value such as {default!r}")
    usual, seed = 0 if default is None else default, key.endswith("seed")
    words, read = next(
        (reader for kind, reader in READERS.items() if isinstance(usual, kind)), READERS[str]
    )
    try:
        value = read(text)
        if seed and isinstance(value, int | float) and value < 0:
            raise ValueError(key)
    except (ValueError, KeyError) as e:
        words += " or None" if default is None else " from 0 on" if seed else ""
        example = (
            ""
            if isinstance(usual, bool)
            else f", such as {2 if default in (None, 0) and not seed else default}"
        )
        raise InputError(f"{key}={text[:60]}: give {words}{example}") from e
    most = LARGEST_SEED if seed else LARGEST
    if isinstance(value, int) and abs(value) > most:
        raise InputError(f"{key}={text[:60]}: give {most} at most")
    return value


def format_value(value: object) -> str:
    """A value as it is typed; `parse_value` reads it again."""
    if type(value).__name__ in ("bool", "bool_"):  # NumPy's own, too
        return str(value).lower()
    return "+".join(map(str, value)) if isinstance(value, tuple) else str(value)


@dataclass(frozen=True)
class Option:
    """A key of some commands."""

    key: str  # key before the ``=``; one with a dot is a parameter that many models take
    # ``text``, ``number`` (above 0), ``count`` (a whole number), ``counts`` (at least 1), ``yes`` (or no), ``amount``
    # (of a cost), or the unit of an amount, such as ``ms``
    type: str
    default: object  # value if it is not given
    help: str  # text of the help; ``{models}`` stands for the names of a room, whose parts the key names
    values: tuple[str, ...] = ()  # allowed values, if they can be listed
    joint: str = ","  # separator of several values
    uses: str = ""  # class that does what a key of a package asks, ``module:object``

    @property
    def part_group(self) -> str:
        """The room whose parts it names, with their parameters behind a dot; empty for any other key."""
        found = ROOM.search(self.help)
        return found[1] if found else ""


def option(default: Any, help: str, values: tuple[str, ...] = (), type: str = "text") -> Any:
    """A field that is an option: a key of the command with its only default.

    A tuple takes all values between commas; of any other, several values are several runs.
    """
    return dataclasses.field(
        default=default, metadata={"option": Option("", type, default, help, values)}
    )


@dataclass(frozen=True)
class Options:
    """Fields made by `option`, which are read from typed values."""

    @classmethod
    def options_by_key(cls) -> dict[str, Option]:
        """Each option by its key."""
        every = dataclasses.fields(cls)
        return {
            f.name: dataclasses.replace(f.metadata["option"], key=f.name)
            for f in every
            if "option" in f.metadata
        }

    @classmethod
    def from_typed(cls, values: Values) -> list[Self]:
        """Every combination of the typed values."""
        choices: dict[str, list] = {}
        for name, one in cls.options_by_key().items():
            if name in values:
                given = list(
                    dict.fromkeys(_read(one, each) for each in split_values(name, values[name]))
                )
                choices[name] = [tuple(given)] if isinstance(one.default, tuple) else given
        return [
            cls(**dict(zip(choices, each, strict=True)))
            for each in itertools.product(*choices.values())
        ]

    def typed_arguments(self) -> dict[str, str]:
        """The options as typed; defaults are left out."""
        given = {
            name: (getattr(self, name), one.default) for name, one in self.options_by_key().items()
        }
        return {
            name: format_option(value)
            for name, (value, default) in given.items()
            if value != default
        }


def _read(one: Option, value: object) -> Any:
    if isinstance(one.default, tuple):
        one = dataclasses.replace(
            one, default=next(iter(one.default), False if one.type == "yes" else "")
        )
    return parse_option(one, value)


def parse_option(one: Option, value: object) -> Any:
    """A typed value of an option."""
    key = one.key
    if one.type == "number":
        return parse_amount(key, value)
    if one.type in UNITS:
        return parse_amount(key, value, one.type)
    if one.type == "counts":
        if (number := parse_value(key, value, 4)) < 1:
            raise InputError(f"{key}={number}: give whole numbers of at least 1")
        return number
    if one.values and (text := format_value(value)) not in one.values:
        words = (
            f"give {' or '.join(one.values)}"
            if len(one.values) <= FEW
            else suggest_names(text, one.values)
        )
        raise InputError(f"{key}={text}: {words}")
    return parse_value(key, value, one.default or 0 if one.type == "count" else one.default)


def format_option(value: object) -> str:
    """A value as it is typed."""
    if isinstance(value, tuple):
        return ",".join(map(format_option, value))
    return (
        format_value(value).removesuffix(".0") if isinstance(value, float) else format_value(value)
    )
