"""The detector `frames`: a classifier of ticks, and hysteresis whose times are learned from the labels."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from scipy.special import expit
from sklearn.linear_model import LogisticRegression
from threadpoolctl import threadpool_limits

from bench.corpora.faults import seeded_generator
from bench.errors import InputError
from touchbench_streams.detectors.base import DetectorC, Sign
from touchbench_streams.detectors.detector import (
    Detector,
    average_into_ticks,
    count_frames_per_tick,
    held_out_units,
    read_c_beside,
    score_levels,
    sweep_levels,
)
from touchbench_streams.detectors.signals import (
    CALM,
    CALMEST,
    CHANGES,
    COMMON,
    HIGHEST,
    LEVELS,
    MAXIMA,
    MEDIAN,
    MINIMA,
    PACES,
    RISES,
    Levels,
    measure_disturbance,
    tick_features,
)
from touchbench_streams.disturbed import KINDS, disturb_recordings
from touchbench_streams.recordings import Recordings

OFFSET = 0.3  # of a logarithm, in units of the median of training touches
CLIP = 6.0  # SDs of a feature
AGES = 3  # ticks of the beginning of a touch
SHORT = 0.1  # share of touches, or gaps, that may be shorter
SEEN = 0.75  # of such a touch is seen at least: its beginning is noticed late; chosen on A to C
FADED = 0.25  # of the highest log-odds of a touch: below, it is over after `hold` seconds; chosen on HAART
BEGUN = -2.0  # log-odds of the beginning of a touch, without which none is reported; chosen on HAART and A to C
MARGIN = 1.5  # how much more disturbed than in training a sensor may be before the other classifier decides
SLIGHT = 3e-4  # of full scale: a sensor that is disturbed less counts as calm; below the gauge of 0.5 % on HAART
IMPOSSIBLE = -1e30  # log of the share of a class that training did not have
GROUPS = "3"  # of training recordings for the threshold of that classifier
BLOCK = 1000  # ticks at once, which bounds memory
MANY = 8  # recordings, or subjects, from which on each kind of disturbance is learned from some of them, to save time


@dataclass(frozen=True)
class TouchTimes:
    """Times that are learned from the labels, in ticks.

    Attributes:
        wait: ticks that a touch has held at its report, fewer than asked for where one touch in ten is nearly as short.
        hold: ticks without touch before a touch is over: half of the gap that one in ten is shorter than, or what
            was asked for, where that is less.
        fade: ticks of weak evidence before a touch is over.
    """

    wait: int
    hold: int
    fade: int

    @classmethod
    def learn_from(cls, recordings: Recordings, wait: float, hold: float) -> TouchTimes:
        """Learn from recordings whose frames are ticks; ``wait`` and ``hold`` are the most seconds of each."""
        events, rate_hz = recordings.events, recordings.corpus.rate_hz
        start, end, recording = (events[name].to_numpy() for name in ("start", "end", "recording"))
        gaps = (start[1:] - end[:-1])[recording[1:] == recording[:-1]]
        near = np.quantile(gaps, SHORT) / 2 if len(gaps) else np.inf
        short = SEEN * np.quantile(end - start, SHORT)
        waits, holds = round(wait * rate_hz), round(hold * rate_hz)
        return cls(max(1, int(min(waits, short))), max(1, int(min(holds, near))), max(1, holds))


class Hysteresis:
    """A touch begins with a tick above a level, and is over when some are below a lower one; for many levels at once.

    It begins only where the classifier has seen its beginning, and is also over when the evidence has faded: background
    whose level has changed keeps some. It is reported at the first tick that is not below the lower level, once it has
    lasted ``times.wait`` ticks. What is over before is no touch.

    Args:
        levels: log-odds of touch.
        drop: distance of the lower level.
        times: learned.
    """

    def __init__(self, levels: np.ndarray, drop: float, times: TouchTimes) -> None:
        self.levels, self.drop, self.times, self.begun = levels, drop, times, 0
        self.since, self.held, self.below, self.weak = np.zeros((4, len(levels)), np.int64)
        self.highest, self.lasts, self.due = (
            np.zeros(len(levels)),
            *np.zeros((2, len(levels)), bool),
        )

    def step(self, evidence: np.ndarray) -> Sign:
        """Take the evidence of a tick; the sign of the first level."""
        report = self.step_levels(evidence)[0]
        odds, lasts = float(evidence[0]), report or self.lasts[0]
        return Sign(
            float(expit(odds - self.levels[0])), int(self.since[0]) if lasts else 0, bool(report)
        )

    def step_levels(self, evidence: np.ndarray) -> np.ndarray:
        """Take the evidence of a tick; which levels report a touch, bool [levels]."""
        odds, begins = map(float, evidence[:2])
        self.begun = AGES - 1 if begins > BEGUN else self.begun - 1
        starts = ~self.lasts & (odds > self.levels) & (self.begun > 0)
        self.since = np.where(self.lasts, self.since + 1, 1)
        self.highest = np.where(self.lasts, np.maximum(self.highest, odds), odds)
        self.below = np.where(self.lasts & (odds < self.levels - self.drop), self.below + 1, 0)
        self.held = np.where(self.below > 0, self.held, self.since)
        self.weak = np.where(self.lasts & (odds < FADED * self.highest), self.weak + 1, 0)
        self.due = self.lasts & self.due | starts
        self.lasts = (
            self.lasts & (self.below < self.times.hold) & (self.weak < self.times.fade) | starts
        )
        report = self.due & (self.held >= self.times.wait)
        self.due = self.due & ~report
        return report


@dataclass
class Frames(Detector):
    """A logistic classifier of ticks (background, beginning, rest of a touch) and hysteresis with learned times.

    Args:
        tick: seconds of a tick, at least one frame. Default: chosen on recordings of a skin at 7 Hz.
        up: seconds in which the baseline of a taxel follows a higher reading; much longer than a touch. Default: a
            touch of a minute is rare.
        down: seconds in which it follows a lower one. Default: shorter than most gaps.
        wait: most seconds of a touch before its report; fewer where training touches are shorter. Default: chosen on
            HAART, for the first label.
        hold: most seconds without touch before a touch is over; fewer where training gaps are shorter. Default: a pat
            every second is one touch.
        drop: log-odds between the level that begins a touch and the one that ends it. Default: chosen on recordings of
            that skin.
    """

    tick: float = 0.125
    up: float = 60.0
    down: float = 2.0
    wait: float = 0.7
    hold: float = 1.0
    drop: float = 2.0

    levels: ClassVar[np.ndarray] = np.arange(-3, 6.25, 0.25)
    memory: ClassVar[int] = 62

    def signals(self) -> Levels:
        """Signals of a new stream."""
        return Levels(
            self.tick / self.up,
            self.tick / self.down,
            [min(1.0, self.tick / pace) for pace in PACES],
        )

    def signals_of(self, ticks: np.ndarray) -> np.ndarray:
        """Many ticks at once."""
        signals = self.signals()
        return np.concatenate(
            [signals.step_many(ticks[i : i + BLOCK]) for i in range(0, len(ticks), BLOCK)]
        )

    def fit(self, signals: list[np.ndarray], recordings: Recordings) -> Self:
        """Fit the classifier, count the times."""
        fitted = replace(self)
        ages = [touch_ages(recordings[[i]]) for i in range(len(recordings))]
        every = np.concatenate(signals)
        age, length = (np.concatenate([each[k] for each in ages]) for k in (0, 1))
        touched = age > 0
        if touched.all() or not touched.any():
            lacking = "background" if touched.any() else "touch"
            raise InputError(
                f"detector=frames: a part of the training recordings has no {lacking}; record some"
            )
        sizes = np.abs(np.concatenate([every[:, :LEVELS], every[:, -CHANGES:]], axis=1))
        fitted.offsets_ = OFFSET * np.median(sizes[touched], axis=0) + 1e-6
        fitted.idle_ = np.median(every[~touched, :LEVELS], axis=0).astype(np.float32)
        table = np.concatenate(
            [tick_features(each, fitted.offsets_, fitted.idle_) for each in signals]
        )
        classes = np.where(~touched, 0, np.where(age <= AGES, 1, 2))
        weight = np.where(touched, np.sqrt(np.minimum(1, 2 * AGES / np.maximum(length, 1))), 1.0)
        fitted.mean_, fitted.sd_ = table.mean(axis=0), table.std(axis=0) + 1e-6
        with threadpool_limits(
            1
        ):  # products are so small that waiting for each other takes most of the time
            fitted.model_ = LogisticRegression(C=0.03, max_iter=300).fit(
                fitted._standardise(table), classes, weight
            )
        shares = np.array([weight[classes == k].sum() for k in fitted.model_.classes_])
        fitted.prior_ = np.log(shares / shares.sum())
        fitted.times_ = TouchTimes.learn_from(recordings, self.wait, self.hold)
        calm = np.max([measure_disturbance(each).max(axis=0) for each in signals], axis=0)
        fitted.limits_ = np.maximum(MARGIN * calm, SLIGHT * recordings.corpus.full_scale)
        fitted.disturbed_ = ()
        return fitted

    def fit_disturbed(
        self, others: list[Self], recordings: Recordings, level: float, false_alarms: float
    ) -> Self:
        """The same with a classifier for noise and one for vibration, each if it is worth more there.

        Each is learned from copies of recordings with such a disturbance, and has a threshold of its own, by which its
        log-odds are shifted.
        """
        hard = copy(self)
        parts = [np.arange(len(recordings))] * len(KINDS)
        if len(set(held_out_units(recordings))) >= MANY:
            parts = np.array_split(
                seeded_generator("disturbed recordings").permutation(len(recordings)), len(KINDS)
            )
        count = count_frames_per_tick(self.tick, recordings.corpus.rate_hz)
        for kind, (change, part) in enumerate(zip(KINDS, parts, strict=True)):
            few = np.sort(part)
            some = recordings[few]
            ticks = average_into_ticks(
                Recordings(disturb_recordings(some.corpus, change), some.events), count
            )
            signals = [self.signals_of(ticks.corpus[i]) for i in range(len(ticks))]
            plain = [others[i] for i in few]
            evidence = [other.evidence(each) for other, each in zip(plain, signals, strict=True)]
            before = score_levels(
                sweep_levels(plain, some, evidence, count, np.array([level])), false_alarms
            ).max()
            fitted, evidence = self.fit_held_out(signals, ticks, GROUPS)
            settings = sweep_levels(fitted, some, evidence, count, self.levels)
            worths = score_levels(settings, false_alarms)
            if worths.max() > before:
                shift = level - float(settings["level"][worths.idxmax()])
                hard.disturbed_ = *hard.disturbed_, (kind, replace(self).fit(signals, ticks), shift)
        return hard

    def _standardise(self, table: np.ndarray) -> np.ndarray:
        return np.clip((table - self.mean_) / self.sd_, -CLIP, CLIP)

    def evidence(self, signals: np.ndarray) -> np.ndarray:
        """Log-odds of touch, and of its beginning, as if all classes were equally frequent, and `refused` [ticks, 3].

        Where the sensor is disturbed, they are those of the classifier for that disturbance. Noise goes first.
        """
        odds, gauges = self._log_odds(signals), measure_disturbance(signals)
        for kind, other, shift in self.disturbed_:
            unlike = gauges[:, [kind]] > self.limits_[kind]
            if unlike.any():
                odds = np.where(unlike, other._log_odds(signals) + [shift, 0], odds)
        return np.column_stack([odds, (gauges > self._disturbance_limits).any(axis=1)])

    def find_refused(self, evidence: np.ndarray) -> np.ndarray:
        """Whether the sensor is more than 1.5 times as disturbed as in all that any classifier learned from."""
        return evidence[:, 2] > 0

    @property
    def _disturbance_limits(self) -> np.ndarray:
        """How disturbed the sensor may be by each of `KINDS`."""
        return np.max([self.limits_, *(other.limits_ for _, other, _ in self.disturbed_)], axis=0)

    def _log_odds(self, signals: np.ndarray) -> np.ndarray:
        scores = self.model_.decision_function(
            self._standardise(tick_features(signals, self.offsets_, self.idle_))
        )
        likely = (
            np.stack([0 * scores, scores], axis=1) if scores.ndim == 1 else scores
        ) - self.prior_
        touch = np.logaddexp.reduce(likely[:, 1:], axis=1) - likely[:, 0]
        begun = likely[:, 1] - np.logaddexp.reduce(
            likely[:, [0, *range(2, likely.shape[1])]], axis=1
        )
        return np.stack([touch, begun], axis=1)

    def rules(self, level: float) -> Hysteresis:
        """Rules of a new stream."""
        return Hysteresis(np.array([level]), self.drop, self.times_)

    def find_reports(self, evidence: np.ndarray, levels: np.ndarray) -> list[np.ndarray]:
        """All levels at once."""
        rules = Hysteresis(levels, self.drop, self.times_)
        return [
            np.flatnonzero(each)
            for each in np.stack([rules.step_levels(tick) for tick in evidence]).T
        ]

    @property
    def soonest(self) -> int:
        """As of `Detector`; learned."""
        return self.times_.wait

    @property
    def latest(self) -> int:
        """As of `Detector`; learned."""
        return self.times_.wait + self.times_.hold

    def in_c(self) -> DetectorC:
        """As `touchbench_streams.detectors.detector.Detector.in_c`."""
        models = [self, *(other for _, other, _ in self.disturbed_)]
        classes = max(len(one.prior_) for one in models)
        learned = [one._linear_weights(classes) for one in models]
        looks = {
            "MINIMA": "{" + ", ".join(map(str, MINIMA)) + "}",
            "MAXIMA": "{" + ", ".join(map(str, MAXIMA)) + "}",
            "LOOK": max(*MINIMA, *MAXIMA) + 1,
            "MEDIAN": MEDIAN,
            "RISES": RISES,
            "LEVELS": LEVELS,
            "CHANGES": CHANGES,
            "LOOKS": len(self.mean_),
            "KINDS": classes,
            "MODELS": len(models),
            "CALM": CALM,
            "CALMEST": int(CALMEST * CALM),
            "KIND_OF": "{" + ", ".join(str(kind) for kind, _, _ in self.disturbed_) + "}",
        }
        constants = (
            (
                "Signals of a tick: which quantile all taxels share, how many are highest, how the baseline follows.",
                {
                    "COMMON": COMMON,
                    "HIGHEST": HIGHEST,
                    "UP": self.tick / self.up,
                    "DOWN": self.tick / self.down,
                },
            ),
            (
                "Looks of a classifier at the last ticks, in ticks; its features and classes.",
                looks | {"CLIP": CLIP},
            ),
            (
                "Rules of a touch, in log-odds and ticks; times are learned.",
                {
                    "DROP": self.drop,
                    "BEGUN": BEGUN,
                    "AGES": AGES,
                    "FADED": FADED,
                    "WAIT": self.times_.wait,
                    "HOLD": self.times_.hold,
                    "FADE": self.times_.fade,
                },
            ),
        )
        arrays = {
            "offsets": np.concatenate([one.offsets_[:LEVELS] for one in models]),
            "paces": self.signals().paces,
            "sizes": np.concatenate([one.offsets_[LEVELS:] for one in models]),
            "idle": np.concatenate([one.idle_ for one in models]),
            "mean": np.concatenate([one.mean_ for one in models]),
            "sd": np.concatenate([one.sd_ for one in models]),
            "weights": np.concatenate([weights.ravel() for weights, _ in learned]),
            "bias": np.concatenate([bias for _, bias in learned]),
            "shift": [0.0, *(shift for _, _, shift in self.disturbed_)],
            "most": self._disturbance_limits,
            **({"limits": self.limits_} if self.disturbed_ else {}),
        }
        state = (
            "float baseline[{TAXELS}], above[{TAXELS}];  /* of the last tick */",
            f"float slow[{len(PACES)}][{{TAXELS}}];  /* slow means */",
            "float logs[{MODELS}][{LOOK}][{LEVELS}], area, row, col;  /* rings; of the last tick */",
            "float means[{LOOK}][{CHANGES} / 3];  /* a ring: mean of the readings less each slow mean */",
            "int model;  /* the classifier that decides */",
            "int at, looked;  /* place in the rings, ticks in them */",
            "int since, below, weak, begun, held, lasts, is_known;  /* ticks of the touch; whether it was reported */",
            "float highest;  /* log-odds of the touch */",
            "float calm[2][{CALM}], shared;  /* rings: changes of what taxels share, movement; last tick */",
            "int calmed;  /* place in these rings */",
        )
        return DetectorC(
            read_c_beside(__file__),
            state,
            constants,
            arrays={
                f"look_{name}": np.asarray(values, np.float32) for name, values in arrays.items()
            },
            pretended="w->level = touched ? -1e30f : 1e30f; w->begun = 9;",
        )

    def _linear_weights(self, classes: int) -> tuple[np.ndarray, np.ndarray]:
        """Weights [classes, features] and biases of the classes; one that was not there in training is impossible."""
        weights, bias = self.model_.coef_, self.model_.intercept_
        if len(weights) == 1:  # of two classes; the first one scores 0
            weights, bias = np.concatenate([0 * weights, weights]), np.append(0, bias)
        more = classes - len(bias)
        return np.pad(weights, ((0, more), (0, 0))), np.append(
            bias - self.prior_, np.full(more, IMPOSSIBLE)
        )

    @property
    def chosen(self) -> dict[str, object]:
        """The learned times in ticks."""
        return {"wait": self.times_.wait, "hold": self.times_.hold, "fade": self.times_.fade}

    @property
    def numbers(self) -> int:
        """Count of learned numbers."""
        own = self.model_.coef_.size + 3 + 2 * len(self.mean_) + 2 * LEVELS + CHANGES + 5
        return own + sum(other.numbers + 2 for _, other, _ in self.disturbed_)


def touch_ages(recording: Recordings) -> tuple[np.ndarray, np.ndarray]:
    """Ticks since the touch of each tick began, itself included, and the length of the touch; 0 without touch."""
    age, length = (np.zeros(int(recording.corpus.lengths[0]), np.int64) for _ in range(2))
    for start, end in zip(recording.events["start"], recording.events["end"], strict=True):
        age[start:end], length[start:end] = np.arange(1, end - start + 1), end - start
    return age, length
