"""Recordings composed of captures: touches of one subject, with background between them."""

from __future__ import annotations

import shlex

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus, shared_frames
from bench.corpora.faults import seeded_generator
from bench.errors import InputError
from bench.ground.machine import check_memory
from touchbench_streams.recordings import Recordings, event_table

TOUCH_S = (2.0, 6.0)  # excerpts of captures; a shorter capture is used whole
GAP_S = (3.0, 10.0)
QUIET = "quiet"  # background from the ends of captures
QUIET_S = 0.25  # of a piece of it, at least
QUIET_SHARE = (
    0.1  # of the highest summed pressure of a capture; frames below, at its ends, are quiet
)
COPIES = 2  # of the readings in memory at once: raw and repaired, in single precision
OTHER_COLUMNS = ("subject", "gesture", "split")  # that are no condition of the sensor


def split_touch_and_background(corpus: Corpus, background: str) -> tuple[Corpus, Corpus]:
    """Split a corpus into captures of touches and of background; no frame is copied.

    The background is a class of captures without touch, or ``quiet``: the frames at both ends of
    each capture whose summed pressure, above the capture's lowest, stays below a tenth of its
    highest. The frames between them are the touches.
    """
    gestures = corpus.gestures.astype(str)
    if background != QUIET:
        if background not in gestures:
            classes = ", ".join(sorted(set(gestures)))
            raise InputError(
                f"background={background}: {corpus.name} has no such class; give {QUIET} or one of "
                f"{classes}"
            )
        return corpus[gestures != background], corpus[gestures == background]
    least = max(1, round(QUIET_S * corpus.rate_hz))
    starts = shared_frames(corpus)[1]
    first, last = np.zeros(len(corpus), np.int64), corpus.lengths.copy()
    for i, frames in enumerate(corpus):
        total = frames.sum(axis=(1, 2), dtype=np.float64)
        total -= total.min()
        touched = np.flatnonzero(total >= QUIET_SHARE * total.max())
        first[i], last[i] = touched[0], touched[-1] + 1
    before, after = np.flatnonzero(first >= least), np.flatnonzero(corpus.lengths - last >= least)
    if not len(before) + len(after):
        raise InputError(
            f"background={QUIET}: no capture of {corpus.name} begins or ends with {QUIET_S:g} s "
            f"without touch; {suggest_background(corpus)}"
        )
    quiet = corpus[np.append(before, after)].with_fields(
        starts=np.append(starts[before], starts[after] + last[after]),
        lengths=np.append(first[before], corpus.lengths[after] - last[after]),
        digest="",
        path=None,
    )
    touches = corpus.with_fields(starts=starts + first, lengths=last - first, digest="", path=None)
    return touches, quiet


def compose_recordings(touches: Corpus, quiet: Corpus) -> Recordings:
    """Compose a recording per subject: every touch once, in random order, between background.

    Captures with the same conditions follow one another, so that the sensor changes in the
    background only and as rarely as possible. The background before a touch has the conditions of
    the touch if the subject has such background, otherwise it is any background of the subject.
    Recordings are in the order of the subjects' names, without the corpus's conditions. Order,
    excerpts and gaps depend on the subject and these captures alone.

    Args:
        touches: captures of touches; an excerpt of 2 to 6 s of each is used.
        quiet: captures of background; gaps of 3 to 10 s are filled with excerpts of them.
    """
    check_background(touches, quiet)
    target_columns = touches.target.split("+")
    labels = [c for c in touches.captures if c not in (*OTHER_COLUMNS, *target_columns)]
    conditions, quiet_conditions = _condition_keys(touches, labels), _condition_keys(quiet, labels)
    subjects, quiet_subjects = touches.subjects.astype(str), quiet.subjects.astype(str)
    names, gestures = sorted(set(subjects)), touches.gestures
    rate_hz, rows, streams = touches.rate_hz, [], []
    for number, subject in enumerate(names):
        rng = seeded_generator(f"recording 0 of {subject}")
        captures = np.flatnonzero(subjects == subject)
        background = quiet_subjects == subject
        blocks = []
        for condition in rng.permutation(np.unique(conditions[captures])):
            blocks.append(rng.permutation(captures[conditions[captures] == condition]))
        order = np.concatenate(blocks)
        parts: list[np.ndarray] = []
        for capture in order:
            pool = _find_background(background, quiet_conditions == conditions[capture])
            parts += _draw_gap(quiet, pool, rng)
            frames = touches[int(capture)]
            length = min(len(frames), max(1, round(rng.uniform(*TOUCH_S) * rate_hz)))
            begin = int(rng.integers(0, len(frames) - length + 1))
            start = sum(map(len, parts))
            parts.append(frames[begin : begin + length])
            rows.append((number, start, start + length, str(gestures[capture])))
        pool = _find_background(background, quiet_conditions == conditions[order[-1]])
        parts += _draw_gap(quiet, pool, rng)
        streams.append(np.concatenate(parts))
    table = pd.DataFrame({"subject": names, "gesture": ""})
    fields = {"full_scale": touches.full_scale, "name": touches.name, "info": touches.info}
    return Recordings(Corpus.from_captures(streams, table, rate_hz, **fields), event_table(rows))


def suggest_background(corpus: Corpus) -> str:
    """Advice on the class to name as background: all classes, and the one of least pressure."""
    means = pd.Series([frames.mean(dtype=np.float64) for frames in corpus])
    pressure = means.groupby(corpus.gestures.astype(str)).mean()
    background = shlex.quote(f"background={pressure.idxmin()}")
    classes = ", ".join(pressure.index)
    return f"name the class without touch: {background} has the least pressure of {classes}"


def check_background(touches: Corpus, quiet: Corpus) -> None:
    """Refuse captures that cannot become recordings."""
    if not len(touches):
        raise InputError(
            f"{touches.name}: there is no touch besides the background; give another background="
        )
    subjects = {*touches.subjects.astype(str)}
    if missing := sorted(subjects - {*quiet.subjects.astype(str)}):
        advice = (
            f"leave the subject out with where=\"subject != '{missing[0]}'\", or give another "
            "background="
        )
        if len(missing) == len(subjects):
            advice = suggest_background(touches)
        raise InputError(
            f"subject {missing[0]} of {touches.name} has no background to compose a recording of; "
            f"{advice}"
        )
    seconds = (sum(TOUCH_S) + sum(GAP_S)) / 2 * len(touches)
    values = seconds * touches.rate_hz * touches.grid[0] * touches.grid[1]
    check_memory(f"recordings of {touches.name}", COPIES * 4.0 * values)


def _condition_keys(corpus: Corpus, labels: list[str]) -> np.ndarray:
    """The conditions of each capture in one string, object [captures]."""
    if not labels:
        return np.full(len(corpus), "", dtype=object)
    table = corpus.captures.reindex(columns=labels).astype(str)
    return table.agg("|".join, axis=1).to_numpy(dtype=object)


def _find_background(of_subject: np.ndarray, of_condition: np.ndarray) -> np.ndarray:
    """Positions of the subject's background in the same conditions; without any, of all of it."""
    both = of_subject & of_condition
    return np.flatnonzero(both if both.any() else of_subject)


def _draw_gap(quiet: Corpus, pool: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Draw excerpts of background, 3 to 10 s together."""
    missing, parts = round(rng.uniform(*GAP_S) * quiet.rate_hz), []
    while missing > 0:
        frames = quiet[int(rng.choice(pool))]
        length = min(missing, len(frames))
        begin = int(rng.integers(0, len(frames) - length + 1))
        parts.append(frames[begin : begin + length])
        missing -= length
    return parts
