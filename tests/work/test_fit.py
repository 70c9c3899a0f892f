"""A system that is saved, loaded elsewhere and labels captures."""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bench.cli import main
from bench.corpora.corpus import Corpus
from bench.corpora.library import open_corpus
from bench.corpora.read.table import from_frame, read_unlabelled
from bench.errors import InputError
from bench.plan.cells import cells
from bench.work.replay import Replay, learned
from bench.work.saved import load, requirements
from tests.conftest import random_corpus, runs

FIT = ["fit", "model=bayes", "data.subjects=3", "data.variants=normal"]


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


def test_a_saved_system_answers_as_the_estimator(tmp_path, capsys):
    import mlflow

    assert main([*FIT, "stopping=no", "out=saved"]) == 0
    out = capsys.readouterr().out
    uri, run_uri = out.split()[0], out.splitlines()[0].split()[-1]
    assert uri.startswith("models:/m-") and run_uri.startswith("runs:/") and out.splitlines()[1] == "saved"
    assert "synthetic" in out
    (cell,) = cells({"model": "bayes", "data.subjects": "3", "data.variants": "normal"})
    corpus = open_corpus(cell.data, cell.data_parameters)
    estimator = cell.estimator().fit(corpus, corpus.gestures)
    some = corpus[::5].detached()
    table = as_table(some)
    for where in (uri, run_uri, "saved"):
        model = mlflow.pyfunc.load_model(where)
        found = model.predict(table)
        assert found["capture"].tolist() == [f"c{i}" for i in range(len(some))]
        assert found["label"].tolist() == estimator.predict(some).tolist()
        proba = found[[f"p_{c}" for c in estimator.classes_]].to_numpy()
        np.testing.assert_allclose(proba, estimator.predict_proba(some), atol=1e-7)
        np.testing.assert_allclose(found["confidence"], proba.max(axis=1))
    decimal = table.assign(**{c: table[c].astype(float) for c in table if c.startswith("ch")})
    assert model.predict(decimal).equals(found)
    assert model.predict(table.drop(columns="frame")).equals(found)  # rows of a capture follow one another
    assert model.predict(table[table.columns[::-1]]).equals(found)  # channels go by their names
    unnamed = model.predict(table.drop(columns="capture"))
    assert unnamed["capture"].tolist() == [str(i + 1) for i in range(len(some))]
    assert unnamed["label"].equals(found["label"])
    assert model.predict(table, params={"rate_hz": corpus.rate_hz}).equals(found)
    for wrong, told in (
        (lambda: model.predict(table, params={"rate_hz": 54.0}), "resample"),
        (lambda: model.predict(table.drop(columns="ch64")), "ch64"),
        (lambda: model.predict(table.assign(ch3=2000)), "full scale 1023"),
        (lambda: model.predict(table.assign(ch3=np.nan)), "ch3 is nan"),
        (lambda: model.predict(table.drop(columns=["capture", "frame"])), "no column capture or frame"),
        (lambda: model.predict(table.assign(frame=table["frame"] * 2)), "restore the frames"),
    ):
        with pytest.raises(mlflow.MlflowException, match=told):
            wrong()
    about = model.metadata.metadata
    assert about["grid"] == [8, 8] and about["rate_hz"] == 135.0 and about["synthetic"] is True
    assert about["classes"] == sorted(set(corpus.gestures))
    pins = Path("saved/requirements.txt").read_text().splitlines()
    assert f"scikit-learn=={version('scikit-learn')}" in pins and all("==" in p and "+" not in p for p in pins)

    client, (run,) = runs("fit")
    assert {"fit_seconds", "fit_cpu_seconds", "predict_ms_p50", "predict_ms_p99", "parameters"} <= set(run.data.metrics)
    assert run.data.tags["system"] == cell.system() and run.data.params["captures"] == str(len(corpus))
    assert main(["report"]) == 2  # a fit is not scored

    table.to_csv("new.csv", index=False)
    capsys.readouterr()
    assert main(["predict", uri, "new.csv", "out=labels.csv"]) == 0
    first, following = capsys.readouterr().out.splitlines()
    assert first.startswith(f"labels.csv: {len(some)} captures labelled: ") and f"model={uri}" in following
    assert main(["predict", "saved", "new.csv"]) == 0
    printed = capsys.readouterr().out
    assert printed == Path("labels.csv").read_text()
    labels = pd.read_csv("labels.csv")
    assert labels["label"].tolist() == found["label"].tolist()
    np.testing.assert_allclose(labels["confidence"], found["confidence"], rtol=1e-5)

    code = "import mlflow, pandas as pd, sys; m = mlflow.pyfunc.load_model(sys.argv[1]); "
    code += "import bench; print(bench.__file__); print(','.join(m.predict(pd.read_csv(sys.argv[2]))['label']))"
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    arguments = [sys.executable, "-c", code, str(tmp_path / "saved"), str(tmp_path / "new.csv")]
    plain = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(arguments, cwd=elsewhere, env=plain, capture_output=True, text=True, check=True)
    file, said = done.stdout.split()
    assert said == ",".join(found["label"]) and "saved/code" in file  # the code that it was trained with


