"""How a system learns to watch, for those who save it or write it as C."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import numpy as np

from bench import contract
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.ground.typed import Values, parse_amount
from bench.plan.cells import Cell, Part
from bench.plan.plan import Fold, captures_of_cell
from touchbench_streams import FALSE_ALARMS
from touchbench_streams.composer import check_background, split_touch_and_background
from touchbench_streams.detectors import parse_detectors
from touchbench_streams.detectors.ticks import TickWatcher, learn_watcher
from touchbench_streams.fold import make_recordings, short_background_warnings, usual_background
from touchbench_streams.recordings import comes_from_recordings, drop_doubtful, restore_recordings
from touchbench_streams.stored import (
    holds_recordings,
    join_background,
    load_background,
    load_recordings,
)

WATCHED_S = 60.0  # of a recording that is watched in an emulator


class Watching:
    """The post-processing for endless streams, learned from all captures or recordings.

    Args:
        values: ``detector`` with its parameters behind a dot, ``false_alarms`` and ``background``, as ``bench fit``
            takes them.
    """

    keys: ClassVar[tuple[str, ...]] = ("detector", "false_alarms", "background")
    without: ClassVar[str] = "cannot watch an endless stream"  # of a model that has not learned to

    def __init__(self, values: Values) -> None:
        self.part, *more = self.parts(values)
        if more:
            raise InputError(
                "bench fit saves one detector; give one value of detector= and its parameters"
            )
        self.background = str(values.get("background") or "")
        self.false_alarms = parse_amount("false_alarms", values.get("false_alarms", FALSE_ALARMS))

    @staticmethod
    def parts(values: Values) -> list[Part]:
        """The detectors that typed values name, with their parameters; the usual one where they name none."""
        of_detector = {
            key: value for key, value in values.items() if key.partition(".")[0] == "detector"
        }
        return parse_detectors(of_detector)

    @property
    def params(self) -> dict[str, str]:
        """What it is, as parameters of a run."""
        return {
            "watch.detector": self.part.as_argument(),
            "watch.false_alarms": f"{self.false_alarms:g}",
            "watch.background": self.background,
        }

    @staticmethod
    def c_digest() -> str:
        """Hash of the C of all detectors."""
        folder = Path(__file__).parent / "detectors"
        return hashlib.sha256(
            b"".join(path.read_bytes() for path in sorted(folder.glob("*.c")))
        ).hexdigest()

    @property
    def sentence(self) -> str:
        """Which detector finds touches."""
        return f"detector={self.part.as_argument()} finds touches in a stream"

    @staticmethod
    def captures(cell: Cell) -> Corpus:
        """What a saved system learns from: its captures, or recordings with their background."""
        if holds_recordings(cell.data):
            return drop_doubtful(load_recordings(cell.data, where=cell.where))
        return captures_of_cell(cell)

    @staticmethod
    def sides(cell: Cell, captures: Corpus, fold: Fold) -> tuple[Corpus, np.ndarray | None]:
        """What the training subjects of a fold teach, and the beginning of a recording of a test subject, if any."""
        if not comes_from_recordings(captures):
            return captures[fold.train], None
        every = load_recordings(cell.data, where=cell.where)
        tested = np.isin(every.subjects, captures.subjects[fold.test])
        one = restore_recordings(every[tested]).corpus
        return drop_doubtful(every[~tested]), one[0][: round(WATCHED_S * one.rate_hz)]

    def check(self, captures: Corpus) -> None:
        """Refuse captures that cannot teach it, as without background to compose recordings with."""
        if comes_from_recordings(captures):
            if self.background:
                load_background(self.background, captures)
            return
        check_background(
            *split_touch_and_background(captures, usual_background(captures, self.background))
        )

    def warnings(self, captures: Corpus) -> list[str]:
        """A line where the background of recordings is too short for the accepted rate."""
        return short_background_warnings(
            captures, [np.arange(len(captures))], self.false_alarms, self.background
        )

    def learned(
        self, make_system: Callable[[], contract.System], system: contract.System, captures: Corpus
    ) -> TickWatcher:
        """A system that watches, which was fitted to captures of two subjects at least, and its factory."""
        recordings = make_recordings(captures, usual_background(captures, self.background))
        if self.background and comes_from_recordings(captures):
            recordings = join_background(
                recordings, load_background(self.background, captures), np.array([], str)
            )
        return learn_watcher(
            self.part.make_object(), make_system, system, recordings, self.false_alarms
        )[0]
