"""Detectors look at no later tick, learn times and thresholds, and agree with plain loops."""

import tracemalloc
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.corpora.corpus import COPY, Corpus
from bench.corpora.faults import FAULTS, as_readings
from bench.errors import InputError
from bench.features.touch import TouchFeatures
from bench.models.classic.lda import lda
from bench.models.recipe import Recipe, split_training
from bench.models.steps import Repair
from touchbench_streams.detectors import names
from touchbench_streams.detectors.detector import (
    Detector,
    choose_operating_points,
    held_out_units,
    run_rules,
    score_levels,
)
from touchbench_streams.detectors.frames import Frames, Hysteresis, TouchTimes
from touchbench_streams.detectors.names import cut_touches
from touchbench_streams.detectors.signals import CALM, Levels, measure_disturbance
from touchbench_streams.detectors.spans import average_blocks, find_spans
from touchbench_streams.detectors.threshold import Threshold, TwoInARow
from touchbench_streams.detectors.ticks import learn_watcher
from touchbench_streams.events import FALSE_ALARM, match_reports
from touchbench_streams.recordings import Recordings, cut_into_captures, event_table
from touchbench_streams.synth_recordings import generate


@pytest.fixture(scope="module")
def recordings():
    """Three generated people with one touch of each gesture, at 30 frames a second."""
    return generate(subjects=3, variants=("normal",), rate_hz=30.0)


make_lda = partial(lda, TouchFeatures())


def learn_from(detector, train, make=make_lda):
    """A watcher that learned from some recordings."""
    captures = cut_into_captures(train)
    return learn_watcher(detector, make, make().fit(captures, captures.gestures), train, 60.0)[0]


@pytest.fixture(scope="module", params=[Frames(), Threshold()], ids=["frames", "threshold"])
def watcher(request, recordings):
    """What learned from the first two people."""
    return learn_from(request.param, recordings[np.arange(2)])


