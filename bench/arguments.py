"""The grammar of the command line: words ``key=value`` are checked and typed by the table of options."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from bench.amounts import convert, text_of
from bench.errors import InputError, nearest
from bench.measures import budgets
from bench.options import OPTIONS, Option, options
from bench.words import PARTS, Values
from bench.work.backend import Backend

KEYS = {o.key for o in OPTIONS if "run" in o.commands.split() and "." not in o.key}  # of the cells of bench run
BACKEND = {"jobs", "cluster"}  # where folds are done, which changes no result
MOVED = {"source": "bench live MODEL", "over": "bench tune smallest="}  # keys of the version before: commands of today


def parse(arguments: Sequence[str], known: Collection[str] | None) -> dict[str, str]:
    """Split ``key=value`` arguments.

    Args:
        arguments: typed words.
        known: keys that may appear, see `bench.options.keys`; those of `PARTS`, ``data`` and ``detector`` may also
            be dotted. None takes every key.

    Raises:
        InputError: an argument without ``=``, a key given twice, or an unknown key.
    """
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
    """Split arguments of a command that takes words without a key first, such as names of files.

    Args:
        arguments: typed words.
        known: keys of the options.
        most: words that there may be; a word with ``=`` is one if it is a file, or if its key is unknown.

    Raises:
        InputError: as `parse`, of what follows the words.
    """
    words = []
    for argument in arguments[:most]:
        if "=" in argument and argument.partition("=")[0] in known and not Path(argument).is_file():
            break
        words.append(argument)
    return words, parse(arguments[len(words) :], known)


def check_key(key: str, known: Collection[str]) -> None:
    """Refuse a key that means nothing here.

    Raises:
        InputError: it is not known, or must not be dotted.
    """
    if key in MOVED and key not in known:
        raise InputError(f"no key is called {key!r}; it is now {MOVED[key]}")
    if key.split(".")[0] not in known or ("." in key and key.split(".")[0] not in (*PARTS, "data", "detector")):
        raise InputError(f"no key is called {key!r}; {nearest(key, known)}")


def setting(command: str, key: str, values: Values) -> object:
    """A value of the type that the table of options names, or its default.

    Raises:
        InputError: it is no such value, or none of those that the table lists.
    """
    option = options(command)[key]
    return value_of(option, values[key]) if key in values else option.default


def value_of(option: Option, value: object) -> Any:
    """A typed value of an option.

    Raises:
        InputError: it is no such value, or none of those that are listed.
    """
    key = option.key
    if option.type == "number":
        return number(key, value)
    if option.type == "amount":
        return budgets()[key].typed(value)
    if option.values and (text := text_of(value)) not in option.values:
        raise InputError(f"{key}={text}: give {' or '.join(option.values)}")
    return convert(key, value, 0 if option.type == "count" else option.default)


def number(key: str, given: object) -> float:
    """A number above 0.

    Raises:
        InputError: it is none.
    """
    value = convert(key, given, 1.0)
    if not 0 < value < float("inf"):
        raise InputError(f"{key}={given}: give a number above 0")
    return value


def backend_of(values: Values) -> Backend:
    """The requested workers.

    Raises:
        InputError: a value that means nothing, or nothing there.
    """
    cluster = str(values.get("cluster", ""))
    if cluster and "jobs" in values:
        raise InputError(f"jobs={values['jobs']}: cluster= sets the number of workers; leave jobs= out")
    return Backend(jobs_of(values), cluster)


def jobs_of(values: Values) -> int | None:
    """The requested number of worker processes."""
    return convert("jobs", values["jobs"], 0) if "jobs" in values else None
