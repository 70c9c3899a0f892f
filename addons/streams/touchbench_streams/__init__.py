"""Endless streams: systems that find touches in recordings and in frames as they come."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

FALSE_ALARMS = (
    5.0  # per hour of background, which are accepted on training subjects unless told otherwise
)
NO_TOUCH = "notouch"  # class of background, where captures have it and no other is named
DETECTOR = "frames"  # that of bench watch, unless told otherwise
RATES = (1, 5, 10, 60)  # false alarms per hour of background, at which missed touches are counted


def watch(**values: object) -> pd.DataFrame:
    """Run ``bench watch`` with its keys, and return a row per run."""
    from bench.commands.run import run_from_python

    return run_from_python("watch", values)
