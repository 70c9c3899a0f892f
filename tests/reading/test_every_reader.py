"""Every reader of stored runs takes stores that are empty, or whose runs failed or were cut off."""

import contextlib
import itertools
import shutil
from pathlib import Path

import pytest

import bench
from bench.cli import main
from bench.errors import InputError
from bench.running import loop
from bench.store.client import connect
from tests.conftest import SMALL, never_busy, shorten_measurements

OWN = """
from tests.running.fakes import Level
class Own(Level):
    def __init__(self, fails=""):
        self.fails = fails
    def fit(self, X, y):
        if self.fails == "all" or self.fails and self.fails not in {*X.subjects}:
            raise RuntimeError("cannot learn")
        return super().fit(X, y)
"""
RUNS = {  # arguments by what becomes of the run; the last is cut off in its second fold
    "finished": ["model=own.py:Own"],
    "failed": ["model=own.py:Own", "model.fails=all"],
    "partly failed": ["model=own.py:Own", "model.fails=2"],
    "failed under noise": ["model=own.py:Own,bayes", "features=jung28", "under=noise"],
    "cut off": ["model=bayes", "features=jung28"],
}
STORES = [(), *itertools.combinations(RUNS, 1), ("finished", "failed"), ("failed", "cut off")]
STORES.append(tuple(RUNS))
COMMANDS = [
    ["runs"],
    ["runs", "latest=yes"],
    ["choose"],
    ["choose", "why=yes", "max_flash=1MB"],
    ["choose", "groups=yes"],
    ["compare", "Own", "Own[fails=2]"],
    ["compare", "bayes · jung28", "Own"],
    ["report", "out=page", "paper=accuracy,macro_f1,fit"],
    ["check", "update=yes", "model=own.py:Own", *SMALL, "baseline=b.json", "stored=yes"],
    ["run", "dry=yes", "model=own.py:Own", "model.fails=all,2", *SMALL],
    ["run", "dry=yes", "model=bayes,own.py:Own", "features=jung28", "under=noise", *SMALL],
]
FUNCTIONS = {
    "runs": lambda: bench.runs(),
    "cases": lambda: bench.runs(cases=True),
    "ledger": lambda: bench.ledger(),
    "latex": lambda: bench.latex(bench.runs()),
    "paper": lambda: bench.latex(bench.runs(), paper="accuracy,macro_f1,flash"),
    **{
        name: lambda name=name: bench.predictions(table=name)
        for name in ("predictions", "per_subject", "labels", "folds", "confusion")
    },
}


@pytest.fixture(scope="module")
def all_runs(tmp_path_factory, empty_store):
    """A folder with a store of all these runs and their file, and the ids of each."""
    folder, ids = tmp_path_factory.mktemp("runs"), {}
    with pytest.MonkeyPatch.context() as patch, contextlib.chdir(folder):
        shorten_measurements(patch)
        never_busy(patch)
        patch.setenv("TOUCHBENCH_HOME", str(folder / "home"))
        patch.setattr("bench.store.client.create_database", lambda p: shutil.copy(empty_store, p))
        Path("own.py").write_text(OWN)
        known = set()
        for name, words in RUNS.items():
            with pytest.MonkeyPatch.context() as cut:
                if name == "cut off":
                    cut_off_after_one_fold(cut)
                main(["run", *words, *SMALL])
            runs = {run.info.run_id for run in connect().runs_of_kind("cell")}
            ids[name], known = runs - known, runs
    return folder, ids


def cut_off_after_one_fold(patch):
    run_fold, count = loop.local_executor(1).run_folds, itertools.count()

    def run_one(executor, plan, missing):
        for result in run_fold(plan, missing):
            if next(count):
                raise KeyboardInterrupt
            yield result

    patch.setattr("bench.running.workers.FoldExecutor.run_folds", run_one)


@pytest.mark.parametrize("kinds", STORES, ids=", ".join)
def test_each_reader_gives_its_result_or_one_line(kinds, all_runs, tmp_path, capsys, monkeypatch):
    folder, ids = all_runs
    shutil.copytree(folder, tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path / "copy/home"))
    store = connect()
    for run in store.runs_of_kind("cell"):
        if run.info.run_id not in set().union(*(ids[kind] for kind in kinds)):
            store.delete_run(run.info.run_id)
    wrong = {}
    for words in COMMANDS:
        capsys.readouterr()
        try:
            code = main([word.replace("own.py", str(folder / "own.py")) for word in words])
        except Exception as e:  # noqa: BLE001 - which is what must not happen
            wrong[" ".join(words)] = repr(e)
            continue
        lines = capsys.readouterr().err.splitlines()
        if code not in (0, 1, 2) or (code == 2 and len(lines) != 1):
            wrong[" ".join(words)] = (code, lines)
    for name, function in FUNCTIONS.items():
        try:
            function()
        except InputError as e:
            assert "\n" not in str(e)
        except Exception as e:  # noqa: BLE001
            wrong[name] = repr(e)
    assert wrong == {}
