"""`bench watch`: what is learned, what is refused, and what is stored."""

from contextlib import nullcontext
from types import SimpleNamespace

import mlflow
import numpy as np
import pandas as pd
import pytest

from addons.streams.tests.made import TINY
from addons.streams.tests.made import watched as seen
from bench.cli import main
from bench.corpora.corpus import Corpus
from bench.errors import InputError
from bench.features.touch import TouchFeatures
from bench.models.classic.lda import lda
from bench.models.recipe import Recipe
from bench.outcomes.candidates import candidates
from bench.plan.cells import cells
from bench.plan.plan import Fold
from bench.store import connect
from bench.work.saved import Recogniser, load
from tests.conftest import predictions, random_corpus, runs
from touchbench_people.commands import save_adapted
from touchbench_streams.detectors.threshold import Threshold
from touchbench_streams.detectors.ticks import learn
from touchbench_streams.fold import recordings_of, run_numbers
from touchbench_streams.recordings import Recordings, captures_in
from touchbench_streams.study import Continuous
from touchbench_streams.synth_recordings import generate


@pytest.fixture(scope="module")
def recordings():
    """Four generated people with one touch of each gesture, at 20 frames a second."""
    return generate(subjects=4, variants=("normal",), rate_hz=20.0, rows=3, cols=3)


@pytest.fixture(scope="module")
def watcher(recordings):
    captures = captures_in(recordings[np.arange(3)])
    system = Recipe(lda(TouchFeatures()), 0.75, repair=("stuck", "dead")).fit(captures, captures.gestures)
    return learn(Threshold(), lambda: lda(TouchFeatures()), system, recordings[np.arange(3)], 5.0)[0]


@pytest.mark.parametrize("detector, unknown", [("frames", ""), ("threshold", "pat")])
def test_nothing_of_a_test_subject_is_learned(detector, unknown, recordings):
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
    results = [Continuous(detector, unknown=unknown).fold(cell, each, fold, 1) for each in (corpus, other)]
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
    ],
)
def test_what_cannot_be_watched_is_one_line(words, fact, capsys):
    assert main(["watch", *TINY, "model=lda", "features=touch", *words]) == 2
    error = capsys.readouterr().err
    assert fact in error and error.count("\n") == 1


def relabelled(recordings, names=None, untouched=()):
    """The same with other names of gestures, and people whose touches are not labelled."""
    events = recordings.events.replace({"gesture": names or {}})
    kept = ~np.isin(recordings.subjects[events["recording"]], untouched)
    return Recordings(recordings.corpus, events[kept].reset_index(drop=True))


def test_false_alarms_of_a_person_without_touches_count(recordings):
    """Subject 4 touches as before, but without labels, so each report is a false alarm."""
    (cell,) = cells({"data": "synth", "model": "lda", "features": "touch", "model.window": "0.75"})
    corpus = captures_in(relabelled(recordings, untouched="4"))
    fold = Fold("4", *(np.flatnonzero((corpus.subjects == "4") == tested) for tested in (False, True)))
    result = Continuous("threshold").fold(cell, corpus, fold, 1)
    reports = (result.table["kind"] == "report").sum()
    numbers, tables = run_numbers([result], 20.0, "")
    rate = reports / (recordings.corpus.lengths[3] / 20 / 3600)
    assert reports >= 5 and numbers["false_alarms_per_hour"] == pytest.approx(rate) and numbers["touches"] == 0
    assert tables["per_subject"]["false_alarms_per_hour"].tolist() == pytest.approx([rate])
    other = {"subject": "5", "end_correct": 0.5, "false_alarms_per_hour": 0.0, "background_s": 1800.0}
    watched = pd.concat([tables["per_subject"], pd.DataFrame([other])], ignore_index=True)
    among = candidates([seen("lda", [0.5], 0.0, 1.0, tables={"per_subject": watched})], {}, study="watch")
    hours = recordings.corpus.lengths[3] / 20 / 3600 + 0.5
    assert among.table["accuracy"][0] == 50 and among.table["false_alarms"][0] == pytest.approx(reports / hours)


@pytest.mark.parametrize(
    ("names", "untouched", "options", "fact"),
    [
        ({}, "1234", {}, "no touch; label"),
        ({}, "34", {}, "fold 1 trains on touches of 1 subject;"),
        ({"rub": "unknown"}, "", {"unknown": "pat"}, "unknown=pat: .* has a gesture of this name; rename it"),
        ({"rub": "unknown"}, "", {"unknown": "unknown"}, ""),
    ],
)
def test_recordings_that_cannot_be_watched_are_refused_before_training(names, untouched, options, fact, recordings):
    (cell,) = cells({"data": "synth", "model": "lda", "features": "touch"})
    corpus = captures_in(relabelled(recordings, names, [*untouched]))
    sides = [[np.flatnonzero((corpus.subjects == one) == tested) for tested in (False, True)] for one in "12"]
    folds = [Fold(name, *parts) for name, parts in zip("12", sides, strict=True)]
    with pytest.raises(InputError, match=fact) if fact else nullcontext():
        Continuous(**options).refuse(SimpleNamespace(corpus=corpus, cell=cell, mixes_subjects=False, folds=folds))


def test_a_class_called_quiet_is_not_the_quiet_ends_of_captures(recordings):
    (cell,) = cells({"data": "synth", "model": "lda", "features": "touch"})
    corpus = random_corpus(gestures=("pat", "quiet"))
    with pytest.raises(InputError, match="background=quiet: .* class quiet; rename it"):
        Continuous(background="quiet").refuse(SimpleNamespace(corpus=corpus, cell=cell, folds=[], mixes_subjects=False))


def test_background_without_touches_is_refused(recordings):
    row = pd.DataFrame({"subject": ["1"], "gesture": ["rub"]})
    with pytest.raises(InputError, match="no touch"):
        recordings_of(Corpus.from_captures([recordings.corpus[0]], row, 20.0), "rub")


def test_the_command_stores_what_it_prints_and_goes_on(capsys):
    words = ["watch", *TINY, "model=lda", "features=touch", "detector=threshold"]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert "3 subjects: too few for an interval" in " ".join(printed.split()) and "3/3" in printed
    (run,) = runs("watch")[1]
    touches = predictions(connect(), run, "touches")
    metrics = run.data.metrics
    assert len(touches) == metrics["touches"] == 42  # 14 gestures of 3 people
    assert touches["found"].mean() == pytest.approx(metrics["touches_found"])
    assert main(words) == 0
    assert "already stored" in capsys.readouterr().err
    assert len(runs("watch")[1]) == 1


def test_a_model_that_is_adapted_watches_with_the_adapted_system(recordings, watcher, tmp_path):
    captures = captures_in(recordings[np.arange(3)])
    recogniser = Recogniser(watcher.system, captures, watcher=watcher)
    path = str(tmp_path / "rec")
    mlflow.pyfunc.save_model(path, **recogniser.model([], captures[0][:3]))
    save_adapted(path, recogniser, captures[:9], captures[:9].gestures, tmp_path / "one")
    one = load(str(tmp_path / "one"))
    assert one.watcher.system is one.estimator and one.watcher.level == watcher.level