def test_a_saved_system_knows_how_sure_it_may_be(tmp_path, capsys):
    arguments = {"model": "lda", "features": "touch", "data.subjects": "4", "where": "gesture in ['pat', 'rub', 'tap']"}
    assert main(["fit", *(f"{k}={v}" for k, v in arguments.items()), "out=saved"]) == 0
    (cell,) = cells(arguments)
    corpus = open_corpus(cell.data, cell.data_parameters).select(cell.where)
    by_hand, _ = learned(cell.estimator, corpus, np.arange(len(corpus)), Replay())
    found = load("saved")
    assert found.stopping == by_hand
    some = corpus[::7].detached()
    plain = cell.estimator().fit(corpus, corpus.gestures).predict_proba(some)
    told = found.label(some)
    temperature = by_hand.calibration
    place = np.clip(np.log(1000 / 135 * some.lengths / temperature.first_ms), 0, None)
    place = np.minimum(place / np.log(temperature.last_ms / temperature.first_ms), 1)
    sharp = np.exp(np.log(temperature.first) * (1 - place) + np.log(temperature.last) * place)[:, None]
    hot = np.maximum(plain, 1e-6) ** (1 / sharp)
    hot /= hot.sum(axis=1, keepdims=True)
    assert temperature.last != 1  # else this shows nothing
    np.testing.assert_allclose(told.filter(like="p_").to_numpy(), hot, rtol=1e-4)
    assert told["label"].tolist() == found.estimator.predict(some).tolist()
    import mlflow

    found.format = "0"  # as another version saved it
    mlflow.pyfunc.save_model("old", python_model=found, pip_requirements=[])
    with pytest.raises(InputError, match="old was saved by another version of touchbench; save it again with bench"):
        load("old")
    np.testing.assert_allclose(told["confidence"], hot.max(axis=1), rtol=1e-4)


def test_captures_that_cannot_teach_when_to_stop_are_said(capsys):
    one = ["fit", "model=lda", "features=touch", "data.subjects=2", "where=subject == '1'", "out=saved"]
    assert main(one) == 0
    assert "no calibration and no threshold go with the model: only one subject trains" in capsys.readouterr().err
    assert load("saved").stopping is None
    assert main(["fit", "model=lda", "features=touch", "data.subjects=3", "target=subject", "out=who"]) == 0
    assert "nobody is left who shows" in capsys.readouterr().err
    assert main(["fit", "stopping=maybe"]) == 2 and "give yes or no" in capsys.readouterr().err


def test_what_cannot_be_fitted_or_loaded_is_refused(capsys, tmp_path):
    import mlflow

    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("")

    class Other(mlflow.pyfunc.PythonModel):
        def predict(self, context, model_input, params=None):
            return model_input

    mlflow.pyfunc.save_model(str(tmp_path / "other"), python_model=Other(), pip_requirements=[])
    for arguments, told in (
        (["fit", "model=bayes,svm"], "one value of each key"),
        (["fit", "protocol=loso"], "no key is called 'protocol'"),
        (["fit", "out=full"], "new or empty"),
        (["fit", "data=nothing"], "not imported"),
        (["fit", "where=gesture == 'pat'"], "only one gesture is left"),
        (["predict", "x"], "give a model and a file"),
        (["predict", "x", "y.csv", "o=z"], "no such option"),
        (["predict", "x", "y.csv", "out=a", "out=b"], "out= is given twice"),
        (["predict", "http://somewhere/model", "y.csv"], "not a saved model"),
        (["predict", "runs:/0123/model", "y.csv"], "cannot be loaded"),
        (["predict", "models:/m-0123", "y.csv"], "cannot be loaded"),
        (["predict", "other", "y.csv"], "a model of something else"),
    ):
        capsys.readouterr()
        assert main(arguments) == 2, arguments
        error = capsys.readouterr().err.splitlines()
        assert told in error[-1] and len([line for line in error if line.startswith("bench:")]) == 1


@pytest.fixture(scope="module")
def grown(tmp_path_factory):
    """A model of random captures at 100 Hz on 3 x 4, and the captures."""
    import mlflow

    from bench.work.saved import Recogniser, quiet

    corpus = random_corpus(grid=(3, 4))
    (cell,) = cells({"model": "bayes", "features": "jung54"})
    made = Recogniser(cell.estimator().fit(corpus, corpus.gestures), corpus)
    folder = tmp_path_factory.mktemp("grown") / "model"
    with quiet():
        mlflow.pyfunc.save_model(str(folder), **made.model([], corpus[0][:2]))
    return str(folder), corpus


