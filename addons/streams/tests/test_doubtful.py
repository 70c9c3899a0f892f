"""Doubtful stretches (`?`): nothing is learned from them, and nothing in them counts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.corpora.corpus import Corpus
from bench.corpora.library import gestures_of, import_corpus
from bench.plan.cells import cells
from bench.plan.plan import planned
from bench.scratch import home
from bench.work.results import FoldResult
from touchbench_streams.detectors.detector import left_out
from touchbench_streams.fold import run_numbers
from touchbench_streams.recordings import Recordings, captures_in, certain, event_table, recorded
from touchbench_streams.stored import joined
from touchbench_streams.study import Continuous
from touchbench_streams.synth_recordings import generate

PEOPLE = generate(subjects=3, variants=("normal",), rows=3, cols=3, rate_hz=15.0)


def doubted(first):
    """The labels of these people; of each, one touch and the second half of another one are doubtful."""
    labels, firsts = PEOPLE.frame_labels(), np.cumsum(PEOPLE.corpus.lengths) - PEOPLE.corpus.lengths
    for i, begin in enumerate(firsts):
        events = PEOPLE.events[PEOPLE.events["recording"] == i].sort_values("gesture").reset_index(drop=True)
        start, end = (begin + events[name].to_numpy() for name in ("start", "end"))
        whole, half = (first + i) % len(events), (first + i + 5) % len(events)  # two people have each gesture
        labels[start[whole] : end[whole]] = "?"
        labels[start[whole] + 2] = ""  # a part of a single frame
        labels[(start[half] + end[half]) // 2 : end[half] + 3] = "?"
    return labels


def fold_of(labels, detector, noise, seed):
    """The fold of `bench watch` that trains on subjects 2 and 3; doubtful readings of some subjects are noise."""
    frames = PEOPLE.corpus.frames.reshape(len(labels), -1).copy()
    subjects = np.repeat(PEOPLE.subjects, PEOPLE.corpus.lengths)
    changed = (labels == "?") & np.isin(subjects, noise)
    frames[changed] = np.random.default_rng(seed).integers(0, 1024, frames[changed].shape)
    table = pd.DataFrame(frames, columns=[f"ch{i}" for i in range(9)]).assign(label=labels, subject=subjects)
    file = Path(home(), "day.parquet")
    file.parent.mkdir(parents=True, exist_ok=True)
    table[["subject", "label", *table.columns[:9]]].to_parquet(file)
    import_corpus("recording", file, {"name": "day", "rate_hz": "15", "grid": "3x3"})
    (plan,) = planned(
        [replace(c, study=Continuous()) for c in cells({"data": "day", "model": "lda", "features": "touch"})], 1
    )
    assert [fold.name for fold in plan.folds] == ["1", "2", "3"]
    return Continuous(detector=detector).fold(plan.cell, plan.corpus, plan.folds[0], 1)


@pytest.mark.parametrize("detector, seed", [("frames", 3), ("threshold", 8)])
def test_readings_in_doubtful_stretches_change_nothing_that_is_learned(detector, seed):
    labels = doubted(seed)
    one, other, tested = (fold_of(labels, detector, noise, seed) for noise in ([], ["2", "3"], ["1"]))
    assert one.chosen == other.chosen
    pd.testing.assert_frame_equal(one.trials, other.trials)
    pd.testing.assert_frame_equal(one.table, other.table)
    pd.testing.assert_frame_equal(one.trials, tested.trials)
    assert not one.table.equals(tested.table)  # the test subject's recording is watched as it is


def test_scores_by_hand():
    """At 10 Hz the collar has 5 frames; of 36,000 frames, 100 are a touch and 3,600 are doubtful."""
    rows = [
        ("recording", 36_000),
        ("touch", 1000, 1100, "pat"),
        ("doubtful", 1100, 4600, "?"),
        ("doubtful", 9900, 10_000, "?"),
        ("report", 1103, 1200),  # soon after the touch, but in a doubtful stretch: no hit
        ("report", 3000, 3010),
        ("report", 4605, 4700),  # last frame of the collar
        ("report", 4606, 4700),  # false alarm
        ("report", 9899, 9950),  # begins before the stretch: false alarm
    ]
    said = {"first": "pat", "label": "pat", "confidence": 1.0}
    names = {"recording": ["end"], "report": ["reported", "end"]}
    table = pd.DataFrame(
        [
            {"kind": kind} | dict(zip(names.get(kind, ["start", "end", "gesture"]), values, strict=True)) | said
            for kind, *values in rows
        ]
    ).assign(subject="ann", fold="ann", recording=0, refused=900)
    table = pd.concat([table, pd.DataFrame([{"kind": "curve", "offset": 0.0, "hits": 0, "alarms": 2, "reports": 2}])])
    numbers, tables = run_numbers([FoldResult("ann", table)], 10.0, "")
    assert numbers["refused"] == 900 / 36_000
    assert tables["reports"]["touch"].tolist() == [-2, -2, -2, -1, -1]
    assert numbers["background_minutes"] == pytest.approx((36_000 - 100 - 3600) / 600)
    assert numbers["false_alarms_per_hour"] == pytest.approx(2 / (32_300 / 36_000))
    assert (numbers["touches"], numbers["touches_found"], numbers["doubtful_reports"]) == (1, 0, 3)


def test_recordings_in_parts_without_what_is_doubtful():
    frames = [np.arange(n).reshape(-1, 1, 1) for n in (10, 4)]
    names = pd.DataFrame({"subject": ["a", "b"], "gesture": "", "recording": ["x", "y"]})
    labelled = event_table([(0, 1, 3, "pat"), (0, 3, 5, "?"), (0, 8, 9, "rub"), (1, 0, 1, "?"), (1, 1, 2, "pat")])
    whole = Recordings(Corpus.from_captures(frames, names, 10.0), labelled)
    assert whole.background_frames().tolist() == [5, 2] and whole[[1]].doubtful["recording"].tolist() == [0]
    captures = captures_in(whole)
    assert captures.gestures.tolist() == ["background", "pat", "?", "background", "rub", "background", "?", "pat"] + [
        "background"
    ]
    again = recorded(captures)
    pd.testing.assert_frame_equal(again.labelled, labelled)
    parts = recorded(certain(captures))
    assert [part.ravel().tolist() for part in parts.corpus] == [[0, 1, 2], [5, 6, 7, 8, 9], [1, 2, 3]]
    rows = [(0, 1, 3, "pat"), (1, 3, 4, "rub"), (2, 0, 1, "pat")]
    assert list(parts.events.itertuples(index=False, name=None)) == rows and not len(parts.doubtful)
    assert left_out(parts).tolist() == ["0", "0", "1"]  # parts of one recording are never on both sides
    touches = gestures_of(captures)
    assert touches.gestures.tolist() == ["pat", "rub", "pat"] and touches[1].ravel().tolist() == [8]
    assert touches.captures["recording"].tolist() == ["x", "x", "y"]
    idle = Recordings(  # further background; of the second recording nothing is sure
        Corpus.from_captures([20 + frames[0], 40 + frames[1]], names.assign(subject=["c", "d"]), 10.0),
        event_table([(0, 2, 4, "?"), (1, 0, 4, "?")]),
    )
    more = joined(parts, idle, np.array(["e"]))
    assert [part[[0, -1]].ravel().tolist() for part in more.corpus][3:] == [[20, 21], [24, 29]]
    assert left_out(more).tolist() == ["0", "0", "1", "2", "2"] and not len(more.doubtful)
    none = joined(parts, idle, np.array(["c"]))
    assert none.background_frames().sum() == parts.background_frames().sum()
