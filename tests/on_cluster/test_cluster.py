"""Folds on a cluster, as far as no process is needed; with processes: `tests/on_cluster/test_on_a_cluster.py`."""

import pickle
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from bench.arguments import backend_of
from bench.cli import main
from bench.corpora.folder import address, write_folder
from bench.corpora.library import open_corpus
from bench.errors import InputError
from bench.on_cluster.worker import check_of, difference, facts, fold_here, packed
from bench.plan.cells import cells
from bench.plan.plan import Fold
from tests.conftest import random_corpus
from tests.work.fakes import Echo

ROOT = Path(__file__).parents[2]
SMALL = ["data.subjects=4", "data.variants=normal", "data.repetitions=2"]
MODEL = '''
from sklearn.naive_bayes import GaussianNB
class Mine(GaussianNB):
    """Reads a table."""
'''


def test_a_cluster_needs_dask_and_no_jobs(monkeypatch, capsys):
    with pytest.raises(InputError, match="jobs=2"):
        backend_of({"cluster": "tcp://a:1", "jobs": "2"})
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["run", *SMALL, "cluster=tcp://127.0.0.1:1"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "touchbench[cluster]" in line and not Path("mlflow.db").exists()


def test_the_first_difference_is_named(tmp_path):
    (tmp_path / "my.py").write_text(MODEL)
    systems = cells({"model": "svm,my.py:Mine", "data.subjects": "2", "data.repetitions": "1"})
    base, here, sent = facts([]), facts(systems), packed(*systems)
    assert base.items() < here.items() and difference(base, here, sent) == ""
    captures = next(name for name in here if name.startswith("the captures of"))
    for name in ("numpy", "touchbench's code", "the code of svm", captures):
        changed = [values | {name: "other"} if name in values else values for values in (base, here)]
        assert difference(*changed, sent) == f"it has {name} {here[name]}, this machine other"
    assert len(here["touchbench's code"]) == 12 and here["the code of svm"]
    (tmp_path / "my.py").unlink()
    with pytest.raises(InputError, match=r"my.py cannot be read"):
        difference(base, here, sent)


def test_a_worker_s_process_does_a_fold_or_says_why_not(tmp_path):
    systems = cells({"model": "bayes", "features": "jung28", "data.subjects": "2", "data.repetitions": "1"})
    check, corpus = check_of(systems), open_corpus("synth", systems[0].data_parameters)
    assert fold_here(check, b"", tmp_path) == ("", b"")
    refusal, content = fold_here(check, b"no pickle", tmp_path)
    assert refusal and not content
    base, here, sent = pickle.loads(check)
    refusal, content = fold_here(packed(base | {"numpy": "1.0"}, here | {"numpy": "1.0"}, sent), b"", tmp_path)
    assert "numpy" in refusal and "1.0" in refusal and not content
    refusal, content = fold_here(
        check, packed(Echo(), systems[0], corpus, Fold("1", np.arange(3, 9), np.arange(3)), 1, "key"), tmp_path
    )
    result, machine = pickle.loads(content)
    assert not refusal and not result.error and list(result.table["capture"]) == [0, 1, 2] and machine.cpu


def test_a_cell_travels_without_what_was_built_of_it(tmp_path):
    (tmp_path / "my.py").write_text(MODEL)
    (cell,) = cells({"model": "my.py:Mine", "features": "jung28"})
    assert cell.untrained is cell.untrained and cell.splitter is cell.splitter
    again = pickle.loads(pickle.dumps(cell))
    assert again == cell and {"untrained", "splitter"}.isdisjoint(vars(again))


def test_a_corpus_is_found_wherever_the_data_folder_is(monkeypatch, tmp_path):
    corpus = open_corpus("synth", {"subjects": 2, "variants": ("normal",)})
    where, travelling = address(corpus), pickle.dumps(corpus[3:5])
    assert pickle.loads(travelling).path == corpus.path
    shutil.move(tmp_path / "home", tmp_path / "moved")
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path / "moved"))
    found = pickle.loads(travelling)
    assert found.path == tmp_path / "moved" / where.within and list(found.index) == [3, 4]
    shutil.move(found.path, tmp_path / "apart")
    with pytest.raises(InputError, match="changed or damaged"):
        pickle.loads(travelling)
    write_folder(random_corpus(), where.path)  # another corpus where it was
    shutil.rmtree(found.path, ignore_errors=True)
    with pytest.raises(InputError, match="was replaced by another corpus"):
        pickle.loads(travelling)
