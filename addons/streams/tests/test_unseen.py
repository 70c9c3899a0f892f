"""Nothing is learned from doubtful stretches (`?`) or a test subject's further background."""

import numpy as np
import pandas as pd
import pytest

from addons.streams.tests.people import PEOPLE, import_day, import_recordings, make_day_plan
from bench.corpora.corpus import Corpus
from bench.corpora.library import captures_with_gesture
from bench.errors import InputError
from bench.running.results import FoldResult
from touchbench_streams.detectors.detector import held_out_units
from touchbench_streams.fold import run_numbers, short_background_warnings
from touchbench_streams.recordings import (
    Recordings,
    cut_into_captures,
    drop_doubtful,
    event_table,
    restore_recordings,
)
from touchbench_streams.stored import join_background, load_background
from touchbench_streams.study import Continuous


def doubtful_labels(first):
    """Labels of `PEOPLE` with one doubtful touch and the second half of another one, of each."""
    labels, firsts = PEOPLE.frame_labels(), np.cumsum(PEOPLE.corpus.lengths) - PEOPLE.corpus.lengths
    for i, begin in enumerate(firsts):
        events = (
            PEOPLE.events[PEOPLE.events["recording"] == i]
            .sort_values("gesture")
            .reset_index(drop=True)
        )
        start, end = (begin + events[name].to_numpy() for name in ("start", "end"))
        whole, half = (
            (first + i) % len(events),
            (first + i + 5) % len(events),
        )  # two people have each gesture
        labels[start[whole] : end[whole]] = "?"
        labels[start[whole] + 2] = ""  # a part of a single frame
        labels[(start[half] + end[half]) // 2 : end[half] + 3] = "?"
    return labels


def evaluate_with_noise(labels, noise):
    """Evaluate the fold that trains on subjects 2 and 3, with noise in doubtful stretches."""
    frames = PEOPLE.corpus.frames.copy()
    changed = (labels == "?") & np.isin(np.repeat(PEOPLE.subjects, PEOPLE.corpus.lengths), noise)
    frames[changed] = np.random.default_rng(3).integers(0, 1024, frames[changed].shape)
    import_day(labels, frames)
    plan = make_day_plan()
    return Continuous().evaluate_fold(plan.cell, plan.corpus, plan.folds[0], 1)


def test_readings_in_doubtful_stretches_change_nothing_that_is_learned():
    labels = doubtful_labels(3)
    one, other = (evaluate_with_noise(labels, noise) for noise in ([], ["2", "3"]))
    assert one.chosen == other.chosen
    pd.testing.assert_frame_equal(one.trials, other.trials)
    pd.testing.assert_frame_equal(one.table, other.table)


def test_scores_by_hand():
    """At 10 Hz the collar has 5 frames; of 36,000, 100 are a touch and 3,600 are doubtful."""
    stretches = [
        ("touch", 1000, 1100, "pat"),
        ("doubtful", 1100, 4600, "?"),
        ("doubtful", 9900, 10_000, "?"),
    ]
    reports = [
        (1103, 1200),  # soon after the touch, but in a doubtful stretch: no hit
        (3000, 3010),
        (4605, 4700),  # last frame of the collar
        (4606, 4700),  # false alarm
        (9899, 9950),  # begins before the stretch: false alarm
    ]
    said = {"kind": "report", "first": "pat", "label": "pat", "confidence": 1.0, "changes": 0}
    table = pd.concat(
        [
            pd.DataFrame([{"kind": "recording", "end": 36_000, "refused": 900}]),
            pd.DataFrame(stretches, columns=["kind", "start", "end", "gesture"]),
            pd.DataFrame(reports, columns=["reported", "end"]).assign(**said),
        ]
    ).assign(subject="ann", fold="ann", recording=0)
    table = pd.concat(
        [
            table,
            pd.DataFrame([{"kind": "curve", "offset": 0.0, "hits": 0, "alarms": 2, "reports": 2}]),
        ]
    )
    numbers, tables = run_numbers([FoldResult("ann", table)], 10.0, "")
    assert numbers["refused"] == 900 / 36_000
    assert tables["reports"]["touch"].tolist() == [-2, -2, -2, -1, -1]
    assert numbers["background_minutes"] == pytest.approx((36_000 - 100 - 3600) / 600)
    assert numbers["false_alarms_per_hour"] == pytest.approx(2 / (32_300 / 36_000))
    assert (numbers["touches"], numbers["touches_found"], numbers["doubtful_reports"]) == (1, 0, 3)


def test_recordings_in_parts_without_what_is_doubtful():
    frames = [np.arange(n).reshape(-1, 1, 1) for n in (10, 4)]
    names = pd.DataFrame({"subject": ["a", "b"], "gesture": "", "recording": ["x", "y"]})
    labelled = event_table(
        [(0, 1, 3, "pat"), (0, 3, 5, "?"), (0, 8, 9, "rub"), (1, 0, 1, "?"), (1, 1, 2, "pat")]
    )
    whole = Recordings(Corpus.from_captures(frames, names, 10.0), labelled)
    assert whole.background_frames().tolist() == [5, 2] and whole[[1]].doubtful[
        "recording"
    ].tolist() == [0]
    captures = cut_into_captures(whole)
    assert captures.gestures.tolist() == [
        "background",
        "pat",
        "?",
        "background",
        "rub",
        "background",
        "?",
        "pat",
    ] + ["background"]
    again = restore_recordings(captures)
    pd.testing.assert_frame_equal(again.labelled, labelled)
    parts = restore_recordings(drop_doubtful(captures))
    assert [part.ravel().tolist() for part in parts.corpus] == [
        [0, 1, 2],
        [5, 6, 7, 8, 9],
        [1, 2, 3],
    ]
    rows = [(0, 1, 3, "pat"), (1, 3, 4, "rub"), (2, 0, 1, "pat")]
    assert list(parts.events.itertuples(index=False, name=None)) == rows and not len(parts.doubtful)
    assert held_out_units(parts).tolist() == [
        "0",
        "0",
        "1",
    ]  # parts of one recording are never on both sides
    touches = captures_with_gesture(captures)
    assert touches.gestures.tolist() == ["pat", "rub", "pat"] and touches[1].ravel().tolist() == [8]
    assert touches.captures["recording"].tolist() == ["x", "x", "y"]
    idle = Recordings(  # further background; of the second recording nothing is sure
        Corpus.from_captures(
            [20 + frames[0], 40 + frames[1]], names.assign(subject=["c", "d"]), 10.0
        ),
        event_table([(0, 2, 4, "?"), (1, 0, 4, "?")]),
    )
    more = join_background(parts, idle, np.array(["e"]))
    assert [part[[0, -1]].ravel().tolist() for part in more.corpus][3:] == [[20, 21], [24, 29]]
    assert held_out_units(more).tolist() == ["0", "0", "1", "2", "2"] and not len(more.doubtful)
    none = join_background(parts, idle, np.array(["c"]))
    assert none.background_frames().sum() == parts.background_frames().sum()


STILL = {"4": 900, "1": 450}  # frames of further background by subject


@pytest.fixture
def imported():
    """Recordings with touches (``day``), and further ones without (``still``)."""
    import_day()
    return import_still(0)


def import_still(seed, changed=""):
    """Import further background, in which the readings of one subject can be replaced."""
    subjects = np.repeat([*STILL], [*STILL.values()])
    frames = np.random.default_rng(7).integers(0, 9, (len(subjects), 9))
    frames[subjects == changed] = np.random.default_rng(seed).integers(
        0, 1024, (np.sum(subjects == changed), 9)
    )
    return import_recordings("still", frames, [""] * len(subjects), subjects)


def test_what_a_test_subject_recorded_changes_nothing_and_what_others_did_counts(imported):
    plan, kind = (
        make_day_plan(),
        Continuous(detector="threshold", background="still", false_alarms=2.0),
    )
    one, identity = kind.evaluate_fold(plan.cell, plan.corpus, plan.folds[0], 1), kind.identity()
    import_still(3, "1")
    assert kind.identity() != identity
    tested = kind.evaluate_fold(plan.cell, plan.corpus, plan.folds[0], 1)
    pd.testing.assert_frame_equal(one.trials, tested.trials)
    assert one.chosen == tested.chosen
    import_still(3, "4")
    assert not kind.evaluate_fold(plan.cell, plan.corpus, plan.folds[0], 1).trials.equals(
        one.trials
    )


def test_further_background_makes_lower_rates_learnable(imported):
    plan = make_day_plan()
    quiet = (
        min(PEOPLE.background_frames()[~(PEOPLE.subjects == out)].sum() for out in PEOPLE.subjects)
        / 15
        / 60
    )
    trains = [fold.train for fold in plan.folds]
    (alone,), (more,) = (
        short_background_warnings(plan.corpus, trains, 0.001, background)
        for background in ("", "still")
    )
    assert f" is {quiet:.1f} minutes" in alone
    assert f" is {quiet + sum(STILL.values()) / 15 / 60:.1f} minutes" in more


def test_further_background_of_another_rate_is_refused():
    import_recordings("fast", np.zeros((60, 9), int), [""] * 60, ["9"] * 60, "30")
    with pytest.raises(InputError, match=r"rate_hz is 30.*not 15"):
        load_background("fast", PEOPLE.corpus)
