"""The command tune, searches in bench run, tables of features, and other targets than the gesture."""

import shlex

import numpy as np
import pandas as pd
import pytest

import bench
from bench.cli import main
from bench.commands import tune
from bench.corpora.library import open_corpus
from bench.errors import InputError
from bench.features.jung28 import Jung28
from bench.options import keys, parse
from bench.plan.plan import planned
from tests.conftest import predictions, runs
from tests.work.test_loop import SMALL

FEW = ["data.subjects=2", "data.repetitions=1"]
TWO = ["protocol=groupkfold", "protocol.folds=2", *SMALL]


def test_a_grid_of_values_is_searched_in_every_fold(capsys):
    line = ["tune", "features=jung28", *TWO, "model=svm", "model.C=1,512", "model.gamma=0.1", "inner=2"]
    assert main(line) == 0
    client, (parent,) = runs("cell")
    assert parent.data.params["tuning.inner"] == "2" and parent.data.metrics["search_seconds"] > 0
    assert parent.data.tags["system"] == "tuned svm[C=1.0|512.0, gamma=0.1, inner=2] · jung28"
    chosen, trials = (predictions(client, parent, name) for name in ("chosen", "trials"))
    assert chosen["fold"].tolist() == ["fold01", "fold02"] and set(chosen["svm.C"]) <= {1, 512}
    assert trials.groupby("fold").size().tolist() == [2, 2]
    before = predictions(client, parent)  # a stored search is printed again, and nothing is run
    assert main(line) == 0
    assert len(runs("cell")[1]) == 1 and predictions(client, parent).equals(before)


def test_declared_ranges_are_searched_single_values_kept_and_each_seed_is_a_run():
    assert main(["tune", "features=jung28", *TWO, "model=xgb", "model.trees=5", "trials=2", "inner=2", "seed=0,1"]) == 0
    client, parents = runs("cell")
    assert [p.data.tags["seed"] for p in parents] == ["0", "1"]
    tried = [predictions(client, p, "trials") for p in parents]
    for trials in tried:
        assert len(trials) == 4 and set(trials["xgb.trees"]) == {5} and trials["xgb.rate"].nunique() == 2
    assert not set(tried[0]["xgb.rate"]) & set(tried[1]["xgb.rate"])


@pytest.mark.parametrize(
    "line", ["model=cnn85 model.frames=100,200 model.hop=90", "model=zhou2016_gm_lstm model.frames=2,3 model.average=1"]
)
def test_values_are_judged_together(monkeypatch, line):
    """A hop that is too long for the default window is none for the listed ones."""
    monkeypatch.setattr(tune, "evaluated", lambda tuned, backend: planned(tuned, backend.jobs))
    assert len(tune.searched(parse([*line.split(), *SMALL], keys("tune")))) == 1


@pytest.mark.parametrize(
    ("line", "part"),
    [
        ("tune model=cnn85", "model=cnn85"),  # it declares no ranges
        ("tune model=svm objective=accuracy", "objective"),
        ("tune model=svm model.C=1,x", "model.C=x:"),
        ("tune model=jung2017_tree", "bench run model=jung2017_tree"),
        ("tune model=rf model.seed=1,2", "seed="),
        ("tune model=zhou2016_gm_lstm model.frames=16,32 model.average=20", "model.average=20:"),
        (f"tune model=zhou2016_gm_lstm model.frames=16,32 {TWO[0]} {TWO[1]} inner=2", "epoch"),  # of one subject
        ("tune model=cnn85 smallest=frames model.hop=20", "model.hop=20:"),
        ("run features=gaus features.families=sd+sad", "features.families=sd+sad:"),
        ('run model=jung2014_svm where=\'subject in ["1", "2"]\'', "there is 1"),
        ("run target=subject protocol=loso", "subject 1"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(line, part, capsys):
    words = shlex.split(line)
    assert main([*words, *SMALL]) == 2
    error = capsys.readouterr().err
    assert part in error and error.startswith("bench: ") and error.count("\n") == 1


def test_a_table_of_features():
    table = bench.extract(features="jung28", data__subjects=2, data__repetitions=1)
    corpus = open_corpus("synth", {"subjects": 2, "repetitions": 1})
    assert np.array_equal(table["gesture"], corpus.gestures)
    expected = Jung28().transform(corpus)
    pd.testing.assert_frame_equal(table[expected.columns], expected)
    with pytest.raises(InputError, match="one value"):
        bench.extract(features=["jung28", "jung54"])


def test_another_target_than_the_gesture():
    assert main(["run", "model=bayes", "features=jung28", "target=gesture+variant", *TWO[:2], *FEW]) == 0
    client, (parent,) = runs("cell")
    table = predictions(client, parent)
    assert (table["true"] == table["gesture"] + " " + table["variant"]).all() and table["true"].nunique() > 20
    assert {c for c in table if c.startswith("p_")} == {"p_" + t for t in set(table["true"])}


def test_the_smallest_value_of_a_parameter_and_the_fewest_features(capsys):
    small = ["data.subjects=4", "data.repetitions=1", "data.variants=normal", "protocol=groupkfold", "protocol.folds=2"]
    small += ["inner=2", "model=bayes", "features=jung28"]
    assert main(["tune", "smallest=ridge", "model.ridge=1,0.01", *small]) == 0
    out = capsys.readouterr().out
    assert "ridge=0.01|1.0" in out and "objective" not in out and "bayes · jung28" in out
    assert main(["tune", "smallest=features", *small]) == 0
    assert "best of jung28" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("values", "fact"),
    [
        ({"model": "rf", "smallest": "seed"}, "smallest=seed"),
        ({"model": "cnn85", "smallest": "features"}, "cnn85"),
        ({"model": "jung2017_tree", "smallest": "features"}, "jung2017_tree"),
    ],
)
def test_a_smallest_value_that_cannot_be_looked_for_is_refused(values, fact):
    with pytest.raises(InputError, match=fact):
        tune.searched({"data": "synth", **values})
