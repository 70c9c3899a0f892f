"""Values that detectors and watchers exchange: signs of ticks, events, and C."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

UNKNOWN = "unknown"  # label of a gesture that is rejected


class Sign(NamedTuple):
    """The output of a detector's rules after a tick.

    Attributes:
        touch: confidence in touch, 0 to 1.
        since: ticks since the current touch began, this one included; 0 without touch.
        report: True if the touch is reported now. It may follow another one without a gap.
    """

    touch: float
    since: int
    report: bool


class Rules(Protocol):
    """Decide when touches of one stream begin, are reported and end, in fixed memory."""

    def step(self, evidence: np.ndarray) -> Sign:
        """Take the evidence of the next tick."""


class Signals(Protocol):
    """Compute a few numbers for each frame of one stream, in fixed memory; nothing is learned."""

    def step(self, frame: np.ndarray) -> np.ndarray:
        """The numbers for the next frame [rows, cols], float32 [signals]."""


@dataclass
class Event:
    """A reported touch of a stream; times are counted in frames seen.

    Attributes:
        reported: time of the first report.
        first: gesture at the first report.
        label: current gesture.
        confidence: mean probability of ``label``.
        end: time of the end; None while the touch lasts.
    """

    reported: int
    first: str
    label: str
    confidence: float
    end: int | None = None


@dataclass(frozen=True)
class DetectorC:
    """C of a watcher; `bench export` writes it behind the C of the system.

    Attributes:
        code: C that defines ``static int watched(touch_watch_t *w, const float *frame,
            touch_event_t *event)``. It takes a frame that was checked and counted, and returns
            news, with details in ``event``.
        state: members of ``touch_watch_t`` besides the common ones (``now``, the state of a
            capture; ``level``; ``counts``, ``health``, ``is_refused``; ``seen``, frames); C,
            with names of constants in braces.
        constants: groups of constants: a comment, and numbers or C by name.
        frames: least number of frames whose signals are kept in ``now.signals``.
        part: most frames of a ``touch_part_t``.
        level: threshold that was learned.
        arrays: learned tables by name.
        deciders: pipelines on features, by the name of the C function that gives probabilities of
            their classes.
        pretended: C that sets ``w`` as if nothing was touched or, if ``touched`` is not 0, as if a
            touch never ended, so that ``make count`` can count instructions of both.
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
