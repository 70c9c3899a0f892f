"""The command tune, what a search cannot be, and tables of features; `tests.net` has a grid that is searched."""

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
from bench.grammar.options import keys, parse
from bench.plan.plan import planned
from tests.conftest import predictions, runs

SMALL = [
    "data.subjects=4",
    "data.variants=normal",
    "jobs=1",
]  # two in each half of the training subjects
TWO = ["protocol=groupkfold", "protocol.folds=2", *SMALL]


def test_declared_ranges_are_searched_single_values_kept_and_each_seed_is_a_run():
    assert (
        main(
            [
                "tune",
                "features=jung28",
                *TWO,
                "model=xgb",
                "model.trees=1",
                "trials=2",
                "inner=2",
                "seed=0,1",
            ]
        )
        == 0
    )
    client, parents = runs("cell")
    assert [p.data.tags["seed"] for p in parents] == ["0", "1"]
    tried = [predictions(client, p, "trials") for p in parents]
    for trials in tried:
        assert (
            len(trials) == 4
            and set(trials["xgb.trees"]) == {1}
            and trials["xgb.rate"].nunique() == 2
        )
    assert not set(tried[0]["xgb.rate"]) & set(tried[1]["xgb.rate"])


def test_values_are_judged_together(monkeypatch):
    """A hop that is too long for the default window is none for the listed ones."""
    monkeypatch.setattr(tune, "evaluated", lambda tuned, backend: planned(tuned, backend.jobs))
    line = ["model=cnn85", "model.frames=100,200", "model.hop=90", *SMALL]
    assert len(tune.searched(parse(line, keys("tune")))) == 1


@pytest.mark.parametrize(
    ("line", "part"),
    [
        ("tune model=cnn85", "model=cnn85"),  # it declares no ranges
        ("tune model=svm objective=accuracy", "objective"),
        ("tune model=svm model.C=1,x", "model.C=x:"),
        ("tune model=jung2017_tree", "bench run model=jung2017_tree"),
        ("tune model=rf model.seed=1,2", "seed="),
        ("tune model=zhou2016_gm_lstm model.frames=16,32 model.average=20", "model.average=20:"),
        (
            f"tune model=zhou2016_gm_lstm model.frames=16,32 {TWO[0]} {TWO[1]} inner=2",
            "epoch",
        ),  # of one subject
        ("tune model=cnn85 smallest=frames model.hop=20", "model.hop=20:"),
        ("tune model=rf smallest=seed", "smallest=seed"),
        ("tune model=cnn85 smallest=features", "cnn85"),
        ("run features=gaus features.families=sd+sad", "features.families=sd+sad:"),
        ('run model=jung2014_svm where=\'subject in ["1", "2"]\'', "there is 1"),
        ("run target=subject protocol=loso", "subject 1"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(line, part, capsys):
    assert main([*shlex.split(line), *SMALL]) == 2
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
