"""The detector `frames`: a classifier of ticks, and hysteresis with learned times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from scipy.special import expit
from sklearn.linear_model import LogisticRegression
from threadpoolctl import threadpool_limits

from bench.corpora.faults import seeded_generator
from bench.corpora.windows import Step
from bench.errors import InputError
from bench.models.recipe import apply_steps
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
    CHANGED,
    CHANGES,
    COMMON,
    HIGHEST,
    LEVELS,
    MAXIMA,
    MEDIAN,
    MINIMA,
    PACES,
    RISES,
    SLOW,
    Levels,
    measure_disturbance,
    tick_features,
)
from touchbench_streams.disturbed import KINDS, add_vibration, disturb_recordings
from touchbench_streams.recordings import Recordings

OFFSET = 0.3  # of a logarithm, in units of the median of training touches
CLIP = 6.0  # SDs of a feature
AGES = 3  # ticks of the beginning of a touch
SHORT = 0.1  # share of touches, or gaps, that may be shorter
# Share of such a touch that is seen at least, as its beginning is noticed late; chosen on A to C.
SEEN = 0.75
# Share of a touch's highest log-odds below which it is over after `hold` seconds; chosen on HAART.
FADED = 0.25
# Log-odds of a beginning, without which no touch is reported; chosen on HAART and A to C.
BEGUN = -2.0
# Log-odds of a beginning that end a reported touch, if those of touch exceed its highest by a
# factor and a summand; chosen on HAART and CuddleBot. Touches were lost in weak false alarms.
BEGINS, GROWN, JUMP = 0.0, 1.5, 2.0
# How much more disturbed than in training a sensor may be before the other classifier decides.
MARGIN = 1.5
# Most seconds of a touch before its report where another classifier decides, whose evidence of weak
# touches comes and goes; chosen on HAART.
SOON = 0.5
FAINTEST = 0.05  # quantile of the disturbance in its training above which that classifier decides
# Of full scale: a sensor that is disturbed less counts as calm; below the gauge of 0.5 % on HAART.
SLIGHT = 3e-4
IMPOSSIBLE = -1e30  # log of the share of a class that training did not have
GROUPS = "3"  # of training recordings for the threshold of that classifier
BLOCK = 1000  # ticks at once, which bounds memory
MOST_SIGNS = 10_000_000  # of recordings at once, for all levels, which bounds memory
# Recordings, or subjects, from which on each kind of disturbance is learned from a part, for time.
MANY = 8


@dataclass(frozen=True)
class TouchTimes:
    """Times learned from the labels, in ticks.

    Attributes:
        wait: ticks that a touch has lasted at its report; fewer than the parameter if one touch in
            ten is nearly as short.
        hold: ticks without touch before a touch is over: half of the 10 % quantile of gaps, or the
            parameter if that is less.
        fade: ticks of weak evidence before a touch is over.
    """

    wait: int
    hold: int
    fade: int

    @classmethod
    def learn_from(cls, recordings: Recordings, wait: float, hold: float) -> TouchTimes:
        """Learn from recordings of ticks; ``wait`` and ``hold`` are upper bounds in seconds."""
        events, rate_hz = recordings.events, recordings.corpus.rate_hz
        start, end, recording = (events[name].to_numpy() for name in ("start", "end", "recording"))
        gaps = (start[1:] - end[:-1])[recording[1:] == recording[:-1]]
        half_gap = np.quantile(gaps, SHORT) / 2 if len(gaps) else np.inf
        short_touch = SEEN * np.quantile(end - start, SHORT)
        most_wait, most_hold = round(wait * rate_hz), round(hold * rate_hz)
        return cls(
            wait=max(1, int(min(most_wait, short_touch))),
            hold=max(1, int(min(most_hold, half_gap))),
            fade=max(1, most_hold),
        )


class Hysteresis:
    """Touches between a higher and a lower level, for many levels at once.

    A touch begins with a tick above a level, and is over after some ticks below a lower one. It
    begins only if the classifier has seen its beginning. It is also over when the evidence has
    faded, because background whose level has changed keeps some, and when a much clearer one begins
    after its report; that one counts from the next tick. It is reported at the first tick
    that is not below the lower level once it has lasted as many ticks as the evidence says. What is
    over earlier is no touch.

    Args:
        levels: log-odds of touch.
        drop: distance of the lower level.
        times: learned times, for each of some streams at once.
    """

    def __init__(self, levels: np.ndarray, drop: float, *times: TouchTimes) -> None:
        self.levels, self.drop = levels, drop
        self.hold, self.fade = np.array([(one.hold, one.fade) for one in times]).T[..., None]
        shape = len(times), len(levels)
        self.begun = np.zeros((len(times), 1), np.int64)
        self.since, self.held, self.below, self.weak = np.zeros((4, *shape), np.int64)
        self.highest = np.zeros(shape)
        self.lasts, self.due = np.zeros((2, *shape), bool)

    def step(self, evidence: np.ndarray) -> Sign:
        """Take the evidence of a tick of the only stream; return the sign of the only level."""
        since, report = self.step_levels(evidence[None].astype(np.float64))
        touch = float(expit(float(evidence[0]) - self.levels[0]))
        return Sign(touch, int(since.item()), bool(report.item()))

    def step_levels(self, evidence: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Take the evidence of a tick of each stream [streams, 4].

        Returns:
            Ticks since a touch began, and whether it is reported [streams, levels] each.
        """
        odds, begins, _, wait = evidence.T[..., None]
        self.begun = np.where(begins > BEGUN, AGES - 1, self.begun - 1)
        is_clearer = ~self.due & (begins > BEGINS) & (odds > GROWN * self.highest + JUMP)
        starts = ~self.lasts & (odds > self.levels) & (self.begun > 0)
        self.since = np.where(self.lasts, self.since + 1, 1)
        self.highest = np.where(self.lasts, np.maximum(self.highest, odds), odds)
        self.below = np.where(self.lasts & (odds < self.levels - self.drop), self.below + 1, 0)
        self.held = np.where(self.below > 0, self.held, self.since)
        self.weak = np.where(self.lasts & (odds < FADED * self.highest), self.weak + 1, 0)
        self.due = self.lasts & self.due | starts
        is_over = (self.below >= self.hold) | (self.weak >= self.fade) | is_clearer
        self.lasts = self.lasts & ~is_over | starts
        report = self.due & (self.held >= wait)
        self.due = self.due & ~report
        return np.where(report | self.lasts, self.since, 0), report


