import subprocess
import sys

import pytest

from bench.arguments import KEYS, parse
from bench.cli import main
from bench.errors import InputError
from bench.plan.cells import cells
from bench.source import source_digest


def asked(*arguments):
    return cells(parse(list(arguments), KEYS))


def named(found):
    return [f"{c.system()} | {c.data} | {c.protocol}" for c in found]


def test_a_comma_makes_a_grid():
    found = asked("data=haart", "protocol=challenge,loso", "model=bayes,svm", "features=jung28,jung54")
    assert len(found) == 8
    assert named(found)[:3] == [
        "bayes · jung28 | haart | challenge",
        "bayes · jung54 | haart | challenge",
        "svm · jung28 | haart | challenge",
    ]


def test_defaults_and_what_a_part_does_not_take():
    assert named(asked()) == ["svm · jung54 | synth | loso"]
    # One cell for a network whatever the feature sets, one for a model without a seed whatever the seeds.
    assert named(asked("model=cnn85,svm", "features=jung28,jung54", "seed=0,1")) == [
        "cnn85 | synth | loso",
        "cnn85 | synth | loso",
        "svm · jung28 | synth | loso",
        "svm · jung54 | synth | loso",
    ]
    assert [c.model.parameters["seed"] for c in asked("model=cnn85", "seed=3,5")] == [3, 5]


