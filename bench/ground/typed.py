"""Typed values: options and their types, text between commas, amounts with units, commands."""

from __future__ import annotations

import dataclasses
import itertools
import math
import os
import re
import shlex
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

from bench.errors import InputError, suggest_names

Values = Mapping[str, object]  # text; from Python also numbers, objects, and lists of these
DEFAULTS = {  # of the keys of a run
    "data": "synth",
    "protocol": "loso",
    "model": "svm",
    "features": "jung54",
    "seed": "0",
    "where": "",
    "target": "gesture",
    "skin": "design",
    "also": "none",
}
# A small system that is accurate on real touch, for examples and hints
SMALL_SYSTEM = "model=lda features=touch model.window=1.0 model.repair=stuck+dead"
UNITS = {  # units that can be typed, by the unit in which an amount is stored
    "k": {"k": 1, "M": 1e3},
    "kB": {"B": 1e-3, "kB": 1, "KiB": 1.024, "MB": 1e3, "MiB": 1048.576},
    "ms": {"ms": 1, "s": 1e3},
    "MHz": {"kHz": 1e-3, "MHz": 1, "GHz": 1e3},
}
LARGEST_INTEGER = 10**6
LARGEST_SEED = 2**32 - 1  # of NumPy and scikit-learn
LISTED_VALUES = 3  # at most, in the refusal of a value
DOTTED_KEY = re.compile(r"\s*\w+\.[\w.]+\s*=")  # of a line of TOML, to which it is a table
DOTTED = 'write a key with a dot in quotes, such as "model.C" = 8'
HOME = re.compile(r"(?:^|(?<=[=,]))~(?:[\w.-]*(?=/)|$)")  # in a word, or a value between commas
GROUP_IN_HELP = re.compile(r"{([\w.]+)}")
BOOLEANS = {"true": True, "yes": True, "false": False, "no": False}
READERS: dict[type, tuple[str, Callable[[str], object]]] = {
    bool: ("yes or no", lambda text: BOOLEANS[text.lower()]),
    int: ("a whole number", int),
    float: ("a number", float),
    tuple: ("names joined by +", lambda text: tuple(text.split("+"))),
    str: ("text", str),
}


def split_values(key: str, value: object) -> list:
    """List the values of a key: the texts between commas, or the members of a list."""
    if isinstance(value, str):
        if key == "where":  # a condition may hold commas
            return [value]
        values = value.split(",")
        if not all(values):
            raise InputError(
                f"{key}={value}: a value is missing beside a comma; add it or remove the comma"
            )
        return values
    is_parameter = "." in key  # which may be a tuple
    if not isinstance(value, list) and (is_parameter or not isinstance(value, tuple)):
        return [value]
    if not value:
        raise InputError(f"{key}=[]: give at least one value")
    return [*value]


def format_command(command: str, arguments: Mapping[str, str]) -> str:
    """Write a command as it is typed."""
    return f"bench {command} {format_arguments(arguments)}".rstrip()


def format_arguments(arguments: Mapping[str, str]) -> str:
    """Write arguments as they are typed."""
    return " ".join(f"{key}={quote_value(value)}" for key, value in arguments.items())


def arguments_of_label(key: str, label: str) -> dict[str, str]:
    """Arguments for a part that tables label ``personal[shots=3]``."""
    name, _, parameters = label.rstrip("]").partition("[")
    pairs = (text.partition("=") for text in parameters.split(", ") if text)
    return {key: name} | {f"{key}.{parameter}": value for parameter, _, value in pairs}


