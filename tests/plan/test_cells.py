"""Arguments as cells: grids, parameters, and mistakes."""

import pytest

from bench.cli import main
from bench.errors import InputError
from bench.options import KEYS, backend_of, parse
from bench.plan.cells import cells
from bench.plan.plan import planned


def cells_of(line):
    return cells(parse(line.split(), KEYS))


def titles(line):
    return [cell.title() for cell in cells_of(line)]


def test_a_comma_makes_a_grid():
    expected = ["bayes · jung28", "bayes · jung54", "svm · jung28", "svm · jung54"]
    line = "data=haart protocol=challenge,loso model=bayes,svm features=jung28,jung54"
    assert titles(line) == [f"{system} | haart | {p}" for p in ("challenge", "loso") for system in expected]


def test_defaults_and_what_a_part_does_not_take():
    assert titles("") == ["svm · jung54 | synth | loso"]
    # One cell for a network whatever the feature sets, one for a model without a seed whatever the seeds.
    assert titles("model=cnn85,svm features=jung28,jung54 seed=0,1") == [
        "cnn85 | synth | loso",
        "cnn85 | synth | loso",
        "svm · jung28 | synth | loso",
        "svm · jung54 | synth | loso",
    ]
    assert [c.model.parameters["seed"] for c in cells_of("model=cnn85 seed=3,5")] == [3, 5]


@pytest.mark.parametrize(
    ("line", "part", "name", "values"),
    [
        ("model=cnn85 model.frames=20", "model", "frames", [20]),
        ("model=cnn85 model.hop=None,10", "model", "hop", [None, 10]),
        ("protocol=kfold protocol.folds=5,3", "protocol", "folds", [5, 3]),
        ("model.C=1,2.5", "model", "C", [1.0, 2.5]),
        ("features.area=capture", "features", "area", ["capture"]),
        ("model.window=2.0", "model", "window", [2.0]),  # of any model
    ],
)
def test_dotted_keys_set_parameters_by_the_type_of_their_default(line, part, name, values):
    found = [getattr(cell, part).parameters[name] for cell in cells_of(line)]
    assert found == values and list(map(type, found)) == list(map(type, values))


def test_a_dotted_key_is_for_the_parts_that_take_it():
    svm, rf = cells_of("model=svm,rf model.trees=7 data.subjects=3 data.variants=rough+gentle")
    assert "trees" not in svm.model.parameters and rf.model.parameters["trees"] == 7
    assert svm.data_parameters["variants"] == ("rough", "gentle") and svm.data_parameters["subjects"] == 3
    (usual,) = cells_of("model.window=0.0")  # a step as it is without
    assert "window" not in usual.model.parameters and usual == cells_of("")[0]
    (cell,) = cells_of("model=cnn85 model.frames=20 model.hop=10 protocol=kfold protocol.folds=5")
    assert (str(cell.model), str(cell.protocol)) == ("cnn85[frames=20, hop=10]", "kfold[folds=5]")


MISTAKES = [  # what is typed, and facts that the message names; others are golden
    ("model=cnn85 model.frames=8.5", "model.frames=8.5", "whole number"),
    ("model=cnn85 features=jung54", "features=jung54", "cnn85"),
    ("data=haart data.subjects=3", "data.subjects", "synth"),
    ("data.subject=3", "data=synth", "'subject'", "subjects"),
    ("where=loudness>3", "synth", "subject, variant"),
    ("where=gesture=='pat'", "gesture=='pat'", "only one"),
    ("protocol=groupkfold protocol.folds=11", "protocol.folds=11", "10"),
    ("where=(subject=='1')|(gesture!='pat')", "fold 1", "pat", "protocol=loso"),
    ("model=cnn85 model.hop=0", "model.hop=0", "1"),
    ("model=rf model.trees=0", "model.trees=0"),
    ("data.subjects=2 model=zhou2016_gm_lstm", "training subject"),
]


@pytest.mark.parametrize(("line", "facts"), [(line, facts) for line, *facts in MISTAKES])
def test_a_mistake_is_refused_with_its_key_its_value_and_what_is_right(line, facts):
    with pytest.raises(InputError) as refusal:
        values = parse(line.split(), KEYS)
        planned(cells(values), backend_of(values).jobs)
    message = str(refusal.value)
    assert all(fact in message for fact in facts) and "\n" not in message, message


def test_an_unusable_store_or_data_folder_is_refused_before_anything_runs(tmp_path, monkeypatch, capsys):
    run = ["run", "data.subjects=2"]
    (tmp_path / "mlflow.db").write_text("this is a letter, not a database")
    assert main(run) == 2 and "mlflow.db" in capsys.readouterr().err
    assert (tmp_path / "mlflow.db").read_text() == "this is a letter, not a database"
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/nowhere/mlflow.db")
    assert main(run) == 2 and "cannot be written" in capsys.readouterr().err
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path / "mlflow.db"))
    assert main(run) == 2
    error = capsys.readouterr().err
    assert "TOUCHBENCH_HOME" in error and error.count("\n") == 1
