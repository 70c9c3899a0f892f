"""`bench watch`: what is learned, refused and stored; recordings of test subjects under faults."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pandas as pd
import pytest

from addons.streams.tests.people import TINY, fold_without, generate_people
from bench.cli import main
from bench.corpora import faults
from bench.corpora.corpus import Corpus
from bench.corpora.faults import FAULTS, as_readings, as_shares, fault
from bench.errors import InputError
from bench.features.touch import TouchFeatures
from bench.models.classic.lda import lda
from bench.models.recipe import Recipe
from bench.plan.grid import make_cells
from bench.reading.runs import load_results
from bench.running.results import FoldResult
from bench.running.saved import Recogniser, load_recogniser, save_model
from bench.store.client import connect
from tests.conftest import predictions, random_corpus, runs
from tests.reading.results import make_result as result_of
from touchbench_people.commands import save_adapted
from touchbench_streams.detectors.frames import Frames
from touchbench_streams.detectors.status import NOISE, SATURATED
from touchbench_streams.detectors.threshold import Threshold
from touchbench_streams.detectors.ticks import learn_watcher
from touchbench_streams.events import report_table
from touchbench_streams.fold import make_recordings, run_numbers
from touchbench_streams.page import fault_rows, make_watch_exhibits
from touchbench_streams.recordings import Recordings, cut_into_captures
from touchbench_streams.stress import apply_fault, watch_under_faults
from touchbench_streams.study import Continuous


@pytest.fixture(scope="module")
def recordings():
    """Four generated people with one touch of each of a few gestures, at 20 frames a second."""
    return generate_people(subjects=4, rate_hz=20.0)


@pytest.mark.parametrize("detector, unknown", [("frames", ""), ("threshold", "pat")])
def test_nothing_of_a_test_subject_is_learned(detector, unknown, recordings):
    (cell,) = make_cells(
        {"data": "synth", "model": "lda", "features": "touch", "model.window": "0.75"}
    )
    corpus = cut_into_captures(recordings)
    table = corpus.captures.copy()
    touched_rows = (table["subject"] == "4") & (table["gesture"] != "background")
    table.loc[touched_rows, "gesture"] = table.loc[touched_rows, "gesture"].to_numpy()[::-1]
    frames = corpus.frames.copy()
    tested = np.repeat(corpus.subjects == "4", corpus.lengths)
    frames[tested] = frames[tested][::-1]
    other = corpus.with_fields(captures=table, frames=frames)
    kind, fold = Continuous(detector, unknown=unknown), fold_without("4", corpus)
    results = [kind.evaluate_fold(cell, each, fold, 1) for each in (corpus, other)]
    assert results[0].chosen == results[1].chosen and (
        float(str(results[0].chosen["reject"])) > 0
    ) == bool(unknown)
    pd.testing.assert_frame_equal(results[0].trials, results[1].trials)
    assert not results[0].table.equals(results[1].table)  # the test subject was another one
    touches = results[0].table[results[0].table["kind"] == "touch"]["gesture"].tolist()
    assert touches.count("unknown") == bool(unknown) and touches.count("pat") != bool(unknown)


def test_false_alarms_of_a_person_without_touches_count():
    row = {"fold": "4", "subject": "4", "recording": 0, "start": np.nan, "gesture": None}
    said = {"first": "pat", "label": "pat", "confidence": 1.0, "changes": 0}
    reports = [
        row | said | {"kind": "report", "reported": at, "end": at + 20} for at in (100, 500, 900)
    ]
    swept = {"kind": "curve", "offset": 0.0, "hits": 0, "alarms": 3, "reports": 3}
    table = pd.DataFrame(
        [row | {"kind": "recording", "end": 36_000.0, "refused": 0}, *reports, row | swept]
    )
    numbers, tables = run_numbers([FoldResult("4", table)], 20.0, "")  # half an hour at 20 Hz
    assert numbers["false_alarms_per_hour"] == pytest.approx(6) and numbers["touches"] == 0
    assert tables["per_subject"]["false_alarms_per_hour"].tolist() == pytest.approx([6])


def relabel(recordings, names=None, untouched=()):
    """The same with other names of gestures, and people whose touches are not labelled."""
    events = recordings.events.replace({"gesture": names or {}})
    kept = ~np.isin(recordings.subjects[events["recording"]], [*untouched])
    return cut_into_captures(Recordings(recordings.corpus, events[kept].reset_index(drop=True)))


@pytest.mark.parametrize(
    ("changes", "options", "fact"),
    [
        ({"untouched": "1234"}, {}, "no touch; label"),
        ({"untouched": "34"}, {}, "fold 1 trains on touches of 1 subject;"),
        (
            {"names": {"rub": "unknown"}},
            {"unknown": "pat"},
            "unknown=pat: .* has a gesture of this name; rename it",
        ),
        ({"names": {"rub": "unknown"}}, {"unknown": "unknown"}, ""),
        ({}, {"background": "quiet"}, "background=quiet: .* class quiet; rename it"),
    ],
)
def test_recordings_that_cannot_be_watched_are_refused_before_training(
    changes, options, fact, recordings
):
    (cell,) = make_cells({"data": "synth", "model": "lda", "features": "touch"})
    corpus = relabel(recordings, **changes) if changes else random_corpus(gestures=("pat", "quiet"))
    folds = [fold_without(name, corpus) for name in "12"]
    with pytest.raises(InputError, match=fact) if fact else nullcontext():
        Continuous(**options).check_plan(
            SimpleNamespace(corpus=corpus, cell=cell, mixes_subjects=False, folds=folds)
        )


def test_background_without_touches_is_refused(recordings):
    row = pd.DataFrame({"subject": ["1"], "gesture": ["rub"]})
    with pytest.raises(InputError, match="no touch"):
        make_recordings(Corpus.from_captures([recordings.corpus[0]], row, 20.0), "rub")


def test_the_command_stores_what_it_prints_and_goes_on_with_a_detector_of_a_file_too(
    quick, few_gestures, tmp_path, capsys
):
    (tmp_path / "my.py").write_text(
        "from touchbench_streams.detectors.threshold import Threshold\n"
        "class Mine(Threshold): pass\n"
    )
    words = ["watch", *TINY, "model=lda", "features=touch", "detector=my.py:Mine", "detector.up=30"]
    words += ["false_alarms=60", "under=noise"]
    assert main(words) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "3 subjects: too few for an interval" in printed and "3/3" in printed
    (run,) = runs("watch")[1]
    assert run.data.params["watch.detector"] == f"{tmp_path / 'my.py'}:Mine[up=30.0]"
    metrics, touches = run.data.metrics, predictions(connect(), run, "touches")
    assert len(touches) == metrics["touches"] == 18  # 6 gestures of 3 people
    assert touches["found"].mean() == pytest.approx(metrics["touches_found"])
    cases = predictions(connect(), run, "scores_under_faults").set_index("severity")
    assert cases["touches_found"][0] == pytest.approx(metrics["touches_found"])
    assert f"{100 * cases['touches_found'][2]:.1f}" in printed.partition("noise 2 │")[2][:80]
    assert (
        main(words) == 0
        and "already stored" in capsys.readouterr().err
        and len(runs("watch")[1]) == 1
    )
    (sentence, *_) = make_watch_exhibits(load_results(connect()), tmp_path, {})[0].sentences
    assert "detector=my.py:Mine[up=30.0]" in sentence and main(["report"]) == 0


def test_a_model_that_is_adapted_watches_with_the_adapted_system(recordings, tmp_path):
    captures, make = cut_into_captures(recordings[:2]), lambda: lda(TouchFeatures())  # noqa: E731
    repair = ("stuck", "dead", "noise")
    system = Recipe(make(), 0.75, repair=repair).fit(captures, captures.gestures)
    watcher = learn_watcher(Threshold(), make, system, recordings[:2], 5.0)[0]
    recogniser = Recogniser(system, captures, watcher=watcher)
    path = str(tmp_path / "rec")
    save_model(Path(path), recogniser.mlflow_arguments([], captures[0][:3]))
    save_adapted(path, recogniser, captures[:9], tmp_path / "one")
    one = load_recogniser(str(tmp_path / "one"))
    assert one.watcher.system is one.estimator and one.watcher.level == watcher.level


SCORES = ("touches_found", "first_correct", "end_correct", "false_alarms_per_hour", "refused")


@pytest.fixture
def damages():
    """Two further faults: a skin without any contact, and one that changes nothing."""

    with mock.patch.dict(FAULTS):

        @fault("% of all", 1, 2, 3, 4, 5)
        def dead(frames, amount, rng):
            return np.zeros_like(frames)

        @fault("% of nothing", 1, 2, 3, 4, 5)
        def none_at_all(frames, amount, rng):
            return frames

        yield dead.__name__, none_at_all.__name__


def test_a_dead_skin_finds_nothing_and_no_fault_is_bench_watch(recordings, damages):
    (cell,) = make_cells({"data": "synth", "model": "lda", "features": "touch"})
    corpus = cut_into_captures(recordings)
    fold = fold_without("3", corpus)
    plain, kind = (Continuous("threshold", 60.0, under=under) for under in ((), damages))
    alone, both = (
        plain.evaluate_fold(cell, corpus, fold, 1),
        kind.evaluate_fold(cell, corpus, fold, 1),
    )
    pd.testing.assert_frame_equal(both.table, alone.table)
    pd.testing.assert_frame_equal(both.trials, alone.trials)
    assert both.chosen == alone.chosen and not alone.tables
    plan = SimpleNamespace(corpus=corpus)
    watched, under = plain.measure_run(plan, {}, [alone]), kind.measure_run(plan, {}, [both])
    assert all(under[name] == watched[name] for name in SCORES)
    cases = {
        (r["fault"], r["severity"]): r
        for r in under.tables["scores_under_faults"].to_dict("records")
    }
    assert [*cases] == [("none", 0), *((name, s) for name in damages for s in range(1, 6))]
    dead, same, clean = cases["dead", 3], cases["none_at_all", 3], cases["none", 0]
    assert clean["touches_found"] == watched["touches_found"] > 0.3 and dead["touches_found"] == 0
    assert all(same[name] == clean[name] for name in SCORES) and dead["amount"] == "3 % of all"
    assert dead["false_alarms_per_hour"] == 0 and dead["refused"] > 0.8  # it is too calm
    assert under["touches_found.dead.3"] == 0 and under["refused.dead.3"] == dead["refused"]
    assert both.tracked_metrics["touches_found.none_at_all.1"] == watched["touches_found"]
    shown = fault_rows(result_of("lda", "watch", under.metrics, under.tables))
    assert [row["case"] for row in shown[:2]] == ["none", "dead 1"]


def test_refused_frames_are_counted_as_a_stream_tells_them(recordings):
    (cell,) = make_cells({"data": "synth", "model": "lda", "features": "touch"})
    captures, corpus = cut_into_captures(recordings[[0, 1]]), recordings[[2]].corpus
    system = cell.estimator().fit(captures, captures.gestures)
    watcher, _ = learn_watcher(Frames(), cell.estimator, system, recordings[[0, 1]], 60.0)
    frames = corpus.frames.copy()
    frames[50:130] = frames[49]  # nothing changes
    frames[200:260] = corpus.full_scale
    shaken = frames[300:520] + np.random.default_rng(0).normal(0, 60, (220, 3, 3))
    frames[300:520] = shaken.clip(0, corpus.full_scale)
    corpus = corpus.with_fields(frames=frames)
    stream = watcher.open_stream(corpus.grid, corpus.rate_hz, corpus.full_scale)
    status = []
    for frame in corpus[0]:
        stream.push(frame.astype(np.float32))
        status.append(stream.status)
    sensed = watcher.sense(corpus)
    assert watcher.find_status(sensed)[0].tolist() == status
    assert watcher.count_refused(sensed).tolist() == [np.count_nonzero(status)]
    saturated, noise = (np.count_nonzero(np.array(status) & bit) for bit in (SATURATED, NOISE))
    assert saturated >= 60 and noise > 50


def test_recordings_go_through_the_faults_of_captures(recordings):
    twice = recordings[[0, 0, 1]]
    shares = as_shares(twice.corpus, np.arange(3))
    names = "noise", "dead_taxels"
    noise, dead = (apply_fault(twice, shares, FAULTS[name], 4)[0] for name in names)
    rng = faults.seeded_generator("noise, recording 2 of 1")
    expected = as_readings(twice.corpus, FAULTS["noise"].damage(shares[1], 2, rng))
    assert np.array_equal(noise[1], expected) and not np.array_equal(noise[0], noise[1])
    broken = [np.flatnonzero(~dead[i].any(axis=0)) for i in range(3)]
    assert np.array_equal(broken[0], broken[1]) and not np.array_equal(broken[0], broken[2])
    capture = FAULTS["dead_taxels"].apply(
        shares[0], 4, "1", 5, 20.0
    )  # the sensor of a subject is the same
    assert np.array_equal(dead[0], as_readings(twice.corpus, capture))


@pytest.mark.parametrize("name", ["dropped_frames", "doubled_frames", "noise"])
def test_reports_of_frames_that_a_fault_moves_have_the_times_of_before(name, recordings):
    """A system that reports each new reading at once reports it when it came."""
    two, fault = recordings[:2], FAULTS[name]
    shares = as_shares(two.corpus, np.arange(2))
    seen, fake = [], SimpleNamespace(count_refused=lambda corpus: np.array([0, len(corpus[1])]))
    fake.sense = lambda corpus: seen.append(corpus) or corpus
    times = lambda corpus: np.array([len(corpus[0]), len(corpus[1]), 2])  # noqa: E731
    fake.name_touches = lambda corpus: report_table(
        (i, time, time, "pat", "pat", 1.0, 0)
        for i, time in zip((0, 1, 1), times(corpus), strict=True)
    )
    table = watch_under_faults(fake, two, [name])
    for severity, corpus in enumerate(seen, 1):
        rows = table[table["severity"] == severity]
        reports = rows[rows["kind"] == "report"]
        for row, time in zip(reports.to_dict("records"), times(corpus), strict=True):
            i, now = row["recording"], corpus[row["recording"]][time - 1]
            assert row["reported"] == row["end"] <= len(two.corpus[i])
            same = as_readings(two.corpus, shares[i])[int(row["reported"]) - 1]
            assert not fault.moves or np.array_equal(now, same)
        assert not fault.moves or len(corpus[0]) != len(two.corpus[0])
        ends = rows[rows["kind"] == "recording"]
        assert ends["end"].tolist() == [*two.corpus.lengths]
        assert ends["refused"].tolist() == [0, two.corpus.lengths[1]]


def test_a_design_of_the_skin_is_watched_with_its_range_of_training_subjects():
    """The rate, the grid and the learned range reach the numbers of the run."""
    words = [*TINY, "model=lda", "features=touch", "skin.grid=2x2", "skin.rate_hz=10"]
    assert main(["watch", *words, "skin.bits=5", "skin.range=auto"]) == 0
    (run,) = [r for r in load_results(connect()) if r.kind == "watch"]
    assert run["skin.grid"] == "2x2" and "design[grid=2x2" in run["system"]
    assert (run["values_per_s"], run["bits_per_s"], run["wires"]) == (40, 200, 4)
    assert {
        "touches_found",
        "first_correct",
        "false_alarms_per_hour",
        "latency_s_p50",
    } <= run.metrics.keys()
