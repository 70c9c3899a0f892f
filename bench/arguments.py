"""What the user typed: ``key=value`` with commas between several values; from Python lists and objects as well."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import SupportsInt, TypeVar, overload

from bench.errors import InputError, nearest

PARTS = {"protocol": "protocols", "features": "features", "model": "models"}
BACKEND = {"jobs", "cluster"}  # where folds are done, which changes no result
KEYS = {"data", "where", "target", "seed", *BACKEND, *PARTS}  # of every command that runs folds
Values = Mapping[str, object]  # text; from Python also numbers, objects, and lists of these
Usual = TypeVar("Usual")
LARGEST, LARGEST_SEED = 10**6, 2**32 - 1  # of a whole number, of a seed, which NumPy and scikit-learn bound


def parse(arguments: list[str], known: set[str]) -> dict[str, str]:
    """Split ``key=value`` arguments.

    Args:
        arguments: what was typed.
        known: keys that may appear; those of `PARTS` and ``data`` may also be dotted.

    Raises:
        InputError: an argument without ``=``, a key given twice, or an unknown key.
    """
    values: dict[str, str] = {}
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if not equals or not key or not value:
            raise InputError(f"{argument!r} is not key=value; keys: {', '.join(sorted(known))}")
        if key in values:
            raise InputError(f"{key}= is given twice; write {key}={values[key]},{value} for both")
        check_key(key, known)
        values[key] = value
    return values


def options_of(given: list[str], known: tuple[str, ...]) -> dict[str, str]:
    """Options of a command that has arguments without a name as well.

    Raises:
        InputError: one that is not known, or is given twice.
    """
    values: dict[str, str] = {}
    for option in given:
        name, _, value = option.partition("=")
        if name in known and not value:
            raise InputError(f"{name}= has no value; give one, or leave it out")
        if name not in known:
            raise InputError(f"{option!r}: no such option; {nearest(name, known)}")
        if name in values:
            raise InputError(f"{name}= is given twice; give it once")
        values[name] = value
    return values


def check_key(key: str, known: set[str]) -> None:
    """Refuse a key that means nothing here.

    Raises:
        InputError: it is not known, or must not be dotted.
    """
    if key.split(".")[0] not in known or ("." in key and key.split(".")[0] not in (*PARTS, "data")):
        raise InputError(f"no key is called {key!r}; {nearest(key, known)}")


def items(key: str, value: object) -> list:
    """The values between commas, or of a list.

    Raises:
        InputError: there is nothing between two of them, or nothing at all.
    """
    if not isinstance(value, str):
        several = isinstance(value, list) or (isinstance(value, tuple) and "." not in key)  # a parameter may be a tuple
        found = list(value) if isinstance(value, list | tuple) and several else [value]
        if not found:
            raise InputError(f"{key}=[]: give at least one value")
        return found
    if key == "where":  # a query may hold commas
        return [value]
    words = value.split(",")
    if not all(words):
        raise InputError(f"{key}={value}: there is nothing between two commas")
    return words


@overload
def convert(key: str, given: object, default: None) -> int | None: ...


@overload
def convert(key: str, given: object, default: Usual) -> Usual: ...


def convert(key: str, given: object, default: object) -> object:
    """Text as a value of the type of the default; a default of None takes None or a whole number.

    What is no text (an API call) is taken as it is, if it is of that type.

    Raises:
        InputError: it is no such value.
    """
    if given == () and isinstance(default, tuple):
        return given
    text = given if isinstance(given, str) else text_of(given)
    read: Callable[[str], object]
    if default is None or text == "None":
        kind, read = "a whole number or None", lambda t: None if t == "None" else int(t)
        if default is not None:
            raise InputError(f"{key}=None: give a value such as {default!r}")
    elif isinstance(default, bool):
        kind, read = "true or false", {"true": True, "false": False}.__getitem__
    elif isinstance(default, int):
        kind, read = "a whole number" + (" from 0 on" if key.endswith("seed") else ""), int
    elif isinstance(default, float):
        kind, read = "a number", float
    elif isinstance(default, tuple):
        kind, read = "names joined by +", lambda t: tuple(t.split("+"))
    else:
        kind, read = "text", str
    try:
        value = read(text)
        if key.endswith("seed") and isinstance(value, int | float) and value < 0:
            raise ValueError(key)
    except (ValueError, KeyError) as e:
        raise InputError(f"{key}={text[:60]}: give {kind}, such as {default}") from e
    most = LARGEST_SEED if key.endswith("seed") else LARGEST
    if isinstance(value, int) and abs(value) > most:
        raise InputError(f"{key}={text[:60]}: give {most} at most")
    return value


def text_of(value: object) -> str:
    """A value as it is typed; `convert` reads it again."""
    if isinstance(value, bool):
        return str(value).lower()
    return "+".join(map(str, value)) if isinstance(value, tuple) else str(value)


def number(key: str, given: object) -> float:
    """A number above 0.

    Raises:
        InputError: it is none.
    """
    value = convert(key, given, 1.0)
    if not 0 < value < float("inf"):
        raise InputError(f"{key}={given}: give a number above 0")
    return value


@dataclass(frozen=True)
class Backend:
    """Where folds are done.

    Attributes:
        jobs: processes of this machine, None for one per core.
        cluster: the address of dask's scheduler, or the file that holds it; empty for this machine.
    """

    jobs: int | None = None
    cluster: str = ""


HERE = Backend()


def backend_of(values: Values) -> Backend:
    """Where folds are to be done.

    Raises:
        InputError: a value that means nothing, or nothing there.
    """
    cluster = str(values.get("cluster", ""))
    if cluster and "jobs" in values:
        raise InputError(f"jobs={values['jobs']}: with cluster=, its workers say how many they are; leave jobs= out")
    return Backend(jobs_of(values), cluster)


def jobs_of(values: Values) -> int | None:
    """Worker processes that were asked for."""
    if "jobs" not in values:
        return None
    try:
        given = values["jobs"]
        return int(given) if isinstance(given, SupportsInt) else int(str(given))
    except (ValueError, TypeError) as e:
        raise InputError(f"jobs={values['jobs']}: give a whole number of worker processes") from e


def typed(command: str, arguments: Mapping[str, str]) -> str:
    """A command as it is typed."""
    return " ".join(["bench", command, *(f"{key}={quoted(value)}" for key, value in arguments.items())])


def labelled(key: str, label: str) -> dict[str, str]:
    """``personal[shots=3]``, as tables name a part, as it is typed."""
    name, _, rest = label.rstrip("]").partition("[")
    return {key: name} | {f"{key}.{k}": v for k, _, v in (part.partition("=") for part in rest.split(", ") if part)}


def quoted(value: str) -> str:
    """A value as a shell takes it: in double quotes where it has single ones, as conditions have."""
    double = "'" in value and not set('"$`\\!') & set(value)
    return f'"{value}"' if double else shlex.quote(value)
