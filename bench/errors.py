"""The errors that a user is meant to see; apart so that raising them imports nothing heavy."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

FORMER = {  # names of the version before, which this one still answers: the name of today, and what differs
    "scene": ("groups", ""),
    "systems": ("papers", ""),
    "budget": ("seconds", ""),
    "run": ("stored", ": stored=yes for run=no"),
    "worst": ("worst_person", ""),
    "max_worst_person": ("min_worst_person", ", the least accuracy: 100 less the old number"),
    "max_worst_tenth": ("min_worst_tenth", ", the least accuracy: 100 less the old number"),
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


def nearest(word: str, known: Iterable[str]) -> str:
    """The end of an error message: what a former name is called now, or the likeliest names, then all of them."""
    known = sorted(known)
    now, change = FORMER.get(word, ("", ""))
    if now in known:
        return f"it is now called {now}{change}"
    close = difflib.get_close_matches(word, known, n=3, cutoff=0.6)
    hint = f"did you mean {' or '.join(close)}? " if close else ""
    return f"{hint}known: {', '.join(known) or 'none'}"
