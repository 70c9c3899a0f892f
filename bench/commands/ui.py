"""The command ``bench ui``: open MLflow's page of the runs."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from http.client import HTTPConnection, HTTPException
from pathlib import Path

from bench.errors import InputError
from bench.grammar.options import typed_settings
from bench.ground.progress import warn
from bench.ground.registry import views_of_runs
from bench.ground.typed import Values
from bench.store.client import Store, connect
from bench.store.database import store_uri

HOST = "127.0.0.1"
RUN_NAME = "attributes.`Run Name`"
COLUMN_WIDTHS = {  # of MLflow's table of runs, in pixels; a name has kind, system, data, protocol
    RUN_NAME: 300,
    "metrics.`accuracy`": 160,
    "metrics.`subject_sd`": 150,
    "metrics.`flash_bytes`": 85,
    "metrics.`ram_bytes`": 90,
    "metrics.`predict_ms_p50`": 90,
    "metrics.`macro_f1`": 90,
    "params.`data`": 80,
    "params.`where`": 120,
    "params.`protocol`": 90,
}
VIEW = {
    "selectedColumns": [column for column in COLUMN_WIDTHS if column != RUN_NAME],
    "columnOrder": [*COLUMN_WIDTHS],
    "columnWidths": COLUMN_WIDTHS,
}


def command(values: Values) -> int:
    """Run MLflow's server on the store, for this machine only; return its exit code."""
    port = typed_settings("ui", values)["port"]
    if not re.fullmatch("[0-9]{1,5}", port) or not 0 < int(port) < 65536:
        raise InputError(f"port={port[:60]}: give a number from 1 to 65535")
    if _answers(port):
        raise InputError(
            f"port={port}: another server uses this port; give port={int(port) % 65535 + 1}"
        )
    store = connect(writes=True)
    view_tag = "mlflow.sharedViewState.touchbench"  # MLflow's button Share writes such tags
    store.client.set_experiment_tag(store.experiment_id, view_tag, json.dumps(VIEW))
    # MLflow's front page is about language models; this one is the table of runs.
    page = f"http://{HOST}:{port}/#/experiments/{store.experiment_id}/runs"
    page += "?workflowType=machine_learning&viewStateShareKey=touchbench"
    print("starting MLflow's server, which takes up to half a minute; Ctrl-C stops it", flush=True)
    options = f"--port {port} --host {HOST} --workers 1".split()
    words = ["-m", "mlflow", "ui", "--backend-store-uri", store_uri(), *options]
    server = subprocess.Popen([sys.executable, *words])
    handler = signal.signal(signal.SIGTERM, lambda *_: server.terminate())  # end it with us
    try:
        while server.poll() is None and not _answers(port):
            time.sleep(0.2)
        if server.poll() is None:
            print(
                f"{page}\nopen this page in a browser: accuracy (mean over subjects), SD and "
                "sizes of all runs",
                flush=True,
            )
        for _ in draw_missing_figures(store):
            if server.poll() is not None:
                break
        return server.wait()
    finally:
        signal.signal(signal.SIGTERM, handler)
        server.terminate()  # Ctrl-C has reached the server as well
        server.wait()


def draw_missing_figures(store: Store) -> Iterator[str]:
    """Draw the figures of runs that have none, the newest first; yield the id of each run."""
    views = views_of_runs()
    for run in sorted(store.runs_of_kind(*views), key=lambda run: -run.info.start_time):
        run_id, artifacts = run.info.run_id, run.info.artifact_uri
        yield run_id
        names = store.artifact_names(run_id, artifacts)
        if not run.data.metrics or any(name.endswith((".svg", ".png")) for name in names):
            continue
        result = store.load_result(run)
        with tempfile.TemporaryDirectory() as folder:
            try:
                views[result.kind].draw_run(result, Path(folder))
            except InputError as e:  # such as a table that was deleted
                warn(f"warning: no figure of run {run_id}: {e}")
                continue
            store.log_artifact(artifacts, Path(folder))


def _answers(port: str) -> bool:
    """True if a web server answers on this machine."""
    connection = HTTPConnection(HOST, int(port), timeout=5)
    try:
        connection.request("GET", "/health")
        connection.getresponse()
    except (OSError, HTTPException):
        return False
    finally:
        connection.close()
    return True