def test_names_are_learned_from_damaged_copies_of_each_touch(recordings):
    system = Recipe(lda(TouchFeatures()), faults=("noise",), repair=("dead",), copies=2)
    damaging, steps, recipe = split_training(system)
    assert recipe.training_steps() == [] and steps == [Repair(("dead",))]
    parts = [*names._training_parts(recordings, damaging, steps)]
    index, copy = (
        np.concatenate(values)
        for values in zip(*((part.index, part.piece // COPY) for part in parts), strict=True)
    )
    assert len({*index}) == len(index) and not copy[: len(parts[0])].any()
    damaged = [part for part in parts if part.piece.any()]
    touches, lengths = len(recordings.events), len(names.DAMAGED_S)
    assert copy.sum() == sum(map(len, damaged)) == 2 * lengths * touches
    untouched = cut_touches(recordings, (np.inf,), (0.0,))
    first = damaged[0][len(damaged[0]) // 2 :]  # whole touches come after their beginnings
    assert np.array_equal(first.lengths[:2], np.repeat(untouched.lengths[:1], 2))
    steps_apart = np.abs(first[0] - untouched[0].astype(np.float32))
    assert 0 < np.median(steps_apart) < 0.1 * recordings.corpus.full_scale


def silent_recordings(lengths, events, rate_hz=8.0):
    """Recordings without pressure, with some events."""
    table = pd.DataFrame({"subject": "1", "gesture": [""] * len(lengths)})
    frames = [np.zeros((length, 2, 2), np.uint16) for length in lengths]
    return Recordings(Corpus.from_captures(frames, table, rate_hz), event_table(events))


def test_a_later_frame_changes_no_report_and_no_first_label(watcher, recordings):
    named, replaced = (
        s[-1].coef_.size + s[-1].intercept_.size for s in (watcher.names.system_, watcher.system)
    )
    assert watcher.numbers == watcher.detector.numbers + named - replaced
    whole = recordings[[2]].corpus
    reports = watcher.report_touches(whole)
    assert len(reports) >= 5
    for row in (1, len(reports) // 2, len(reports) - 1):
        seen = int(reports["reported"][row])
        cut = watcher.report_touches(
            whole.with_fields(lengths=np.array([seen]), digest="", path=None)
        )
        same = ["recording", "reported", "first"]
        pd.testing.assert_frame_equal(cut[same], reports.loc[:row, same])
    (evidence,), fitted = watcher.sense(whole).evidence, watcher.detector
    signals = fitted.signals()
    each = np.stack([signals.step(tick) for tick in average_blocks(whole[0], watcher.count)])
    for tick in (0, 5, 100, len(each) - 1):  # from the last ticks alone: memory does not grow
        ring = each[max(0, tick + 1 - fitted.memory) : tick + 1]
        np.testing.assert_allclose(fitted.evidence(ring)[-1], evidence[tick], rtol=1e-5, atol=1e-5)


def test_times_come_from_the_labels():
    quick = [
        (0, 10 * k, 10 * k + (1 if k < 3 else 8), "pat") for k in range(10)
    ]  # gaps of 9 and 2 ticks
    assert TouchTimes.learn_from(silent_recordings([200], quick), 0.25, 1.0) == TouchTimes(
        wait=1, hold=1, fade=8
    )
    slow = [(0, 60 * k, 60 * k + 20, "pat") for k in range(3)]
    assert TouchTimes.learn_from(silent_recordings([200], slow), 0.25, 1.0) == TouchTimes(
        wait=2, hold=8, fade=8
    )
    assert (
        TouchTimes.learn_from(silent_recordings([200], slow), 5.0, 1.0).wait == 15
    )  # three quarters of a touch


def test_a_touch_begins_above_the_level_and_a_new_one_after_a_dip():
    odds = [-5, 3, 3, 3, -1, 3, 3, -5, 3, -5, 3]  # the tick before the last dip is too short
    evidence = np.stack([odds, np.zeros(len(odds)), np.zeros(len(odds))], axis=1)

    def of(evidence, *times):
        waits = np.full((len(evidence), 1), times[0])
        rules = Hysteresis(np.array([1.0]), 1.5, TouchTimes(*times))
        return run_rules(rules, np.hstack([evidence, waits]))

    signs = of(evidence, 2, 1, 9)
    assert np.flatnonzero(signs[:, 2]).tolist() == [2, 6]
    assert signs[:, 1].astype(int).tolist() == [0, 1, 2, 3, 0, 1, 2, 0, 1, 0, 1]
    assert np.flatnonzero(of(evidence, 3, 3, 9)[:, 2]).tolist() == [
        3
    ]  # a dip is no end, but does not hold
    never = evidence + [0, -9, 0]  # the beginning was not seen
    assert not of(never, 2, 1, 9)[:, 2].any()
    signs = run_rules(TwoInARow(2.0), np.array([[0], [3], [3], [1.5], [3], [0.5], [3], [3]]))
    assert np.flatnonzero(signs[:, 2]).tolist() == [2, 7]


@given(
    steps=st.lists(
        st.tuples(st.floats(-4, 4, width=16), st.sampled_from([-9, -9, -9, 4])),
        min_size=9,
        max_size=60,
    ),
    times=st.tuples(*[st.integers(1, 5)] * 3),
)
def test_many_recordings_and_levels_at_once_have_the_signs_of_each_alone(steps, times):
    detectors = [Frames(), Frames()]  # each with other times
    detectors[0].times_, detectors[1].times_ = TouchTimes(*times), TouchTimes(2, 1, 9)
    evidence = np.array(steps).cumsum(axis=0) * [1, 0] + np.array(steps) * [0, 1]
    evidence = np.hstack([evidence, np.tile([0, times[0]], (len(steps), 1))])
    evidence = [evidence, evidence[5:], evidence[:1], evidence[:2]]
    detectors, levels = 2 * detectors, np.array([-3.0, 0.0, 1.5, 4.0])
    plain = [Threshold()] * 4, np.array([0.5, 1.0, 2.0, 4.0])
    for ones, at in ((detectors, levels), plain):
        found, expected = (of.find_signs(ones, evidence, at) for of in (type(ones[0]), Detector))
        for of_found, of_expected in zip(found, expected, strict=True):
            np.testing.assert_array_equal(of_found, of_expected)


def test_signs_of_short_recordings_take_no_more_memory_beside_a_long_one():
    detector, lengths = Frames(), [*[9] * 60, 1500, *[9] * 60]
    detector.times_ = TouchTimes(2, 1, 9)
    evidence = [np.zeros((length, 4)) for length in lengths]
    tracemalloc.start()
    signs = Frames.find_signs([detector] * len(lengths), evidence, Frames.levels)
    assert [len(each) for each in signs] == lengths
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4e6  # bytes; 1500 ticks of all recordings and levels have 60e6


class Patient(Frames):
    """A detector of a user, with rules of its own."""

    def rules(self, level):
        return TwoInARow(level)


def test_a_subclass_with_rules_of_its_own_finds_the_same_in_recordings_as_live():
    detector = Patient()
    detector.times_ = TouchTimes(2, 1, 9)
    evidence = np.random.default_rng(0).normal(size=(50, 4))
    signs = Patient.find_signs([detector], [evidence], np.array([0.5]))
    np.testing.assert_array_equal(next(signs)[:, 0], run_rules(detector.rules(0.5), evidence))


@given(
    lengths=st.lists(st.integers(3, 40), min_size=1, max_size=4),
    seconds=st.lists(st.sampled_from([0.1, 0.5, 2.0, np.inf]), min_size=1, max_size=3, unique=True),
    shifts=st.lists(st.sampled_from([-0.5, 0.0, 0.25]), min_size=1, max_size=3, unique=True),
    data=st.data(),
)
def test_beginnings_are_frames_of_their_touch_and_at_most_its_shift_before(
    lengths, seconds, shifts, data
):
    frames = [1000 * i + np.arange(n).reshape(n, 1, 1) for i, n in enumerate(lengths)]
    bounds = [
        sorted(data.draw(st.sets(st.integers(0, n), min_size=2, max_size=2))) for n in lengths
    ]
    table = pd.DataFrame({"subject": "1", "gesture": [""] * len(lengths)})
    events = event_table([(i, start, end, f"g{i}") for i, (start, end) in enumerate(bounds)])
    made = cut_touches(
        Recordings(Corpus.from_captures(frames, table, 8.0, full_scale=9999), events),
        seconds,
        shifts,
    )
    assert len(made) == len(lengths) * len(seconds) * len(shifts)
    expected = []
    for i, (start, end) in enumerate(bounds):
        for shift in shifts:
            for s in seconds:
                begin = min(max(start + round(8 * shift), 0), end - 1)
                until = min(start + max(2, min(round(8 * min(s, 99)), max(lengths))), end)
                expected.append(
                    (f"g{i}", tuple(frames[i][begin : max(until, begin + 1), 0, 0].tolist()))
                )
    got = [
        (str(made.gestures[k]), tuple(made[k][:, 0, 0].astype(int).tolist()))
        for k in range(len(made))
    ]
    assert sorted(got) == sorted(expected)


def test_names_come_from_the_frames_up_to_the_last_sure_tick_of_each_part():
    sure, since = [0.1, 0.9, 0.9, 0.9, 0.9, 0.2, 0.1, 0.1, 0.9, 0.2], [0, 1, 2, 3, 4, 5, 6, 0, 1, 0]
    first, second = find_spans(
        np.column_stack([sure, since, np.isin(np.arange(10), [2, 8])]), 7, 99
    )
    assert (first.reported, first.end) == (21, 49) and first.named == [(0, 21), (0, 28), (0, 35)]
    assert (second.reported, second.end) == (63, 63) and second.named == [(49, 63)]
    assert first.last is None
    longer = [0.1, *[0.9] * 8, 0.2, 0.9, 0.2, 0.1, 0.1]
    (span,) = find_spans(np.column_stack([longer, [*range(13), 0], np.arange(14) == 2]), 1, 99)
    assert span.named == [(0, 3), (0, 4), (0, 5), (0, 7), (0, 9)] and span.last == (0, 11)
    sure = [0.1, *[0.9] * 8, 0.2, 0.9, 0.2, 0.2, 0.2, 0.9, 0.1]
    (span,) = find_spans(np.column_stack([sure, [*range(15), 0], np.arange(16) == 2]), 2, 6)
    # parts end with ticks 6 and 12, the second with a last sure tick before
    assert span.named == [(0, 6), (0, 8), (0, 10), (0, 12), (12, 18), (12, 22), (24, 30)]
    again = find_spans(
        np.array([[0.1, 0, 0], [0.9, 1, 0], [0.9, 2, 1], [0.9, 1, 0], [0.9, 2, 1], [0.1, 0, 0]]),
        1,
        9,
    )
    assert [(each.reported, each.end) for each in again] == [
        (3, 3),
        (5, 5),
    ]  # a touch right after another one


@pytest.mark.parametrize("slices", [1, 3])
def test_the_soonest_report_is_of_a_touch_that_begins_in_the_last_frame_of_a_tick(
    slices, recordings
):
    """Of readings that jump, by a threshold; a touch begins in each frame of a tick."""
    train = recordings[np.arange(2)]
    watcher = replace(learn_from(Threshold(), train), slices=slices)
    starts = 10 * watcher.count + np.arange(watcher.count)
    frames = [np.zeros((start + 60, 10, 10), np.uint16) for start in starts]
    for start, each in zip(starts, frames, strict=True):
        each[start:] = 1000
    table = pd.DataFrame({"subject": "1", "gesture": [""] * len(frames)})
    reports = watcher.report_touches(Corpus.from_captures(frames, table, 30.0))
    assert len(reports) == len(starts)
    assert (reports["reported"] - starts).min() == watcher.soonest


@pytest.mark.parametrize("slices", [1, 3])
def test_frames_one_by_one_give_the_reports_of_whole_recordings(slices, watcher, recordings):
    tested, watcher = recordings[[2]].corpus, replace(watcher, slices=slices)
    live = watcher.open_stream(tested.grid, tested.rate_hz, tested.full_scale)
    some = tested[0][:2000].astype(np.float32)
    news = [(n, event) for n, frame in enumerate(some, 1) for event in live.push(frame)]
    reports = watcher.report_touches(tested)
    ended = [(e.reported, e.end, e.first, e.label) for _, e in news if e.end is not None]
    whole = reports[["reported", "end", "first", "label"]].itertuples(index=False, name=None)
    assert len(ended) >= 5 and ended == [*whole][: len(ended)]
    sure = [e.confidence for _, e in news if e.end is not None]
    assert sure == pytest.approx(reports["confidence"][: len(sure)].tolist(), abs=1e-5)
    assert {e.reported for n, e in news if n == e.reported} == {
        e.reported for _, e in news
    }  # at once


def test_noise_that_training_did_not_have_costs_few_touches(recordings):
    corpus = recordings.corpus
    weak = [np.rint(0.3 * stream) for stream in corpus]  # a light hand
    noise = FAULTS["noise"].damage(
        weak[2].astype(np.float32) / corpus.full_scale, 1.0, np.random.default_rng(0)
    )
    noisy = as_readings(corpus, noise)
    corpus = Corpus.from_captures(
        [*weak[:2], noisy], corpus.captures, corpus.rate_hz, full_scale=corpus.full_scale
    )
    disturbed = Recordings(corpus, recordings.events)
    watcher, test = learn_from(Frames(), disturbed[np.arange(2)]), disturbed[[2]]
    found, reported = match_reports(
        test.events, watcher.report_touches(test.corpus), corpus.rate_hz
    )
    assert (
        found["found"].sum() >= 8
    )  # of 14; 0 with the classifier for a calm sensor, at 12 false alarms
    assert (reported["touch"] == FALSE_ALARM).sum() <= 3


def test_a_filter_for_noise_changes_names_and_no_other_part_of_reports(recordings):
    train, test = recordings[np.arange(2)], recordings[[2]].corpus
    reports = []
    for repair in (("dead",), ("dead", "noise")):
        make = partial(Recipe, lda(TouchFeatures()), repair=repair)
        reports.append(learn_from(Frames(), train, make).report_touches(test))
    same = ["recording", "reported", "end"]
    pd.testing.assert_frame_equal(*(one[same] for one in reports))
    one, other = (table["confidence"] for table in reports)
    assert len(one) >= 5 and (one != other).any()


def test_a_sensor_is_disturbed_as_a_plain_loop_says():
    rng = np.random.default_rng(0)
    levels = Levels(0.002, 0.06, [0.1])
    frames = rng.integers(0, 50, (150, 4, 5))
    signals = np.stack([levels.step(frame) for frame in frames])
    shared = [sorted(frame.ravel().tolist())[8] for frame in frames]  # the 40 % quantile
    change = [0.0, *[abs(b - a) for a, b in zip(shared, shared[1:], strict=False)]]
    gauge = measure_disturbance(signals)
    for tick in (CALM - 1, 100, 149):
        past = range(tick - CALM + 1, tick + 1)
        assert gauge[tick, 0] == sorted(change[k] for k in past)[CALM // 4]
        assert gauge[tick, 1] == min(signals[k, 3] for k in past)
    assert not gauge[: CALM // 4].any() and not gauge[:CALM, 1].any()  # calm at first


def test_slow_means_are_summed_over_nine_taxels_as_a_plain_loop_says():
    rows, cols, shares = 5, 11, [0.5, 0.2, 0.1, 0.02]
    frames = np.random.default_rng(0).integers(0, 50, (40, rows, cols))
    levels = Levels(0.002, 0.06, shares)
    signals = np.stack([levels.step(frame) for frame in frames])
    means = [frames[0].astype(float) for _ in shares]
    for frame in frames:
        means = [mean + share * (frame - mean) for mean, share in zip(means, shares, strict=True)]
    expected = []
    for mean in means[:-1]:
        change = np.pad(mean - means[-1], 1)
        around = sorted(
            change[r : r + 3, c : c + 3].sum() / 9 for r in range(rows) for c in range(cols)
        )
        inner = change[1:-1, 1:-1]
        expected += [inner.mean(), np.mean(around[-2:]), np.mean(around[:2]), inner.std()]
    np.testing.assert_allclose(signals[-1, -12:], expected, rtol=1e-4, atol=1e-4)


def test_a_much_clearer_touch_is_another_one_after_the_report_of_a_weak_one():
    odds = [0, 3, 3, 3, 3, 9, 9, 9, 20, 20, 20]
    begins = [0, 1, 1, 1, 1, 1, 1, 1, -1, -1, -1]  # the last rise is no beginning
    evidence = np.column_stack([odds, begins, np.zeros(11), np.full(11, 2)])
    signs = run_rules(Hysteresis(np.array([1.0]), 1.5, TouchTimes(2, 1, 9)), evidence)
    assert np.flatnonzero(signs[:, 2]).tolist() == [2, 7]
    assert signs[:, 1].astype(int).tolist() == [0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 5]
    evidence[:, 3] = 6  # it was not reported yet
    signs = run_rules(Hysteresis(np.array([1.0]), 1.5, TouchTimes(6, 1, 9)), evidence)
    assert np.flatnonzero(signs[:, 2]).tolist() == [6]


def test_few_subjects_are_left_out_by_recording():
    few = silent_recordings([9, 9, 9], [(0, 0, 3, "pat")])
    assert held_out_units(few).tolist() == ["0", "1", "2"]
    captures = (
        few.corpus.captures.iloc[[0] * 6].assign(subject=list("aabcde")).reset_index(drop=True)
    )
    many = Recordings(few.corpus[[0] * 6].with_fields(captures=captures), few.events)
    assert held_out_units(many).tolist() == list("aabcde")


def test_a_threshold_that_reports_always_is_not_chosen():
    rows = [
        ("always", 0, 1.0, 100, 1300),
        ("fair", 2, 0.9, 90, 99 + 2),
        ("many alarms", 500, 0.95, 95, 595),
    ]
    table = pd.DataFrame([(n, a, 1.0, f, h, r) for n, a, f, h, r in rows])
    table.columns = ["level", "alarms", "hours", "found", "hits", "reports"]
    assert table["level"][score_levels(table, 5.0).idxmax()] == "fair"
    np.testing.assert_allclose(
        score_levels(table, 5.0), [1 - 0.2 * (13 - 1.15), 0.9, 0.95 - 0.001 * 495]
    )


def test_operating_points_find_more_with_more_alarms():
    rows = [
        (-9, 0, 0.2),
        (-8, 0, 0.5),
        (-7, 0, 0.5),
        (-5, 3, 0.5),
        (-3, 2, 0.8),
        (1, 6, 0.7),
        (2, 9, 0.9),
    ]
    table = pd.DataFrame(rows, columns=["level", "alarms", "found"]).assign(hours=0.5)
    expected = (
        (2.0, 9.0, 0.5, 0.9),
        (1.0, 6.0, 0.5, 0.7),
        (-3.0, 2.0, 0.5, 0.8),
        (-7.0, 0.0, 0.5, 0.5),
    )
    assert (
        choose_operating_points(table, 1.0) == expected
    )  # the learned one, too; from the highest level to the lowest


@pytest.mark.parametrize("events, lacking", [([(0, 0, 20, "pat")], "background"), ([], "touch")])
def test_without_touch_or_background_frames_says_so(events, lacking):
    with pytest.raises(InputError, match=f"no {lacking}"):
        Frames().fit([np.ones((20, 16), np.float32)], silent_recordings([20], events))
