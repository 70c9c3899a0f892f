"""`bench watch`: what is learned, how events are told from probabilities, one frame at a time or all at once."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.cli import main
from bench.corpora.composer import captures_in
from bench.corpora.corpus import Corpus
from bench.corpora.synth_recordings import generate
from bench.errors import InputError
from bench.outcomes.store import connect
from bench.plan.cells import cells
from bench.plan.plan import Fold
from bench.work.watch import Watch
from bench.work.watcher import Clock, LiveStream, Tracker, learned, spans, touched
from features.touch import TouchFeatures
from models.classic.lda import lda
from models.recipe import Recipe
from tests.conftest import SMALL, runs

CLOCK = Clock(hop=5, detect=25, name=40, wait=10, hold=15)


@pytest.fixture(scope="module")
def recordings():
    """Four generated people with one touch of each gesture, at 50 frames a second."""
    return generate(subjects=4, variants=("normal",), rate_hz=50.0)


@pytest.fixture(scope="module")
def watcher(recordings):
    captures = captures_in(recordings[np.arange(3)])
    system = Recipe(lda(TouchFeatures()), 0.75, repair=("stuck", "dead")).fit(captures, captures.gestures)
    return learned(system, recordings[np.arange(3)], 5.0)[0]


def followed(probabilities, windows, tail=10, reject=0.0, peak=0.0):
    """News of a tracker, whose recogniser's windows are given by frames seen."""
    names = np.array(["pat", "rub"])
    tracker = Tracker(SimpleNamespace(clock=CLOCK, tail=tail, reject=reject, names=names, strong=12.0))
    news = []
    for i, probability in enumerate(probabilities):
        seen = CLOCK.detect + i * CLOCK.hop
        if tracker.step(seen, np.float32(probability), np.float32(peak)):
            tracker.name(seen, np.array(windows(seen), np.float32))
        if event := tracker.news(seen):
            news.append((seen, event.reported, event.end, event.first, event.label))
    return news


def test_a_touch_by_hand():
    # Decisions after 25, 30, ... frames; touch is more probable than not from 50 on and detected at 55; it is over at
    # 120. Windows of 40 frames from 50 on: the first is complete at 90, the report comes 10 frames later.
    probabilities = [0.1] * 5 + [0.6] + [0.99] * 13 + [0.05] * 6
    news = followed(probabilities, lambda seen: (0.9, 0.1) if seen < 105 else (0.0, 1.0))
    # At 100: windows of 90, 95, 100 say pat. 0.9 * 3 / (3 + n) < 0.5 for n = 3 more that say rub: 105, 110, 115; of the
    # windows until 10 frames before now, that is at 125, but the touch was over at 120: 120 - 10 is 110, so pat.
    assert news == [(100, 100, None, "pat", "pat"), (140, 100, 120, "pat", "pat")]
    news = followed(probabilities, lambda seen: (0.9, 0.1) if seen < 105 else (0.0, 1.0), tail=0)
    assert news == [(100, 100, None, "pat", "pat"), (115, 100, None, "pat", "rub"), (140, 100, 120, "pat", "rub")]
    assert followed(probabilities, lambda seen: (0.6, 0.4), reject=0.7)[0][3] == "unknown"


def test_short_touches_and_touches_that_begin_again():
    def pat(seen):
        return (1.0, 0.0)

    assert followed([0.1] * 5 + [0.99] * 7 + [0.05] * 9, pat) == []  # over before a window of 40 frames is complete
    # over at 85: reported all the same where its log-odds are high enough, 10 frames later
    strong = followed([0.1] * 5 + [0.99] * 7 + [0.05] * 9, pat, peak=13)
    assert strong == [(95, 95, None, "pat", "pat"), (105, 95, 85, "pat", "pat")]
    # over at 95, after the first complete window at 90: reported 10 frames after that, ended 15 frames after 95
    short = followed([0.1] * 5 + [0.99] * 9 + [0.05] * 9, pat)
    assert short == [(100, 100, None, "pat", "pat"), (115, 100, 95, "pat", "pat")]
    # a gap of 15 frames from 110 on: one event
    again = followed([0.1] * 5 + [0.99] * 12 + [0.05] * 3 + [0.99] * 4 + [0.05] * 5, pat)
    assert [each[:3] for each in again] == [(100, 100, None), (165, 100, 145)]


@settings(max_examples=100, deadline=None)
@given(st.lists(st.sampled_from([0.0, 0.05, 0.2, 0.6, 0.96, 1.0]), max_size=60))
def test_spans_are_those_of_a_naive_loop(values):
    expected, crossed, begun, before, last = [], 0, None, 0.0, None
    for i, value in enumerate(values):
        if value > 0.5 >= before:
            crossed = i
        before = value
        if begun is None and value > 0.95:
            if expected and i - expected[-1][2] <= 4:
                begun = expected.pop()[:2]
            else:
                begun = (crossed, i)
        elif begun is not None and value < 0.1:
            expected.append((*begun, i))
            begun = None
        last = i
    if begun is not None:
        expected.append((*begun, last))
    found = (spans(np.array(values, np.float32), CLOCK) - 25) // 5
    assert found.tolist() == [list(row) for row in expected]


