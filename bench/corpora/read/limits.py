"""What importers take from files that nobody has looked at, and how they speak of them: in one line of known length."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

from bench.errors import InputError

SYNTHETIC = "synthetic"  # a column that marks generated captures
MOST_LABEL = 200  # characters
MOST_CONDITIONS = 256  # columns beside the channels
MOST_TIMES = 100  # what a packed file may unpack to, in its own size; sensor values seldom reach 20
ALWAYS = 16 << 20  # bytes that every packed file may unpack to

# Characters that end a line, move a cursor or cannot be written as UTF-8: files, tables and terminals take them ill.
_UNSEEN = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ufeff\ud800-\udfff]")


def short(text: str, most: int = 60) -> str:
    """The text, or its beginning and end with dots between them where it is longer than ``most`` characters."""
    if len(text) <= most:
        return text
    head = (most - 3) // 2
    return f"{text[:head]}...{text[-(most - 3 - head) :]}"


def quoted(text: str, most: int = 40) -> str:
    """The text between quotes, with every character visible."""
    return short(repr(short(text, 4 * most)), most)


def plain(text: object, most: int = 80) -> str:
    """What a path or another's error says, in one line."""
    said = short(str(text) or type(text).__name__, 4 * most)
    return short("".join(c if c.isprintable() else " " for c in said), most)


def called(path: Path) -> str:
    """What messages call a file."""
    return plain(path.name, 60)


def briefly(warnings: list[str], rest: str) -> str:
    """Warnings of an import in one line: the first three, and where all of them are.

    Args:
        warnings: at least one.
        rest: the command that prints all.
    """
    said = "; ".join(warnings[:3])
    return said if len(warnings) <= 3 else f"{len(warnings)} of them: {said}; for all: {rest}"


def flaw(word: str) -> str:
    """What is wrong with a label, as the end of a message, or nothing."""
    if not word:
        return "is empty; fill it"
    if len(word) > MOST_LABEL:
        return f"is {quoted(word)}, longer than {MOST_LABEL} characters; shorten it"
    if _UNSEEN.search(word):
        return f"is {quoted(word)}, with characters that cannot be seen; correct it"
    return ""


def check_names(names: list[str], where: str) -> None:
    """Refuse names of columns that are missing, unreadable or there twice.

    Raises:
        InputError: the message begins with ``where``.
    """
    for i, name in enumerate(names, start=1):
        if not name:
            raise InputError(f"{where}: column {i} has no name; name it")
        if wrong := flaw(name):
            raise InputError(f"{where}: column {i} {wrong}")
    twice = [name for name, times in Counter(names).items() if times > 1]
    if twice:
        raise InputError(f"{where}: column {quoted(min(twice))} stands twice; rename one")


def check_conditions(count: int, where: str) -> None:
    """Refuse more columns than conditions can have: mostly a grid that is too small.

    Raises:
        InputError: the message begins with ``where``.
    """
    if count > MOST_CONDITIONS:
        raise InputError(
            f"{where}: {count} columns before the channels, at most {MOST_CONDITIONS} are read; check grid= or delete "
            "some"
        )


def size(count: int) -> str:
    """A number of bytes in words."""
    for unit in ("bytes", "KiB", "MiB", "GiB", "TiB"):
        if count < 1000:
            return (
                f"{count} {unit}" if unit == "bytes" else f"{count:.2g} {unit}" if count < 10 else f"{count:.0f} {unit}"
            )
        count = count / 1024 if count < 1 << 100 else 1 << 100  # larger whole numbers fit no float
    return "more than 1000 TiB"


def check_unpacked(unpacked: int, path: Path, instead: str) -> None:
    """Refuse a file that unpacks to so much more than it is that it cannot be sensor values.

    Args:
        unpacked: bytes that the file says it holds.
        path: the file.
        instead: what to do if it is right after all.

    Raises:
        InputError: it is too much.
    """
    most = max(ALWAYS, MOST_TIMES * path.stat().st_size)
    if unpacked > most:
        raise InputError(
            f"{called(path)}: unpacks to {size(unpacked)}, a file of this size to at most {size(most)}; if it is "
            f"right, {instead}"
        )
