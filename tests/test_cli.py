"""The command: every bad line is one line with exit code 2; streams, files and folders that cannot be used."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from bench.cli import main
from bench.commands.ui import draw_missing_figures
from bench.store.client import connect
from tests.commands.test_server import free_port
from tests.conftest import BENCH

SMALL = ["data=synth", "data.subjects=2", "data.variants=normal"]
SYNTH = ["data", "export", "synth"]
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


@pytest.mark.parametrize("arguments", [["--help"], ["data"]])
def test_output_that_is_closed_is_no_error(arguments):
    done = subprocess.run(
        [*BENCH, *arguments], stderr=subprocess.PIPE, preexec_fn=lambda: os.close(1)
    )
    assert (done.returncode, done.stderr) == (0, b"")


def test_the_ui_opens_a_view_with_columns_that_runs_have(in_net, monkeypatch, capsys):
    # Instead of MLflow's server one that answers once, and ends.
    code = (
        "from http.server import HTTPServer, SimpleHTTPRequestHandler; "
        f"HTTPServer(('127.0.0.1', {(port := free_port())}), SimpleHTTPRequestHandler).handle_request()"
    )
    started = subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: started([sys.executable, "-c", code]))
    assert main(["ui", f"port={port}"]) == 0
    key = re.search(r"viewStateShareKey=(\w+)", capsys.readouterr().out)[1]
    store = connect()
    view = json.loads(
        store.client.get_experiment(store.experiment_id).tags[f"mlflow.sharedViewState.{key}"]
    )
    shown = store.search_runs()
    kinds = {run.info.run_name.split()[0] for run in shown}
    assert kinds == {"run", "tune"}
    run = next(run for run in shown if run.info.run_name.startswith("run "))
    for column in view["selectedColumns"]:
        kind, name = re.fullmatch("(metrics|params)[.]`(.+)`", column).groups()
        assert name in getattr(run.data, kind), column


def test_figures_of_runs_are_drawn_once(in_net, monkeypatch):
    drawings = []
    figure = "matplotlib.figure.Figure.savefig"
    monkeypatch.setattr(
        figure, lambda self, path, **_: drawings.append(Path(path).write_text("<svg/>"))
    )
    store = connect()
    for _ in range(2):
        runs = store.runs_of_kind("cell")
        assert {*draw_missing_figures(store)} == {run.info.run_id for run in runs}
        names = [
            (
                r.info.run_name.split()[0],
                {*store.artifact_names(r.info.run_id, r.info.artifact_uri)},
            )
            for r in runs
        ]
        assert all("confusion.svg" in files for kind, files in names if kind in ("run", "tune"))
    assert len(drawings) == sum(file.endswith(".svg") for _, files in names for file in files)


def test_memory_that_runs_out_is_one_line(monkeypatch, capsys):
    def hungry(_):
        raise MemoryError("Unable to allocate 1 TiB")

    monkeypatch.setattr("bench.commands.data.command", hungry)
    assert main(["data"]) == 1
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and "Unable to allocate 1 TiB" in line
