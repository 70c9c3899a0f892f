"""A process dies while it writes into the data folder: what was there stays, and what it left goes. All commands,
killed at random moments: `tests/nightly/test_kills.py`."""

import subprocess
import sys
from pathlib import Path

import pytest

import bench
from bench.corpora.library import import_corpus, open_corpus
from bench.scratch import home, scratch
from tests.corpora.made import GOOD, csv

ROOT = Path(bench.__file__).parents[1]
OPTIONS = {"name": "arm", "rate_hz": "50", "grid": "1x2"}
# Ends at once, without any clean-up, when it calls the function that is named first.
DYING = """
import os, sys, numpy as np, pandas as pd
from pathlib import Path
from bench.corpora.folder import open_folder
from bench.corpora.library import import_corpus, open_corpus
from features.jung28 import Jung28
die = lambda *_, **__: os._exit(9)
exec(sys.argv[1] + " = die")
exec(sys.argv[2])
"""


def die(at, code):
    done = subprocess.run([sys.executable, "-c", DYING, at, code], cwd=ROOT)
    assert done.returncode == 9


def hidden():
    return [p.name for p in home().rglob(".*") if not p.name.endswith(".lock")]


@pytest.mark.parametrize("at", ["np.save", "pd.DataFrame.to_parquet", "Path.rename", "os.replace"])
def test_an_import_that_dies_leaves_the_earlier_corpus(tmp_path, at):
    import_corpus("table", csv(tmp_path), OPTIONS)
    csv(tmp_path, *(row.replace("ann", "bob") for row in GOOD))
    die(at, f"import_corpus('table', Path({str(tmp_path / 'my.csv')!r}), {OPTIONS})")
    assert hidden() and open_corpus("arm", {}).subjects.tolist() == ["ann"]
    with scratch():  # as the next command does
        assert not hidden()
    assert import_corpus("table", tmp_path / "my.csv", OPTIONS).subjects.tolist() == ["bob"]
    folder = home() / "corpora" / "arm"
    assert {p.name for p in folder.iterdir()} == {"current", (folder / "current").read_text()}
