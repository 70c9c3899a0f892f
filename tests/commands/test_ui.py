"""The command ``bench ui``: columns that runs have, and figures that are drawn once."""

import json
import re
import subprocess
import sys
from pathlib import Path

from bench.cli import main
from bench.commands.ui import draw_missing_figures
from bench.store.client import connect
from tests.commands.test_server import free_port


def test_the_ui_opens_a_view_with_columns_that_runs_have(in_net, monkeypatch, capsys):
    # Instead of MLflow's server one that answers once, and ends.
    code = (
        "from http.server import HTTPServer, SimpleHTTPRequestHandler; "
        f"server = HTTPServer(('127.0.0.1', {(port := free_port())}), SimpleHTTPRequestHandler); "
        "server.handle_request()"
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
