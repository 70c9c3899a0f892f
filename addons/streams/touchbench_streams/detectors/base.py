"""What detectors and their watchers exchange: signs of ticks, events, and what C needs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

UNKNOWN = "unknown"  # label of a gesture that is rejected


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


@dataclass(frozen=True)
class DetectorC:
    """What the C of a watcher needs; `bench export` writes it behind the C of the system.

    Attributes:
        code: C that defines ``static int watched(touch_watch_t *w, const float *frame, touch_event_t *event)``, which
            takes a frame that was checked and counted, and returns news, which ``event`` then tells.
        state: members of ``touch_watch_t`` besides the common ones (``now``, the state of a capture; ``level``;
            ``counts``, ``is_refused``, ``is_saturated``; ``seen``, frames); C, with names of constants in braces.
        constants: groups of constants, each a comment, and numbers or C by name.
        frames: frames whose signals are kept in ``now.signals``, at least.
        part: frames of a ``touch_part_t``, at most.
        level: threshold that was learned.
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
