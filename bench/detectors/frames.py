"""The detector `frames`: a classifier of ticks, and a filter whose times are learned from the labels."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from sklearn.linear_model import LogisticRegression

from bench.corpora.recordings import Recordings
from bench.detectors.base import Sign
from bench.detectors.ticks import Detector

COMMON = 0.4  # quantile over taxels that a change of all taxels moves, too
HIGHEST = 25  # one of so many taxels is among the highest
OFFSET = 0.1  # of a logarithm, in units of the median of training touches
MINIMA, MAXIMA, MEDIAN = (1, 2, 4, 10, 40), (2, 5, 15, 60), 30  # ticks that features look back
CLIP = 6.0  # SDs of a feature
AGES = 3  # ticks of the beginning of a touch
LEVELS = 3  # signals that are levels: mean, excess, highest


class Levels:
    """Signals of a frame: its levels, how much of the skin it covers, where, and how it changes."""

    def __init__(self, up: float, down: float) -> None:
        self.up, self.down = np.float32(up), np.float32(down)
        self.baseline: np.ndarray | None = None
        self.before: deque[np.ndarray] = deque(maxlen=3)

    def step(self, frame: np.ndarray) -> np.ndarray:
        """Mean, mean excess over the baseline, mean of the highest taxels, effective area, cosines, centroid."""
        flat = np.asarray(frame, np.float32).ravel()
        if len(flat) > 1:
            flat = np.maximum(flat - np.partition(flat, int(COMMON * len(flat)))[int(COMMON * len(flat))], 0)
        if self.baseline is None:
            self.baseline = flat.copy()
        above = flat - self.baseline
        self.baseline += np.where(above > 0, self.up, self.down) * above
        above = np.maximum(above, 0)
        few = max(1, len(flat) // HIGHEST)
        highest = np.partition(above, len(above) - few)[-few:].mean()
        total, squares = above.sum(), (above * above).sum()
        area = total * total / squares / len(flat) if squares else 0.0
        near, far = (self._cosine(above, back) for back in (1, 3))
        rows, cols = np.divmod(np.arange(len(flat)), frame.shape[1])
        y, x = ((above * where).sum() / total if total else 0.0 for where in (rows, cols))
        self.before.append(above)
        size = max(frame.shape)
        return np.array([flat.mean(), above.mean(), highest, area, near, far, y / size, x / size], np.float32)

    def _cosine(self, above: np.ndarray, back: int) -> float:
        if len(self.before) < back:
            return 1.0
        old = self.before[-back]
        length = float(np.sqrt((above @ above) * (old @ old)))
        return float(above @ old) / length if length else 1.0


def features(signals: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """What the classifier sees of each tick, from the signals of this tick and those before it [ticks, features].

    Args:
        signals: result of `Levels`, one recording [ticks, signals].
        offsets: added to each level before its logarithm is taken.
    """
    logs = np.log(signals[:, :LEVELS] + offsets)
    columns = []
    for level in logs.T:
        columns.append(level)
        columns += [level - _past(minimum_filter1d, level, back + 1) for back in MINIMA]
        columns += [level - _past(maximum_filter1d, level, back + 1) for back in MAXIMA]
        columns.append(level - _median(level, MEDIAN))
    change = np.diff(logs[:, 1], prepend=logs[:1, 1])
    rise, fall = np.maximum(change, 0), np.maximum(-change, 0)
    columns += [rise, fall, rise - _median(rise, MEDIAN), fall - _median(fall, MEDIAN)]
    columns.append(_past(maximum_filter1d, rise, 8))
    area = signals[:, 3]
    columns += [area, np.diff(area, prepend=area[:1]), signals[:, 4], signals[:, 5]]
    speed = np.abs(np.diff(signals[:, 6:8], axis=0, prepend=signals[:1, 6:8])).sum(axis=1)
    columns.append(speed)
    return np.stack(columns, axis=1).astype(np.float32)


def _past(kind, series, size):  # noqa
    """A filter over the last so many ticks."""
    return kind(series, size, origin=(size - 1) // 2, mode="nearest")


def _median(series, size):  # noqa
    padded = np.concatenate([np.full(size - 1, series[0], series.dtype), series])
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, size), axis=1)


@dataclass(frozen=True)
class Times:
    """How touches begin and end, counted on labels, per tick.

    Attributes:
        start: touches that begin, per tick of background.
        end: touches that end, by age: of those of 1, 2 and more ticks.
        follow: share of touches that follow another one without a gap.
    """

    start: float
    end: tuple[float, ...]
    follow: float

    @classmethod
    def of(cls, recordings: Recordings) -> Times:
        """Count on recordings whose frames are ticks; half a touch more than there were, so nothing is impossible."""
        events = recordings.events
        length = (events["end"] - events["start"]).to_numpy()
        ends = []
        for age in range(1, AGES):
            ends.append((0.5 * 0.2 + (length == age).sum()) / (0.5 + (length >= age).sum()))
        late = np.maximum(length - AGES + 1, 0)
        ends.append((0.1 + (late > 0).sum()) / (0.5 + late.sum()))
        quiet = int(recordings.background_frames().sum())
        same = events["recording"].to_numpy()[1:] == events["recording"].to_numpy()[:-1]
        follow = (same & (events["start"].to_numpy()[1:] == events["end"].to_numpy()[:-1])).sum()
        return cls(
            float((len(events) - follow + 0.5) / (quiet + 1)),
            tuple(map(float, ends)),
            float((follow + 0.5) / (len(events) + 1)),
        )


class States:
    """A filter over seven states: background, and touches of 1, 2 and more ticks, new or reported.

    A touch is reported when a new one of at least two ticks is more probable than the level; from then on it is a
    reported one. A dip and a rise make a new one, so touches may follow one another without a gap.
    """

    def __init__(self, level: float, times: Times, wait: int) -> None:
        self.level, self.times, self.wait = level, times, wait
        self.p = np.zeros(1 + 2 * AGES)
        self.p[0] = 1.0
        self.since, self.new, self.reported = 0, 0, False
        end, ages = np.array(times.end), AGES
        move = np.zeros((1 + 2 * ages, 1 + 2 * ages))  # from, to
        move[0, 0], move[0, 1] = 1 - times.start, times.start
        for first in (1, 1 + ages):
            for age in range(ages):
                at = first + age
                move[at, first + min(age + 1, ages - 1)] += 1 - end[age]
                move[at, 0] += end[age] * (1 - times.follow)
                move[at, 1] += end[age] * times.follow
        self.move = move

    def step(self, evidence: np.ndarray) -> Sign:
        """Take the log-likelihoods of background, beginning and rest of a touch."""
        likely = np.exp(evidence - evidence.max())
        of_touch = np.array([likely[1]] * (AGES - 1) + [max(likely[1], likely[2])])
        prior = self.p @ self.move
        self.p = prior * np.concatenate([likely[:1], of_touch, of_touch])
        self.p /= self.p.sum()
        fresh = self.p[1 : 1 + AGES]
        touch = 1 - self.p[0]
        self.new = self.new + 1 if fresh.sum() > 0.5 * self.level else 0
        report = bool(fresh[self.wait - 1 :].sum() > self.level)
        if report:
            self.p[1 + AGES :] += fresh
            self.p[1 : 1 + AGES] = 0
            self.since, self.new, self.reported = max(self.new, self.wait), 0, True
        elif self.reported:
            self.reported = touch > 0.5
            self.since = self.since + 1 if self.reported else 0
        return Sign(float(touch), self.since, report)


@dataclass
class Frames(Detector):
    """A logistic classifier of ticks (background, beginning, rest of a touch) and a filter with learned times.

    Args:
        tick: seconds of a tick, at least one frame. Default: chosen on recordings of a skin at 7 Hz.
        up: seconds in which the baseline follows a higher reading: much longer than a touch.
        down: seconds in which it follows a lower one: shorter than most gaps.
        wait: ticks of a new touch before its report, 1 to 3. Default: chosen on sittings A to C.
    """

    tick: float = 0.125
    up: float = 60.0
    down: float = 2.0
    wait: int = 2

    levels: ClassVar[np.ndarray] = 1 / (1 + np.exp(-np.linspace(-6, 6, 33)))
    memory: ClassVar[int] = 62

    def signals(self) -> Levels:
        """Signals of a new stream."""
        return Levels(self.tick / self.up, self.tick / self.down)

    def fit(self, signals: list[np.ndarray], recordings: Recordings) -> Self:
        """Fit the classifier, count the times."""
        fitted = replace(self)
        ages = [ages_of(recordings[[i]]) for i in range(len(recordings))]
        every = np.concatenate(signals)
        age, length = (np.concatenate([each[k] for each in ages]) for k in (0, 1))
        touched = age > 0
        fitted.offsets_ = OFFSET * np.median(every[touched, :LEVELS], axis=0) + 1e-6
        table = np.concatenate([features(each, fitted.offsets_) for each in signals])
        classes = np.where(~touched, 0, np.where(age <= AGES, 1, 2))
        weight = np.where(touched, np.sqrt(np.minimum(1, 2 * AGES / np.maximum(length, 1))), 1.0)
        fitted.mean_, fitted.sd_ = table.mean(axis=0), table.std(axis=0) + 1e-6
        fitted.model_ = LogisticRegression(C=0.03, max_iter=300).fit(fitted._units(table), classes, weight)
        shares = np.array([weight[classes == k].sum() for k in fitted.model_.classes_])
        fitted.prior_ = np.log(shares / shares.sum())
        fitted.times_ = Times.of(recordings)
        return fitted

    def _units(self, table: np.ndarray) -> np.ndarray:
        return np.clip((table - self.mean_) / self.sd_, -CLIP, CLIP)

    def evidence(self, signals: np.ndarray) -> np.ndarray:
        """Log-likelihoods of background, beginning and rest of a touch."""
        return self.model_.predict_log_proba(self._units(features(signals, self.offsets_))) - self.prior_

    def rules(self, level: float) -> States:
        """Rules of a new stream."""
        return States(level, self.times_, self.wait)

    @property
    def numbers(self) -> int:
        """Count of learned numbers."""
        return self.model_.coef_.size + 3 + 2 * len(self.mean_) + LEVELS + AGES + 2


def ages_of(recording: Recordings) -> tuple[np.ndarray, np.ndarray]:
    """Ticks since the touch of each tick began, itself included, and the length of the touch; 0 without touch."""
    age, length = (np.zeros(int(recording.corpus.lengths[0]), np.int64) for _ in range(2))
    for start, end in zip(recording.events["start"], recording.events["end"], strict=True):
        age[start:end], length[start:end] = np.arange(1, end - start + 1), end - start
    return age, length