def parse_toml(content: bytes) -> dict[str, Any]:
    """Parse a TOML file; a byte order mark, which editors on Windows write, is left out.

    Raises:
        InputError: it is not TOML; the message ends with advice on the line.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeError as e:
        raise InputError("not UTF-8 text; save the file as UTF-8") from e
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as e:
        number = re.search(r"at line (\d+)", str(e))
        lines = text.splitlines()[: int(number[1]) if number else None]
        advice = "write text in quotes and lists in brackets"
        if lines and DOTTED_KEY.match(lines[-1]):
            advice = DOTTED
        elif "overwrite" in str(e) or "twice" in str(e):
            advice = "write each key and table once, and several values of a key as a list"
        reason = str(e).partition(";")[0]
        raise InputError(f"not TOML: {reason}; {advice}") from e


def expand_home(argument: str) -> str:
    """Replace ``~`` at the start of a word or value, which only some shells do behind ``=``."""
    return HOME.sub(lambda match: os.path.expanduser(match[0]), argument)


def quote_value(value: str) -> str:
    """Quote a value for a shell; in double quotes if it has single ones, as conditions have."""
    double = "'" in value and not set('"$`\\!') & set(value)
    return f'"{value}"' if double else shlex.quote(value)


def parse_amount(
    key: str, value: object, unit: str = "", allow_zero: bool = False, prefix: str = ""
) -> float:
    """Read an amount above 0 in ms, kB (1000 bytes; KiB are 1024), thousands (k), MHz or no unit.

    Raises:
        InputError: it is no such amount; the message begins with ``prefix`` and the key.
    """
    text = str(value)
    number = text.rstrip("BkKiMmsGHz ")
    units = UNITS.get(unit, {"": 1.0})
    try:
        amount = float(number) * units[text[len(number) :].strip()]
        if not (0 < amount < float("inf") or (allow_zero and amount == 0)):
            raise ValueError(text)
    except (ValueError, KeyError) as e:
        choice = f" and {' or '.join(units)}" if "" not in units else ""
        raise InputError(f"{prefix}{key}={text}: give a number above 0{choice}") from e
    return amount


def parse_value(key: str, value: object, example: object) -> Any:
    """Read a value of the type of the default; a default of None takes None or a whole number.

    A value from Python that is no text must have this type.

    Raises:
        InputError: it has another type, or is too large.
    """
    if isinstance(value, tuple) and not value and isinstance(example, tuple):
        return value
    text = value if isinstance(value, str) else format_value(value)
    if text == "None" and example is None:
        return None
    if text == "None" and isinstance(example, tuple):
        raise InputError(f"{key}=None: give a value such as {example!r}")
    is_optional = example is None
    example = 0 if is_optional else example
    is_seed = key.endswith("seed")
    fitting = (reader for kind, reader in READERS.items() if isinstance(example, kind))
    kind_words, read = next(fitting, READERS[str])
    try:
        result = read(text)
        if is_seed and isinstance(result, int | float) and result < 0:
            raise ValueError(key)
    except (ValueError, KeyError) as e:
        advice = kind_words
        if is_optional:
            advice += " or None"
        elif is_seed:
            advice += " from 0 on"
        if not isinstance(example, bool):
            shown = 2 if example == 0 and not is_seed else example
            advice += f", such as {shown}"
        raise InputError(f"{key}={text[:60]}: give {advice}") from e
    largest = LARGEST_SEED if is_seed else LARGEST_INTEGER
    if isinstance(result, int) and abs(result) > largest:
        raise InputError(f"{key}={text[:60]}: give {largest} at most")
    return result


def parse_open_value(key: str, value: object, default: object) -> Any:
    """Read a value of a parameter of a user's part, whose default may have one of several types.

    Beside text, such as ``gamma="scale"``, and None, a number may be typed, None beside text, and
    text beside None. Other defaults fix the type, as for `parse_value`.
    """
    text = value if isinstance(value, str) else format_value(value)
    if key.endswith("seed") or not isinstance(default, str | None) or _is_number(default or ""):
        return parse_value(key, value, default)
    if text == "None":
        return None
    if _is_number(text):
        return parse_value(key, text, 0 if text.lstrip("+-").isdigit() else 0.0)
    return text if isinstance(default, str) else BOOLEANS.get(text.lower(), text)


def _is_number(text: str) -> bool:
    """Return True for the text of a finite number."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def format_value(value: object) -> str:
    """Write a value so that `parse_value` reads it again."""
    if type(value).__name__ in ("bool", "bool_"):  # of NumPy, too
        return str(value).lower()
    return "+".join(map(str, value)) if isinstance(value, tuple) else str(value)


