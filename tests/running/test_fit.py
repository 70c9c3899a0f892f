"""A system that is saved, loaded elsewhere and labels captures."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from shutil import copytree
from types import SimpleNamespace

import mlflow
import numpy as np
import pandas as pd
import pytest

from bench.cli import main
from bench.corpora.corpus import Corpus
from bench.corpora.library import open_corpus
from bench.errors import InputError
from bench.ground.digests import write_folder_digest
from bench.plan.grid import make_cells
from bench.running.fit import fit
from bench.running.replay import STATE, Calibration, Stopping, Waiting, learn_stopping_rule
from bench.running.saved import Recogniser, load_recogniser, reading_step
from tests.conftest import random_corpus, runs
from tests.net.build import inside
from tests.running.fakes import Level
from tests.running.test_circumstances import CORPUS, TEST, TRAIN, Shy

CELL = {"model": "lda", "features": "touch", "data.subjects": "3", "data.variants": "normal"}
CELL |= {"where": "gesture in ['pat', 'rub', 'tap']"}


def as_table(corpus, names=None, origin=0):
    """A corpus as a long table: capture, frame, ch1, ch2, ..."""
    parts = []
    for i, frames in enumerate(corpus):
        values = frames.reshape(len(frames), -1)
        part = pd.DataFrame(values, columns=[f"ch{c + 1}" for c in range(values.shape[1])])
        part.insert(0, "frame", np.arange(origin, len(frames) + origin))
        part.insert(0, "capture", names[i] if names else f"c{i}")
        parts.append(part)
    return pd.concat(parts, ignore_index=True)


@pytest.fixture(scope="module")
def shipped(tmp_path_factory, empty_store):
    """A system that `fit` has trained on captures of three subjects, and the captures."""
    folder = tmp_path_factory.mktemp("shipped")
    (cell,) = make_cells(CELL)
    with inside(folder, empty_store):
        fitted = fit(cell, Path("saved"))
        (run,) = runs("fit")[1]
    corpus = open_corpus(cell.data, cell.data_parameters).select(cell.where)
    return SimpleNamespace(folder=folder, fitted=fitted, run=run, cell=cell, corpus=corpus)


def calibrated(proba, ms, calibration):
    """By hand: the logarithm of the temperature is a straight line over that of time."""
    share = np.clip(
        np.log(ms / calibration.first_ms) / np.log(calibration.last_ms / calibration.first_ms), 0, 1
    )
    temperature = np.exp(np.log(calibration.first) * (1 - share) + np.log(calibration.last) * share)
    proba = np.maximum(proba, 1e-6) ** (1 / temperature[:, None])
    return proba / proba.sum(axis=1, keepdims=True)


def test_a_saved_system_decides_as_the_estimator_as_surely_as_it_may(shipped, monkeypatch):
    monkeypatch.setenv("TOUCHBENCH_HOME", str(shipped.folder / "home"))
    monkeypatch.chdir(shipped.folder)
    corpus, some = shipped.corpus, shipped.corpus[::3].detach()
    estimator, table = shipped.cell.estimator().fit(corpus, corpus.gestures), as_table(some)
    stopping, _ = learn_stopping_rule(shipped.cell.estimator, corpus, np.arange(len(corpus)))
    assert load_recogniser("saved").stopping == stopping and stopping.calibration.last != 1
    expected = calibrated(
        estimator.predict_proba(some), 1000 / 135 * some.lengths, stopping.calibration
    )
    model = mlflow.pyfunc.load_model("saved")  # as a program without touchbench's functions does
    for labels in (load_recogniser(shipped.fitted.uri).predict(None, table), model.predict(table)):
        assert labels["capture"].tolist() == [f"c{i}" for i in range(len(some))]
        assert labels["label"].tolist() == estimator.predict(some).tolist()
        np.testing.assert_allclose(
            labels[[f"p_{c}" for c in estimator.classes_]], expected, rtol=1e-4
        )
        np.testing.assert_allclose(labels["confidence"], expected.max(axis=1), rtol=1e-4)
    for same in (
        table.assign(**{c: table[c].astype(float) for c in table if c.startswith("ch")}),
        table.drop(columns="frame"),  # rows of a capture follow one another
        table[table.columns[::-1]],  # channels go by their names
    ):
        assert model.predict(same).equals(labels)
    unnamed = model.predict(table.drop(columns="capture"), params={"rate_hz": 135.0})
    assert unnamed["capture"].tolist() == [str(i + 1) for i in range(len(some))]
    for wrong, rate_hz, fact in ((table, 54.0, "54"), (table.drop(columns="ch64"), 135.0, "ch64")):
        with pytest.raises(mlflow.MlflowException, match=fact):
            model.predict(wrong, params={"rate_hz": rate_hz})
    told = {"grid": [8, 8], "rate_hz": 135.0, "synthetic": True, "classes": ["pat", "rub", "tap"]}
    assert model.metadata.metadata.items() >= told.items()
    pins = Path("saved/requirements.txt").read_text().splitlines()
    assert f"scikit-learn=={version('scikit-learn')}" in pins and all(
        "==" in p and "+" not in p for p in pins
    )
    run = shipped.run
    assert {
        "fit_seconds",
        "fit_cpu_seconds",
        "predict_ms_p50",
        "predict_ms_p99",
        "parameters",
    } <= set(run.data.metrics)
    assert run.data.tags["system"] == shipped.cell.system_name() and run.data.params[
        "captures"
    ] == str(len(corpus))


def test_the_step_of_readings_is_that_of_the_training_captures_alone():
    rng = np.random.default_rng(0)
    streams = [
        1.5 * rng.integers(0, 9, (5, 2, 3)),
        1.5 * rng.integers(0, 9, (4, 2, 3)),
        rng.random((6, 2, 3)),
    ]
    captures = pd.DataFrame({"subject": ["1", "2", "3"], "gesture": "pat"})
    corpus = Corpus.from_captures(
        [s.astype(np.float32) for s in streams], captures, 7.0, full_scale=255.0
    )
    assert reading_step(corpus[:2]) == 1.5 and reading_step(corpus) == 0.0
    whole = Corpus.from_captures(
        [s.astype(np.int16) for s in streams], captures, 7.0, full_scale=255.0
    )
    assert reading_step(whole) == 1.0


@pytest.mark.parametrize("kind", ["folder", "store"])
def test_a_damaged_model_is_refused_before_it_is_loaded(shipped, monkeypatch, tmp_path, kind):
    """Each kind of file of a model, of which Python runs some."""
    monkeypatch.chdir(copytree(shipped.folder, tmp_path / "copy"))
    monkeypatch.setattr(mlflow.pyfunc, "load_model", lambda _: pytest.fail("loaded"))
    model, folder = "saved", Path("saved")
    if kind == "store":
        model = shipped.fitted.uri
        folder = next(Path("mlruns").rglob("MLmodel")).parent
    for name in ("python_model.pkl", "MLmodel", "code/bench/contract.py", "sha256.json"):
        content = (folder / name).read_bytes()
        for damaged in (content[:-1], bytes([content[0] ^ 4]) + content[1:]):
            (folder / name).write_bytes(damaged)
            with pytest.raises(InputError, match=f"is damaged: {name}.*restore it") as error:
                load_recogniser(model)
            assert "\n" not in str(error.value)
        (folder / name).write_bytes(content)


def test_what_cannot_be_fitted_or_loaded_is_refused(monkeypatch, capsys):
    Path("full").mkdir()
    Path("full/MLmodel").write_text("")
    for arguments, fact in (
        (["fit", "out=full"], "out=full"),
        (["fit", "where=gesture == 'pat'"], "one gesture"),
        (["predict", "runs:/0123/model", "y.csv"], "runs:/0123/model cannot be loaded"),
    ):
        assert main(arguments) == 2, arguments
        assert fact in capsys.readouterr().err.splitlines()[-1]
    old = Recogniser(Level(), CORPUS)
    old.format = "0"
    fitted = Level().fit(CORPUS, CORPUS.gestures)
    of_commit, fit = Recogniser(fitted, CORPUS), Recogniser(fitted, CORPUS)
    of_commit.revision, of_commit.usual = "", None  # as code of before, whose range was a tuple
    fit.revision = ""
    held = iter([object(), old, of_commit, fit])
    monkeypatch.setattr(
        mlflow.pyfunc, "load_model", lambda _: SimpleNamespace(unwrap_python_model=held.__next__)
    )
    write_folder_digest(Path("full"))
    facts = "is not a model of touchbench", "saved by another version", "saved by another commit"
    for fact in facts:
        with pytest.raises(InputError, match=f"full .*{fact}"):
            load_recogniser("full")
    assert load_recogniser("full") is fit


def test_files_are_labelled_whatever_their_format_and_a_bad_one_is_one_line(monkeypatch, capsys):
    corpus = random_corpus(grid=(3, 4))
    system = Level().fit(corpus, corpus.gestures)
    monkeypatch.setattr(
        "bench.commands.predict.load_recogniser", lambda _: Recogniser(system, corpus)
    )
    table = as_table(corpus, origin=1)
    table.assign(gesture="?")[["gesture", *table.columns[::-1]]].to_csv("new.csv", index=False)
    offsets = np.append(0, np.cumsum(corpus.lengths))
    np.savez(
        "new.npz",
        frames=corpus.frames,
        offsets=offsets,
        capture=[f"c{i}" for i in range(len(corpus))],
    )
    for path in ("new.csv", "new.npz"):
        assert main(["predict", "m", path, "rate_hz=100", "out=labels.csv"]) == 0
        labels = pd.read_csv("labels.csv")
        assert list(labels) == [
            "capture",
            "label",
            "confidence",
            "unlike",
            "p_pat",
            "p_rub",
            "p_tap",
        ]
        assert labels["capture"].tolist() == [f"c{i}" for i in range(len(corpus))]
        assert labels["label"].tolist() == system.predict(corpus).tolist()
        np.testing.assert_allclose(
            labels.filter(like="p_"), system.predict_proba(corpus), atol=1e-5
        )
    table.drop(columns="ch12").to_csv("bad.csv", index=False)
    capsys.readouterr()
    for arguments, facts in {
        ("bad.csv",): "bad.csv 3x4 ch12",
        ("new.csv", "rate_hz=54"): "54 100",
    }.items():
        assert main(["predict", "m", *arguments]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert all(fact in line for fact in facts.split())


@pytest.mark.nightly
def test_a_saved_system_runs_elsewhere_on_the_code_that_it_was_trained_with(shipped):
    as_table(shipped.corpus[::9].detach()).to_csv("new.csv", index=False)
    code = "import mlflow, pandas as pd, sys; m = mlflow.pyfunc.load_model(sys.argv[1]); "
    code += "import bench; "
    code += "print(bench.__file__); print(','.join(m.predict(pd.read_csv('new.csv'))['label']))"
    saved = str(shipped.folder / "saved")
    plain = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", code, saved], env=plain, capture_output=True, text=True, check=True
    )
    file, printed = done.stdout.split()
    assert (
        printed.split(",")
        == [*load_recogniser(saved).predict(None, pd.read_csv("new.csv"))["label"]]
        and "saved/code" in file
    )


def test_a_saved_system_that_abstains_gives_an_empty_label_without_confidence():
    system = Shy().fit(CORPUS[TRAIN], CORPUS.gestures[TRAIN])
    gone = np.isnan(system.predict_proba(CORPUS[TEST])[:, 0])
    stopping = Stopping(Calibration(100.0, 200.0, 2.0, 3.0), Waiting((0.1,) * len(STATE)), 0.5)
    recogniser = Recogniser(system, CORPUS[TRAIN], stopping)
    table = recogniser.label(CORPUS[TEST])
    assert table["label"].eq("").tolist() == table["confidence"].eq(0).tolist() == gone.tolist()
    assert recogniser.decide_on(CORPUS[TEST[gone][:1]], "pat")[:2] == ("", 0.0)
