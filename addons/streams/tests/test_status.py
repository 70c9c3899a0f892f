"""The status of a watch in C as in Python: the reason of each fault; lost frames."""

import ctypes
from copy import copy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from addons.chip.tests.compiled import describe_missing
from addons.streams.tests.test_c import (
    NEWS,
    WatcherInC,
    check_equal,
    events_from_news,
    fit_watcher,
    recordings_for,
    report_in_python,
)
from bench.corpora.corpus import Corpus
from touchbench_streams.detectors import status
from touchbench_streams.detectors.base import UNKNOWN
from touchbench_streams.detectors.status import REASONS, Health, learn_limits, watch_health
from touchbench_streams.detectors.ticks import TickStream

needs_gcc = pytest.mark.skipif(bool(describe_missing("gcc")), reason=describe_missing("gcc"))


@pytest.fixture(scope="module")
def recogniser():
    """A system with a watcher whose blocks are short, as its recordings are."""
    found, streams = copy(fit_watcher("frames")), recordings_for("frames")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(status, "QUIET_TICKS", 16)
        patch.setattr(status, "TOUCHES", 3)
        patch.setattr(status, "CALM_TICKS", 40)
        watcher = found.watcher
        sensed = watcher.sense(streams.corpus)
        paces = [
            watcher.pace.of_touches(sensed.stepped[[i]], one)
            for i, one in enumerate(sensed.touches)
        ]
        limits = learn_limits(streams.corpus, sensed.signs, watcher.count, paces, streams.subjects)
        found.watcher = replace(watcher, limits=limits)
        yield found


@pytest.fixture(scope="module")
def in_c(recogniser, tmp_path_factory):
    """Its C, compiled once."""
    return WatcherInC(recogniser, tmp_path_factory.mktemp("c"))


def status_in_c(watched, frames):
    """The status after each frame, and the counts."""
    values = np.ascontiguousarray(frames.reshape(len(frames), -1), dtype=np.float32)
    found, counts = np.zeros(len(frames), np.int32), np.zeros(3 + len(REASONS), np.uint32)
    places = [array.ctypes.data_as(ctypes.c_void_p) for array in (values, found, counts)]
    watched.start().code.statuses(places[0], len(frames), places[1])
    watched.code.status(places[2])
    return found, counts


def bits(*reasons):
    """An OR of the bits of some reasons."""
    return sum(1 << REASONS.index(reason) for reason in reasons)


@cache
def first_recording():
    """Frames of the first recording, shares of full scale."""
    corpus = recordings_for("frames").corpus
    return np.asarray(corpus[0], np.float64) / corpus.full_scale


def set_taxel(frames, value):
    """A taxel that always reads the same."""
    frames = frames.copy()
    frames[:, 3, 3] = value
    return frames


RNG = np.random.default_rng(0)
FAULTS = {  # change of shares, and the reason
    "as it is": (lambda x: x, ""),
    "noise of 1 %": (lambda x: x + 0.01 * RNG.standard_normal(x.shape), "noise"),
    "every frame twice": (lambda x: np.repeat(x, 2, axis=0)[: len(x)], "rate"),
    "offset of 2 %": (lambda x: x + 0.02, "offset"),
    "half the gain": (lambda x: x / 2, "gain"),
    "a dead taxel": (lambda x: set_taxel(x, 0), "stuck"),
    "a short-circuited taxel": (lambda x: set_taxel(x, 1), "stuck"),
    "touches cut off": (lambda x: np.minimum(x, 0.05), "saturated"),
    "another order of taxels": (lambda x: x.transpose(0, 2, 1)[:, ::2].repeat(2, 1), "unlike"),
}


@needs_gcc
@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_has_its_reason_in_c_as_in_python(fault, recogniser, in_c):
    change, reason = FAULTS[fault]
    streams, scale = recordings_for("frames").corpus, recogniser.full_scale
    frames = (np.clip(change(first_recording()), 0, 1) * scale).astype(np.float32)
    corpus = Corpus.from_captures(
        [frames], streams.captures.iloc[:1], streams.rate_hz, full_scale=scale
    )
    watcher = recogniser.watcher
    (expected,) = watcher.find_status(watcher.sense(corpus))
    found, counts = status_in_c(in_c, frames)
    assert (found != expected).mean() < 0.02
    every = np.bitwise_or.reduce(expected)
    assert every & bits(reason) if reason else every == 0
    counted = [int((found >> k & 1).sum()) for k in range(len(REASONS))]
    assert counts.tolist() == [len(frames), 0, 0, *counted]


def test_frames_one_by_one_have_the_status_of_a_recording(recogniser):
    frames = (np.clip(first_recording() + 0.02, 0, 1) * recogniser.full_scale)[:1500]
    streams = recordings_for("frames").corpus
    corpus = Corpus.from_captures(
        [frames], streams.captures.iloc[:1], streams.rate_hz, full_scale=recogniser.full_scale
    )
    watcher = recogniser.watcher
    (expected,) = watcher.find_status(watcher.sense(corpus))
    stream = TickStream(watcher, (8, 8), streams.rate_hz, recogniser.full_scale)
    found = []
    for frame in frames:
        stream.push(frame)
        found.append(stream.status)
    np.testing.assert_array_equal(found, expected)
    assert np.bitwise_or.reduce(expected) & bits("offset")


