"""The contract of detectors: what finds the touches of a stream, and when it reports them.

A detector is made by a factory whose keyword arguments are its parameters (``detector.tick=``), and is registered in
`touchbench_streams.keys`, or as ``detector=my.py:Mine``. One
that decides tick by tick derives from `touchbench_streams.detectors.ticks.Detector`; any other has ``learn``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
import pandas as pd

from bench import contract
from bench.corpora.corpus import Corpus
from touchbench_streams.recordings import Recordings

UNKNOWN = "unknown"  # label of a gesture that is rejected


Point = tuple[float, float, float]  # of `Watches.points`


@dataclass(frozen=True)
class InC:
    """What the C of a watcher needs; `bench export` writes it behind the C of the system.

    Attributes:
        code: C that defines ``static int watched(touch_watch_t *w, const float *frame, touch_event_t *event)``, which
            takes a frame that was checked and counted, and returns news, which ``event`` then tells.
        state: members of ``touch_watch_t`` besides the common ones (``now``, the state of a capture; ``level``;
            ``counts``, ``is_refused``, ``is_saturated``; ``seen``, frames); C, with names of constants in braces.
        constants: groups of constants, each a comment, and numbers or C by name.
        frames: frames whose signals are kept in ``now.signals``, at least.
        part: frames of a ``part_t``, at most.
        level: threshold that was learned, as in `Watches.points`.
        arrays: learned tables by name.
        deciders: pipelines on features, by the name of the C function that gives probabilities of their classes.
        pretended: C that sets ``w`` as if nothing was touched or, where ``touched`` is not 0, as if a touch never
            ended, so that ``make count`` can count instructions of both.
    """

    code: str
    state: tuple[str, ...]
    constants: tuple[tuple[str, dict[str, float | str]], ...]
    frames: int = 0
    part: int = 0
    level: float = 0.0
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    deciders: dict[str, Any] = field(default_factory=dict)
    pretended: str = ""


@dataclass
class Event:
    """A touch of a stream that is reported; times are frames seen.

    Attributes:
        reported: time of the first report.
        first: gesture then.
        label: gesture by now.
        confidence: mean probability of ``label``.
        end: time of the end; None while the touch lasts.
    """

    reported: int
    first: str
    label: str
    confidence: float
    end: int | None = None


class Stream(Protocol):
    """A watcher on frames that come one by one; memory does not grow.

    Attributes:
        status: ``ok``, ``saturated`` (many taxels are at full scale), or ``refused`` (the frames are unlike all that
            the detector learned from; it may miss touches).
    """

    @property
    def status(self) -> str: ...  # noqa: D102

    def push(self, frame: np.ndarray) -> list[Event]:
        """Take a frame [rows, cols]; the events that it ends, reports or renames, in this order."""


class Watches(Protocol):
    """A fitted system and a detector that learned from recordings; a dataclass, whose fields can be replaced.

    What it makes of a frame depends on this frame and those before it, and its memory does not grow.

    Attributes:
        system: fitted to captures.
        reject: confidence below which a label is ``unknown``; 0 for never.
        numbers: count of learned numbers beyond those of the system.
        chosen: values that training has chosen, by name.
        points: threshold, false alarms per hour and share of touches found of operating points on training recordings,
            from the strictest to the most eager.
    """

    system: contract.System
    reject: float
    points: tuple[Point, ...]

    @property
    def numbers(self) -> int: ...  # noqa: D102

    @property
    def chosen(self) -> dict[str, object]: ...  # noqa: D102

    @property
    def soonest(self) -> int:
        """Frames from the start of a touch to its report, at least."""

    def stream(self, grid: tuple[int, int], rate_hz: float, full_scale: float) -> Stream:
        """The same on frames that come one by one.

        Args:
            grid: (rows, cols) of the sensor.
            rate_hz: frames per second.
            full_scale: largest value of a channel.
        """

    def at(self, point: int) -> Watches:
        """The same at another of its ``points``."""

    def in_c(self, classes: list[str], rate_hz: float) -> InC | None:
        """What its C needs; None where it has none.

        Args:
            classes: names of the classes of the C, in their order.
            rate_hz: frames per second.
        """

    def adapted(self, system: contract.System, captures: Corpus, y: np.ndarray | None) -> Watches:
        """The same with a system that was adapted to a person, and whatever else names, adapted to these captures."""

    def evidence(self, recordings: Corpus) -> list[Any]:
        """What the detector makes of each recording, for the other methods, which are called several times."""

    def reports(self, recordings: Corpus, evidence: list[Any] | None = None) -> pd.DataFrame:
        """The touches that it reports (columns of `touchbench_streams.events.REPORT`)."""

    def refused(self, recordings: Corpus, evidence: list[Any]) -> np.ndarray:
        """How many frames of each recording are refused or saturated, as `Stream.status` has it; int64 [recordings]."""

    def sweep(self, recordings: Recordings, evidence: list[Any]) -> pd.DataFrame:
        """What other thresholds find: ``offset`` from the learned one, ``hits``, ``alarms`` and ``reports``, counts."""

    def probability(self, evidence: Any, rate_hz: float) -> pd.DataFrame:
        """How sure it is of touch, 0 to 1: ``confidence`` after ``reported`` frames of one recording."""

    def renamed(self, make_system: Callable[[], contract.System], captures: Corpus, recordings: Recordings) -> Watches:
        """The same with names learned from other captures and their recordings; it rejects nothing."""

    def decide(self, recording: Corpus, end: int) -> None:
        """Do the work of one decision after so many frames, to be timed."""


class Detects(Protocol):
    """A detector before training; its parameters are arguments of its factory."""

    def learn(
        self,
        make_system: Callable[[], contract.System],
        system: contract.System,
        captures: Corpus,
        recordings: Recordings,
        false_alarms: float,
    ) -> tuple[Watches, pd.DataFrame]:
        """Learn from recordings of training subjects.

        Args:
            make_system: factory of the system, not fitted.
            system: fitted to the captures.
            captures: captures of the same subjects.
            recordings: their recordings, parted where doubtful stretches were.
            false_alarms: accepted false alarms per hour of background.

        Returns:
            What watches, and a table of the thresholds that were tried.

        Raises:
            InputError: the recordings cannot teach it.
        """


class Sign(NamedTuple):
    """What the rules of a detector say after a tick.

    Attributes:
        touch: confidence in touch, 0 to 1.
        since: ticks since the touch that lasts began, this one included; 0 without touch.
        report: True if the touch is reported now. It may follow another one without a gap.
    """

    touch: float
    since: int
    report: bool


class Rules(Protocol):
    """When touches begin, are reported and end; one stream, fixed memory."""

    def step(self, evidence: np.ndarray) -> Sign:
        """Take the evidence of the next tick."""


class Signals(Protocol):
    """A few numbers for each frame; nothing is learned; one stream, fixed memory."""

    def step(self, frame: np.ndarray) -> np.ndarray:
        """The numbers of the next frame [rows, cols], float32 [signals]."""