def test_the_filter_is_bayes_rule_for_two_states():
    odds = np.array([1.0, -2.0, 5.0, 0.5])
    touch = 0.0
    for value, got in zip(odds, touched(odds, CLOCK, 50.0), strict=True):
        prior = touch * (1 - 0.2 * 0.1) + (1 - touch) * 0.05 * 0.1
        likelihood = np.exp(4 * 5 / 25 * value)  # each of five overlapping windows counts 4/5
        touch = prior * likelihood / (prior * likelihood + 1 - prior)
        assert got == pytest.approx(touch, rel=1e-5)


def test_frames_one_by_one_give_the_events_of_whole_recordings(recordings, watcher):
    one = recordings[[3]].corpus
    live = LiveStream(watcher, one.grid, one.rate_hz, one.full_scale)
    news = [event for frame in one[0] if (event := live.push(frame.astype(np.float32))) and event.end]
    reports = watcher.reports(one)
    assert len(reports) >= 5
    rows = [(e.reported, e.end, e.first, e.label) for e in news]
    whole = reports[["reported", "end", "first", "label"]].itertuples(index=False, name=None)
    assert rows == [*whole][: len(rows)] and len(reports) - len(rows) <= 1  # the recording may end before a touch does
    assert [e.confidence for e in news] == pytest.approx(reports["confidence"][: len(rows)].tolist(), abs=1e-5)


def test_nothing_of_a_test_subject_is_learned(recordings):
    (cell,) = cells({"data": "synth", "model": "lda", "features": "touch", "model.window": "0.75"})
    corpus = captures_in(recordings)
    fold = Fold("4", *(np.flatnonzero((corpus.subjects == "4") == tested) for tested in (False, True)))
    table = corpus.captures.copy()
    touched_rows = (table["subject"] == "4") & (table["gesture"] != "background")
    table.loc[touched_rows, "gesture"] = table.loc[touched_rows, "gesture"].to_numpy()[::-1]
    frames = corpus.frames.copy()
    tested = np.repeat(corpus.subjects == "4", corpus.lengths)
    frames[tested] = frames[tested][::-1]
    other = corpus.changed(captures=table, frames=frames)
    results = [Watch().fold(cell, each, fold, 1) for each in (corpus, other)]
    assert results[0].chosen == results[1].chosen
    pd.testing.assert_frame_equal(results[0].trials, results[1].trials)
    assert not results[0].table.equals(results[1].table)  # the test subject was another one


@pytest.mark.parametrize(
    ("words", "fact"),
    [
        (["where=variant == 'normal'"], "where="),
        (["background=quiet"], "background=quiet"),
        (["protocol=kfold", "protocol.folds=2"], "protocol=kfold"),
        (["target=variant"], "target="),
        (["false_alarms=0"], "false_alarms="),
    ],
)
def test_what_cannot_be_watched_is_one_line(words, fact, capsys):
    assert main(["watch", *SMALL, "model=lda", "features=touch", *words]) == 2
    error = capsys.readouterr().err
    assert fact in error and error.count("\n") == 1


def test_background_without_touches_is_refused(recordings):
    row = pd.DataFrame({"subject": ["1"], "gesture": ["rub"]})
    with pytest.raises(InputError, match="no touch"):
        Watch(background="rub").recordings(Corpus.from_captures([recordings.corpus[0]], row, 50.0))


def test_the_command_stores_what_it_prints_and_goes_on(capsys):
    words = ["watch", *SMALL, "model=lda", "features=touch", "model.window=0.5"]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert "42" in printed and "3/3" in printed  # 14 gestures of 3 people
    (run,) = runs("watch")[1]
    touches = pd.read_csv(connect().fetched(run.info.run_id, "touches.csv"))
    metrics = run.data.metrics
    assert len(touches) == metrics["touches"] == 42
    assert touches["found"].mean() == pytest.approx(metrics["touches_found"])
    label = pd.read_csv(connect().fetched(run.info.run_id, "reports.csv")).drop_duplicates("touch", keep="last")
    label = label[label["touch"] >= 0].set_index("touch")["label"]
    right = sum(touches["gesture"][i] == name for i, name in label.items())
    assert right <= touches["found"].sum() and metrics["end_correct"] <= metrics["touches_found"]
    assert main(words) == 0
    assert "already stored" in capsys.readouterr().err
    assert len(runs("watch")[1]) == 1
