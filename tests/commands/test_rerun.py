"""`bench leaderboard rerun=`: commands of submissions repeated, and the marks of those whose labels are equal."""

import json
import shutil
from datetime import UTC, datetime
from pathlib import Path

import pandas as pd
import pytest

import bench
from bench.cli import main
from bench.leaderboard import marks, submissions, tasks
from bench.leaderboard.tasks import CAPTURE, LOSO, TASKS, Task
from bench.source import git_revision
from tests.commands.test_leaderboard import MINE, SMALL
from tests.conftest import runs
from tests.reports.submitted import folder_of

NAME = "synth-loso-v1"


@pytest.fixture
def task(monkeypatch):
    """A task on the smallest generated corpus, as no real one is here."""
    corpus = bench.corpus("synth", subjects=2, variants=("normal",), repetitions=1)
    listed = corpus.captures[["subject", "gesture"]].assign(capture=[str(i) for i in range(len(corpus))])
    others = tasks.captures_of
    monkeypatch.setattr(tasks, "captures_of", lambda task: listed if task.name == NAME else others(task))
    monkeypatch.setitem(TASKS, NAME, Task(NAME, "synth", corpus.digest, "loso", LOSO, CAPTURE, "28 captures"))


def submitted(*arguments):
    """A submission of a run of these arguments, in submissions/mine."""
    assert main(["run", *SMALL, *arguments]) == 0
    (run,) = runs("cell")[1]
    assert main(["submit", f"task={NAME}", f"run={run.info.run_id}", "who=A. Name", "out=submissions/mine"]) == 0
    return Path("submissions/mine")


def shown(capsys):
    """What the leaderboard says of the submission in one line."""
    capsys.readouterr()
    main(["leaderboard", "submissions"])
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith(NAME)]
    return line


def test_equal_labels_are_verified_until_the_submission_changes(task, capsys):
    folder = submitted("model=bayes", "features=jung28")
    forged = {f"{NAME}/mine": {"sha256": "0" * 64, "date": "2026-01-01", "revision": "abc", "system": "bayes"}}
    (folder / marks.FILE).write_text(json.dumps(forged))
    assert shown(capsys).endswith("not verified")
    assert main(["leaderboard", "rerun=mine"]) == 0
    out = capsys.readouterr().out
    assert f"{NAME}/mine: 28 of 28 labels are equal (100.00 %), 0 differ" in out
    (mark,) = json.loads(Path(marks.FILE).read_text()).values()
    today = datetime.now(UTC).date().isoformat()
    assert (mark["date"], mark["revision"], mark["labels"]) == (today, git_revision(), 28)
    assert shown(capsys).endswith(f"verified {today} at {git_revision()}, ran bayes · jung28")
    assert len(runs("cell")[1]) == 1, "the rerun must not read or fill the store of this folder"
    table = pd.read_parquet(folder / "predictions.parquet")
    table.assign(p_pat=table["p_pat"] + 1e-4).to_parquet(folder / "predictions.parquet")
    assert shown(capsys).endswith("not verified")
    labels = submissions.read(folder).table[["capture", "predicted"]]
    labels.loc[0, "predicted"] = "pat" if labels.loc[0, "predicted"] != "pat" else "tap"
    (folder / "predictions.parquet").unlink()
    labels.to_csv(folder / "predictions.csv", index=False)
    before = Path(marks.FILE).read_bytes()
    assert main(["leaderboard", "rerun=mine"]) == 1
    out, err = capsys.readouterr()
    assert "27 of 28 labels are equal (96.42 %), 1 differs" in out and "not verified" in err
    assert Path(marks.FILE).read_bytes() == before


def test_a_file_of_ones_own_must_be_there_as_it_was(task, capsys):
    Path("mine.py").write_text(MINE)
    submitted("jobs=1", "model=mine.py:Taxels")
    Path("mine.py").unlink()
    capsys.readouterr()
    for content, told in ((None, "its command needs mine.py"), (MINE + "\n", "mine.py here has another content")):
        if content:
            Path("mine.py").write_text(content)
        assert main(["leaderboard", "rerun=mine"]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"bench: mine: {told}")
    Path("mine.py").write_text(MINE)
    assert main(["leaderboard", "rerun=mine"]) == 0 and Path(marks.FILE).exists()


@pytest.mark.parametrize(
    ("command", "told"),
    [
        ("", "its command '' is not a bench run"),
        ("python train.py", "its command 'python train.py' is not a bench run"),
        ("bench run 'model=svm", "is not a bench run"),
        ("bench stream data=haart", "is not a bench run"),
        ("bench run data=haart protocol=loso", "protocol loso is not that of haart-challenge-v1"),
        ("bench run protocol=challenge where=x", "no key is called 'where'"),
        ("bench run protocol=challenge cluster=tcp://1.2.3.4:5", "no key is called 'cluster'"),
        ("bench run protocol=challenge out=/tmp/x", "no key is called 'out'"),
        ("bench run protocol=challenge model=/tmp/evil.py:Mine", "'/tmp/evil.py:Mine' is not a file of the working"),
        ("bench run protocol=challenge model=svm,all/mine/evil.py:Mine,rf", "is not a file of the working folder"),
        ("bench run protocol=evil.py:Mine", "its command needs evil.py"),
        ("bench run protocol=challenge model=lda,svm", "names 2 systems"),
    ],
)
def test_commands_that_are_not_repeated(command, told, capsys):
    folder_of("mine", command=command)
    Path("all/mine/evil.py").write_text("raise SystemExit(99)")
    shutil.move("all", "submissions")
    assert main(["leaderboard", "rerun=mine"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("bench: mine: ") and told in line and not Path(marks.FILE).exists()


def test_what_a_rerun_is_of(capsys):
    for arguments, told in (
        (["rerun=mine"], "rerun=mine: there is no such folder in submissions"),
        (["rerun=../mine"], "rerun=../mine: give the name of one folder in submissions"),
        (["rerun=mine", "out=x.html"], "leave out out="),
    ):
        assert main(["leaderboard", *arguments]) == 2 and told in capsys.readouterr().err
    Path(marks.FILE).write_text("[]")
    assert main(["leaderboard"]) == 2 and "leaderboard-verified.json" in capsys.readouterr().err
