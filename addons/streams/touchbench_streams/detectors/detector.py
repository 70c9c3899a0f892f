"""The base of detectors, which decide tick by tick, and the choice of their threshold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.windows import Step
from bench.errors import InputError
from bench.models.search.inner_folds import split_subjects
from bench.values.few import FEWEST_FOR_INTERVAL
from touchbench_streams.detectors.base import DetectorC, Rules, Signals
from touchbench_streams.detectors.spans import average_blocks
from touchbench_streams.events import DOUBTFUL, FALSE_ALARM, assign_touches
from touchbench_streams.recordings import Recordings

# In shares of touches; chosen on sittings A to C.
ALARM_PENALTY = 0.001  # for each false alarm per hour above the target
REPEAT_PENALTY = 0.2  # for each report per touch above `FREE_REPORTS`
FREE_REPORTS = 1.15  # per touch


def read_c_beside(path: str) -> str:
    """Read the C file beside a Python file."""
    return Path(path).with_suffix(".c").read_text(encoding="utf-8")


class Detector:
    """A detector of touch, before training or fitted.

    It decides once per tick, which is a frame of a slow skin, or the mean of several frames. It is
    a dataclass whose fields are its parameters (``detector.tick=``), named in
    `touchbench_streams.detectors.PARTS` or as ``detector=my.py:Mine``.

    Attributes:
        tick: seconds of a tick; at least one frame.
        levels: thresholds to choose among, from the most eager to the strictest.
        memory: ticks on which the evidence of one tick depends.
        soonest: fewest ticks from the start of a touch to its report.
        latest: most ticks from the start of a touch to its report.
        numbers: count of learned numbers.
        chosen: values chosen in training, by name.
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
        self,
        others: list[Self],
        recordings: Recordings,
        steps: Sequence[Step],
        level: float,
        false_alarms: float,
    ) -> Self:
        """Prepare the fitted detector for a sensor that changes after training.

        It is returned unchanged unless overridden.

        Args:
            others: a detector for each recording that was fitted without it.
            recordings: training recordings as the sensor gives them.
            steps: those that work frame by frame, which follow.
            level: learned threshold.
            false_alarms: accepted false alarms per hour of background.
        """
        return self

    def evidence(self, signals: np.ndarray) -> np.ndarray:
        """Evidence of touch in each tick, from its signals and earlier ones [ticks, ...]."""
        raise NotImplementedError

    def find_refused(self, evidence: np.ndarray) -> np.ndarray:
        """Whether the sensor is unlike all training, bool [ticks]; never unless overridden."""
        return np.zeros(len(evidence), bool)

    def rules(self, level: float) -> Rules:
        """Rules of a new stream."""
        raise NotImplementedError

    def signals_of(self, ticks: np.ndarray) -> np.ndarray:
        """Signals of a recording whose frames are ticks [ticks, signals]."""
        signals = self.signals()
        return np.stack([signals.step(frame) for frame in ticks])

    @classmethod
    def find_signs(
        cls, detectors: Sequence[Self], evidence: Sequence[np.ndarray], levels: np.ndarray
    ) -> Iterator[np.ndarray]:
        """Yield the signs of each recording at each level, float64 [ticks, levels, 3].

        Args:
            detectors: the detector of each recording.
            evidence: of each recording.
            levels: thresholds.
        """
        for detector, series in zip(detectors, evidence, strict=True):
            rules = [detector.rules(float(level)) for level in levels]
            yield np.stack([run_rules(each, series) for each in rules], axis=1)

    def in_c(self) -> DetectorC | None:
        """The C of a fitted detector; None if it has none. Subclasses do not inherit it.

        It defines ``static sign_t sensed(touch_watch_t *w, const float *tick)``: the sign of a
        tick, from the mean readings of its frames. It may use ``w->now.taxels`` and
        ``w->now.features`` as buffers.
        """
        return None

    def fit_held_out(
        self, signals: list[np.ndarray], ticks: Recordings, folds: str
    ) -> tuple[list[Self], list[np.ndarray]]:
        """For each recording, a detector fitted without it, and that detector's evidence."""
        detectors, evidence = [self] * len(signals), [np.zeros(0)] * len(signals)
        for train, left_out in split_subjects(held_out_units(ticks), folds):
            fitted = copy(self).fit([signals[i] for i in train], ticks[train])
            for i in left_out:
                detectors[i], evidence[i] = fitted, fitted.evidence(signals[i])
        return detectors, evidence


def count_frames_per_tick(tick: float, rate_hz: float) -> int:
    """Number of frames of a tick of so many seconds; at least 1."""
    return max(1, round(tick * rate_hz))