def test_dotted_keys_set_parameters_by_the_type_of_their_default():
    (cell,) = asked("model=cnn85", "model.frames=20", "model.hop=10", "protocol=kfold", "protocol.folds=5")
    assert cell.model.parameters["frames"] == 20 and cell.model.parameters["hop"] == 10
    assert (str(cell.model), str(cell.protocol)) == ("cnn85[frames=20, hop=10]", "kfold[folds=5]")
    assert [c.model.parameters["C"] for c in asked("model.C=1,2.5")] == [1.0, 2.5]
    assert asked("model=svm,rf", "model.trees=7")[1].model.parameters["trees"] == 7
    assert asked("data.subjects=3", "data.variants=rough+gentle")[0].data_parameters["variants"] == ("rough", "gentle")
    assert asked("model=cnn85", "model.hop=None")[0].model.parameters["hop"] is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["modle=svm"], "no key is called 'modle'; did you mean model?"),
        (["svm"], "'svm' is not key=value"),
        (["model="], "'model=' is not key=value"),
        (["model=svm", "model=rf"], "model= is given twice"),
        (["model=svn"], "model=svn: not known; did you mean svm?"),
        (["protocol=losso"], "protocol=losso: not known; did you mean loso?"),
        (["features=jung55"], "features=jung55: not known; did you mean jung54"),
        (["model=svm,"], "nothing between two commas"),
        (["model.c=3"], "model=svm has no parameter 'c'"),
        (["model.C=big"], "model.C=big: give a number"),
        (["model=cnn85", "model.frames=8.5"], "model.frames=8.5: give a whole number"),
        (["model=cnn85", "model.frames=None"], "model.frames=None: give a value"),
        (["seed=x"], "seed=x: give a whole number"),
        (["model=cnn85", "features=jung54"], "features=jung54 does nothing: cnn85 takes none"),
        (["data=haart", "data.subjects=3"], "data.subjects: only data=synth has parameters"),
        (["data.subject=3"], "data=synth has no parameter 'subject'; did you mean subjects"),
        (["jobs.x=3"], "no key is called 'jobs.x'"),
        (["data=nowhere"], "data=nowhere: not imported"),
        (["jobs=0"], "jobs=0: give at least 1"),
        (["jobs=two"], "jobs=two: give a whole number"),
        (["where=variant == 'loud'"], "selects none of the"),
        (["where=loudness > 3"], "the columns of synth are subject, variant"),
        (["where=gesture == 'pat'"], "only one gesture is left"),
        (["protocol=groupkfold", "protocol.folds=11"], "protocol.folds=11: synth has 10 subjects here"),
        (
            ["where=subject == '1' or gesture != 'pat'", "protocol=loso"],
            "fold 1 tests gesture pat and trains none of it",
        ),
        (["model=cnn85", "model.frames=0"], "model.frames=0: give at least 1"),
        (["model=cnn85", "model.hop=0"], "model.hop=0: give at least 1"),
        (["model.C=-1"], "model.C=-1 model.gamma=0.125: both must be above 0"),
        (["model.kernel=foo"], "model.kernel=foo: give rbf or linear"),
        (["model=rf", "model.trees=0"], "model.trees=0"),
        (["model=xgb", "model.rate=0"], "model.rate=0"),
        (["model=bayes", "model.ridge=0"], "model.ridge=0"),
        (["features.area=hand"], "features.area=hand: give frame or capture"),
        (["model=rf", "seed=-1"], "seed=-1: give a whole number from 0 on"),
        (["protocol=challenge", "protocol.seed=-1"], "protocol.seed=-1: give a whole number from 0 on"),
        (["data.seed=-1"], "data.seed=-1: give a whole number from 0 on"),
        (["data.subjects=0"], "data.subjects=0: give at least 1"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(arguments, message, capsys):
    assert main(["run", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1 and error.startswith("bench: ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["rnu"], "no command is called 'rnu'; did you mean run"),
        (["data", "imprt"], "bench data imprt: did you mean import?"),
        (["data", "export", "synth"], "not understood"),
        (["data", "export", "synth", "x.csv", "seed=1", "seed=2"], "seed= is given twice"),
        (["data", "import", "cots", "x.csv"], "format=cots: not known; did you mean cost"),
        (["data", "import", "cost", "x.csv"], "x.csv: cannot be read"),
        (["data", "import", "table", "x.csv"], "x.csv: there is no such file"),
        (["data", "import", "table", "."], "format table also needs rate_hz="),
        (["data", "import", "table", 5000 * "x", "rate_hz=5"], "cannot be read (File name too long); check the path"),
        (["data", "import", "haart", 5000 * "x"], "cannot be read (File name too long); check the path"),
        (["data", "import", "table", "x.csv", "rate_hz=fast"], "rate_hz=fast: give a number"),
        (["data", "import", "table", "x.csv", "rate=5"], "has no option 'rate'; did you mean rate_hz"),
        (["data", "import", "cost", "x.csv", "name=../x"], "name=../x: use letters"),
        (["data", "import", "cost", "x.csv", "name=synth"], "choose another name"),
        (["data", "export", "synth", "x.csv", "format=wav"], "format=wav"),
        (["data", "export", "synth", "x.csv", "subject=3"], "no parameter 'subject'"),
        (["report"], "no scored run is tracked here"),
        (["report", "to=x"], "no key is called 'to'"),
        (["ui", "port=x"], "give a number"),
    ],
)
def test_mistakes_in_other_commands(arguments, message, capsys):
    assert main(arguments) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert message in error and error.startswith("bench: ")


def test_an_unwritable_store_is_refused_before_anything_runs(tmp_path, monkeypatch, capsys):
    (tmp_path / "mlflow.db").write_text("this is a letter, not a database")
    assert main(["run", "data.subjects=2"]) == 2
    assert "is not an MLflow store" in capsys.readouterr().err
    assert (tmp_path / "mlflow.db").read_text() == "this is a letter, not a database"
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/nowhere/mlflow.db")
    assert main(["run", "data.subjects=2"]) == 2
    assert "cannot be written" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [[], ["--help"], ["run", "--help"], ["stress", "--help"], ["data", "--help"]])
def test_help_names_every_part_and_imports_nothing_heavy(arguments):
    code = (
        "import sys; from bench.cli import main; main(sys.argv[1:]);"
        "heavy = {'numpy', 'pandas', 'sklearn', 'torch', 'mlflow', 'rich', 'matplotlib'} & set(sys.modules);"
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True)
    if arguments[:1] == ["run"]:
        assert all(name in done.stdout for name in ("cnn85", "bayes", "loso", "challenge", "groupkfold", "jung28"))


def test_the_code_of_a_part_is_part_of_its_identity():
    from models.classic.svm import svm
    from models.nets.cnn85 import CNN85
    from protocols.subjects import LOSO

    digests = {source_digest(part) for part in (CNN85, svm, LOSO)}
    assert len(digests) == 3 and source_digest(svm) in digests


def test_parse_keeps_what_stands_behind_the_first_equals_sign():
    assert parse(["where=subject != '3'"], KEYS) == {"where": "subject != '3'"}
    with pytest.raises(InputError):
        parse(["=3"], KEYS)
