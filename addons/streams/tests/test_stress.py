"""`bench watch under=`: recordings of test subjects under faults, by hand, and frames that are refused."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from addons.streams.tests.made import TINY
from bench.cli import main
from bench.corpora import faults
from bench.corpora.faults import FAULTS, as_readings, as_shares, fault
from bench.plan.cells import cells
from bench.plan.plan import Fold
from bench.store import connect
from tests.conftest import predictions, runs
from tests.results import result as result_of
from touchbench_streams.detectors import detectors
from touchbench_streams.detectors.ticks import learn
from touchbench_streams.page import rows_under
from touchbench_streams.recordings import captures_in
from touchbench_streams.stress import disturbed
from touchbench_streams.study import Continuous
from touchbench_streams.synth_recordings import generate

SCORES = ("touches_found", "first_correct", "end_correct", "false_alarms_per_hour", "refused")
WORDS = ["watch", *TINY, "model=lda"]


@pytest.fixture(scope="module")
def recordings():
    """Three generated people with one touch of each gesture, at 20 frames a second."""
    return generate(subjects=3, variants=("normal",), rate_hz=20.0, rows=4, cols=4)


@pytest.fixture
def damages(monkeypatch):
    """Two further faults: a skin without any contact, and one that changes nothing."""
    monkeypatch.setattr(faults, "FAULTS", dict(FAULTS))

    @fault("% of all", 1, 2, 3, 4, 5)
    def dead(frames, amount, rng):
        return np.zeros_like(frames)

    @fault("% of nothing", 1, 2, 3, 4, 5)
    def none_at_all(frames, amount, rng):
        return frames

    return dead.__name__, none_at_all.__name__


def test_a_dead_skin_finds_nothing_and_no_fault_is_bench_watch(recordings, damages):
    (cell,) = cells({"data": "synth", "model": "lda", "features": "touch"})
    corpus = captures_in(recordings)
    fold = Fold("3", *(np.flatnonzero((corpus.subjects == "3") == tested) for tested in (False, True)))
    plain, kind = (Continuous("threshold", 60.0, under=under) for under in ((), damages))
    alone, both = plain.fold(cell, corpus, fold, 1), kind.fold(cell, corpus, fold, 1)
    pd.testing.assert_frame_equal(both.table, alone.table)
    pd.testing.assert_frame_equal(both.trials, alone.trials)
    assert both.chosen == alone.chosen and not alone.tables
    plan = SimpleNamespace(corpus=corpus)
    watched, under = plain.result(plan, {}, [alone]), kind.result(plan, {}, [both])
    assert all(under[name] == watched[name] for name in SCORES)
    cases = {(r["fault"], r["severity"]): r for r in under.tables["scores_under_faults"].to_dict("records")}
    assert [*cases] == [("none", 0), *((name, s) for name in damages for s in range(1, 6))]
    dead, same, clean = cases["dead", 3], cases["none_at_all", 3], cases["none", 0]
    assert clean["touches_found"] == watched["touches_found"] > 0.3 and dead["touches_found"] == 0
    assert all(same[name] == clean[name] for name in SCORES) and dead["amount"] == "3 % of all"
    assert dead["false_alarms_per_hour"] == dead["refused"] == 0  # `threshold` refuses nothing
    assert under["touches_found.dead.3"] == 0 and under["refused.dead.3"] == dead["refused"]
    assert kind.fold_metrics(both, 20.0)["touches_found.none_at_all.1"] == watched["touches_found"]
    shown = rows_under(result_of("lda", "watch", under.metrics, under.tables))
    assert [row["case"] for row in shown[:2]] == ["none", "dead 1"]


@pytest.mark.parametrize("detector", ["threshold", "frames"])
def test_refused_frames_are_counted_as_a_stream_tells_them(detector, recordings):
    (cell,) = cells({"data": "synth", "model": "lda", "features": "touch"})
    captures, corpus = captures_in(recordings[[0, 1]]), recordings[[2]].corpus
    system = cell.estimator().fit(captures, captures.gestures)
    (part,) = detectors({"detector": detector})
    watcher, _ = learn(part.make(), cell.estimator, system, recordings[[0, 1]], 60.0)
    frames = corpus.frames.copy()
    frames[50:130] = frames[49]  # nothing changes
    frames[200:260] = corpus.full_scale
    corpus = corpus.changed(frames=frames)
    stream = watcher.stream(corpus.grid, corpus.rate_hz, corpus.full_scale)
    status = []
    for frame in corpus[0]:
        stream.push(frame.astype(np.float32))
        status.append(stream.status)
    counts = pd.Series(status).value_counts()
    assert watcher.refused(corpus, watcher.evidence(corpus)).tolist() == [len(status) - counts["ok"]]
    assert counts["saturated"] >= 60 and (detector == "frames" or "refused" not in counts)


def test_recordings_go_through_the_faults_of_captures(recordings):
    twice = recordings[[0, 0, 1]]
    shares = as_shares(twice.corpus, np.arange(3))
    noise, dead = (disturbed(twice, shares, FAULTS[name], 4) for name in ("noise", "dead_taxels"))
    rng = faults.seeded("noise, recording 2 of 1")
    expected = as_readings(twice.corpus, FAULTS["noise"].damage(shares[1], 2, rng))
    assert np.array_equal(noise[1], expected) and not np.array_equal(noise[0], noise[1])
    broken = [np.flatnonzero(~dead[i].any(axis=0)) for i in range(3)]
    assert np.array_equal(broken[0], broken[1]) and not np.array_equal(broken[0], broken[2])
    capture = FAULTS["dead_taxels"].apply(shares[0], 4, "1", 5, 20.0)  # the sensor of a subject is the same
    assert np.array_equal(dead[0], as_readings(twice.corpus, capture))


@pytest.mark.parametrize(("under", "fact"), [("late_start", "removes frames"), ("nosie", "did you mean noise")])
def test_a_fault_that_recordings_cannot_have_is_one_line(under, fact, capsys):
    assert main([*WORDS, "features=touch", f"under={under}"]) == 2
    error = capsys.readouterr().err
    assert f"under={under}: " in error and fact in error and error.count("\n") == 1


def test_the_command_prints_what_it_stores(capsys):
    assert main([*WORDS, "features=touch", "detector=threshold", "false_alarms=60", "under=noise"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    (run,) = runs("watch")[1]
    cases = predictions(connect(), run, "scores_under_faults").set_index("severity")
    assert cases["touches_found"][0] == pytest.approx(run.data.metrics["touches_found"])
    assert f"│ noise 2 │ {100 * cases['touches_found'][2]:.1f} │" in printed.replace("0.5 % of full scale, SD │ ", "")
    assert run.data.params["watch.under"] == "noise" and main(["report"]) == 0
