"""What the command does with its streams and with what cannot be shown: one line, whatever it is about."""

import json
import os
import re
import resource
import subprocess
import sys
from functools import partial
from http.server import HTTPServer, SimpleHTTPRequestHandler
from pathlib import Path
from threading import Thread

import pytest

from bench.cli import main
from bench.options import COMMANDS
from bench.outcomes.store import connect
from tests.commands.test_server import free_port
from tests.conftest import BENCH

SMALL = ["data=synth", "data.subjects=2", "data.variants=normal"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "data=\x1b[31mred"],
        ["run", "jobs=\x1b]0;title\x07"],
        ["run", "model=/tmp/\x9b31m.py:Mine"],
        ["run", "target=\u202eevil"],
        ["data", "verify", "\x1b[2J"],
        ["data", "import", "\x1b[2J", "x.csv"],
        ["data", "import", "cost", "\udcff.csv"],
        ["extract", "out=\x1b[2J"],
        ["predict", "models:/\x1b[2J", "x.csv"],
        ["predict", "models:/" + 400 * "x", "x.csv"],
        ["run", "where=" + 500 * "x"],
        ["run", "model=" + 500 * "x"],
    ],
)
def test_no_line_moves_a_cursor_or_is_longer_than_300_characters(arguments, capsys):
    assert main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("bench: ") and line.isprintable() and len(line) <= 300


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["systems"], ["data"]])
def test_output_that_is_closed_is_no_error(arguments):
    done = subprocess.run([*BENCH, *arguments], stderr=subprocess.PIPE, preexec_fn=lambda: os.close(1))
    assert (done.returncode, done.stderr) == (0, b"")


def test_a_name_that_is_no_text_is_printed_somehow(tmp_path):
    out = os.fsencode(tmp_path) + b"/\xff.csv"
    utf8 = os.environ | {"PYTHONIOENCODING": "utf-8:strict"}
    for arguments in (["data", "export", "synth", out, "subjects=2", "variants=normal"], ["data"]):
        done = subprocess.run([*BENCH, *arguments], capture_output=True, env=utf8)
        assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["run", "--model", "svm"], "model=svm"),
        (["run", "--model=svm"], "model=svm"),
        (["stream", "--hop-ms", "125"], "hop_ms=125"),
        (["choose", "data=synth", "--max-flash", "256kB"], "max_flash=256kB"),
        (["run", "--jobs"], "jobs=VALUE"),
    ],
)
def test_options_as_other_programs_have_them_are_told_as_they_are_written_here(arguments, told, capsys):
    assert main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(f"key=value, without dashes: {told}")


def test_every_command_stands_once_in_the_overview_and_those_to_begin_with_come_first(capsys):
    assert main(["--help"]) == 0
    said = capsys.readouterr().out
    listed = [line.split()[1] for line in said.splitlines() if line.startswith("  bench ")]
    assert sorted(listed) == sorted(COMMANDS) and all(len(line) <= 100 for line in said.splitlines())
    first = said[said.index("start here:") : said.index("your captures:")]
    assert said.splitlines()[2] == "start here:" and "bench demo" in first and "bench stress" not in first


def test_the_ui_opens_a_view_with_columns_that_runs_have_and_names_tell_kinds_apart(monkeypatch, capsys):
    for command in ("run", "stress", "stream", "fit"):
        more = {"stress": ["faults=noise"], "fit": ["stopping=no"]}.get(command, [])
        assert main([command, "model=lda", "features=jung28", *SMALL[:1], "data.subjects=3", *SMALL[2:], *more]) == 0
    capsys.readouterr()
    # Instead of MLflow's server one that answers once, and ends.
    code = (
        "from http.server import HTTPServer, SimpleHTTPRequestHandler; "
        f"HTTPServer(('127.0.0.1', {(port := free_port())}), SimpleHTTPRequestHandler).handle_request()"
    )
    started = subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: started([sys.executable, "-c", code]))
    assert main(["ui", f"port={port}"]) == 0
    starting, address, _ = capsys.readouterr().out.splitlines()
    assert starting.startswith("starting")
    store = connect()
    key = address.partition("viewStateShareKey=")[2]
    view = json.loads(store.client.get_experiment(store.experiment_id).tags[f"mlflow.sharedViewState.{key}"])
    shown = store.runs(view["searchFilter"])  # as the page asks for them
    assert {run.info.run_name.split()[0] for run in shown} == {"run", "stress", "stream", "fit"} and len(shown) == 4
    assert all(run.info.run_name.split()[1] == "lda" and len(run.info.run_name) < 45 for run in shown)
    (evaluated,) = [run for run in shown if run.info.run_name.startswith("run ")]
    for column in view["selectedColumns"]:
        kind, name = re.fullmatch("(metrics|params)[.]`(.+)`", column).groups()
        assert name in getattr(evaluated.data, kind), column
    assert view["columnOrder"][1] == "metrics.`accuracy`"
    visible = sum(view["columnWidths"][c] for c in view["columnOrder"][:5])  # name, accuracy, interval, flash
    assert visible < 1000 - 105 - 150  # pixels that MLflow has for them at 1600, without its boxes and dates


