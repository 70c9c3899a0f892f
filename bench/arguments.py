"""The grammar of the command line: words ``key=value`` are checked and typed by the table of options."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench.amounts import convert
from bench.errors import InputError, nearest
from bench.measures import budgets
from bench.option import value_of as plain_value_of
from bench.options import WORK, Option, added_keys, options, rooms
from bench.words import Values
from bench.work.backend import Backend

KEYS = {option.key for option in WORK}  # of the cells of bench run


def parse(arguments: Sequence[str], known: Collection[str] | None) -> dict[str, str]:
    """Split ``key=value`` arguments."""
    values: dict[str, str] = {}
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if not equals or not key or not value:
            names = f"keys: {', '.join(sorted(known))}" if known else "leave it out, or see --help"
            raise InputError(f"{argument!r} is not key=value; {names}")
        if key in values:
            raise InputError(f"{key}= is given twice; give it once, several values as {key}={values[key]},{value}")
        if known is not None:
            check_key(key, known)
        values[key] = value
    return values


def parse_words(arguments: Sequence[str], known: Collection[str], most: int) -> tuple[list[str], dict[str, str]]:
    """Split arguments of a command that takes words without a key first, such as names of files."""
    words = []
    for argument in arguments[:most]:
        if "=" in argument and argument.partition("=")[0] in known and not Path(argument).is_file():
            break
        words.append(argument)
    return words, parse(arguments[len(words) :], known)


def check_key(key: str, known: Collection[str]) -> None:
    """Refuse a key that means nothing here."""
    if key.split(".")[0] not in known or ("." in key and key.split(".")[0] not in (*rooms(), "data")):
        raise InputError(f"no key is called {key!r}; {nearest(key, known)}")


def values_of(values: Mapping[str, object], known: Collection[str]) -> dict[str, object]:
    """Keyword arguments as the command line has them; None is the same as not given."""
    typed = {key.replace("__", "."): value for key, value in values.items() if value is not None}
    for key in typed:
        check_key(key, known)
    return typed


def settings(command: str, values: Values, listed: Iterable[Option] = ()) -> dict[str, Any]:
    """The options of a command, or of its action, in their types; those that it shares with ``bench run`` aside."""
    every = {option.key: option for option in listed} or options(command)
    own = {key: one for key, one in every.items() if one not in WORK and "makers" not in one.commands}
    given = {key: values[key] for key in own if values.get(key) is not None}
    return {key: value_of(one, given[key]) if key in given else one.default for key, one in own.items()}


def limits_of(given: Mapping[str, Any]) -> dict[str, float]:
    """The budget of each cost, of the settings of a command."""
    return {cost.key: given[key] for key, cost in budgets().items() if given.get(key) is not None}


def value_of(option: Option, value: object) -> Any:
    """A typed value of an option."""
    return budgets()[option.key].typed(value) if option.type == "amount" else plain_value_of(option, value)


def backend_of(values: Values) -> Backend:
    """The requested workers."""
    for key, one in added_keys("run").items():
        if (address := str(values.get(key, ""))) and "jobs" in values:
            raise InputError(f"jobs={values['jobs']}: {key}= sets the number of workers; leave jobs= out")
        if address:
            return Backend(workers=one.uses, address=address)
    return Backend(jobs_of(values))


def backend_keys() -> set[str]:
    """Keys that say where folds are done, which changes no result."""
    return {"jobs", *added_keys("run")}


def jobs_of(values: Values) -> int | None:
    """The requested number of worker processes."""
    return convert("jobs", values["jobs"], 0) if "jobs" in values else None
