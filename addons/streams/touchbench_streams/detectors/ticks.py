"""How a detector and a recogniser learn to watch a stream together, and watch it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus
from bench.models.recipe import apply_steps, split_causal_steps
from bench.models.sizes import count_parameters
from touchbench_streams.detectors.base import UNKNOWN, DetectorC, Event
from touchbench_streams.detectors.detector import (
    Detector,
    average_into_ticks,
    choose_operating_points,
    count_frames_per_tick,
    read_c_beside,
    run_rules,
    score_levels,
    sweep_levels,
)
from touchbench_streams.detectors.names import (
    LONGEST_S,
    fit_names,
    longest_part,
    name_probabilities,
)
from touchbench_streams.detectors.spans import GROWTH, Span, Touches, average_blocks, find_spans
from touchbench_streams.events import report_table
from touchbench_streams.recent import Recent, find_saturated
from touchbench_streams.recordings import Recordings

FOLDS = "12"  # at most, of training recordings for the choice of the threshold


def learn_watcher(
    detector: Detector,
    make_system: Callable[[], contract.System],
    system: contract.System,
    recordings: Recordings,
    false_alarms: float,
) -> tuple[TickWatcher, pd.DataFrame]:
    """Learn to watch from recordings of training subjects, parted where doubtful stretches were.

    Each subject is left out for the choice of the threshold, for so many accepted false alarms per hour of background.
    The system is fitted to captures of the same subjects. Also returns the thresholds that were tried (`sweep_recordings`).
    """
    seen = replace(
        recordings, corpus=apply_steps(recordings.corpus, split_causal_steps(system)[0])[0]
    )
    count = count_frames_per_tick(detector.tick, seen.corpus.rate_hz)
    ticks = average_into_ticks(seen, count)
    signals = [detector.signals_of(ticks.corpus[i]) for i in range(len(ticks))]
    others, evidence = detector.fit_held_out(signals, ticks, FOLDS)
    settings = sweep_levels(others, recordings, evidence, count, detector.levels)
    level = float(settings["level"][score_levels(settings, false_alarms).idxmax()])
    names = fit_names(make_system, recordings)
    fitted = copy(detector).fit(signals, ticks).fit_disturbed(others, seen, level, false_alarms)
    return TickWatcher(
        system, names, fitted, level, count, points=choose_operating_points(settings, level)
    ), settings


@dataclass(eq=False)
class TickWatcher:
    """A fitted system and a detector that learned from recordings.

    What it makes of a frame depends on this frame and those before it, and its memory does not grow. A touch is named
    when it is reported, from its frames so far, and again as it grows.

    Attributes:
        system: fitted to captures.
        names: the system that names touches, fitted to beginnings and whole touches.
        detector: fitted to training recordings.
        level: threshold, learned for a number of false alarms per hour.
        count: frames of a tick.
        reject: confidence below which a label is ``unknown``; 0 for never.
        points: level, false alarms, hours of background and share of touches found of operating points on training
            recordings, from the strictest to the most eager.
    """

    system: contract.System
    names: contract.System
    detector: Detector
    level: float
    count: int
    reject: float = 0.0
    points: tuple[tuple[float, float, float, float], ...] = ()

    @property
    def numbers(self) -> int:
        """Learned numbers: of the detector, and of the system that names in place of the one fitted to captures."""
        return self.detector.numbers + count_parameters(self.names) - count_parameters(self.system)

    @property
    def chosen(self) -> dict[str, object]:
        """What training has chosen, by name."""
        learned = {"level": self.level, "reject": self.reject} | self.detector.chosen
        return {"detector": type(self.detector).__name__.lower()} | learned

    @property
    def soonest(self) -> int:
        """Frames from the start of a touch to its report, at least."""
        return self.detector.soonest * self.count

    def open_stream(self, grid: tuple[int, int], rate_hz: float, full_scale: float) -> TickStream:
        """The same on frames that come one by one."""
        return TickStream(self, grid, rate_hz, full_scale)

    def in_c(self, classes: list[str], rate_hz: float) -> DetectorC | None:
        """What its C needs: that of the detector, and of the names."""
        derived = "in_c" not in vars(
            type(self.detector)
        )  # what derives from a detector with C may compute otherwise
        inner = None if derived else self.detector.in_c()
        if inner is None:
            return None
        longest, named = longest_part(rate_hz, self.count), split_causal_steps(self.names)[1]
        times = {"TICK": self.count, "PART_TICKS": longest, "NAMED": len(named.classes_)}
        constants = ("Frames of a tick, ticks of a part of a touch, gestures.", times)
        again = {"GROWTH": GROWTH, "REJECT": self.reject}
        naming = ("When a touch is named again, and from which confidence on.", again)
        state = (
            *(("float tick[{TAXELS}];  /* sum of its frames */",) if self.count > 1 else ()),
            "int within, length, first, named, sure, after;  /* frames of the tick; ticks of the part and its names */",
            "int is_reported, label;  /* of the touch that lasts */",
            "uint32_t reported, end;  /* frames; modulo 2^32 */",
            "float due, weight, sum[{NAMED}], last[{NAMED}];  /* next name; of the names so far; of that at the end */",
        )
        return replace(
            inner,
            code=f"{read_c_beside(__file__)}\n{inner.code}",
            state=state + inner.state,
            constants=(constants, naming, *inner.constants),
            frames=(max(longest, self.detector.latest + 1) + 1) * self.count,
            part=max(longest, self.detector.latest + 1) * self.count,
            level=float(self.level),
            arrays=inner.arrays
            | {"class_of": np.searchsorted(classes, named.classes_.astype(str)).astype(np.int8)},
            deciders={"name": named},
        )

    def with_system(
        self,
        system: contract.System,
        change: Callable[..., contract.System],
        captures: Corpus,
        y: np.ndarray | None,
    ) -> TickWatcher:
        """The same with another system, and names changed by these captures; they have not learned background."""
        if y is not None:
            known = np.isin(y, self.names.classes_)
            captures, y = captures[known], y[known]
        return replace(self, system=system, names=change(self.names, captures, y))

    def apply_frame_steps(self, recordings: Corpus) -> Corpus:
        """Recordings without their labels, after the steps that are done frame by frame."""
        return apply_steps(
            contract.blind_captures(self.system, recordings), split_causal_steps(self.system)[0]
        )[0]

    def collect_evidence(self, recordings: Corpus) -> list[np.ndarray]:
        """The evidence of each recording, tick by tick."""
        seen = self.apply_frame_steps(recordings)
        series = (
            self.detector.signals_of(average_blocks(seen[i], self.count)) for i in range(len(seen))
        )
        return [self.detector.evidence(each) for each in series]

    def count_refused(self, recordings: Corpus, evidence: list[np.ndarray]) -> np.ndarray:
        """Frames of each recording that are saturated, or whose last tick is unlike all training; int64."""
        counts = []
        for stream, each in zip(recordings, evidence, strict=True):
            tick = np.arange(1, len(stream) + 1) // self.count - 1  # the last whole one
            silent = (tick >= 0) & self.detector.find_refused(each)[tick]
            counts.append((silent | find_saturated(stream, recordings.full_scale)).sum())
        return np.array(counts, dtype=np.int64)

    def sweep_recordings(self, recordings: Recordings, evidence: list[np.ndarray]) -> pd.DataFrame:
        """Touches found, false alarms and reports of all levels, by their place relative to the learned one."""
        levels = self.detector.levels
        settings = sweep_levels(
            [self.detector] * len(evidence), recordings, evidence, self.count, levels
        )
        learned = int(np.abs(levels - self.level).argmin())
        return settings[["hits", "alarms", "reports"]].assign(
            offset=np.arange(len(settings)) - float(learned)
        )

    def touch_probability(self, evidence: np.ndarray) -> pd.DataFrame:
        """How sure the rules are of touch in one recording."""
        signs = run_rules(self.detector.rules(self.level), evidence)
        return pd.DataFrame(
            {"reported": self.count * np.arange(1, len(signs) + 1), "confidence": signs[:, 0]}
        )

    def decide(self, recording: Corpus, end: int) -> None:
        """Do the work of one decision after so many frames: signals and evidence of a tick, and a name."""
        frames = recording[0][max(0, end - self.count) : max(end, self.count)]
        ring = np.repeat(
            self.detector.signals().step(average_blocks(frames, self.count)[0])[None],
            self.detector.memory,
            0,
        )
        self.detector.evidence(ring)
        begin = max(0, end - round(LONGEST_S * recording.rate_hz))
        name_probabilities(self.names, recording, np.array([begin]), np.array([end]))

    def report_touches(
        self, recordings: Corpus, evidence: list[np.ndarray] | None = None
    ) -> pd.DataFrame:
        """Touches in recordings, each as if its frames came one by one."""
        seen = self.apply_frame_steps(recordings)
        evidence = self.collect_evidence(recordings) if evidence is None else evidence
        rows: list[tuple] = []
        for i, series in enumerate(evidence):
            signs = run_rules(self.detector.rules(self.level), series)
            touches = find_spans(signs, self.count, longest_part(seen.rate_hz, self.count))
            if not touches:
                continue
            asked = [[*touch.named, *filter(None, [touch.last])] for touch in touches]
            begin, end = np.array([span for each in asked for span in each], dtype=np.int64).T
            named = name_probabilities(self.names, seen[[i]], begin, end)
            parts = np.cumsum([len(each) for each in asked])[:-1]
            for touch, each, frames in zip(
                touches, np.split(named, parts), np.split(end - begin, parts), strict=True
            ):
                mean = frames @ each / frames.sum()  # longer spans count more
                (first, _), (label, sure) = self.choose_label(each[0]), self.choose_label(mean)
                rows.append((i, touch.reported, touch.end, first, label, sure))
        return report_table(rows)

    def with_new_names(
        self, make_system: Callable[[], contract.System], captures: Corpus, recordings: Recordings
    ) -> TickWatcher:
        """The same with names learned from other captures and their recordings; it rejects nothing."""
        system = make_system().fit(captures, captures.gestures)
        return replace(self, system=system, names=fit_names(make_system, recordings), reject=0.0)

    def choose_label(self, proba: np.ndarray) -> tuple[str, float]:
        """The gesture that is named, and how sure it is."""
        sure, gestures = float(proba.max()), np.asarray(self.names.classes_).astype(str)
        return (
            str(gestures[proba.argmax()]) if sure > 0 and sure >= self.reject else UNKNOWN
        ), sure


class TickStream:
    """A watcher on frames that come one by one; memory does not grow."""

    def __init__(
        self, watcher: TickWatcher, grid: tuple[int, int], rate_hz: float, full_scale: float
    ) -> None:
        longest = longest_part(rate_hz, watcher.count)
        self.watcher, self.touches = watcher, Touches(watcher.count, longest)
        self.signals, self.rules = watcher.detector.signals(), watcher.detector.rules(watcher.level)
        self.ring: deque[np.ndarray] = deque(maxlen=watcher.detector.memory)
        kept = (max(longest, watcher.detector.latest + 1) + 1) * watcher.count
        self.recent = Recent(kept, grid, rate_hz, full_scale)
        self.is_refused = False
        self._reset_touch()

    def _reset_touch(self) -> None:
        self.event: Event | None = None
        self.names, self.sum, self.weight = (
            0,
            np.zeros(len(self.watcher.names.classes_)),
            0.0,
        )  # so far
        self.last: tuple[int, int] | None = None
        self.after = (
            self.sum,
            0.0,
        )  # what the name at the end adds, if the touch ends before it is named again

    @property
    def status(self) -> str:
        """``ok``, ``saturated`` (many taxels are at full scale), or ``refused`` (frames are unlike all training)."""
        return "saturated" if self.recent.is_saturated else "refused" if self.is_refused else "ok"

    def push(self, frame: np.ndarray) -> list[Event]:
        """Take a frame [rows, cols]; the events that it ends, reports or renames, in this order."""
        self.recent.push(frame)
        if self.recent.seen % self.watcher.count:
            return []
        recording = self.recent.as_recording(self.watcher.apply_frame_steps)
        tick = average_blocks(recording[0][-self.watcher.count :], self.watcher.count)[0]
        self.ring.append(self.signals.step(tick))
        evidence = self.watcher.detector.evidence(np.stack(self.ring))[-1:]
        self.is_refused = bool(self.watcher.detector.find_refused(evidence)[0])
        sign = self.rules.step(evidence[0])
        ended = self.touches.step(sign)
        news = []
        if ended is not None and self.event is not None:
            self._add_names(ended, recording)
            label, sure = self.watcher.choose_label(
                (self.sum + self.after[0]) / (self.weight + self.after[1])
            )
            news.append(replace(self.event, label=label, confidence=sure, end=ended.end))
            self._reset_touch()
        lasting = self.touches.lasting
        if lasting is not None:
            self._add_names(lasting, recording)
            label, sure = self.watcher.choose_label(self.sum / self.weight)
            before = self.event
            first = label if before is None else before.first
            self.event = Event(lasting.reported, first, label, sure)
            if before is None or before.label != label:
                news.append(self.event)
        return news

    def _add_names(self, span: Span, recording: Corpus) -> None:
        """Add the names that a touch has got since the last tick."""
        for begin, end in span.named[self.names :]:
            proba, weight = self._name(recording, begin, end)
            self.sum, self.weight = self.sum + proba, self.weight + weight
        self.names = len(span.named)
        if span.last != self.last:
            self.last = span.last
            self.after = (
                (0 * self.sum, 0.0) if span.last is None else self._name(recording, *span.last)
            )

    def _name(self, recording: Corpus, begin: int, end: int) -> tuple[np.ndarray, float]:
        """Probabilities from some frames of the stream, times their weight, and the weight."""
        gone = self.recent.seen - len(self.recent.frames)
        named = name_probabilities(
            self.watcher.names, recording, np.array([begin - gone]), np.array([end - gone])
        )[0]
        return (end - begin) * named, float(end - begin)