@dataclass
class Frames(Detector):
    """A logistic classifier of ticks and hysteresis with learned times.

    Its classes are background, the beginning of a touch and the rest of it.

    Args:
        tick: seconds of a tick, at least one frame. Default: chosen on recordings of a skin at
            7 Hz.
        up: seconds in which the baseline of a taxel follows a higher reading; much longer than a
            touch. Default: a touch of a minute is rare.
        down: seconds in which it follows a lower one. Default: shorter than most gaps.
        wait: most seconds of a touch before its report; fewer if training touches are shorter.
            Default: chosen on HAART, for the first label.
        hold: most seconds without touch before a touch is over; fewer if training gaps are
            shorter. Default: a pat every second is one touch.
        drop: log-odds between the level that begins a touch and the one that ends it. Default:
            chosen on recordings of that skin.
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
        paces = [min(1.0, self.tick / pace) for pace in PACES]
        return Levels(self.tick / self.up, self.tick / self.down, paces)

    def signals_of(self, ticks: np.ndarray) -> np.ndarray:
        """As of `Detector`; many ticks at once."""
        signals, firsts = self.signals(), range(0, len(ticks), BLOCK)
        return np.concatenate([signals.step_many(ticks[i : i + BLOCK]) for i in firsts])

    def fit(self, signals: list[np.ndarray], recordings: Recordings) -> Self:
        """Fit the classifier, and learn times and limits of disturbance."""
        fitted = replace(self)
        age, length = np.concatenate(
            [touch_ages(recordings[[i]]) for i in range(len(recordings))], axis=1
        )
        is_touch = age > 0
        if is_touch.all() or not is_touch.any():
            missing = "background" if is_touch.any() else "touch"
            raise InputError(
                f"detector=frames: a part of the training recordings has no {missing}; record some"
            )
        all_signals = np.concatenate(signals)
        sizes = np.abs(all_signals[:, [*range(LEVELS), *range(CHANGED, CHANGED + CHANGES)]])
        fitted.offsets_ = OFFSET * np.median(sizes[is_touch], axis=0) + 1e-6
        fitted.idle_ = np.median(all_signals[~is_touch, :LEVELS], axis=0).astype(np.float32)
        fitted.slight_ = SLIGHT * recordings.corpus.full_scale
        features = np.concatenate([fitted._features(series) for series in signals])
        classes = np.where(~is_touch, 0, np.where(age <= AGES, 1, 2))
        weight = np.where(is_touch, np.sqrt(np.minimum(1, 2 * AGES / np.maximum(length, 1))), 1.0)
        fitted.mean_, fitted.sd_ = features.mean(axis=0), features.std(axis=0) + 1e-6
        model = LogisticRegression(C=0.03, max_iter=300)
        with threadpool_limits(1):  # products are so small that threads mostly wait for each other
            fitted.model_ = model.fit(fitted._standardise(features), classes, weight)
        shares = np.array([weight[classes == k].sum() for k in fitted.model_.classes_])
        fitted.prior_ = np.log(shares / shares.sum())
        fitted.times_ = TouchTimes.learn_from(recordings, self.wait, self.hold)
        gauges = [measure_disturbance(series).max(axis=0) for series in signals]
        calm = np.max(gauges, axis=0)
        fitted.calm_ = calm
        fitted.limits_ = np.maximum(MARGIN * calm, fitted.slight_)
        fitted.disturbed_ = ()
        return fitted

    def fit_disturbed(
        self,
        others: list[Self],
        recordings: Recordings,
        steps: Sequence[Step],
        level: float,
        false_alarms: float,
    ) -> Self:
        """Add a classifier for vibration and two for noise, each if it improves the score there.

        Each is learned from copies of recordings with such a disturbance, and has its own
        threshold, by which its log-odds are shifted.
        """
        prepared, quick = copy(self), replace(self, wait=min(self.wait, SOON))
        half = np.arange(len(recordings))
        if len(set(held_out_units(recordings))) >= MANY:
            half = seeded_generator("disturbed recordings").permutation(half)[: len(half) // 2]
        count = count_frames_per_tick(self.tick, recordings.corpus.rate_hz)
        for kind, gauge in KINDS.items():
            used = np.sort(half) if kind is add_vibration else np.arange(len(recordings))
            part, calm_detectors = recordings[used], [others[i] for i in used]
            disturbed = apply_steps(disturb_recordings(part.corpus, kind), [*steps])[0]
            ticks = average_into_ticks(Recordings(disturbed, part.events), count)
            signals = [self.signals_of(ticks.corpus[i]) for i in range(len(ticks))]
            pairs = zip(calm_detectors, signals, strict=True)
            evidence = [detector.evidence(series) for detector, series in pairs]
            before = sweep_levels(calm_detectors, part, evidence, count, np.array([level]))
            detectors, evidence = quick.fit_held_out(signals, ticks, GROUPS)
            sweep = sweep_levels(detectors, part, evidence, count, self.levels)
            scores = score_levels(sweep, false_alarms)
            if scores.max() > score_levels(before, false_alarms).max():
                shift = level - float(sweep["level"][scores.idxmax()])
                limit = prepared._limit_of_kind(gauge, signals)
                fitted = replace(quick).fit(signals, ticks)
                prepared.disturbed_ = *prepared.disturbed_, (gauge, fitted, shift, limit)
        return prepared

    def _limit_of_kind(self, gauge: int, signals: list[np.ndarray]) -> float:
        """How disturbed a sensor is at least where the next classifier decides."""
        gauges = np.concatenate([measure_disturbance(series)[CALM:, gauge] for series in signals])
        faintest = float(np.quantile(gauges, FAINTEST)) if len(gauges) else np.inf
        if any(gauge == other for other, *_ in self.disturbed_):
            return faintest
        return float(np.clip(faintest, self.calm_[gauge], self.limits_[gauge]))

    def _features(self, signals: np.ndarray) -> np.ndarray:
        return tick_features(signals, self.offsets_, self.idle_, self.slight_)

    def _standardise(self, table: np.ndarray) -> np.ndarray:
        return np.clip((table - self.mean_) / self.sd_, -CLIP, CLIP)

    def evidence(self, signals: np.ndarray) -> np.ndarray:
        """Evidence of each tick [ticks, 4].

        It is log-odds of touch and of its beginning, whether the tick is refused, and how many
        ticks a touch lasts before its report. Log-odds are as if all classes were equally frequent.
        If the sensor is disturbed, they are those of the classifier for that disturbance; noise
        takes precedence.
        """
        odds, gauges = self._log_odds(signals), measure_disturbance(signals)
        wait = np.full((len(signals), 1), self.times_.wait)
        for gauge, other, shift, limit in self.disturbed_:
            is_disturbed = gauges[:, [gauge]] > limit
            if is_disturbed.any():
                odds = np.where(is_disturbed, other._log_odds(signals) + [shift, 0], odds)
                wait = np.where(is_disturbed, other.times_.wait, wait)
        return np.column_stack([odds, (gauges > self._disturbance_limits).any(axis=1), wait])

    def find_refused(self, evidence: np.ndarray) -> np.ndarray:
        """Whether the sensor is `MARGIN` times as disturbed as in training, bool [ticks]."""
        return evidence[:, 2] > 0

    @property
    def _disturbance_limits(self) -> np.ndarray:
        """Most disturbance of the sensor by each gauge that is not refused."""
        return np.max([self.limits_, *(other.limits_ for _, other, *_ in self.disturbed_)], axis=0)

    def _log_odds(self, signals: np.ndarray) -> np.ndarray:
        """Log-odds of touch and of its beginning by this classifier alone [ticks, 2]."""
        features = self._standardise(self._features(signals))
        scores = self.model_.decision_function(features)
        if scores.ndim == 1:  # two classes; the first one scores 0
            scores = np.stack([0 * scores, scores], axis=1)
        scores = scores - self.prior_
        not_beginning = scores[:, [0, *range(2, scores.shape[1])]]
        touch = np.logaddexp.reduce(scores[:, 1:], axis=1) - scores[:, 0]
        beginning = scores[:, 1] - np.logaddexp.reduce(not_beginning, axis=1)
        return np.stack([touch, beginning], axis=1)

    def rules(self, level: float) -> Hysteresis:
        """Rules of a new stream."""
        return Hysteresis(np.array([level]), self.drop, self.times_)

    @classmethod
    def find_signs(
        cls, detectors: Sequence[Self], evidence: Sequence[np.ndarray], levels: np.ndarray
    ) -> Iterator[np.ndarray]:
        """As of `Detector`; many recordings and all levels at once."""
        if cls.rules is not Frames.rules:  # a subclass decides otherwise
            yield from super().find_signs(detectors, evidence, levels)
            return
        for part in _group_lengths([len(series) for series in evidence], len(levels)):
            lengths = [len(series) for series in evidence[part]]
            padded = np.zeros((max(lengths), len(lengths), 4))
            for i, series in enumerate(evidence[part]):
                padded[: len(series), i] = series
            times = (detector.times_ for detector in detectors[part])
            rules = Hysteresis(levels, detectors[0].drop, *times)
            since, report = zip(*map(rules.step_levels, padded), strict=True)
            for i, length in enumerate(lengths):
                touch = expit(padded[:length, i, :1] - levels)
                signs = (np.stack([tick[i] for tick in each[:length]]) for each in (since, report))
                yield np.stack([touch, *signs], axis=-1)

    @property
    def soonest(self) -> int:
        """As of `Detector`; learned."""
        return min([self.times_.wait, *(other.times_.wait for _, other, *_ in self.disturbed_)])

    @property
    def latest(self) -> int:
        """As of `Detector`; learned."""
        return self.times_.wait + self.times_.hold

    def in_c(self) -> DetectorC:
        """As of `touchbench_streams.detectors.detector.Detector`."""
        models = [self, *(other for _, other, *_ in self.disturbed_)]
        classes = max(len(model.prior_) for model in models)
        weights, biases = zip(*(model._linear_weights(classes) for model in models), strict=True)
        signal_constants = {
            "COMMON": COMMON,
            "HIGHEST": HIGHEST,
            "MEANS": len(PACES),
            "UP": self.tick / self.up,
            "DOWN": self.tick / self.down,
        }
        feature_constants = {
            "MINIMA": "{" + ", ".join(map(str, MINIMA)) + "}",
            "MAXIMA": "{" + ", ".join(map(str, MAXIMA)) + "}",
            "LOOK": max(*MINIMA, *MAXIMA) + 1,
            "MEDIAN": MEDIAN,
            "RISES": RISES,
            "LEVELS": LEVELS,
            "CHANGES": CHANGES,
            "SLOW": SLOW,
            "LEAST_NOISE": self.slight_,
            "LOOKS": len(self.mean_),
            "KINDS": classes,
            "MODELS": len(models),
            "CALM": CALM,
            "CALMEST": int(CALMEST * CALM),
            "GAUGE_OF": "{" + ", ".join(str(gauge) for gauge, *_ in self.disturbed_) + "}",
            "CLIP": CLIP,
        }
        rule_constants = {
            "DROP": self.drop,
            "BEGUN": BEGUN,
            "AGES": AGES,
            "BEGINS": BEGINS,
            "GROWN": GROWN,
            "JUMP": JUMP,
            "FADED": FADED,
            "HOLD": self.times_.hold,
            "FADE": self.times_.fade,
        }
        constants = (
            (
                "Signals of a tick: which quantile all taxels share, how many are highest, how the "
                "baseline follows.",
                signal_constants,
            ),
            (
                "Looks of a classifier at the last ticks, in ticks; its features and classes.",
                feature_constants,
            ),
            ("Rules of a touch, in log-odds and ticks; times are learned.", rule_constants),
        )
        arrays = {
            "offsets": np.concatenate([model.offsets_[:LEVELS] for model in models]),
            "paces": self.signals().paces,
            "sizes": np.concatenate([model.offsets_[LEVELS:] for model in models]),
            "idle": np.concatenate([model.idle_ for model in models]),
            "mean": np.concatenate([model.mean_ for model in models]),
            "sd": np.concatenate([model.sd_ for model in models]),
            "weights": np.concatenate([of_model.ravel() for of_model in weights]),
            "bias": np.concatenate(biases),
            "shift": [0.0, *(shift for _, _, shift, _ in self.disturbed_)],
            "wait": [float(model.times_.wait) for model in models],
            "most": self._disturbance_limits,
        }
        if self.disturbed_:
            arrays["limits"] = [limit for *_, limit in self.disturbed_]
        state = (
            "float baseline[{TAXELS}], above[{TAXELS}];  /* of the last tick */",
            "float slow[{MEANS}][{TAXELS}];  /* slow means */",
            "float logs[{MODELS}][{LOOK}][{LEVELS}], area, row, col;  "
            "/* rings; of the last tick */",
            "float means[{LOOK}][{SLOW}];  /* a ring: mean of the readings less each slow mean */",
            "int model;  /* the classifier that decides */",
            "int at, looked;  /* place in the rings, ticks in them */",
            "int since, below, weak, begun, held, lasts, is_known;  "
            "/* ticks of the touch; whether it was reported */",
            "float highest;  /* log-odds of the touch */",
            "float calm[2][{CALM}], shared, noise;  "
            "/* rings: changes of what taxels share, movement; last tick; least movement */",
            "int calmed;  /* place in these rings */",
        )
        arrays = {f"look_{name}": np.asarray(v, np.float32) for name, v in arrays.items()}
        pretended = "w->level = touched ? -1e30f : 1e30f; w->begun = 9;"
        return DetectorC(
            read_c_beside(__file__), state, constants, arrays=arrays, pretended=pretended
        )

    def _linear_weights(self, classes: int) -> tuple[np.ndarray, np.ndarray]:
        """Weights [classes, features] and biases; classes that training lacked are impossible."""
        weights, bias = self.model_.coef_, self.model_.intercept_
        if len(weights) == 1:  # two classes; the first one scores 0
            weights, bias = np.concatenate([0 * weights, weights]), np.append(0, bias)
        missing = classes - len(bias)
        biases = np.append(bias - self.prior_, np.full(missing, IMPOSSIBLE))
        return np.pad(weights, ((0, missing), (0, 0))), biases

    @property
    def chosen(self) -> dict[str, object]:
        """As of `Detector`: the learned times in ticks."""
        return {"wait": self.times_.wait, "hold": self.times_.hold, "fade": self.times_.fade}

    @property
    def numbers(self) -> int:
        """As of `Detector`, with those of classifiers for a disturbed sensor."""
        numbers = self.model_.coef_.size + 3 + 2 * len(self.mean_) + 2 * LEVELS + CHANGES + 5
        return numbers + sum(other.numbers + 4 for _, other, *_ in self.disturbed_)


def touch_ages(recording: Recordings) -> tuple[np.ndarray, np.ndarray]:
    """Age of the touch in each tick, from 1, and its length; 0 without touch."""
    age, length = (np.zeros(int(recording.corpus.lengths[0]), np.int64) for _ in range(2))
    for start, end in zip(recording.events["start"], recording.events["end"], strict=True):
        age[start:end], length[start:end] = np.arange(1, end - start + 1), end - start
    return age, length


def _group_lengths(lengths: Sequence[int], levels: int) -> Iterator[slice]:
    """Yield slices of recordings that are as long as each other, more or less, and not too long."""
    first = 0
    for i in range(1, len(lengths) + 1):
        group = lengths[first : i + 1]
        padded = len(group) * max(group)
        if i == len(lengths) or padded > min(2 * sum(group), MOST_SIGNS / levels):
            yield slice(first, i)
            first = i
