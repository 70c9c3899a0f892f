"""A saved system in a process, a folder and a path of its own, and a first fit of a command with its files."""

import os
import subprocess
import sys

import pandas as pd
import pytest

from bench.cli import main
from bench.corpora.library import open_corpus
from bench.work.saved import load
from tests.work.test_fit import CELL, as_table

pytestmark = pytest.mark.nightly


def test_a_saved_system_runs_elsewhere_on_the_code_that_it_was_trained_with(tmp_path, capsys):
    assert main(["fit", *(f"{k}={v}" for k, v in CELL.items()), "stopping=no", "out=saved"]) == 0
    uri = capsys.readouterr().out.split()[0]
    as_table(open_corpus("synth", {"subjects": 1})[::9].detached()).to_csv("new.csv", index=False)
    assert main(["predict", uri, "new.csv", "out=labels.csv"]) == 0
    labels = pd.read_csv("labels.csv")["label"].tolist()
    assert load("saved").stopping is None and main(["report"]) == 2  # a fit is not scored
    code = "import mlflow, pandas as pd, sys; m = mlflow.pyfunc.load_model(sys.argv[1]); "
    code += "import bench; print(bench.__file__); print(','.join(m.predict(pd.read_csv(sys.argv[2]))['label']))"
    (tmp_path / "elsewhere").mkdir()
    arguments = [sys.executable, "-c", code, str(tmp_path / "saved"), str(tmp_path / "new.csv")]
    plain = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(arguments, cwd=tmp_path / "elsewhere", env=plain, capture_output=True, text=True, check=True)
    file, printed = done.stdout.split()
    assert printed.split(",") == labels and "saved/code" in file
