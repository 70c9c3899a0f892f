"""Options as fields of dataclasses: type, default and help once, read from what is typed."""

from __future__ import annotations

import dataclasses
import itertools
import re
from dataclasses import dataclass
from typing import Any, Self

from bench.errors import InputError, nearest
from bench.words import UNITS, Values, convert, items, quantity, text_of

ROOM = re.compile(r"{([\w.]+)}")  # in the help of an option
FEW = 3  # values that a refusal lists


@dataclass(frozen=True)
class Option:
    """A key of some commands.

    Attributes:
        key: key before the ``=``; one with a dot is a parameter that many models take.
        type: ``text``, ``number`` (above 0), ``count`` (a whole number), ``counts`` (at least 1), ``yes`` (or no),
            ``amount`` (of a cost), or the unit of an amount, such as ``ms``.
        default: value if it is not given.
        help: text of the help; ``{models}`` stands for the names of a room, whose parts the key names.
        values: allowed values, if they can be listed.
        joint: separator of several values.
        uses: class that does what a key of a package asks, ``module:object``.
    """

    key: str
    type: str
    default: object
    help: str
    values: tuple[str, ...] = ()
    joint: str = ","
    uses: str = ""

    @property
    def room(self) -> str:
        """The room whose parts it names, with their parameters behind a dot; empty for any other key."""
        found = ROOM.search(self.help)
        return found[1] if found else ""


def option(default: Any, help: str, values: tuple[str, ...] = (), type: str = "text") -> Any:
    """A field that is an option: a key of the command with its only default.

    A tuple takes all values between commas; of any other, several values are several runs.
    """
    return dataclasses.field(default=default, metadata={"option": Option("", type, default, help, values)})


@dataclass(frozen=True)
class Options:
    """Fields made by `option`, which are read from typed values."""

    @classmethod
    def fields(cls) -> dict[str, Option]:
        """Each option by its key."""
        every = dataclasses.fields(cls)
        return {f.name: dataclasses.replace(f.metadata["option"], key=f.name) for f in every if "option" in f.metadata}

    @classmethod
    def of(cls, values: Values) -> list[Self]:
        """Every combination of the typed values."""
        choices: dict[str, list] = {}
        for name, one in cls.fields().items():
            if name in values:
                given = list(dict.fromkeys(_read(one, each) for each in items(name, values[name])))
                choices[name] = [tuple(given)] if isinstance(one.default, tuple) else given
        return [cls(**dict(zip(choices, each, strict=True))) for each in itertools.product(*choices.values())]

    def arguments(self) -> dict[str, str]:
        """The options as typed; defaults are left out."""
        given = {name: (getattr(self, name), one.default) for name, one in self.fields().items()}
        return {name: typed_as(value) for name, (value, default) in given.items() if value != default}


def _read(one: Option, value: object) -> Any:
    if isinstance(one.default, tuple):
        one = dataclasses.replace(one, default=next(iter(one.default), False if one.type == "yes" else ""))
    return value_of(one, value)


def value_of(one: Option, value: object) -> Any:
    """A typed value of an option."""
    key = one.key
    if one.type == "number":
        return quantity(key, value)
    if one.type in UNITS:
        return quantity(key, value, one.type)
    if one.type == "counts":
        if (number := convert(key, value, 4)) < 1:
            raise InputError(f"{key}={number}: give whole numbers of at least 1")
        return number
    if one.values and (text := text_of(value)) not in one.values:
        words = f"give {' or '.join(one.values)}" if len(one.values) <= FEW else nearest(text, one.values)
        raise InputError(f"{key}={text}: {words}")
    return convert(key, value, one.default or 0 if one.type == "count" else one.default)


def typed_as(value: object) -> str:
    """A value as it is typed."""
    if isinstance(value, tuple):
        return ",".join(map(typed_as, value))
    return text_of(value).removesuffix(".0") if isinstance(value, float) else text_of(value)
