"""Detectors that decide tick by tick: what they define, and how a threshold is chosen."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.models.search.inner_folds import split_subjects
from bench.values.few import FEWEST_FOR_INTERVAL
from touchbench_streams.detectors.base import DetectorC, Rules, Signals
from touchbench_streams.detectors.spans import average_blocks
from touchbench_streams.events import DOUBTFUL, FALSE_ALARM, assign_touches
from touchbench_streams.recordings import Recordings

PRICE = 0.001  # share of touches that a false alarm per hour above the target costs; chosen on sittings A to C
REPEATS = 0.2  # share of touches that a report per touch above `SPARE` costs; chosen there, too
SPARE = 1.15  # reports per touch that cost nothing


def read_c_beside(path: str) -> str:
    """The C beside a Python file."""
    return Path(path).with_suffix(".c").read_text(encoding="utf-8")


class Detector:
    """A detector of touch before training, and fitted; a tick is a frame of a slow skin, or the mean of several.

    It is a dataclass whose fields are its parameters (``detector.tick=``), and is named in
    `touchbench_streams.detectors.PARTS`, or as ``detector=my.py:Mine``.

    Attributes:
        tick: seconds of a tick; at least one frame.
        levels: thresholds to choose among, from the most eager to the strictest.
        memory: ticks that the evidence of one tick looks back.
        soonest: ticks of a touch before its report, at least.
        latest: the same, at most.
        numbers: count of learned numbers.
        chosen: what training has chosen, by name.
    """

    tick: float = 0.125
    levels: ClassVar[np.ndarray]
    memory: ClassVar[int] = 1
    soonest: ClassVar[int] = 1
    latest: ClassVar[int] = 1
    numbers: ClassVar[int] = 0
    chosen: ClassVar[dict[str, object]] = {}

    def __post_init__(self) -> None:
        """Refuse times and distances that are not above 0."""
        for name, value in vars(self).items():
            if isinstance(value, float) and not 0 < value < np.inf:
                raise InputError(f"detector.{name}={value:g}: give a number above 0")

    def signals(self) -> Signals:
        """Signals of a new stream."""
        raise NotImplementedError

    def fit(self, signals: list[np.ndarray], recordings: Recordings) -> Self:
        """Learn from the signals of recordings whose frames are ticks."""
        raise NotImplementedError

    def fit_disturbed(
        self, others: list[Self], recordings: Recordings, level: float, false_alarms: float
    ) -> Self:
        """The same, fitted, and prepared for a sensor that changes after training; unchanged unless overridden.

        Args:
            others: detectors that were fitted without each recording.
            recordings: training recordings, after the steps that are done frame by frame.
            level: learned threshold.
            false_alarms: accepted false alarms per hour of background.
        """
        return self

    def evidence(self, signals: np.ndarray) -> np.ndarray:
        """What the signals of each tick and those before it say [ticks, ...]."""
        raise NotImplementedError

    def find_refused(self, evidence: np.ndarray) -> np.ndarray:
        """Whether the sensor is unlike all that it learned from, bool [ticks]; never unless overridden."""
        return np.zeros(len(evidence), bool)

    def rules(self, level: float) -> Rules:
        """Rules of a new stream."""
        raise NotImplementedError

    def signals_of(self, ticks: np.ndarray) -> np.ndarray:
        """Signals of a recording whose frames are ticks [ticks, signals]."""
        signals = self.signals()
        return np.stack([signals.step(frame) for frame in ticks])

    def find_reports(self, evidence: np.ndarray, levels: np.ndarray) -> list[np.ndarray]:
        """In which ticks of a recording the rules of each level report a touch."""
        return [
            np.flatnonzero(run_rules(self.rules(float(level)), evidence)[:, 2]) for level in levels
        ]

    def in_c(self) -> DetectorC | None:
        """What the C of a fitted detector needs; None where it has none. Classes do not inherit it.

        It defines ``static sign_t sensed(touch_watch_t *w, const float *tick)``: the sign of a tick, from the readings
        of its frames, a mean. It may work in ``w->now.taxels`` and ``w->now.features``.
        """
        return None

    def fit_held_out(
        self, signals: list[np.ndarray], ticks: Recordings, folds: str
    ) -> tuple[list[Self], list[np.ndarray]]:
        """The detector that is fitted without each recording, and its evidence of it."""
        detectors, evidence = [self] * len(signals), [np.zeros(0)] * len(signals)
        for train, judged in split_subjects(held_out_units(ticks), folds):
            fitted = copy(self).fit([signals[i] for i in train], ticks[train])
            for i in judged:
                detectors[i], evidence[i] = fitted, fitted.evidence(signals[i])
        return detectors, evidence


def count_frames_per_tick(tick: float, rate_hz: float) -> int:
    """Frames of a tick of so many seconds."""
    return max(1, round(tick * rate_hz))


def average_into_ticks(recordings: Recordings, count: int) -> Recordings:
    """Recordings whose frames are means of so many frames; a rest at the end is left out."""
    corpus = recordings.corpus
    streams = [average_blocks(corpus[i], count) for i in range(len(corpus))]
    ticks = Corpus.from_captures(
        streams, corpus.captures, corpus.rate_hz / count, full_scale=corpus.full_scale
    )
    start, end = recordings.events["start"] // count, -(-recordings.events["end"] // count)
    lengths = ticks.lengths[recordings.events["recording"]]
    start = np.minimum(start, lengths - 1)
    events = recordings.events.assign(
        start=start, end=np.minimum(np.maximum(end, start + 1), lengths)
    )
    return Recordings(ticks, events)


def run_rules(rules: Rules, evidence: np.ndarray) -> np.ndarray:
    """The signs of new rules over one recording, float64 [ticks, 3]."""
    return np.array([rules.step(each) for each in evidence], dtype=np.float64).reshape(-1, 3)


def sweep_levels(
    detectors: Sequence[Detector],
    recordings: Recordings,
    evidence: list[np.ndarray],
    count: int,
    levels: np.ndarray,
) -> pd.DataFrame:
    """Touches found and alarms at each level of a threshold, over recordings with a fitted detector each.

    Columns ``level``, ``alarms``, ``hours`` (of background), ``found`` (share), ``hits`` and ``reports`` (counts; of
    reports, those outside of doubtful stretches).
    """
    rate_hz = recordings.corpus.rate_hz
    hours = int(recordings.background_frames().sum()) / rate_hz / 3600
    reported = [
        one.find_reports(series, levels) for one, series in zip(detectors, evidence, strict=True)
    ]
    parts = [(i, k, ticks) for i, each in enumerate(reported) for k, ticks in enumerate(each)]
    recording, place = np.repeat(
        [part[:2] for part in parts], [len(part[2]) for part in parts], axis=0
    ).T
    frames = (np.concatenate([part[2] for part in parts]) + 1) * count
    reports = pd.DataFrame({"recording": recording, "reported": frames})
    touch = assign_touches(recordings.events, reports, rate_hz, doubtful=recordings.doubtful)
    once = np.unique(np.stack([place, touch])[:, touch >= 0], axis=1)[
        0
    ]  # a touch counts once at each level
    told = place[touch == FALSE_ALARM], once, place[touch != DOUBTFUL]
    alarms, hits, counted = (np.bincount(each, minlength=len(levels)) for each in told)
    found = hits / max(len(recordings.events), 1)
    columns = {
        "level": levels,
        "alarms": alarms,
        "hours": hours,
        "found": found,
        "hits": hits,
        "reports": counted,
    }
    return pd.DataFrame(columns)


def score_levels(settings: pd.DataFrame, false_alarms: float) -> pd.Series:
    """The share of touches that each level finds, less what alarms above the target and repeated reports cost."""
    hours = settings["hours"].replace(0, np.nan)  # without background, rates are unknown
    excess = (settings["alarms"] / hours - false_alarms).fillna(0).clip(lower=0)
    per_touch = (settings["reports"] - settings["alarms"]) / settings["hits"].clip(lower=1)
    return settings["found"] - PRICE * excess - REPEATS * (per_touch - SPARE).clip(lower=0)


def choose_operating_points(
    settings: pd.DataFrame, learned: float
) -> tuple[tuple[float, float, float, float], ...]:
    """Operating points of a sweep: the learned level, and those that find more than all with as few alarms."""
    rows = settings.sort_values(
        ["alarms", "found", "level"], ascending=[True, False, False], kind="stable"
    )
    better = rows[
        rows["found"] > rows["found"].cummax().shift(fill_value=-1.0)
    ]  # of equal ones the strictest
    kept = settings[
        settings["level"].isin(better["level"]) | np.isclose(settings["level"], learned)
    ]
    kept = kept.sort_values("level", ascending=False)
    return tuple(
        tuple(map(float, row)) for row in kept[["level", "alarms", "hours", "found"]].to_numpy()
    )


def held_out_units(recordings: Recordings) -> np.ndarray:
    """What is left out together for the choice of the threshold: subjects, or single recordings of few subjects.

    A classifier of one subject fewer than few is another one, whose evidence has another scale. Parts of one recording
    stay together (`touchbench_streams.recordings.restore_recordings`).
    """
    subjects = recordings.subjects.astype(str)
    if len(set(subjects)) >= FEWEST_FOR_INTERVAL:
        return subjects
    numbers = recordings.corpus.captures.get("recording", pd.Series(np.arange(len(recordings))))
    return pd.factorize(numbers)[0].astype(str)
