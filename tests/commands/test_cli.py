"""The command: a bad line is one line of output with exit code 2; streams and files."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from bench.cli import _accept_all_output, main
from tests.conftest import BENCH

SMALL = ["data=synth", "data.subjects=2", "data.variants=normal"]
SYNTH = ["data", "export", "synth"]
FEW = "where=gesture in ('pat', 'rub', 'tap') and (gesture != 'rub' or subject in ('1', '2'))"
FEW_RUBS = ["data.subjects=4", "data.variants=normal", "data.repetitions=1", "features=jung28", FEW]
BAD = [  # arguments, and what the line names
    (["run", "model="], "'model='"),
    (["run", "data.subjects.x=2"], "subjects.x"),
    (["run", "model.C=None"], "model.C=None"),
    (["run", "jobs=two"], "jobs=two"),
    (["run", "--hop-ms", "125"], "hop_ms=125"),
    (["run", "data=a\0b"], "NUL"),
    (["run", "data=\x1b[31mred"], "data="),
    (["run", "where=" + 500 * "x"], "where="),
    *(
        (["stress", "data.subjects=4", f"train_subjects={n}"], f"train_subjects={n}")
        for n in ("few", "4")
    ),
    (["run", "after=each", "hop_ms=1"], "hop_ms=1"),
    (["run", "after=each", "stopping=yes", "data.subjects=2"], "one subject"),
    (["run", "model=bayes", "train_subjects=1", *FEW_RUBS], "nobody"),
    (["tune", "model=tree", "inner=loso", *FEW_RUBS], "nobody"),
    (["fit", "stopping=maybe"], "stopping=maybe"),
    (["predict", "rec"], "MODEL FILE"),
    (["predict", "rec", "x.csv", "rate_hz=-1"], "rate_hz=-1"),
    *((["ui", f"port={port}"], "from 1 to 65535") for port in ("65536", "٣")),
    *(([*SYNTH, target, "subjects=2"], "name a file") for target in ("", "folder", "pipe")),
    ([*SYNTH, "o.csv", "subjects=1,2"], "one value of each parameter"),
    (["data", "import", "cost", "\udcff.csv"], ".csv"),
    (["data", "import", "table", "x.csv", "rate_hz=fast"], "rate_hz=fast"),
    (["data", "import", "cost", "x.csv", "name=../x"], "name=../x"),
    (["data", "show", "synth", "subject=2"], "did you mean subjects"),
    (["data", "show", "synth", "subjects=2", "data.subjects=3"], "data.subjects="),
    (["data", "show", "synth", "subjects=1", "out=file/x"], "file/x"),
    (["data", "show", "synth", "subjects=1", "variants=normal", "out=taken"], "taken/captures.svg"),
]


@pytest.mark.parametrize(("arguments", "fact"), BAD, ids=range(len(BAD)))
def test_a_bad_line_is_one_line_that_names_the_key_and_writes_nothing(arguments, fact, capsys):
    Path("folder").mkdir()
    Path("taken/captures.svg").mkdir(parents=True)
    Path("file").write_text("mine")
    os.mkfifo("pipe")
    assert main(arguments) == 2
    output = capsys.readouterr()
    (line,) = output.err.splitlines()
    assert line.startswith("bench: ") and line.isprintable() and len(line) <= 300
    assert fact in line and not output.out
    made = {path.name for path in Path().iterdir()} - {"home", "mlflow.db", "mlruns", "mlartifacts"}
    assert made == {"folder", "taken", "file", "pipe"} and Path("file").read_text() == "mine"


def test_output_is_written_where_the_locale_knows_no_such_letter(monkeypatch):
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written := io.BytesIO(), encoding="ascii"))
    _accept_all_output()
    print("\xb7", flush=True)
    assert written.getvalue().strip() == b"\\xb7"


@pytest.mark.parametrize("arguments", [["--help"], ["data"]])
def test_output_that_is_closed_is_no_error(arguments):
    done = subprocess.run(
        [*BENCH, *arguments], stderr=subprocess.PIPE, preexec_fn=lambda: os.close(1)
    )
    assert (done.returncode, done.stderr) == (0, b"")


def test_memory_that_runs_out_is_one_line(monkeypatch, capsys):
    def hungry(_):
        raise MemoryError("Unable to allocate 1 TiB")

    monkeypatch.setattr("bench.commands.data.command", hungry)
    assert main(["data"]) == 1
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and "Unable to allocate 1 TiB" in line
