"""Endless streams: systems that find touches in recordings and in live frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

FALSE_ALARMS = 5.0  # accepted in training per hour of background, by default
NO_TOUCH = "notouch"  # default class of background, if captures have it
DETECTOR = "frames"  # default of bench watch
RATES = (1, 5, 10, 60)  # false alarms per hour of background at which missed touches are counted


def watch(**values: object) -> pd.DataFrame:
    """Run ``bench watch`` with its keys; return a row per run."""
    from bench.commands.run import run_from_python

    return run_from_python("watch", values)
