"""Exported C watches an endless stream: its events are those of Python."""

import ctypes
import io
import subprocess
from copy import copy
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from addons.chip.tests.compiled import (
    STRICT,
    describe_missing,
    fit_recogniser,
    load_library,
    write_files,
)
from bench.corpora import synth
from bench.corpora.corpus import Corpus, shared_frames
from bench.corpora.faults import as_readings, as_shares, noise
from bench.errors import InputError
from bench.features.touch import TouchFeatures
from bench.features.touch_profiles import TouchProfiles
from bench.models.classic.lda import lda
from bench.models.recipe import Recipe
from bench.models.reflex import Reflex
from touchbench_chip import measure
from touchbench_streams import live, synth_recordings
from touchbench_streams.composer import compose_recordings
from touchbench_streams.detectors import names
from touchbench_streams.detectors.base import UNKNOWN
from touchbench_streams.detectors.detector import average_into_ticks, count_frames_per_tick
from touchbench_streams.detectors.frames import Frames
from touchbench_streams.detectors.threshold import Threshold
from touchbench_streams.detectors.ticks import learn_watcher
from touchbench_streams.disturbed import KINDS, disturb_recordings
from touchbench_streams.recordings import Recordings

pytestmark = pytest.mark.skipif(bool(describe_missing("gcc")), reason=describe_missing("gcc"))
EVENT = [
    ("label", np.int32),
    ("confidence", np.float32),
    ("reported", np.uint32),
    ("end", np.uint32),
]
NEWS = np.dtype([*EVENT, ("news", np.int32), ("seen", np.uint32)])
REPORTED, CHANGED, ENDED = 1, 2, 3


