"""Grids in a file, runs that are still missing, and stored runs that are listed and deleted."""

import hashlib
from pathlib import Path

import pytest
from mlflow.entities import ViewType

from bench.cli import main
from bench.commands.run_grids import read_grids
from bench.errors import InputError
from bench.plan.plan import Plan
from bench.running.workers import FoldExecutor
from tests.conftest import SMALL, runs

GRIDS = """
data = "synth"
"data.subjects" = 3
"data.variants" = "normal"
"data.repetitions" = 1
features = "jung28"

[few]
model = ["bayes", "tree"]

[again]
model = "tree"
seed = [0, 1]
"""
WRONG = [  # content of a file, and what the refusal names
    ("model = ", "not TOML"),
    ('model = "svm"\nmodel.C = 8', 'such as "model.C" = 8'),
    ("model.C = 8", 'such as "model.C" = 8'),
    ('[a]\nmodell = "svm"', "[a]: no key is called 'modell'; did you mean model"),
    ("seed = 1979-05-27", "seed = 1979-05-27: give text, a number"),
    ("# nothing", "it names nothing to run"),
]


@pytest.mark.parametrize(("content", "fact"), WRONG)
def test_a_wrong_file_is_refused_in_a_line(content, fact):
    Path("grids.toml").write_text(content)
    with pytest.raises(InputError) as refusal:
        read_grids("grids.toml", {})
    assert fact in str(refusal.value)


def test_a_file_of_grids_goes_on_after_ctrl_c_and_marks_its_runs(monkeypatch, capsys):
    folds_done, run_folds = [], FoldExecutor.run_folds
    Path("grids.toml").write_text(GRIDS)

    def run_command(*words, code=0):
        assert main(["run", "grids.toml", "jobs=1", *words]) == code
        return capsys.readouterr()

    def interrupt(self, plan, missing):
        for result in run_folds(self, plan, missing):
            if len(folds_done) == 4:
                raise KeyboardInterrupt
            folds_done.append(result.name)
            yield result

    monkeypatch.setattr(FoldExecutor, "run_folds", interrupt)
    identities, identity = [], Plan.identity
    with monkeypatch.context() as patch:
        patch.setattr(Plan, "identity", lambda plan: identities.append(plan) or identity(plan))
        out = run_command("dry=yes").out
    assert len(identities) == 4 and not folds_done  # of four named runs two are the same
    assert "3 runs, 0 stored, about " in out and out.count("0 of 3") == 3
    assert "; 3 times rough: no similar run is stored" in out
    shared = "data=synth data.subjects=3 data.variants=normal protocol=loso features=jung28"
    assert out.splitlines()[0] == shared  # what all runs have, without defaults
    run_command(code=130)
    out = run_command("dry=yes").out
    assert len(folds_done) == 4 and [out.count(f"{n} of 3") for n in (3, 1, 0)] == [1, 1, 1]
    assert "3 runs, 1 stored, about " in out and "rough" not in out  # from similar folds
    monkeypatch.setattr(FoldExecutor, "run_folds", run_folds)
    progress = run_command().err
    assert "1 of 3 runs already stored" in progress and "run 3 of 3" in progress
    assert "run 2 of 3: tree · jung28 | synth | loso: fold 1 " not in progress  # it was stored
    assert main(["run", *SMALL, "model=bayes,tree", "features=jung28"]) == 0  # the same runs
    assert "2 of 2 runs already stored" in capsys.readouterr().err
    Path("grids.toml").write_text(GRIDS + "# the same grids in another file\n")
    assert "3 of 3 runs already stored" in run_command().err
    assert "3 runs, 3 stored\n" in run_command("dry=yes").out
    contents = GRIDS.encode(), Path("grids.toml").read_bytes()
    digests = ", ".join(hashlib.sha256(content).hexdigest()[:16] for content in contents)
    assert [run.data.tags["touchbench.grids"] for run in runs("cell")[1]] == [digests] * 3


def test_after_a_failure_of_everything_no_command_comes_next(capsys):
    Path("mine.py").write_text(
        "from sklearn.base import BaseEstimator, ClassifierMixin\n\n\n"
        "class No(ClassifierMixin, BaseEstimator):\n"
        "    def fit(self, X, y):\n        raise RuntimeError('no')\n\n"
        "    def predict(self, X):\n        return X\n"
    )
    assert main(["run", *SMALL, "model=mine.py:No"]) == 1
    assert "next:" not in capsys.readouterr().out
    assert main(["runs"]) == 0 and "3 of 3 folds failed" in capsys.readouterr().out


def test_runs_are_listed_and_deleted_as_mlflow_deletes_them(monkeypatch, capsys):
    make_runs = ["run", *SMALL, "model=bayes,tree", "features=jung28", "seed=0,1"]
    assert main(make_runs) == 0
    store, stored = runs("cell")
    capsys.readouterr()
    assert main(["runs", "model=tree"]) == 0
    out = capsys.readouterr().out
    trees = [run.info.run_id for run in stored if run.data.tags["model"].startswith("tree")]
    assert len(trees) == 2 and all(run_id[:8] in out for run_id in trees) and "bayes" not in out
    questions = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    for answer, code in (("no", 1), ("yes", 0)):
        monkeypatch.setattr("builtins.input", lambda asked: questions.append(asked) or answer)  # noqa: B023
        assert main(["runs", f"run={trees[0][:8]}", "delete=yes"]) == code
    assert questions == ["Delete 1 run? [yes/no] "] * 2
    experiment = [store.experiment_id]
    (gone,) = store.client.search_runs(experiment, run_view_type=ViewType.DELETED_ONLY)
    assert gone.info.run_id == trees[0] and gone.info.lifecycle_stage == "deleted"
    left = {run.info.run_id for run in runs("cell")[1]}
    assert left == {run.info.run_id for run in stored} - {trees[0]}
    store.client.restore_run(trees[0])
    capsys.readouterr()
    assert main(make_runs) == 0
    assert "3 of 3 runs already stored" in capsys.readouterr().err
    assert main(["runs", "data=synth", "delete=yes", "yes=yes"]) == 0 and runs("cell")[1] == []
