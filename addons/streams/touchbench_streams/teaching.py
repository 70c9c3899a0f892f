"""Learn the post-processing for endless streams, to save it or to write it as C."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import numpy as np

from bench import contract
from bench.corpora.corpus import Corpus
from bench.corpora.skin import design_of
from bench.errors import InputError
from bench.ground.typed import Values, parse_amount
from bench.plan.cells import Cell, Part
from bench.plan.plan import Fold, captures_of_cell
from touchbench_streams import FALSE_ALARMS
from touchbench_streams.composer import check_background, split_touch_and_background
from touchbench_streams.detectors import parse_detectors, values_of_detector
from touchbench_streams.detectors.ticks import TickWatcher, learn_watcher
from touchbench_streams.fold import default_background, make_recordings, short_background_warnings
from touchbench_streams.recordings import comes_from_recordings, drop_doubtful, restore_recordings
from touchbench_streams.stored import (
    holds_recordings,
    join_background,
    load_background,
    load_recordings,
)

EMULATED_S = 60.0  # of a recording that is watched in an emulator


class Watching:
    """The post-processing for endless streams, learned from all captures or recordings.

    Args:
        values: ``detector`` with its parameters behind a dot, ``false_alarms`` and ``background``,
            as ``bench fit`` takes them.
    """

    keys: ClassVar[tuple[str, ...]] = ("detector", "false_alarms", "background")
    inability: ClassVar[str] = "cannot watch an endless stream"  # of a model that did not learn it

    def __init__(self, values: Values) -> None:
        self.part, *others = self.parse_detectors(values)
        if others:
            raise InputError(
                "bench fit saves one detector; give one value of detector= and its parameters"
            )
        self.background = str(values.get("background") or "")
        self.false_alarms = parse_amount("false_alarms", values.get("false_alarms", FALSE_ALARMS))

    @staticmethod
    def parse_detectors(values: Values) -> list[Part]:
        """The detectors in typed values, with their parameters; the default one without any."""
        return parse_detectors(values_of_detector(values))

    @property
    def params(self) -> dict[str, str]:
        """Its options as parameters of a run."""
        return {
            "watch.detector": self.part.as_argument(),
            "watch.false_alarms": f"{self.false_alarms:g}",
            "watch.background": self.background,
        }

    @staticmethod
    def hash_c_code() -> str:
        """Hash of the C of all detectors."""
        paths = sorted((Path(__file__).parent / "detectors").glob("*.c"))
        return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()

    @property
    def note(self) -> str:
        """Which detector finds touches, for the user."""
        return f"detector={self.part.as_argument()} finds touches in a stream"

    @staticmethod
    def load_captures(cell: Cell) -> Corpus:
        """Training data of a saved system: captures, or recordings with their background."""
        if holds_recordings(cell.data):
            if cell.also:
                name = cell.data
                raise InputError(f"also= adds captures, and {name} has recordings; leave also= out")
            recorded = load_recordings(cell.data, where=cell.where, design=cell.design)
            return drop_doubtful(recorded)
        return captures_of_cell(cell)

    @staticmethod
    def split_fold(cell: Cell, captures: Corpus, fold: Fold) -> tuple[Corpus, np.ndarray | None]:
        """Training data of a fold, and the beginning of a test subject's recording, if any."""
        if not comes_from_recordings(captures):
            return captures[fold.train], None
        design = design_of(captures.info)
        recorded = load_recordings(cell.data, where=cell.where, design=design)
        is_tested = np.isin(recorded.subjects, captures.subjects[fold.test])
        tested = restore_recordings(recorded[is_tested]).corpus
        return drop_doubtful(recorded[~is_tested]), tested[0][: round(EMULATED_S * tested.rate_hz)]

    def check_captures(self, captures: Corpus) -> None:
        """Refuse captures to learn from, such as those without background to compose with."""
        if not comes_from_recordings(captures):
            background = default_background(captures, self.background)
            check_background(*split_touch_and_background(captures, background))
        elif self.background:
            load_background(self.background, captures)

    def warnings_of_captures(self, captures: Corpus) -> list[str]:
        """Warn if the background of recordings is too short for the accepted rate."""
        return short_background_warnings(
            captures, [np.arange(len(captures))], self.false_alarms, self.background
        )

    def learn_watcher(
        self, make_system: Callable[[], contract.System], system: contract.System, captures: Corpus
    ) -> TickWatcher:
        """Learn to watch with a system that was fitted to captures of at least two subjects."""
        recordings = make_recordings(captures, default_background(captures, self.background))
        if self.background and comes_from_recordings(captures):
            background = load_background(self.background, captures)
            recordings = join_background(recordings, background, np.array([], str))
        detector = self.part.make_object()
        return learn_watcher(detector, make_system, system, recordings, self.false_alarms)[0]