@needs_gcc
def test_small_negative_readings_are_zero_and_other_frames_are_refused(recogniser, in_c):
    frames = recordings_for("frames").corpus[0][:1000].astype(np.float32)
    zero, negative = frames.copy(), frames.copy()
    zero[:, 3, 3], negative[:, 3, 3] = 0, -1
    np.testing.assert_array_equal(in_c.start()(negative), in_c.start()(zero).copy())
    found, counts = status_in_c(in_c, negative)
    assert counts[:3].tolist() == [1000, 0, 1000]
    odd = {np.nan: "not a number", -0.03 * 1023: "out of range", 1023.5: "out of range"}
    stream = TickStream(recogniser.watcher, (8, 8), 54.0, recogniser.full_scale)
    for value, reason in odd.items():
        wrong = frames[:2].copy()
        wrong[1, 3, 3] = value
        found, counts = status_in_c(in_c, wrong)
        assert found.tolist() == [0, bits(reason)]
        assert counts[0] == 1 and counts[3 + REASONS.index(reason)] == 1
        stream.push(frames[0])
        assert stream.push(wrong[1]) == [] and stream.status == bits(reason)
    assert stream.seen == len(odd)


@needs_gcc
@pytest.mark.parametrize("most", [12, 200])
def test_lost_frames_move_time_on_in_c_as_in_python(most, recogniser, in_c):
    """Runs of lost frames, shorter or longer than a second, also within touches."""
    frames = recordings_for("frames").corpus[0][:6000].astype(np.float32)
    rng = np.random.default_rng(most)
    watched, stream = (
        in_c.start(),
        TickStream(recogniser.watcher, (8, 8), recogniser.rate_hz, recogniser.full_scale),
    )
    news, ended, at, lost = [], [], 0, 0
    while at < len(frames):
        part = frames[at : at + int(rng.integers(20, 400))]
        news.append(watched(part))
        missing = int(rng.integers(1, most))
        event = np.zeros(1, NEWS)
        if watched.code.missed(missing, event.ctypes.data_as(ctypes.c_void_p)):
            news.append(event)
        for frame in part:
            ended += [event for event in stream.push(frame) if event.end is not None]
        ended += [event for event in stream.miss(missing) if event.end is not None]
        at, lost = at + len(part) + missing, lost + missing
    in_python = np.array([[event.reported, event.end] for event in ended])
    events = events_from_news(np.concatenate(news), recogniser.classes)
    np.testing.assert_array_equal(events[["reported", "end"]].to_numpy(), in_python)
    assert events["label"].tolist() == [event.label for event in ended]
    counts = np.zeros(3 + len(REASONS), np.uint32)
    watched.code.status(counts.ctypes.data_as(ctypes.c_void_p))
    assert counts[1] == lost and len(ended) > 5
    assert stream.seen == at
    watched.code.pace.restype = ctypes.c_float
    assert watched.code.pace() == pytest.approx(stream.health.slow_pace or 0, abs=1e-3)


@needs_gcc
def test_labels_below_a_confidence_are_unknown_in_c_as_in_python(recogniser, in_c):
    strict = copy(recogniser)
    strict.watcher = replace(recogniser.watcher, reject=0.7)
    frames = recordings_for("frames").corpus[0]
    in_c.start()
    assert in_c.code.confidence(ctypes.c_double(1.5)) == -1
    assert in_c.code.confidence(ctypes.c_double(0.7)) == 0
    events = events_from_news(in_c(frames), recogniser.classes)
    expected = report_in_python(strict, frames)[: len(events)]
    check_equal(events, expected)
    assert {UNKNOWN} < set(events["label"])


@needs_gcc
@pytest.mark.parametrize("slices", [1, 7])
def test_the_pace_of_touches_is_that_of_python_also_in_slices(slices, recogniser, tmp_path):
    """The name at the end of a touch counts, which is computed in the frames after it."""
    sliced, corpus = copy(recogniser), recordings_for("frames").corpus
    sliced.watcher = replace(recogniser.watcher, slices=slices)
    watched, sensed = WatcherInC(sliced, tmp_path), sliced.watcher.sense(corpus)
    watched.code.pace.restype = ctypes.c_float
    for i, frames in enumerate(corpus):
        paces = sliced.watcher.pace.of_touches(sensed.stepped[[i]], sensed.touches[i])
        health = Health(sliced.watcher.limits, recogniser.full_scale)
        watch_health(health, frames, sensed.signs[i], sliced.watcher.count, paces)
        watched.start()(frames)
        assert watched.code.pace() == pytest.approx(health.slow_pace, abs=1e-3)


@needs_gcc
def test_lost_frames_change_the_pace_of_touches_in_c_as_in_python(recogniser, tmp_path):
    """With a limit between the paces of both, every second frame lost is told."""
    watcher, streams = recogniser.watcher, recordings_for("frames").corpus
    high, paces = watcher.limits.high.copy(), []
    for step in (1, 2):
        frames = [streams[i][::step].astype(np.float32) for i in range(3)]
        fields = {"full_scale": streams.full_scale}
        corpus = Corpus.from_captures(frames, streams.captures, streams.rate_hz, **fields)
        sensed, found = watcher.sense(corpus), []
        for i, touches in enumerate(sensed.touches):
            found.append(watcher.pace.of_touches(sensed.stepped[[i]], touches).mean())
        paces.append(np.mean(found))
    assert paces[1] - paces[0] > 0.2
    high[status.FIRST_TOUCHED + status.PACE] = np.mean(paces)
    strict = copy(recogniser)
    strict.watcher = replace(watcher, limits=replace(watcher.limits, high=high))
    (expected,) = strict.watcher.find_status(strict.watcher.sense(corpus[[0]]))
    found, _ = status_in_c(WatcherInC(strict, tmp_path), corpus[0])
    assert (found != expected).mean() < 0.02 and expected[-1] & bits("rate")