def average_into_ticks(recordings: Recordings, count: int) -> Recordings:
    """Recordings whose frames are means of ``count`` frames; a rest at the end is dropped."""
    corpus = recordings.corpus
    streams = [average_blocks(corpus[i], count) for i in range(len(corpus))]
    ticks = Corpus.from_captures(
        streams, corpus.captures, corpus.rate_hz / count, full_scale=corpus.full_scale
    )
    events = recordings.events
    lengths = ticks.lengths[events["recording"]]
    start = np.minimum(events["start"] // count, lengths - 1)
    end = np.minimum(np.maximum(-(-events["end"] // count), start + 1), lengths)
    return Recordings(ticks, events.assign(start=start, end=end))


def run_rules(rules: Rules, evidence: np.ndarray) -> np.ndarray:
    """The signs of new rules over one recording, float64 [ticks, 3]."""
    return np.array([rules.step(tick) for tick in evidence], dtype=np.float64).reshape(-1, 3)


def sweep_levels(
    detectors: Sequence[Detector],
    recordings: Recordings,
    evidence: list[np.ndarray],
    count: int,
    levels: np.ndarray,
) -> pd.DataFrame:
    """Count touches found and alarms at each level of a threshold.

    Args:
        detectors: a fitted detector for each recording.
        recordings: recordings with events.
        evidence: of each recording, by its detector.
        count: frames of a tick.
        levels: thresholds.

    Returns:
        Columns ``level``, ``alarms``, ``hours`` (of background), ``found`` (share), ``hits`` and
        ``reports`` (counts; reports in doubtful stretches are left out).
    """
    rate_hz = recordings.corpus.rate_hz
    hours = int(recordings.background_frames().sum()) / rate_hz / 3600
    rows, ticks = [], []  # of all reports: recording and position of the level; their tick
    for i, signs in enumerate(detectors[0].find_signs(detectors, evidence, levels)):
        of_level, reported = np.nonzero(signs[..., 2].T)
        rows.append(np.stack([np.full_like(of_level, i), of_level]))
        ticks.append(reported)
    recording, level = np.concatenate(rows, axis=1)
    frames = (np.concatenate(ticks) + 1) * count
    reports = pd.DataFrame({"recording": recording, "reported": frames})
    touch = assign_touches(recordings.events, reports, rate_hz, doubtful=recordings.doubtful)
    hits = np.unique(np.stack([level, touch])[:, touch >= 0], axis=1)  # once at each level
    hit_counts = np.bincount(hits[0], minlength=len(levels))
    columns = {
        "level": levels,
        "alarms": np.bincount(level[touch == FALSE_ALARM], minlength=len(levels)),
        "hours": hours,
        "found": hit_counts / max(len(recordings.events), 1),
        "hits": hit_counts,
        "reports": np.bincount(level[touch != DOUBTFUL], minlength=len(levels)),
    }
    return pd.DataFrame(columns)


def score_levels(sweep: pd.DataFrame, false_alarms: float) -> pd.Series:
    """Share of touches found at each level, less penalties for alarms and repeated reports."""
    hours = sweep["hours"].replace(0, np.nan)  # without background, rates are unknown
    excess = (sweep["alarms"] / hours - false_alarms).fillna(0).clip(lower=0)
    per_touch = (sweep["reports"] - sweep["alarms"]) / sweep["hits"].clip(lower=1)
    repeats = (per_touch - FREE_REPORTS).clip(lower=0)
    return sweep["found"] - ALARM_PENALTY * excess - REPEAT_PENALTY * repeats


def choose_operating_points(
    sweep: pd.DataFrame, learned: float
) -> tuple[tuple[float, float, float, float], ...]:
    """Operating points of a sweep, from the strictest to the most eager.

    They are the learned level, and those that find more than all with as few alarms.
    """
    rows = sweep.sort_values(  # of equal ones the strictest comes first
        ["alarms", "found", "level"], ascending=[True, False, False], kind="stable"
    )
    most_found = rows["found"].cummax().shift(fill_value=-1.0)
    better = rows[rows["found"] > most_found]
    is_kept = sweep["level"].isin(better["level"]) | np.isclose(sweep["level"], learned)
    points = sweep[is_kept].sort_values("level", ascending=False)
    columns = ["level", "alarms", "hours", "found"]
    return tuple(tuple(map(float, row)) for row in points[columns].to_numpy())


def held_out_units(recordings: Recordings) -> np.ndarray:
    """Names of the units that are left out together: subjects, or recordings of few subjects.

    With one of few subjects left out, a classifier changes so much that its evidence has another
    scale. Parts of one recording stay together
    (`touchbench_streams.recordings.restore_recordings`).
    """
    subjects = recordings.subjects.astype(str)
    if len(set(subjects)) >= FEWEST_FOR_INTERVAL:
        return subjects
    numbers = recordings.corpus.captures.get("recording", pd.Series(np.arange(len(recordings))))
    return pd.factorize(numbers)[0].astype(str)