@pytest.mark.parametrize("suffix", ["csv", "parquet", "npz"])
def test_files_of_every_format_are_labelled(suffix, grown, capsys):
    model, corpus = grown
    estimated = pd.DataFrame(as_table(corpus, origin=1))
    path = f"new.{suffix}"
    if suffix == "csv":
        estimated.assign(gesture="?").to_csv(
            path, index=False, columns=["gesture", *estimated]
        )  # conditions may be there
    elif suffix == "parquet":
        estimated.to_parquet(path, index=False)
    else:
        offsets = np.append(0, np.cumsum(corpus.lengths))
        np.savez(path, frames=corpus.frames, offsets=offsets, capture=[f"c{i}" for i in range(len(corpus))])
    assert main(["predict", model, path, "rate_hz=100", "out=labels.csv"]) == 0
    labels = pd.read_csv("labels.csv")
    assert list(labels) == ["capture", "label", "confidence", "p_pat", "p_rub", "p_tap"]
    assert labels["capture"].tolist() == [f"c{i}" for i in range(len(corpus))]
    (cell,) = cells({"model": "bayes", "features": "jung54"})
    own = cell.estimator().fit(corpus, corpus.gestures)
    assert labels["label"].tolist() == own.predict(corpus).tolist()
    np.testing.assert_allclose(labels[["p_pat", "p_rub", "p_tap"]], own.predict_proba(corpus), atol=1e-5)
    if suffix == "csv":
        estimated[estimated.columns[::-1]].to_csv(path, index=False)
        assert main(["predict", model, path, "out=other.csv"]) == 0  # channels go by their names
        assert Path("other.csv").read_text() == Path("labels.csv").read_text()


def test_a_bad_file_is_one_line(grown, capsys):
    model, corpus = grown
    table = as_table(corpus[:3])
    for bad, told in (
        (table.drop(columns="frame"), "no column frame"),
        (table.drop(columns="ch12"), "12 channels, ch1 to ch12: ch12 is missing"),
        (table.assign(ch13=1), "12 channels, ch1 to ch12: ch13 is extra"),
        (table.assign(ch5="x"), "line 2: ch5 is 'x'"),
        (table.assign(ch5=5000), "the full scale 1023"),
        (table.iloc[1:], "a capture starts at frame"),
    ):
        bad.to_csv("bad.csv", index=False)
        assert main(["predict", model, "bad.csv"]) == 2, told
        error = capsys.readouterr().err
        assert told in error and error.count("\n") == 1
    np.savez("bad.npz", frames=np.zeros((4, 2, 2)), offsets=[0, 4])
    assert main(["predict", model, "bad.npz"]) == 2 and "grid= says 3x4" in capsys.readouterr().err
    assert main(["predict", model, "none.csv"]) == 2 and "no such file" in capsys.readouterr().err
    assert main(["predict", model, "bad.csv", "rate_hz=54"]) == 2 and "trained at 100 Hz" in capsys.readouterr().err
    assert main(["predict", model, "bad.npz", "rate_hz=x"]) == 2


def test_captures_without_labels_are_read(tmp_path):
    corpus = random_corpus(subjects=1, grid=(2, 3))
    table = as_table(corpus)
    table.drop(columns="capture").to_csv("a.csv", index=False)
    found = read_unlabelled(Path("a.csv"), 100.0, (2, 3), 1023.0)
    assert [f.tolist() for f in found] == [f.tolist() for f in corpus] and found.frames.dtype == np.uint16
    assert found.captures["capture"].tolist() == [str(i + 1) for i in range(len(corpus))]
    channels = [f"ch{i + 1}" for i in range(6)]
    twice = pd.concat([table[table["capture"] == "c1"], table[table["capture"] == "c1"]])
    again = from_frame(twice, channels, 100.0, (2, 3), 1023.0, "input")  # frame starts again: another capture
    assert len(again) == 2 and isinstance(again, Corpus)
    with pytest.raises(InputError, match="input: there are no frames"):
        from_frame(table[:0], channels, 100.0, (2, 3), 1023.0, "input")
    with pytest.raises(InputError, match="input, row 3: capture is empty"):
        from_frame(
            table.assign(capture=[None if i == 2 else "a" for i in range(len(table))]),
            channels,
            100.0,
            (2, 3),
            1023.0,
            "input",
        )


def test_a_system_with_an_extra_brings_what_the_extra_names():
    assert f"aeon=={version('aeon')}" in requirements(["rocket", "jung54"])
    usual = requirements(["svm", "jung54"])
    assert f"mlflow=={version('mlflow')}" in usual and not {"aeon", "pytest", "ruff"} & {
        u.split("==")[0] for u in usual
    }
