"""Learn to watch a stream with a detector and a recogniser, and watch it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus
from bench.corpora.windows import Step
from bench.errors import InputError
from bench.models.recipe import apply_steps, split_causal_steps
from bench.models.sizes import count_parameters
from bench.models.steps import STEP_MEMORY, Repair
from touchbench_streams.detectors.base import UNKNOWN, DetectorC, Event
from touchbench_streams.detectors.detector import (
    Detector,
    choose_operating_points,
    count_frames_per_tick,
    read_c_beside,
    sweep_levels,
)
from touchbench_streams.detectors.learning import load_or_learn_detector
from touchbench_streams.detectors.names import (
    LONGEST_S,
    fit_names,
    longest_part,
    name_probabilities,
)
from touchbench_streams.detectors.pace import MOST, NO_PACE, Pace, span_features
from touchbench_streams.detectors.spans import (
    GROWTH,
    Span,
    Touches,
    average_blocks,
    find_spans,
)
from touchbench_streams.detectors.status import (
    NO_LIMITS,
    NOISE,
    SATURATED,
    Health,
    Limits,
    check_frame,
    watch_health,
)
from touchbench_streams.events import report_table
from touchbench_streams.recent import Recent, find_saturated
from touchbench_streams.recordings import Recordings


def learn_watcher(
    detector: Detector,
    make_system: Callable[[], contract.System],
    system: contract.System,
    recordings: Recordings,
    false_alarms: float,
) -> tuple[TickWatcher, pd.DataFrame]:
    """Learn to watch from recordings of training subjects.

    The detector is learned once for all systems (`touchbench_streams.detectors.learning`).

    Args:
        detector: before training.
        make_system: makes a new system.
        system: fitted to captures of the same subjects.
        recordings: cut where doubtful stretches were.
        false_alarms: accepted per hour of background.

    Returns:
        The watcher, and the sweep of thresholds (`sweep_levels`).
    """
    steps, steps_of_names = steps_of_detector(system), split_causal_steps(system)[0]
    learned = load_or_learn_detector(detector, recordings, steps, steps_of_names, false_alarms)
    watcher = TickWatcher(
        system,
        fit_names(make_system, recordings),
        learned.detector,
        learned.level,
        count_frames_per_tick(detector.tick, recordings.corpus.rate_hz),
        points=choose_operating_points(learned.sweep, learned.level),
        limits=learned.limits,
        pace=learned.pace,
    )
    return watcher, learned.sweep


def steps_of_detector(system: contract.System) -> list[Step]:
    """Causal steps before a detector, which measures the noise: all that are before its filter."""
    before: list[Step] = []
    for step in split_causal_steps(system)[0]:
        if isinstance(step, Repair) and "noise" in step.kinds:
            others = tuple(kind for kind in step.kinds if kind != "noise")
            return [*before, *[Repair(others)][: len(others)]]
        before.append(step)
    return before


@dataclass(frozen=True, eq=False)
class Sensed:
    """Touches that a watcher has found in recordings, before it names them.

    Attributes:
        recordings: as the sensor gave them.
        stepped: the same after the steps before names.
        evidence: of each recording, by the detector.
        signs: of each recording, float64 [ticks, 3].
        touches: of each recording.
    """

    recordings: Corpus
    stepped: Corpus
    evidence: list[np.ndarray]
    signs: list[np.ndarray]
    touches: list[list[Span]]


@dataclass(eq=False)
class TickWatcher:
    """A fitted system and a detector that learned from recordings.

    Its output depends on the current frame and earlier ones, and its memory does not grow. A touch
    is named when it is reported, from its frames so far, and again as it grows.

    Attributes:
        system: fitted to captures.
        names: the system that names touches, fitted to beginnings and to whole touches.
        detector: fitted to training recordings.
        level: threshold, learned for a number of false alarms per hour.
        count: frames of a tick.
        reject: confidence below which a label is ``unknown``; 0 for never.
        points: operating points from the strictest to the most eager: level, and on training
            recordings false alarms, hours of background and share of touches found.
        slices: frames over which the C spreads the work of a tick, so that news come later by one
            frame less; at most the frames of a tick.
    """

    system: contract.System
    names: contract.System
    detector: Detector
    level: float
    count: int
    reject: float = 0.0
    points: tuple[tuple[float, float, float, float], ...] = ()
    slices: int = 1
    limits: Limits = NO_LIMITS
    pace: Pace = NO_PACE

    @property
    def delay(self) -> int:
        """Frames between a tick and its news, which times contain."""
        return self.slices - 1

    @property
    def numbers(self) -> int:
        """Count of learned numbers besides those of the system."""
        namer, system = (split_causal_steps(one)[1] for one in (self.names, self.system))
        return self.detector.numbers + count_parameters(namer) - count_parameters(system)

    @property
    def chosen(self) -> dict[str, object]:
        """Values chosen in training, by name."""
        learned = {"level": self.level, "reject": self.reject} | self.detector.chosen
        return {"detector": type(self.detector).__name__.lower()} | learned

    @property
    def soonest(self) -> int:
        """Fewest frames from the start of a touch, in the last frame of a tick, to its report."""
        return (self.detector.soonest - 1) * self.count + 1 + self.delay

    def open_stream(self, grid: tuple[int, int], rate_hz: float, full_scale: float) -> TickStream:
        """Start watching a stream frame by frame."""
        return TickStream(self, grid, rate_hz, full_scale)

    def in_c(self, classes: list[str], rate_hz: float) -> DetectorC | None:
        """The C of the detector and of the names; None if the detector has none."""
        if "in_c" not in vars(type(self.detector)):  # a subclass may compute something else
            return None
        of_detector = self.detector.in_c()
        if of_detector is None:
            return None
        if not 1 <= self.slices <= self.count:
            raise InputError(f"slices={self.slices}: give 1 to {self.count}, the frames of a tick")
        longest, namer = longest_part(rate_hz, self.count), split_causal_steps(self.names)[1]
        part = max(longest, self.detector.latest + 1)
        sizes = {"TICK": self.count, "SLICES": self.slices, "DELAY": self.delay}
        sizes |= {"PART_TICKS": longest, "NAMED": len(namer.classes_)}
        naming = {"GROWTH": GROWTH, "REJECT": self.reject}
        state = (
            "int within, length, first, named, sure, after;  "
            "/* frames of the tick; ticks of the part and its names */",
            "int is_reported, label;  /* of the touch that lasts */",
            "int is_over, is_new, is_sure, is_lasting, is_grown;  /* what the last tick shows */",
            "int stage, step, spent, until, odd;  /* work done on it; its frames */",
            "uint32_t reported, end;  /* frames; modulo 2^32 */",
            "float due, weight, sum[{NAMED}], last[{NAMED}];  "
            "/* next name; of the names so far; of that at the end */",
        )
        if self.count > 1:
            state = ("float tick[{TAXELS}];  /* sum of its frames */", *state)
        classes_of_names = np.searchsorted(classes, namer.classes_.astype(str)).astype(np.int8)
        limits, limit_arrays = self.limits.in_c()
        limits |= {"PACES": len(self.pace.places), "PACE_BIAS": self.pace.bias, "MOST_PACE": MOST}
        limit_arrays |= {
            "pace_places": self.pace.places.astype(np.int16),
            "pace_weights": self.pace.weights.astype(np.float32),
        }
        return replace(
            of_detector,
            code=f"{read_c_beside(__file__)}\n{of_detector.code}",
            state=state + of_detector.state,
            constants=(
                (
                    "Frames of a tick, of the work on it, and before its news; ticks of a part.",
                    sizes,
                ),
                ("When a touch is named again, and from which confidence on.", naming),
                (
                    "The status: numbers and ticks of a block of background, of one of touches.",
                    limits,
                ),
                *of_detector.constants,
            ),
            frames=(part + 1) * self.count + self.delay,
            part=part * self.count,
            level=float(self.level),
            arrays=of_detector.arrays | limit_arrays | {"class_of": classes_of_names},
            deciders={"name": namer},
        )

    def with_system(
        self,
        system: contract.System,
        change: Callable[..., contract.System],
        captures: Corpus,
        y: np.ndarray | None,
    ) -> TickWatcher:
        """A copy with another system, and names changed by captures of gestures that they know."""
        if y is not None:
            is_named = np.isin(y, self.names.classes_)  # background is not
            captures, y = captures[is_named], y[is_named]
        captures = apply_steps(captures, split_causal_steps(self.system)[0])[0]
        return replace(self, system=system, names=change(self.names, captures, y))

    def apply_frame_steps(self, recordings: Corpus) -> Corpus:
        """Recordings without their labels, after the steps before names."""
        captures = contract.blind_captures(self.system, recordings)
        return apply_steps(captures, split_causal_steps(self.system)[0])[0]

    def apply_steps_of_detector(self, recordings: Corpus) -> Corpus:
        """Recordings without their labels, after the steps before the detector."""
        captures = contract.blind_captures(self.system, recordings)
        return apply_steps(captures, steps_of_detector(self.system))[0]

    def sense(self, recordings: Corpus) -> Sensed:
        """Find the touches in recordings, as if the frames came one by one."""
        stepped = sensed = self.apply_frame_steps(recordings)
        if steps_of_detector(self.system) != split_causal_steps(self.system)[0]:
            sensed = self.apply_steps_of_detector(recordings)
        ticks = (average_blocks(frames, self.count) for frames in sensed)
        evidence = [self.detector.evidence(self.detector.signals_of(tick)) for tick in ticks]
        detectors, level = [self.detector] * len(evidence), np.array([self.level])
        signs = [s[:, 0] for s in self.detector.find_signs(detectors, evidence, level)]
        longest = longest_part(stepped.rate_hz, self.count)
        touches = [find_spans(each, self.count, longest) for each in signs]
        return Sensed(recordings, stepped, evidence, signs, touches)

    def find_status(self, sensed: Sensed) -> list[np.ndarray]:
        """Bits of the status after each frame of each recording, as if frames came one by one."""
        found, full_scale = [], sensed.recordings.full_scale
        for i, frames in enumerate(sensed.recordings):
            paces = self.pace.of_touches(sensed.stepped[[i]], sensed.touches[i])
            health = Health(self.limits, full_scale)
            of_ticks, _ = watch_health(health, frames, sensed.signs[i], self.count, paces)
            of_ticks |= NOISE * self.detector.find_refused(sensed.evidence[i])
            tick = np.arange(1, len(frames) + 1) // self.count  # complete ones
            is_saturated = find_saturated(frames, full_scale)
            found.append(np.append(0, of_ticks)[tick] | SATURATED * is_saturated)
        return found

    def count_refused(self, sensed: Sensed) -> np.ndarray:
        """Count frames after which the status has a reason, int64 [recordings]."""
        status = self.find_status(sensed)
        return np.array([np.count_nonzero(one) for one in status], dtype=np.int64)

    def sweep_recordings(self, recordings: Recordings, evidence: list[np.ndarray]) -> pd.DataFrame:
        """Count hits, false alarms and reports at all levels, by offset from the learned one."""
        levels, detectors = self.detector.levels, [self.detector] * len(evidence)
        sweep = sweep_levels(detectors, recordings, evidence, self.count, levels)
        learned = int(np.abs(levels - self.level).argmin())
        offset = np.arange(len(sweep)) - float(learned)
        return sweep[["hits", "alarms", "reports"]].assign(offset=offset)

    def decide_once(self, recording: Corpus, end: int) -> None:
        """Do the work of one decision, to be timed: signals and evidence of a tick, and a name."""
        frames = recording[0][max(0, end - self.count) : max(end, self.count)]
        signals = self.detector.signals().step(average_blocks(frames, self.count)[0])
        self.detector.evidence(np.repeat(signals[None], self.detector.memory, axis=0))
        begin = max(0, end - round(LONGEST_S * recording.rate_hz))
        name_probabilities(self.names, recording, np.array([begin]), np.array([end]))

    def report_touches(self, recordings: Corpus) -> pd.DataFrame:
        """Report the touches in recordings, as if the frames came one by one."""
        return self.name_touches(self.sense(recordings))

    def name_touches(self, sensed: Sensed) -> pd.DataFrame:
        """Reports of the touches that were found in recordings, with their names."""
        rows: list[tuple] = []
        stepped = sensed.stepped
        for i, touches in enumerate(sensed.touches):
            if not touches:
                continue
            spans = [[*touch.named, *filter(None, [touch.last])] for touch in touches]
            begin, end = np.array(sum(spans, []), dtype=np.int64).T
            proba = name_probabilities(self.names, stepped[[i]], begin, end)
            firsts = np.cumsum([len(of_touch) for of_touch in spans])[:-1]
            probas, lengths = np.split(proba, firsts), np.split(end - begin, firsts)
            for touch, of_touch, frames in zip(touches, probas, lengths, strict=True):
                first, _ = self.choose_label(of_touch[0])
                label, confidence = self.choose_label(frames @ of_touch / frames.sum())
                labels = self._labels_so_far(frames, of_touch)
                changes = int((labels[1:] != labels[:-1]).sum())
                times = touch.reported + self.delay, min(touch.end + self.delay, stepped.lengths[i])
                if times[0] <= stepped.lengths[i]:  # else the recording ends before the report
                    rows.append((i, *times, first, label, confidence, changes))
        return report_table(rows)

    def with_new_names(
        self, make_system: Callable[[], contract.System], captures: Corpus, recordings: Recordings
    ) -> TickWatcher:
        """A copy with names learned from other captures and recordings; it rejects nothing."""
        system = make_system().fit(captures, captures.gestures)
        return replace(self, system=system, names=fit_names(make_system, recordings), reject=0.0)

    def _labels_so_far(self, frames: np.ndarray, proba: np.ndarray) -> np.ndarray:
        """Label of a touch after each of its names: frames [names], proba [names, gestures]."""
        means = np.cumsum(frames[:, None] * proba, axis=0) / np.cumsum(frames)[:, None]
        return np.array([self.choose_label(mean)[0] for mean in means], dtype=object)

    def choose_label(self, proba: np.ndarray) -> tuple[str, float]:
        """The most probable gesture, or ``unknown`` if it is rejected, and its probability."""
        confidence = float(proba.max())
        if confidence > 0 and confidence >= self.reject:
            return str(self.names.classes_[proba.argmax()]), confidence
        return UNKNOWN, confidence


class TickStream:
    """A watcher on frames that come one by one; memory does not grow."""

    def __init__(
        self, watcher: TickWatcher, grid: tuple[int, int], rate_hz: float, full_scale: float
    ) -> None:
        self.watcher, self.sensor = watcher, (grid, rate_hz, full_scale)
        self.health = Health(watcher.limits, full_scale)
        self.of_frame = 0  # status of the last frame by itself
        self.begun = 0  # frames before the stream began anew
        self._begin()

    def _begin(self) -> None:
        """Begin, or begin anew."""
        watcher, (grid, rate_hz, full_scale) = self.watcher, self.sensor
        longest = longest_part(rate_hz, watcher.count)
        self.touches = Touches(watcher.count, longest)
        self.signals, self.rules = watcher.detector.signals(), watcher.detector.rules(watcher.level)
        self.ring: deque[np.ndarray] = deque(maxlen=watcher.detector.memory)
        capacity = (max(longest, watcher.detector.latest + 1) + 1) * watcher.count
        self.recent = Recent(capacity + STEP_MEMORY, grid, rate_hz, full_scale)
        self.is_refused = False
        self.pace, self.pace_frames = 0.0, 0  # of the longest name of a touch
        self.news: list[Event] = []  # of the last tick
        self._reset_touch()

    def _reset_touch(self) -> None:
        self.event: Event | None = None
        self.names = 0  # of the touch so far
        self.sum, self.weight = np.zeros(len(self.watcher.names.classes_)), 0.0
        self.last: tuple[int, int] | None = None
        # sum and weight of the name at the end, if the touch ends before it is named again
        self.last_name = self.sum, 0.0

    @property
    def status(self) -> int:
        """Bits of all reasons not to trust the sensor now (`REASONS`); 0 for none."""
        return self.of_frame | self.health.status | NOISE * self.is_refused

    @property
    def seen(self) -> int:
        """Frames so far, lost ones included."""
        return self.begun + self.recent.seen

    def push(self, frame: np.ndarray) -> list[Event]:
        """Take a frame [rows, cols]; return events that it ends, reports or renames, in order.

        A frame that is refused changes nothing but the status.
        """
        frame, self.of_frame = check_frame(frame, self.sensor[2])
        if self.of_frame & ~SATURATED:
            return []
        self.health.take(frame[None])
        return self._advance(frame)

    def miss(self, frames: int) -> list[Event]:
        """Count frames as lost before the next one; return the events of this time.

        Up to a second of them count as if the last frame were read again. After more, a touch that
        lasts is over and the stream begins anew.
        """
        if not frames:
            return []
        self.health.lose_frames()
        if self.recent.seen and frames <= self.sensor[1]:
            last = self.recent.frames[-1]
            return [event for _ in range(frames) for event in self._advance(last)]
        ended = []
        if self.event is not None:
            label, confidence = self._label_at_end()
            end = self.seen - self.recent.seen % self.watcher.count + self.watcher.delay
            ended.append(replace(self.event, label=label, confidence=confidence, end=end))
        self.begun = self.seen + frames
        self.health.drop_tick()
        self._begin()
        return ended

    def _advance(self, frame: np.ndarray) -> list[Event]:
        self.recent.push(frame)
        within = self.recent.seen % self.watcher.count
        if not within:
            self.news = self._decide_on_tick()
        return self.news if within == self.watcher.delay else []

    def _decide_on_tick(self) -> list[Event]:
        """News of the last tick; their times contain the delay."""
        delay = self.begun + self.watcher.delay
        system = self.watcher.system
        recording = sensed = self.recent.as_recording(self.watcher.apply_frame_steps)
        if steps_of_detector(system) != split_causal_steps(system)[0]:
            sensed = self.recent.as_recording(self.watcher.apply_steps_of_detector)
        tick = average_blocks(sensed[0][-self.watcher.count :], self.watcher.count)[0]
        self.ring.append(self.signals.step(tick))
        evidence = self.watcher.detector.evidence(np.stack(self.ring))[-1:]
        self.is_refused = bool(self.watcher.detector.find_refused(evidence)[0])
        sign = self.rules.step(evidence[0])
        ended = self.touches.step(sign)
        news = []
        if ended is not None and self.event is not None:
            self._add_names(ended, recording)
            label, confidence = self._label_at_end()
            end = ended.end + delay
            news.append(replace(self.event, label=label, confidence=confidence, end=end))
            self._reset_touch()
        self.health.finish_tick(sign.since, sign.report, self.pace)
        if ended is not None:
            self.pace_frames = 0
        lasting = self.touches.lasting
        if lasting is not None:
            self._add_names(lasting, recording)
            label, confidence = self.watcher.choose_label(self.sum / self.weight)
            previous = self.event
            first = label if previous is None else previous.first
            self.event = Event(lasting.reported + delay, first, label, confidence)
            if previous is None or previous.label != label:
                news.append(self.event)
        return news

    def _label_at_end(self) -> tuple[str, float]:
        """Label and confidence with the name at the end."""
        last_sum, last_weight = self.last_name
        mean = (self.sum + last_sum) / (self.weight + last_weight)
        return self.watcher.choose_label(mean)

    def _add_names(self, span: Span, recording: Corpus) -> None:
        """Add the names of a touch since the last tick."""
        for begin, end in span.named[self.names :]:
            proba, weight = self._name_frames(recording, begin, end)
            self.sum, self.weight = self.sum + proba, self.weight + weight
        self.names = len(span.named)
        if span.last != self.last:
            self.last, self.last_name = span.last, (0 * self.sum, 0.0)
            if span.last is not None:
                self.last_name = self._name_frames(recording, *span.last)

    def _name_frames(self, recording: Corpus, begin: int, end: int) -> tuple[np.ndarray, float]:
        """Probabilities from some frames of the stream, times their weight, and the weight."""
        dropped = self.recent.seen - len(self.recent.frames)
        spans = np.array([begin - dropped]), np.array([end - dropped])
        (proba,) = name_probabilities(self.watcher.names, recording, *spans)
        if end - begin >= self.pace_frames:
            features = span_features(recording, [(begin - dropped, end - dropped)])
            (self.pace,), self.pace_frames = self.watcher.pace.of_features(features), end - begin
        return (end - begin) * proba, float(end - begin)
