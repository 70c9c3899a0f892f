"""Learn a detector from recordings, once for all systems that name its touches.

What is learned depends on the recordings and on the steps before the system, not on the system.
It lies in the data folder. The name of its file is a hash of all that it depends on, so another
fold, corpus, parameter or version of the code never finds it.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from bench.corpora.windows import Step
from bench.ground.digests import append_digest, split_digest
from bench.ground.scratch import data_folder, write_then_rename
from bench.ground.source import loaded_code_digest, package_versions
from bench.models.recipe import apply_steps
from touchbench_streams.detectors.detector import (
    Detector,
    average_into_ticks,
    count_frames_per_tick,
    held_out_units,
    score_levels,
    sweep_levels,
)
from touchbench_streams.detectors.names import longest_part
from touchbench_streams.detectors.pace import Pace, learn_pace
from touchbench_streams.detectors.spans import find_spans
from touchbench_streams.detectors.status import Limits, learn_limits
from touchbench_streams.recordings import Recordings

FOLDS = "12"  # most folds of training recordings for the choice of the threshold


@dataclass(frozen=True, eq=False)
class LearnedDetector:
    """A fitted detector, and what was learned with it.

    Attributes:
        detector: fitted to all recordings.
        level: threshold, learned for a number of false alarms per hour.
        sweep: of thresholds, as of `sweep_levels`.
        limits: of the status.
        pace: of touches.
    """

    detector: Detector
    level: float
    sweep: pd.DataFrame
    limits: Limits
    pace: Pace


def load_or_learn_detector(
    detector: Detector,
    recordings: Recordings,
    steps: Sequence[Step],
    steps_of_names: Sequence[Step],
    false_alarms: float,
) -> LearnedDetector:
    """Load what `learn_detector` returned for the same arguments, or learn and store it."""
    options = (detector, recordings, steps, steps_of_names, false_alarms)
    path = data_folder() / "detectors" / f"{_cache_key(*options)}.pickle"
    # No file, a damaged one, or the class of another process
    with suppress(Exception):
        return pickle.loads(split_digest(path.read_bytes()))
    learned = learn_detector(*options)
    with suppress(OSError, pickle.PickleError, AttributeError):  # this only costs time
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_then_rename(path) as part:
            Path(part).write_bytes(append_digest(pickle.dumps(learned)))
    return learned


def learn_detector(
    detector: Detector,
    recordings: Recordings,
    steps: Sequence[Step],
    steps_of_names: Sequence[Step],
    false_alarms: float,
) -> LearnedDetector:
    """Learn a detector from recordings of training subjects.

    Each subject is left out in turn for the choice of the threshold.

    Args:
        detector: before training.
        recordings: cut where doubtful stretches were.
        steps: before the detector.
        steps_of_names: before the system that names touches.
        false_alarms: accepted per hour of background.
    """
    sensed = replace(recordings, corpus=apply_steps(recordings.corpus, [*steps])[0])
    corpus = sensed.corpus
    if steps != steps_of_names:
        corpus = apply_steps(recordings.corpus, [*steps_of_names])[0]
    count = count_frames_per_tick(detector.tick, corpus.rate_hz)
    ticks = average_into_ticks(sensed, count)
    signals = [detector.signals_of(ticks.corpus[i]) for i in range(len(ticks))]
    others, evidence = detector.fit_held_out(signals, ticks, FOLDS)
    sweep = sweep_levels(others, recordings, evidence, count, detector.levels)
    level = float(sweep["level"][score_levels(sweep, false_alarms).idxmax()])
    fitted = copy(detector).fit(signals, ticks)
    fitted = fitted.fit_disturbed(others, recordings, steps, level, false_alarms)
    signs = [s[:, 0] for s in detector.find_signs(others, evidence, np.array([level]))]
    longest, units = longest_part(corpus.rate_hz, count), held_out_units(recordings)
    touches = [find_spans(one, count, longest) for one in signs]
    pace, paces = learn_pace(corpus, units, touches)
    limits = learn_limits(recordings.corpus, signs, count, paces, units)
    return LearnedDetector(fitted, level, sweep, limits, pace)


def _cache_key(
    detector: Detector,
    recordings: Recordings,
    steps: Sequence[Step],
    steps_of_names: Sequence[Step],
    false_alarms: float,
) -> str:
    """Hash of all arguments of `learn_detector`, of its code, and of versions."""
    code = loaded_code_digest(
        __name__,
        type(detector),
        *(part for step in (*steps, *steps_of_names) for part in step.code_objects()),
    )
    options = type(detector).__qualname__, sorted(vars(detector).items()), steps, steps_of_names
    corpus, labelled = recordings.corpus, recordings.labelled
    tables = [table.to_dict("list") for table in (corpus.captures, labelled)]
    sensor = corpus.rate_hz, corpus.full_scale, corpus.grid, corpus.lengths.tolist()
    parts = code, package_versions(), options, false_alarms, sensor, tables
    digest = hashlib.sha256(repr(parts).encode())
    for frames in corpus:
        digest.update(f"{frames.dtype}".encode() + np.ascontiguousarray(frames).data)
    return digest.hexdigest()[:32]