class WatcherInC:
    """The C of a watcher; called with frames, it gives the news of them, a row each."""

    def __init__(self, recogniser, folder, bits=32):
        self.folder = write_files(recogniser, folder, bits)
        self.code = load_library(folder, (Path(__file__).parent / "watched.c").read_text())

    def start(self):
        """Begin."""
        self.code.start()
        return self

    def __call__(self, frames):
        values = np.ascontiguousarray(frames.reshape(len(frames), -1), dtype=np.float32)
        news = np.zeros(len(frames) // 2 + 1, NEWS)
        values, place = (a.ctypes.data_as(ctypes.c_void_p) for a in (values, news))
        count = self.code.stream(values, len(frames), place)
        assert count >= 0
        return news[:count]


def events_from_news(news, classes):
    """Ended events from the news of the C, as `TickWatcher.report_touches` returns them."""
    ended = np.flatnonzero(news["news"] == ENDED)
    begun = np.append(0, ended[:-1] + 1)[: len(ended)]  # the first news of an event may be its end
    words = np.append(classes, UNKNOWN)
    assert (news["news"][np.setdiff1d(begun, ended)] == REPORTED).all()
    columns = {name: news[name][ended].astype(np.int64) for name in ("reported", "end")}
    columns |= {"first": words[news["label"][begun]], "label": words[news["label"][ended]]}
    return pd.DataFrame(columns | {"confidence": news["confidence"][ended]})


@cache
def compose_test_recordings(rate_hz, whole):
    """Generated captures, and recordings composed of them and of generated idle time.

    Readings have fractions, unless ``whole``: if sums of whole numbers are equal, rounding decides
    on turns, in Python as in C.
    """
    corpus = synth.generate(subjects=3, variants=("normal",), rate_hz=rate_hz)
    streams = synth_recordings.generate(subjects=3, variants=("normal",), rate_hz=rate_hz)
    idle = [
        streams.corpus[i][: streams.events.query("recording == @i")["start"].min()]
        for i in range(3)
    ]
    conditions = corpus.captures.drop_duplicates("subject")
    quiet = Corpus.from_captures(idle, conditions, corpus.rate_hz, full_scale=corpus.full_scale)
    streams = compose_recordings(corpus, quiet)
    if whole:
        return corpus, streams
    frames, rng = shared_frames(streams.corpus)[0].astype(np.float32), np.random.default_rng(0)
    frames += rng.random(frames.shape, np.float32) * (frames < corpus.full_scale)
    return corpus, replace(streams, corpus=streams.corpus.with_fields(frames=frames))


DETECTORS = {"frames": Frames(), "frames at 8 Hz": Frames(), "threshold": Threshold()}
IN_STEPS = {
    "frames at 8 Hz": 8.0,
    "threshold": 100.0,
}  # whole numbers, at rates where rounding decides on few turns


def recordings_for(name):
    """The recordings that a watcher of `watching` learned from."""
    return compose_test_recordings(IN_STEPS.get(name, 54.0), name in IN_STEPS)[1]


@cache
def fit_watcher(name):
    """A fitted system with a watcher, which has a stricter and a more eager operating point."""
    corpus, streams = compose_test_recordings(IN_STEPS.get(name, 54.0), name in IN_STEPS)
    make = {
        "reflex": lambda: Reflex(units=6, copies=1),
        **dict.fromkeys(IN_STEPS, lambda: Recipe(lda(TouchFeatures()), window=0.4)),
    }.get(name, lambda: Recipe(lda(TouchProfiles()), window=1.0, repair=("stuck", "dead", "noise")))
    recogniser = fit_recogniser(make(), corpus)
    watcher = learn_watcher(
        DETECTORS.get(name, Frames()), make, recogniser.estimator, streams, 5.0
    )[0]
    assert watcher.level in [level for level, *_ in watcher.points]
    strict, eager = (
        (watcher.level * 2, watcher.level / 2) if name == "threshold" else (watcher.level + 8, -2.0)
    )
    points = ((strict, 0.0, 2.0, 0.0), (watcher.level, 1.0, 2.0, 1.0), (eager, 120.0, 2.0, 1.0))
    recogniser.watcher = replace(watcher, points=points, reject=0.7 if name == "threshold" else 0.0)
    return recogniser


@pytest.fixture(scope="module")
def in_c(tmp_path_factory):
    """The C of a watcher of `watching`, compiled once."""
    return cache(
        lambda name, bits=32: WatcherInC(fit_watcher(name), tmp_path_factory.mktemp("c"), bits)
    )


HOP = 15  # frames at 135 Hz, or fewer
WHOLE = 0.15  # largest difference of confidences if rounding decides on turns


def check_equal(events, expected, wrong=0.0, most=0.02):
    """Compare events and, up to rounding of counts, confidences.

    A share of them may have other labels, or times that are a hop apart, for that reason.
    """
    expected = expected.reset_index(drop=True)
    times, labels = ["reported", "end"], ["first", "label"]
    assert len(events) == len(expected)
    if not len(expected):
        return
    late = np.abs(events[times].to_numpy(np.int64) - expected[times].to_numpy(np.int64))
    assert (late > 0).any(axis=1).mean() <= wrong and late.max() <= HOP * bool(wrong)
    assert (events[labels].astype(str) != expected[labels].astype(str)).any(axis=1).mean() <= wrong
    apart = np.abs(events["confidence"].to_numpy() - expected["confidence"].to_numpy())
    assert np.quantile(apart, 0.8) < 1e-3 and (wrong or apart.max() < most)


@pytest.mark.parametrize("name", DETECTORS)
def test_events_are_those_of_python(name, in_c):
    recogniser, streams = fit_watcher(name), recordings_for(name)
    expected = recogniser.watcher.report_touches(streams.corpus)
    watched, in_8_bits = in_c(name), in_c(name, 8)
    labels = 0
    for i in range(len(streams)):
        mine = expected[expected["recording"] == i]
        news = watched.start()(streams.corpus[i])
        events = events_from_news(news, recogniser.classes)
        lasting = mine["end"] > len(streams.corpus[i]) - recogniser.rate_hz / 8  # to the last tick
        assert len(events) == (~lasting).sum() >= len(mine) - 1
        mine = mine[: len(events)]
        check_equal(events, mine, most=WHOLE if name in IN_STEPS else 0.02)
        few = events_from_news(in_8_bits.start()(streams.corpus[i]), recogniser.classes)
        assert few["reported"].tolist() == mine["reported"].tolist()
        changes = news[news["news"] == CHANGED]
        assert (changes["end"] == 0).all() and (changes["reported"] < changes["seen"]).all()
        labels += len(changes)
    assert len(expected) > 30 and labels > 0
    assert ("touch_sum_t sum[64]" in (watched.folder / "touch.h").read_text()) is (name in IN_STEPS)
    assert (UNKNOWN in set(expected["label"])) is (name == "threshold")


@pytest.mark.parametrize(("name", "slices"), [("frames", 2), ("frames", 7), ("reflex", 4)])
def test_news_in_slices_are_the_same_later_in_c_and_in_python(name, slices, in_c, tmp_path):
    recogniser, corpus, late = copy(fit_watcher(name)), recordings_for(name).corpus, slices - 1
    recogniser.watcher = replace(recogniser.watcher, slices=slices)
    expected, sliced = recogniser.watcher.report_touches(corpus), WatcherInC(recogniser, tmp_path)
    at_once = fit_watcher(name).watcher.report_touches(corpus)
    kept = expected.index[: len(at_once)]
    assert (expected["reported"] - at_once["reported"][kept] == late).all() and len(kept) > 30
    for i in range(len(corpus)):
        news, first = sliced.start()(corpus[i]), in_c(name).start()(corpus[i]).copy()
        for column in ("reported", "seen", "end"):
            first[column][first[column] > 0] += late  # the end is 0 while a touch lasts
        np.testing.assert_array_equal(news, first[first["seen"] <= len(corpus[i])])
        times = expected[expected["recording"] == i][["reported", "end"]].to_numpy()
        ended = news[news["news"] == ENDED]
        assert [*zip(ended["reported"], ended["end"], strict=True)] == [*map(tuple, times)][
            : len(ended)
        ]


def test_a_disturbed_sensor_has_the_events_of_python(tmp_path):
    recogniser, streams = copy(fit_watcher("frames")), recordings_for("frames")
    watcher = recogniser.watcher = copy(recogniser.watcher)
    detector = copy(watcher.detector)
    detector.disturbed_, detector.times_ = (), replace(detector.times_, wait=3)
    calm = copy(detector)
    ticks = average_into_ticks(streams, count_frames_per_tick(calm.tick, streams.corpus.rate_hz))
    shaken = [disturb_recordings(streams.corpus, kind) for kind in KINDS]
    quick = replace(calm, wait=0.25)
    for each, gauge in zip(shaken, KINDS.values(), strict=True):
        parts = average_into_ticks(
            Recordings(each, streams.events), count_frames_per_tick(calm.tick, each.rate_hz)
        ).corpus
        signals = [calm.signals_of(part) for part in parts]
        limit = detector._limit_of_kind(gauge, signals)
        # whatever is worth more in training, each of the classifiers decides here
        other = replace(quick).fit(signals, ticks)
        detector.disturbed_ = *detector.disturbed_, (gauge, other, 0.5, limit)
    assert detector.soonest < calm.soonest
    watcher.detector = detector
    watched = WatcherInC(recogniser, tmp_path)
    for each in shaken:
        watcher.detector = detector
        expected, mine, theirs = watcher.report_touches(each), [], []
        for i in range(len(streams)):
            mine.append(events_from_news(watched.start()(each[i]), recogniser.classes))
            theirs.append(expected[expected["recording"] == i])
            assert len(theirs[-1]) - len(mine[-1]) in (0, 1)  # one may last to the end
            theirs[-1] = theirs[-1][: len(mine[-1])]
        check_equal(pd.concat(mine, ignore_index=True), pd.concat(theirs), wrong=0.05)
        watcher.detector = calm
        assert len(expected) > 10 and not expected.equals(watcher.report_touches(each))


def report_in_python(recogniser, frames):
    """Events of one recording in Python."""
    captures = pd.DataFrame({"subject": ["1"], "gesture": [""]})
    corpus = Corpus.from_captures(
        [frames], captures, recogniser.rate_hz, full_scale=recogniser.full_scale
    )
    return recogniser.watcher.report_touches(corpus).drop(columns="recording")


@pytest.mark.parametrize("name", ["frames", "frames at 8 Hz"])
def test_names_from_several_parts_of_a_touch_are_those_of_python(name, tmp_path, monkeypatch):
    recogniser, frames = fit_watcher(name), recordings_for(name).corpus[0]
    whole = report_in_python(recogniser, frames)
    monkeypatch.setattr(names, "LONGEST_S", 0.75)
    expected = report_in_python(recogniser, frames)
    events = events_from_news(WatcherInC(recogniser, tmp_path).start()(frames), recogniser.classes)
    check_equal(events, expected, most=WHOLE if name in IN_STEPS else 0.02)
    assert (expected["end"] - expected["reported"]).max() > 1.5 * recogniser.rate_hz
    assert (np.abs(whole["confidence"] - expected["confidence"]) > 0.01).any()


@pytest.mark.parametrize("name", ["frames", "frames at 8 Hz"])
def test_interrupted_touches_are_those_of_python(name, in_c):
    """Recordings begin with a touch, touches have a gap of 0.8 s, at two thresholds."""
    recogniser, streams, watched = copy(fit_watcher(name)), recordings_for(name), in_c(name)
    learned_one, gap, counts = recogniser.watcher, round(0.8 * recogniser.rate_hz), []
    for point in (1, 0):
        recogniser.watcher = replace(learned_one, level=learned_one.points[point][0])
        mine, theirs = [], []
        for i in range(len(streams)):
            frames, events = streams.corpus[i].copy(), streams.events.query("recording == @i")
            for middle in ((events["start"] + events["end"]) // 2).tolist():
                frames[middle : middle + gap] = frames[:gap]
            frames = frames[events["start"].min() :]
            watched.start().code.set(point)
            mine.append(events_from_news(watched(frames), recogniser.classes))
            whole = report_in_python(recogniser, frames)
            theirs.append(whole[whole["end"] < len(frames)])  # it ends before a touch does
        # a count of one more is a larger share of a few frames
        expected = pd.concat(theirs)
        check_equal(
            pd.concat(mine, ignore_index=True), expected, most=WHOLE if name in IN_STEPS else 0.02
        )
        counts.append(len(expected))
    assert counts[0] != counts[1] and min(counts) > 18
    for i, (_, alarms, hours, found) in enumerate(learned_one.points):
        most = (
            f"{stats.chi2.ppf(0.95, 2 * (alarms + 1)) / 2 / hours:.3g} per hour (95 % confidence)"
        )
        line = f"{i}: {alarms:g} false alarms in 120 minutes, so at most {most}; "
        line += f"{100 * found:.1f} % of touches found"
        assert line in (watched.folder / "touch.h").read_text() and watched.code.set(i) == 0
    assert watched.code.set(-1) == watched.code.set(len(learned_one.points)) == -1


def test_a_sensor_that_is_noisier_than_in_training_is_refused_frame_by_frame_and_in_c(tmp_path):
    recogniser, streams = copy(fit_watcher("frames")), recordings_for("frames")
    watcher = recogniser.watcher = copy(recogniser.watcher)
    watcher.detector = copy(watcher.detector)
    watcher.detector.disturbed_ = ()  # no classifier for noise
    corpus, rng = streams.corpus, np.random.default_rng(0)
    noisy = [
        as_readings(corpus, noise(one, 4.0, rng))
        for one in as_shares(corpus, np.arange(len(corpus)))
    ]
    noisy = Corpus.from_captures(
        noisy, corpus.captures, corpus.rate_hz, full_scale=corpus.full_scale
    )
    calm, expected = (watcher.count_refused(watcher.sense(one)) for one in (corpus, noisy))
    assert calm.sum() < 0.1 * len(corpus.frames) and expected.sum() > 0.6 * len(corpus.frames)
    watched, counts = WatcherInC(recogniser, tmp_path), (ctypes.c_uint32 * 12)()
    for i in range(len(noisy)):
        watched.start()(noisy[i])
        watched.code.status(counts)
        assert counts[6] == pytest.approx(expected[i], rel=0.02)


@pytest.mark.skipif(bool(describe_missing("make")), reason=describe_missing("make"))
def test_the_program_prints_what_bench_live_prints_and_nothing_is_undefined(tmp_path, capsys):
    recogniser = fit_watcher("frames")
    write_files(recogniser, tmp_path)
    frames = recordings_for("frames").corpus[0][:1600]
    lines = "\n".join(" ".join(f"{v:.3f}" for v in frame.ravel()) for frame in frames) + "\n"
    call = [
        "gcc",
        *STRICT,
        "-fsanitize=address,undefined",
        "-fno-sanitize-recover=all",
        "touch.c",
        "main.c",
        "-lm",
    ]
    subprocess.run([*call, "-o", "checked"], cwd=tmp_path, check=True, capture_output=True)

    def printed(text):
        return subprocess.run(
            [tmp_path / "checked", "-w"], input=text, capture_output=True, text=True, check=False
        )

    done = printed(lines)
    assert (done.returncode, done.stderr) == (0, "")
    source = io.BytesIO(lines.encode())
    assert live.report_touches_live(recogniser, recogniser.watcher, source, show=False) == 0
    outputs = done.stdout, capsys.readouterr().out
    mine, theirs = ([line.split(",") for line in out.splitlines()] for out in outputs)
    assert [row[:3] for row in mine] == [row[:3] for row in theirs] and {"reported", "ended"} < {
        row[1] for row in mine
    }
    np.testing.assert_allclose(
        *([float(row[3]) for row in rows[1:]] for rows in (mine, theirs)), atol=0.02
    )
    assert (
        len(mine) > 4 and printed("\n" + lines.replace("\n", "\n \n", 9)).stdout == done.stdout
    )  # blank lines


def test_what_is_no_frame_changes_nothing(in_c):
    watched, frames = in_c("threshold"), recordings_for("threshold").corpus[0].astype(np.float32)
    expected = watched.start()(frames)
    watched.start()
    first = watched(frames[:1000])
    for odd in (np.nan, np.inf, -21, 1023.5):
        wrong = frames[:1].copy()
        wrong[0, 7, 7] = odd
        places = (values.ctypes.data_as(ctypes.c_void_p) for values in (wrong, np.zeros(2, NEWS)))
        assert watched.code.stream(next(places), 1, next(places)) == -1
    np.testing.assert_array_equal(np.append(first, watched(frames[1000:])), expected)


@pytest.mark.parametrize("slices", [0, 8])
def test_more_slices_than_frames_of_a_tick_are_refused(slices, tmp_path):
    recogniser = copy(fit_watcher("frames"))
    recogniser.watcher = replace(recogniser.watcher, slices=slices)
    with pytest.raises(InputError, match=f"slices={slices}: give 1 to 7"):
        write_files(recogniser, tmp_path)


@pytest.mark.live
@pytest.mark.skipif(bool(measure.missing_programs()), reason=", ".join(measure.missing_programs()))
def test_slices_share_the_work_of_a_name_evenly(tmp_path):
    recogniser, most = copy(fit_watcher("frames")), {}
    for slices in (1, 4, 7):
        recogniser.watcher = replace(recogniser.watcher, slices=slices)
        counted = measure.measure_watching(write_files(recogniser, tmp_path / str(slices), 8))
        most[slices] = counted["chip_watch_most_instructions"]
        assert most[slices] / most[1] < 1.3 / max(slices - 1, 1)


@pytest.mark.live
@pytest.mark.skipif(bool(measure.missing_programs()), reason=", ".join(measure.missing_programs()))
@pytest.mark.parametrize(
    "name", ["frames at 8 Hz", pytest.param("reflex", marks=pytest.mark.nightly)]
)
def test_bytes_and_instructions_of_watching_are_counted(name, tmp_path):
    recogniser, frames = fit_watcher(name), recordings_for(name).corpus[0][:700]
    folder = write_files(recogniser, tmp_path, 8)
    captures = measure.measure_footprint(folder, *measure.ROOMY)
    counted = measure.measure_watching(folder, frames)
    assert 0 < counted["chip_watch_ram_bytes"] - captures["chip_ram_bytes"] < 8192
    assert abs(counted["chip_watch_flash_bytes"] - captures["chip_flash_bytes"]) < 16384
    assert (
        50 < counted["chip_watch_stack_bytes"] < 2000 and 50 < captures["chip_stack_bytes"] < 2000
    )
    idle, mean, most = (
        counted[f"chip_watch_{of}_instructions"] for of in ("idle", "frame", "most")
    )
    assert 1e4 < idle < mean < most < 1e7
    assert idle / 3 < counted["chip_watch_recorded_instructions"] < most
    assert (
        counted["chip_watch_recorded_instructions"]
        < counted["chip_watch_recorded_most_instructions"]
    )
    expected = (report_in_python(recogniser, frames)["reported"] <= len(frames)).sum()
    assert counted["chip_watch_recorded_reports"] == expected > 0
