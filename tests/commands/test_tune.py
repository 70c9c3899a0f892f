"""The command tune, what a search cannot be, and tables of features.

`tests.net` has a grid that is searched.
"""

import numpy as np
import pandas as pd
import pytest

import bench
from bench.commands.tune import _make_searches, run_searches
from bench.errors import InputError
from bench.features.jung28 import Jung28
from bench.grammar.options import key_options, parse_arguments
from bench.plan.plan import make_plans
from tests.conftest import predictions, runs

SMALL = "data.subjects=4 data.variants=normal jobs=1"
TWO = f"protocol=groupkfold protocol.folds=2 {SMALL}"  # two subjects in each half of the training


def parse_tune(line):
    return parse_arguments(line.split(), key_options("tune"))


def test_declared_ranges_are_searched_single_values_kept_and_each_seed_is_a_run():
    line = "features=jung28 model=xgb model.trees=1 trials=2 inner=2 seed=0,1"
    run_searches(parse_tune(f"{line} {TWO}"))
    client, parents = runs("cell")
    assert [p.data.tags["seed"] for p in parents] == ["0", "1"]
    tried = [predictions(client, p, "trials") for p in parents]
    for trials in tried:
        assert len(trials) == 4 and set(trials["xgb.trees"]) == {1}
        assert trials["xgb.rate"].nunique() == 2
    assert not set(tried[0]["xgb.rate"]) & set(tried[1]["xgb.rate"])


def test_a_search_is_made_again_by_its_arguments():
    for line in (
        "model=svm features=gaus model.C=1.0,2.0 model.gamma=0.5 trials=9 seconds=60 seed=1",
        "model=rf features=hughes36 smallest=trees model.trees=5,10 seed=2 protocol=kfold",
    ):
        (cell, *_) = _make_searches(parse_tune(line))
        typed = " ".join(f"{key}={value}" for key, value in cell.arguments().items())
        assert cell.command == "tune" and _make_searches(parse_tune(typed))[0] == cell


@pytest.mark.parametrize(
    ("line", "part"),
    [
        ("model=cnn85", "model=cnn85"),  # it declares no ranges
        ("model=svm objective=accuracy", "objective"),
        ("model=svm model.C=1,x", "model.C=x:"),
        ("model=jung2017_tree", "bench run model=jung2017_tree"),
        ("model=rf model.seed=1,2", "seed="),
        ("model=zhou2016_gm_lstm model.frames=16,32 model.average=20", "model.average=20:"),
        (f"model=zhou2016_gm_lstm model.frames=16,32 {TWO} inner=2", "epoch"),  # of one subject
        ("model=cnn85 smallest=frames model.hop=20", "model.hop=20:"),
        ("model=rf smallest=seed", "smallest=seed"),
        ("model=cnn85 smallest=features", "cnn85"),
        ("model=lda features=jung28 model.tune=yes,no", "lda model.tune=yes searches by itself"),
        ("model=lda features=jung28 model.tune=yes smallest=shrinkage", "lda searches by itself"),
    ],
)
def test_an_impossible_search_is_refused(line, part):
    with pytest.raises(InputError) as refusal:
        make_plans(_make_searches(parse_tune(line if "jobs" in line else f"{line} {SMALL}")), 1)
    assert part in str(refusal.value) and "\n" not in str(refusal.value)


def test_values_are_judged_together():
    """A hop that is too long for the default window is none for the listed ones."""
    line = f"model=cnn85 model.frames=100,200 model.hop=90 {SMALL}"
    assert len(make_plans(_make_searches(parse_tune(line)), 1)) == 1


def test_a_table_of_features():
    table = bench.extract(features="jung28", data__subjects=2, data__repetitions=1)
    corpus = bench.corpus("synth", subjects=2, repetitions=1)
    assert np.array_equal(table["gesture"], corpus.gestures)
    expected = Jung28().transform(corpus)
    pd.testing.assert_frame_equal(table[expected.columns], expected)
    with pytest.raises(InputError, match="one value"):
        bench.extract(features=["jung28", "jung54"])
