"""`bench watch`: what is learned, how events are told from probabilities, one frame at a time or all at once."""

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import mlflow
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.cli import main
from bench.corpora.corpus import Corpus
from bench.corpora.recordings import Recordings, captures_in, event_table
from bench.corpora.synth_recordings import generate
from bench.endless.detector import Clock, touched
from bench.endless.kind import Continuous
from bench.endless.watch import _rejection, recordings_of, run_numbers
from bench.endless.watcher import LiveStream, Rules, Tracker, events_of
from bench.endless.watcher_training import learned
from bench.errors import InputError
from bench.features.touch import TouchFeatures
from bench.models.classic.lda import lda
from bench.models.recipe import Recipe
from bench.outcomes.candidates import candidates
from bench.outcomes.store import connect
from bench.plan.cells import cells
from bench.plan.plan import Fold
from bench.work.fit import save_adapted
from bench.work.saved import Recogniser, load
from tests.conftest import SMALL, random_corpus, runs
from tests.results import watched as seen

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
        if tracker.step(seen, probability, peak):
            tracker.name(seen, np.array(windows(seen)))
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
    assert followed(probabilities, lambda seen: (0.0, 0.0))[0][3] == "unknown"  # it abstains


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


@settings(max_examples=200, deadline=None)
@given(st.lists(st.sampled_from([0.0, 0.05, 0.2, 0.6, 0.96, 1.0]), max_size=60), st.sampled_from([0.0, 20.0]))
def test_events_are_those_of_a_naive_reading_of_the_rules(values, odds):
    """Touches as runs of decisions, and what is reported of each run, without state."""
    times = [25 + 5 * i for i in range(len(values))]
    rises = [i for i, v in enumerate(values) if v > 0.5 and (i == 0 or values[i - 1] <= 0.5)]
    expected, i = [], 0
    while i < len(values):
        if values[i] <= 0.95:
            i += 1
            continue
        crossed, begun, low, report, first = max(r for r in rises if r <= i), i, None, None, None
        for i in range(begun, len(values)):
            low = None if values[i] > 0.95 else i if low is None and values[i] < 0.1 and i > begun else low
            over = low is not None and i - low > 3  # 15 frames
            whole = times[i] >= max(times[crossed] + 40, times[begun]) and not over
            sure = odds >= 12 and low == i and times[i] >= 40 and first is None
            first = i if first is None and (whole or sure) else first
            late = first is not None and first <= (i if low is None else low) and (over or i - first >= 2)  # 10 frames
            report = i if report is None and late else report
            if over:
                break
        if report is not None:
            expected.append([times[report], times[i if low is None else low]])
        i += 1
    found, _ = events_of(Rules(CLOCK, 12.0), np.array(times), np.array(values), np.full(len(values), odds))
    assert found.tolist() == expected


def test_memory_does_not_grow_in_a_touch_that_never_ends(watcher):
    tracker = Tracker(watcher)
    for i in range(20_000):
        if tracker.step(25 + 5 * i, 1.0, 5.0):
            tracker.name(25 + 5 * i, np.full(len(watcher.names), 1 / len(watcher.names)))
        tracker.news(25 + 5 * i)
    assert len(tracker.waiting) <= watcher.tail // watcher.clock.hop + 1 and tracker.count > 19_000


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
    news = [event for frame in one[0] for event in live.push(frame.astype(np.float32)) if event.end]
    reports = watcher.reports(one)
    assert len(reports) >= 5
    rows = [(e.reported, e.end, e.first, e.label) for e in news]
    whole = reports[["reported", "end", "first", "label"]].itertuples(index=False, name=None)
    assert rows == [*whole][: len(rows)] and len(reports) - len(rows) <= 1  # the recording may end before a touch does
    assert [e.confidence for e in news] == pytest.approx(reports["confidence"][: len(rows)].tolist(), abs=1e-5)


