"""The detector `best`: the better of `filter` and `frames` on recordings that each was not fitted to."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus
from bench.corpora.recordings import Recordings
from bench.endless.detectors.base import Watches
from bench.endless.detectors.filter import Filter
from bench.endless.detectors.frames import Frames
from bench.endless.detectors.ticks import learned, trial_of, worth
from bench.errors import InputError


@dataclass
class Best:
    """The better of `filter` and `frames` in each fold, on training recordings that each was not fitted to.

    Each is worth the share of touches that its best threshold finds, less the price of false alarms and of repeated
    reports (`bench.endless.detectors.ticks.worth`); where both are worth the same, `frames` is taken, which is sooner.
    Where one of them cannot learn from the recordings, the other is taken.
    """

    def learn(
        self,
        make_system: Callable[[], contract.System],
        system: contract.System,
        captures: Corpus,
        recordings: Recordings,
        false_alarms: float,
    ) -> tuple[Watches, pd.DataFrame]:
        """The better watcher, and the thresholds of both; arguments of `bench.endless.detectors.base.Detects`."""
        settings: dict[str, pd.DataFrame] = {}
        with suppress(InputError):
            trial = trial_of(Frames(), system, recordings)
            settings["frames"] = trial.settings
        try:
            watcher, settings["filter"] = Filter().learn(make_system, system, captures, recordings, false_alarms)
        except InputError:
            if not settings:
                raise
        tables = []
        for name, table in settings.items():
            counted = table.assign(hits=table["found"] * len(recordings.events))
            tables.append(table.assign(detector=name, worth=worth(counted, false_alarms)))
        both = pd.concat(tables, ignore_index=True)
        if both.loc[both["worth"].idxmax(), "detector"] == "filter":
            return watcher, both
        return learned(Frames(), make_system, system, recordings, false_alarms, trial), both
