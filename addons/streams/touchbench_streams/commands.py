"""The command ``bench live``: frames from standard input, classified by a saved model as they come."""

from __future__ import annotations

import sys

from bench.errors import InputError
from bench.options import keys, parse_words, settings


def live(arguments: list[str]) -> int:
    """Classify frames from standard input until it ends.

    Raises:
        InputError: something in the arguments cannot be used, or a line is no frame; earlier decisions are printed.
    """
    words, values = parse_words(arguments, keys("live"), 1)
    if not words:
        raise InputError("give the address or folder that bench fit printed: bench live MODEL")
    if sys.stdin is None:
        raise InputError("bench live: standard input is closed; send frames to it")
    from touchbench_streams.live import decide

    given = settings("live", values)
    return decide(words[0], float(given["hop_ms"]), given["events"])
