"""The commands tune, systems and extract, searches in bench run, and other targets than the gesture."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from bench.cli import main
from bench.commands.systems import command
from bench.plan.plan import planned
from bench.registry import names
from features.jung28 import Jung28
from reports.comparison import published
from tests.conftest import predictions, runs
from tests.work.test_loop import SMALL

FEW = ["data.subjects=1", "data.repetitions=1"]
TUNE = ["tune", "features=jung28", "protocol=groupkfold", "protocol.folds=2", *SMALL]


def test_a_grid_of_values_is_searched_in_every_fold(capsys):
    assert main([*TUNE, "model=svm", "model.C=1,512", "model.gamma=0.1", "inner=2"]) == 0
    out = capsys.readouterr().out
    assert "tuned svm[C=1.0|512.0" in out and "Chosen in each training part" in out and "synthetic" in out
    client, (parent,) = runs("cell")
    assert (
        parent.data.params["tuning.inner"] == "2"
        and parent.data.tags["system"] == "tuned svm[C=1.0|512.0, gamma=0.1, inner=2] · jung28"
    )
    assert parent.data.metrics["search_seconds"] > 0
    folder = client.fetched(parent.info.run_id, "")
    chosen, trials = (pd.read_csv(f"{folder}/{name}.csv") for name in ("chosen", "trials"))
    assert chosen["fold"].tolist() == ["fold01", "fold02"] and set(chosen["svm.C"]) <= {1, 512}
    assert trials.groupby("fold").size().tolist() == [2, 2] and trials.groupby("fold")["front"].any().all()
    _, children = runs("fold")
    assert {c.data.params["chosen.svm.C"] for c in children} == {str(float(c)) for c in chosen["svm.C"]}
    # what is stored is told again, and nothing is run
    before = predictions(client, parent)
    assert main([*TUNE, "model=svm", "model.C=1,512", "model.gamma=0.1", "inner=2"]) == 0
    assert "Chosen in each training part" in capsys.readouterr().out
    assert len(runs("cell")[1]) == 1 and predictions(client, parent).equals(before)


def test_declared_ranges_are_searched_and_given_values_kept():
    assert main([*TUNE, "model=xgb", "model.trees=5", "trials=2", "objective=accuracy+time"]) == 0
    client, (parent,) = runs("cell")
    trials = pd.read_csv(client.fetched(parent.info.run_id, "trials.csv"))
    assert len(trials) == 4 and set(trials["xgb.trees"]) == {5} and trials["xgb.rate"].nunique() == 2
    assert (trials["state"] == "complete").all()


def test_seeds_of_a_search_are_different_runs():
    assert main([*TUNE, "model=bayes", "trials=2", "inner=2", "seed=0,1"]) == 0
    client, parents = runs("cell")
    assert [p.data.tags["seed"] for p in parents] == ["0", "1"]
    tried = [pd.read_csv(client.fetched(p.info.run_id, "trials.csv"))["bayes.ridge"] for p in parents]
    assert not set(tried[0]) & set(tried[1])


def test_auto_tells_what_it_chose(capsys):
    assert (
        main(
            ["run", "model=auto", "model.trials=2", "model.inner=2", "protocol=groupkfold", "protocol.folds=2", *SMALL]
        )
        == 0
    )
    out = capsys.readouterr().out
    assert "Chosen in each" in out and "auto[trials=2, inner=2]" in out
    _, (parent,) = runs("cell")
    assert parent.data.tags["features"] == "touch, jung54"


def test_a_published_system_says_its_features():
    assert main(["run", "model=jung2014_bayes", "protocol=groupkfold", "protocol.folds=2", *SMALL]) == 0
    _, (parent,) = runs("cell")
    assert parent.data.tags["features"] == "jung28" and parent.data.tags["system"] == "jung2014_bayes"


def test_values_are_judged_together(monkeypatch):
    """A hop that is too long for the default window is none for the listed ones."""
    monkeypatch.setattr("bench.commands.tune.evaluated", lambda cells, backend: planned(cells, backend.jobs))
    monkeypatch.setattr("bench.commands.tune.show", len)
    monkeypatch.setattr("bench.commands.tune.one_label", lambda outcomes: None)
    assert main(["tune", "model=cnn85", "model.frames=100,200", "model.hop=90", *SMALL]) == 1
    assert main(["tune", "model=zhou2016_gm_lstm", "model.frames=2,3", "model.average=1", *SMALL]) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["tune", "model=cnn85"], "model=cnn85 declares no ranges to search; list values, such as model.frames=1,2"),
        (["tune", "model=svm", "model.D=1,2"], "model=svm has no parameter 'D'"),
        (["tune", "model=svm", "trials=many"], "trials=many: give a whole number"),
        (["tune", "model=svm", "trials=0"], "trials=0: give at least 1"),
        (["tune", "model=svm", "inner=1"], "inner=1: give a number of subject groups"),
        (["tune", "model=svm", "budget=-1"], "budget=-1: give"),
        (["tune", "model=svm", "objective=speed"], "objective=speed: give accuracy, accuracy+time or smallest"),
        (["tune", "model=svm", "model.C=1,x"], "model.C=x: give a number"),
        (["tune", "model=svm", "model.C=0,1"], "model.C=0"),
        (["tune", "model=jung2017_tree"], "model=jung2017_tree searches by itself; use bench run model=jung2017_tree"),
        (["tune", "model=rf", "model.seed=1,2"], "model.seed=1,2: give seed= instead"),
        (["run", "model=balli2015_rf", "model.selected=-1"], "features.selected=-1: give"),
        (["run", "model=jung2014_svm", "where=subject in ['1', '2']"], "leaving training subjects out, and there is 1"),
        (["run", "target=subject", "protocol=loso"], "tests subject 1 and trains none of it"),
        (
            ["extract", "out=/nonexistent/a.csv", "data.subjects=1", "data.repetitions=1"],
            "cannot be written (Cannot save",
        ),
        (["run", "model=auto", "model.budget=0"], "budget=0: give"),
        (["run", "target=mood"], "target=mood: synth has no full column 'mood'; known: subject, variant, gesture"),
        (["systems", "all"], "bench systems takes no arguments"),
        (["extract", "features=jung28"], "out=: give a file name"),
        (["extract", "out=a.xlsx"], "out=a.xlsx: give a file name that ends in .parquet or .csv"),
        (["extract", "out=a.csv", "features=jung28,jung54"], "one table; give one value"),
        (["extract", "out=none/a.csv", "data.subjects=1", "data.repetitions=1"], "cannot be written"),
        (["tune", "model=cnn85", "model.frames=10,200", "model.hop=90"], "model.hop=90: frames between windows of 10"),
        (["choose", "model=cnn85", "over=frames", "model.hop=20"], "model.hop=20: frames between windows of 10"),
        (
            ["tune", "model=zhou2016_gm_lstm", "model.frames=16,32", "model.average=20"],
            "model.average=20: give 1 to 16",
        ),
        (
            [
                "tune",
                "model=zhou2016_gm_lstm",
                "model.frames=16,32",
                "protocol=groupkfold",
                "protocol.folds=2",
                "inner=2",
            ],
            "lets one training subject choose the epoch; train on two or more",
        ),
        (["run", "features=gaus", "features.families=sd+sad"], "features.families=sd+sad: give some of sd+bmh"),
        (["run", "features=balli", "features.selected=-1"], "features.selected=-1: give"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(arguments, message, capsys):
    small = [] if arguments[0] in ("systems", "extract") else SMALL
    assert main([*arguments, *small]) == 2
    error = capsys.readouterr().err
    assert message in error and error.startswith("bench: ") and error.count("\n") == 1


def test_every_published_number_has_its_command_or_a_reason(capsys):
    assert main(["systems"]) == 0
    out = capsys.readouterr().out
    rows, lines = published(), out.splitlines()
    assert len(rows) >= 65
    for row in rows.itertuples():
        (place,) = [i for i, line in enumerate(lines) if line.split()[-1:] == [row.id]]
        line = lines[place + 1].strip()
        assert command(row) == line
        assert f"model={row.system}" in line or line.rstrip().endswith(("build it", "not here yet", "elsewhere"))
    assert "bench run data=cost where=\"variant == 'rough'\" protocol=loso model=jung2014_bayes" in out
    assert "bench run data=cost target=gesture+variant protocol=loso model=jung2017_bayes" in out
    assert "bench run data=haart protocol=challenge model=ta2015_rf" in out


def test_commands_of_systems_are_understood():
    """Every one of them, up to the corpus, which is not here; quotes are those of a shell."""
    import shlex

    from bench.arguments import KEYS, parse
    from bench.plan.cells import cells

    for row in published().itertuples():
        text = command(row)
        if text.startswith("bench run"):
            (cell,) = cells(parse(shlex.split(text)[2:], KEYS))
            assert cell.model.name == row.system and cell.where == row.subset_key.replace("all", "", 1)
            assert cell.estimator() is not None


def test_closed_pipes_end_quietly():
    done = subprocess.run(
        f"{sys.executable} -c 'from bench.cli import main; import sys; sys.exit(main([\"systems\"]))' | head -1",
        shell=True,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == ""


def test_features_are_written_as_a_table(tmp_path, capsys):
    few = ["data.subjects=2", "data.repetitions=1"]
    assert main(["extract", "features=jung28", "out=f.parquet", *few]) == 0
    assert "synthetic captures, 28 features" in capsys.readouterr().out
    from bench.corpora.library import open_corpus

    corpus = open_corpus("synth", {"subjects": 2, "repetitions": 1})
    table = pd.read_parquet("f.parquet")
    assert np.array_equal(table["gesture"], corpus.gestures)
    expected = Jung28().transform(corpus)
    pd.testing.assert_frame_equal(table[expected.columns], expected)
    assert main(["extract", "features=ta273", "out=f.csv", "where=gesture != 'tap'", *few]) == 0
    assert "fitted to all of these captures" in capsys.readouterr().out
    assert set(pd.read_csv("f.csv")["gesture"]) == set(corpus.gestures) - {"tap"}


def test_another_target_than_the_gesture():
    small = ["data.subjects=4", "data.repetitions=1", "jobs=2", "protocol=groupkfold", "protocol.folds=2"]
    assert main(["run", "model=bayes", "features=jung28", "target=variant,gesture+variant", *small]) == 0
    client, parents = runs("cell")
    found = {p.data.tags["target"]: predictions(client, p) for p in parents}
    variant, both = found["variant"], found["gesture+variant"]
    assert sorted(c for c in variant if c.startswith("p_")) == ["p_gentle", "p_normal", "p_rough"]
    assert (variant["true"] == variant["variant"]).all() and "gesture" in variant
    assert len([c for c in both if c.startswith("p_")]) == 42 and "p_tap rough" in both
    assert (both["true"] == both["gesture"] + " " + both["variant"]).all()


def test_every_part_of_a_system_gets_the_seed():
    from bench.plan.cells import cells

    (cell,) = cells({"model": "softmax", "features": "hughes36", "seed": "7"})
    assert cell.features.parameters["seed"] == 7 and cell.features.make().seed == 7
    assert all(name in names("features") for name in ("hughes36", "gaus", "balli", "ta273", "wingerden45"))
