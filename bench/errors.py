"""The errors that a user is meant to see; apart so that raising them imports nothing heavy."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

GONE = {  # commands and keys that are gone: what to type instead
    "groups": "bench choose groups=yes",
    "stream": "bench run after=each stopping=yes",
    "chip": "bench run form=c",
    "capture": "bench.corpus(...).plot(i) in Python",
    "demo": "see README.md for the commands of a comparison",
    "extract": "bench.extract(data=..., features=...) in Python",
    "papers": "bench report lists published numbers",
    "completion": "bench COMMAND --help lists the keys",
    "submit": "bench report writes comparison.csv, which others can compare with theirs",
    "shots": "protocol=personal protocol.shots=N",
    "person": "model=adaptable model.classifier=NAME model.ways=centre+scale+pool",
    "leaderboard": "bench report writes comparison.csv, which others can compare with theirs",
}


class InputError(Exception):
    """Invalid user input; the message is one line: what, where, what to do."""


class StoreError(Exception):
    """The store, or the disk under it, failed in the middle of the work: one line; the same command goes on later."""


class HiddenError(Exception):
    """Access of a system to a forbidden part of a corpus, such as labels in prediction; one line."""


class PredictionError(ValueError):
    """A system predicts what cannot be counted, such as a label that is no class; one line that says what to do."""


class ClusterError(Exception):
    """The cluster failed in the middle of the work: one line; the same command goes on later."""


def check_value(key: str, value: object, is_valid: bool, advice: str) -> None:
    """Raise an `InputError` that names a key with its value and says what to give, unless the value is valid."""
    if not is_valid:
        shown = f"{value:g}" if isinstance(value, float) else value
        raise InputError(f"{key}={shown}: give {advice}")


def suggest_names(word: str, known: Iterable[str]) -> str:
    """The end of an error message: what to type instead of a name that is gone, or the likeliest names, then all."""
    if word in GONE:
        return f"it is gone: {GONE[word]}"
    known = sorted(known)
    close = difflib.get_close_matches(word, known, n=3, cutoff=0.6)
    hint = f"did you mean {' or '.join(close)}? " if close else ""
    return f"{hint}known: {', '.join(known) or 'none'}"


def shorten(text: str, most: int = 60) -> str:
    """The text, or its beginning and end with dots between them where it is longer than ``most`` characters."""
    if len(text) <= most:
        return text
    head = (most - 3) // 2
    return f"{text[:head]}...{text[-(most - 3 - head) :]}"


def one_line(value: object, most: int = 80) -> str:
    """A path or the message of another library, in one line."""
    text = shorten(str(value) or type(value).__name__, 4 * most)
    return shorten("".join(c if c.isprintable() else " " for c in text), most)