def test_a_stream_says_that_it_refuses_or_saturates(recordings, watcher):
    one = recordings[[3]].corpus
    live = LiveStream(watcher, one.grid, one.rate_hz, one.full_scale)
    quiet = [frame.astype(np.float32) for frame in one[0][:60]]
    for frame in quiet:
        live.push(frame)
    assert live.status == "ok"
    for _ in range(60):  # no taxel changes
        live.push(quiet[-1])
    assert live.status == "refused"
    frame = quiet[-1].copy()
    frame.flat[: -(-frame.size // 10)] = one.full_scale
    live.push(frame)
    assert live.status == "saturated"
    frame.flat[0] = 0
    live.push(frame)
    assert live.status != "saturated"


@pytest.mark.parametrize("unknown", ["", "pat"])
def test_nothing_of_a_test_subject_is_learned(unknown, recordings):
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
    results = [Continuous(unknown=unknown).fold(cell, each, fold, 1) for each in (corpus, other)]
    assert results[0].chosen == results[1].chosen and (float(str(results[0].chosen["reject"])) > 0) == bool(unknown)
    pd.testing.assert_frame_equal(results[0].trials, results[1].trials)
    assert not results[0].table.equals(results[1].table)  # the test subject was another one
    touches = results[0].table[results[0].table["kind"] == "touch"]["gesture"].tolist()
    assert touches.count("unknown") == bool(unknown) and touches.count("pat") != bool(unknown)


@pytest.mark.parametrize(
    ("words", "fact"),
    [
        (["where=variant == 'normal'"], "where="),
        (["background=quiet"], "background=quiet"),
        (["unknown=hug"], "unknown=hug"),
        (["protocol=kfold", "protocol.folds=2"], "protocol=kfold"),
        (["target=variant"], "target="),
        (["false_alarms=0"], "false_alarms="),
    ],
)
def test_what_cannot_be_watched_is_one_line(words, fact, capsys):
    assert main(["watch", *SMALL, "model=lda", "features=touch", *words]) == 2
    error = capsys.readouterr().err
    assert fact in error and error.count("\n") == 1


def relabelled(recordings, names=None, untouched=()):
    """The same with other names of gestures, and people whose touches are not labelled."""
    events = recordings.events.replace({"gesture": names or {}})
    kept = ~np.isin(recordings.subjects[events["recording"]], untouched)
    return replace(recordings, events=events[kept].reset_index(drop=True))


def test_false_alarms_of_a_person_without_touches_count(recordings):
    """Subject 4 touches as before, but without labels, so each report is a false alarm."""
    (cell,) = cells({"data": "synth", "model": "lda", "features": "touch", "model.window": "0.75"})
    corpus = captures_in(relabelled(recordings, untouched="4"))
    fold = Fold("4", *(np.flatnonzero((corpus.subjects == "4") == tested) for tested in (False, True)))
    result = Continuous().fold(cell, corpus, fold, 1)
    reports = (result.table["kind"] == "report").sum()
    numbers, tables = run_numbers([result], 50.0, "")
    rate = reports / (recordings.corpus.lengths[3] / 50 / 3600)
    assert reports >= 5 and numbers["false_alarms_per_hour"] == pytest.approx(rate) and numbers["touches"] == 0
    assert tables["per_subject"]["false_alarms_per_hour"].tolist() == pytest.approx([rate])
    other = {"subject": "5", "end_correct": 0.5, "false_alarms_per_hour": 0.0, "background_s": 1800.0}
    watched = pd.concat([tables["per_subject"], pd.DataFrame([other])], ignore_index=True)
    among = candidates([seen("lda", [0.5], 0.0, 1.0, tables={"per_subject": watched})], {}, recordings=True)
    hours = recordings.corpus.lengths[3] / 50 / 3600 + 0.5
    assert among.table["accuracy"][0] == 50 and among.table["false_alarms"][0] == pytest.approx(reports / hours)


@pytest.mark.parametrize(
    ("names", "untouched", "options", "fact"),
    [
        ({}, "1234", {}, "no touch; label"),
        ({}, "34", {}, "fold 1 trains on touches of 1 subject;"),
        ({"rub": "unknown"}, "", {"unknown": "pat"}, "unknown=pat: .* has a gesture of this name; rename it"),
        ({"rub": "unknown"}, "", {"unknown": "unknown"}, ""),
        ({"rub": "background"}, "", {}, "called background"),  # stored by an earlier version
        ({"rub": "notouch"}, "", {}, ""),
        ({"rub": "quiet"}, "", {}, ""),
    ],
)
def test_recordings_that_cannot_be_watched_are_refused_before_training(names, untouched, options, fact, recordings):
    (cell,) = cells({"data": "synth", "model": "lda", "features": "touch"})
    with pytest.raises(InputError, match=fact) if fact else nullcontext():
        corpus = captures_in(relabelled(recordings, names, [*untouched]))
        sides = [[np.flatnonzero((corpus.subjects == one) == tested) for tested in (False, True)] for one in "12"]
        plan = SimpleNamespace(corpus=corpus, cell=cell, mixes_subjects=False)
        plan.folds = [Fold(name, *parts) for name, parts in zip("12", sides, strict=True)]
        Continuous(**options).refuse(plan)


def test_a_class_called_quiet_is_not_the_quiet_ends_of_captures(recordings):
    (cell,) = cells({"data": "synth", "model": "lda", "features": "touch"})
    corpus = random_corpus(gestures=("pat", "quiet"))
    with pytest.raises(InputError, match="background=quiet: .* class quiet; rename it"):
        Continuous(background="quiet").refuse(SimpleNamespace(corpus=corpus, cell=cell, folds=[], mixes_subjects=False))


def test_without_background_all_is_touch_and_false_alarms_are_unknown(recordings):
    """Each recording is cut to its longest touch."""
    longest = recordings.events.assign(length=lambda e: e["end"] - e["start"]).sort_values("length")
    longest = longest.drop_duplicates("recording", keep="last").sort_values("recording")
    frames = [recordings.corpus[r][s:e] for r, s, e in longest[["recording", "start", "end"]].itertuples(index=False)]
    table = recordings.corpus.captures
    events = event_table((i, 0, len(f), "pat") for i, f in enumerate(frames))
    whole = Recordings(Corpus.from_captures(frames, table, 50.0), events)
    captures = captures_in(whole)
    watcher, _ = learned(Recipe(lda(TouchFeatures()), 0.75).fit(captures, captures.gestures), whole, 5.0)
    assert watcher.reports(whole.corpus)["recording"].tolist() == [0, 1, 2, 3]  # one event of each, until its end
    quiet, loud = (seen("lda", [0.5], 0.0, 1.0) for _ in range(2))
    del quiet.metrics["background_minutes"]
    assert [*Continuous.printed([loud, quiet])] == ["alarms/h is unknown: the recordings have no background"]
    assert not [*Continuous.printed([loud])]


def test_background_without_touches_is_refused(recordings):
    row = pd.DataFrame({"subject": ["1"], "gesture": ["rub"]})
    with pytest.raises(InputError, match="no touch"):
        recordings_of(Corpus.from_captures([recordings.corpus[0]], row, 50.0), "rub")


def test_the_command_stores_what_it_prints_and_goes_on(capsys):
    words = ["watch", *SMALL, "model=lda", "features=touch", "model.window=0.5"]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert "3 subjects: too few for an interval" in " ".join(printed.split()) and "3/3" in printed
    (run,) = runs("watch")[1]
    touches = pd.read_parquet(connect().fetched(run.info.run_id, "touches.parquet"))
    metrics = run.data.metrics
    assert len(touches) == metrics["touches"] == 42  # 14 gestures of 3 people
    assert touches["found"].mean() == pytest.approx(metrics["touches_found"])
    reports = pd.read_parquet(connect().fetched(run.info.run_id, "reports.parquet"))
    label = reports.drop_duplicates("touch", keep="last")
    label = label[label["touch"] >= 0].set_index("touch")["label"]
    right = sum(touches["gesture"][i] == name for i, name in label.items())
    assert right <= touches["found"].sum() and metrics["end_correct"] <= metrics["touches_found"]
    assert main(words) == 0
    assert "already stored" in capsys.readouterr().err
    assert len(runs("watch")[1]) == 1


def test_rejection_is_counted_by_each_fold_s_threshold():
    """Touches of 1 s, one every 2 s; thresholds 0.5 and 0.2: of the known 0.6, 0.4 and 0.3 one lies below."""
    rows = [("a", "pat", 0.6), ("a", "pat", 0.4), ("a", "unknown", 0.55), ("b", "pat", 0.3), ("b", "unknown", 0.05)]
    tables = []
    for i, (fold, gesture, confidence) in enumerate(rows):
        common = {"fold": fold, "subject": fold, "recording": 0}
        tables.append(common | {"kind": "touch", "start": 200 * i, "end": 200 * i + 100, "gesture": gesture})
        said = {"reported": 200 * i + 50, "end": 200 * i + 90, "first": "pat", "label": "pat", "confidence": confidence}
        tables.append(common | {"kind": "report"} | said)
    scores = _rejection(pd.DataFrame(tables), {"a": 0.5, "b": 0.2}, 100.0)
    # above the thresholds: known 0.1, -0.1, 0.1, unknown 0.05, -0.15; of 6 pairs 5 are in order
    assert scores == pytest.approx({"auroc": 5 / 6, "rejected_unknown": 1 / 2, "rejected_known": 1 / 3})


def test_a_model_that_is_adapted_watches_with_the_adapted_system(recordings, watcher, tmp_path):
    captures = captures_in(recordings[np.arange(3)])
    recogniser = Recogniser(watcher.system, captures, watcher=watcher)
    path = str(tmp_path / "rec")
    mlflow.pyfunc.save_model(path, **recogniser.model([], captures[0][:3]))
    save_adapted(path, recogniser, captures[:4], captures[:4].gestures, tmp_path / "one")
    one = load(str(tmp_path / "one"))
    assert one.watcher.system is one.estimator and one.watcher.bias == watcher.bias