def test_a_port_that_is_taken(capsys):
    with HTTPServer(("127.0.0.1", 0), SimpleHTTPRequestHandler) as taken:
        port = taken.server_port
        Thread(target=taken.handle_request).start()
        assert main(["ui", f"port={port}"]) == 2
    assert f"port={port}: another server answers there; give another" in capsys.readouterr().err


@pytest.mark.parametrize("port", ["0", "65536", "99999999999", "٣", "-1"])
def test_a_port_that_cannot_be(port, capsys):
    assert main(["ui", f"port={port}"]) == 2
    assert "give a number from 1 to 65535" in capsys.readouterr().err


@pytest.mark.parametrize("target", ["", ".", "/", "folder", "pipe"])
def test_a_corpus_is_not_exported_over_a_folder_or_a_device(target, tmp_path, capsys):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    assert main(["data", "export", "synth", target, "subjects=2", "variants=normal"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "name a file" in line
    assert (tmp_path / "folder").is_dir() and (tmp_path / "pipe").is_fifo()


@pytest.mark.parametrize("name", ["features.csv", "features.parquet"])
def test_a_table_that_cannot_be_written_leaves_the_earlier_one(name, tmp_path):
    (tmp_path / name).write_text("earlier")
    full = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (8192, 8192))
    command = [*BENCH, "extract", *SMALL, "features=jung54", f"out={name}"]
    assert main(["extract", *SMALL, "features=jung54", "out=other.csv"]) == 0  # so that all else is there
    done = subprocess.run(command, capture_output=True, text=True, preexec_fn=full)
    assert done.returncode == 2 and "cannot be written" in done.stderr and done.stderr.count("\n") == 1
    assert (tmp_path / name).read_text() == "earlier"
    assert not list(tmp_path.glob(".*part*"))
    assert main(["extract", *SMALL, "features=jung54", f"out={name}"]) == 0
    assert (tmp_path / name).stat().st_size > 8192


def test_a_table_goes_where_a_link_points_and_into_a_device(tmp_path):
    (tmp_path / "link.csv").symlink_to(tmp_path / "there.csv")
    (tmp_path / "there.csv").write_text("earlier")
    (tmp_path / "null.csv").symlink_to("/dev/null")
    for name in ("link.csv", "null.csv"):
        assert main(["extract", *SMALL, "features=jung54", f"out={name}"]) == 0
        assert (tmp_path / name).is_symlink()
    assert "subject" in (tmp_path / "there.csv").read_text() and Path("/dev/null").is_char_device()


def test_a_working_folder_that_is_gone(tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    done = subprocess.run([*BENCH, "run"], capture_output=True, text=True, cwd=gone, preexec_fn=gone.rmdir)
    assert done.returncode == 2 and "the working folder is gone" in done.stderr and done.stderr.count("\n") == 1


def test_memory_that_runs_out_is_one_line(monkeypatch, capsys):
    def hungry(_):
        raise MemoryError("Unable to allocate 1 TiB")

    monkeypatch.setattr("bench.commands.data.data", hungry)
    assert main(["data"]) == 1
    assert capsys.readouterr().err == "bench: memory ran out (Unable to allocate 1 TiB); ask for less\n"


@pytest.mark.parametrize(("key", "told"), [("window_ms=1e300", "give at most"), ("window_ms=1e20", "give at most")])
def test_a_window_that_cannot_be(key, told, capsys):
    assert main(["stream", "source=-", "model=nothing", key]) == 2
    assert told in capsys.readouterr().err


def test_frames_from_an_input_that_is_closed(monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", None)
    assert main(["stream", "source=-", "model=nothing"]) == 2
    assert "standard input is closed" in capsys.readouterr().err
