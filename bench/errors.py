"""Errors for the user, and helpers for their messages. Nothing heavy is imported."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class InputError(Exception):
    """Invalid user input; the message is one line: what, where, what to do."""


class StoreError(Exception):
    """The store or its disk failed during a run, in one line; the same command continues later."""


class HiddenError(Exception):
    """A system accessed a hidden part of a corpus, such as labels during prediction; one line."""


class PredictionError(ValueError):
    """A system gave an invalid prediction, such as an unknown label; one line with advice."""


class ClusterError(Exception):
    """The cluster failed during a run, in one line; the same command continues later."""


def check_value(key: str, value: object, is_valid: bool, advice: str) -> None:
    """Refuse an invalid value: the `InputError` names the key, the value and what to give."""
    if not is_valid:
        shown = f"{value:g}" if isinstance(value, float) else value
        raise InputError(f"{key}={shown}: give {advice}")


def suggest_names(word: str, known: Iterable[str]) -> str:
    """End an error message about an unknown name: the most similar names, then all known ones."""
    known = sorted(known)
    close = difflib.get_close_matches(word, known, n=3, cutoff=0.6)
    hint = f"did you mean {' or '.join(close)}? " if close else ""
    return f"{hint}known: {', '.join(known) or 'none'}"


def shorten(text: str, most: int = 60) -> str:
    """Replace the middle of a text by dots if it has more than ``most`` characters."""
    if len(text) <= most:
        return text
    head = (most - 3) // 2
    return f"{text[:head]}...{text[-(most - 3 - head) :]}"


def one_line(value: object, most: int = 80) -> str:
    """Print a path, or the message of another library, as one line."""
    text = shorten(str(value) or type(value).__name__, 4 * most)
    return shorten("".join(c if c.isprintable() else " " for c in text), most)
