"""What learns the post-processing for endless streams, if an installed package has it."""

from __future__ import annotations

from typing import Any

from bench.grammar.options import implementations_of_packages
from bench.ground.typed import arguments_of_label


def find_watch_learner() -> Any:
    """The class that learns to watch for ``bench fit``; None if it is not installed."""
    return next(iter(implementations_of_packages("fit").values()), None)


def make_watch_learner(detector: str) -> Any:
    """A learner that uses a detector; the default one of ``bench fit`` for ``""``."""
    values = arguments_of_label("detector", detector) if detector else {}
    return find_watch_learner()(values)
