"""The detector `filter`: a classifier of windows, and a filter over its log-odds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus
from bench.corpora.recordings import Recordings
from bench.endless.watcher import Watcher
from bench.endless.watcher_training import learned


@dataclass
class Filter:
    """Linear discriminants on touch features of windows of 0.45 s, and a filter with two states; can be exported as C.

    The recogniser names a touch from its own windows, of 0.75 s if it has none.
    """

    def learn(
        self,
        make_system: Callable[[], contract.System],
        system: contract.System,
        captures: Corpus,
        recordings: Recordings,
        false_alarms: float,
    ) -> tuple[Watcher, pd.DataFrame]:
        """A watcher, and its table of biases; arguments of `bench.endless.detectors.base.Detects`."""
        return learned(system, recordings, false_alarms)