@dataclass(frozen=True)
class Option:
    """A key of some commands."""

    key: str  # before the ``=``; one with a dot is a parameter that many models take
    # ``text``, ``number`` (above 0), ``count`` (a whole number), ``counts`` (at least 1), ``yes``
    # (or no), ``amount`` (of a cost), or the unit of an amount, such as ``ms``
    type: str
    default: object  # value if it is not given
    help: str  # ``{models}`` in it stands for the names of a group of parts; the key names one
    values: tuple[str, ...] = ()  # allowed values, if they can be listed
    joint: str = ","  # separator of several values
    uses: str = ""  # class that implements the key of a package, ``module:object``

    @property
    def part_group(self) -> str:
        """Group of parts that it names, whose parameters follow a dot; empty for any other key."""
        group = GROUP_IN_HELP.search(self.help)
        return group[1] if group else ""


def option(default: Any, help: str, values: tuple[str, ...] = (), type: str = "text") -> Any:
    """Declare a field of `Options`: a key of the command, with its default.

    If the default is a tuple, all values between commas are one. Otherwise each is a run.
    """
    declared = Option("", type, default, help, values)
    return dataclasses.field(default=default, metadata={"option": declared})


@dataclass(frozen=True)
class Options:
    """Base of dataclasses whose fields made by `option` are read from typed values."""

    @classmethod
    def options_by_key(cls) -> dict[str, Option]:
        """Each option by its key."""
        declared = (f for f in dataclasses.fields(cls) if "option" in f.metadata)
        return {f.name: dataclasses.replace(f.metadata["option"], key=f.name) for f in declared}

    @classmethod
    def from_typed(cls, values: Values) -> list[Self]:
        """Make one for every combination of the typed values."""
        choices: dict[str, list] = {}
        for key, declared in cls.options_by_key().items():
            if key in values:
                read = [_parse_member(declared, text) for text in split_values(key, values[key])]
                read = list(dict.fromkeys(read))
                choices[key] = [tuple(read)] if isinstance(declared.default, tuple) else read
        combinations = itertools.product(*choices.values())
        return [cls(**dict(zip(choices, each, strict=True))) for each in combinations]

    def typed_arguments(self) -> dict[str, str]:
        """Write the options as typed; those with their default are left out."""
        values = {key: getattr(self, key) for key in self.options_by_key()}
        defaults = {key: declared.default for key, declared in self.options_by_key().items()}
        return {k: format_option(value) for k, value in values.items() if value != defaults[k]}


def _parse_member(declared: Option, value: object) -> Any:
    """Read one of several values of an option."""
    if isinstance(declared.default, tuple):
        empty = False if declared.type == "yes" else ""
        declared = dataclasses.replace(declared, default=next(iter(declared.default), empty))
    return parse_option(declared, value)


def parse_option(option: Option, value: object) -> Any:
    """Read the value of an option; an `InputError` for one that it cannot have."""
    key = option.key
    if option.type == "number":
        return parse_amount(key, value)
    if option.type in UNITS:
        return parse_amount(key, value, option.type)
    if option.type == "counts":
        if (number := parse_value(key, value, 4)) < 1:
            raise InputError(f"{key}={number}: give whole numbers of at least 1")
        return number
    if option.values and (text := format_value(value)) not in option.values:
        advice = suggest_names(text, option.values)
        if len(option.values) <= LISTED_VALUES:
            advice = f"give {' or '.join(option.values)}"
        raise InputError(f"{key}={text}: {advice}")
    default = option.default or 0 if option.type == "count" else option.default
    return parse_value(key, value, default)


def format_option(value: object) -> str:
    """Write the value of an option as it is typed."""
    if isinstance(value, tuple):
        return ",".join(map(format_option, value))
    text = format_value(value)
    return text.removesuffix(".0") if isinstance(value, float) else text
