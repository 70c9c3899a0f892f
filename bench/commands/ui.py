"""The command ``bench ui``: MLflow's page of the runs."""

from __future__ import annotations

import json
import re
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from bench.errors import InputError
from bench.grammar.options import (
    COMPARE,
    Command,
    Option,
    key_options,
    parse_arguments,
    typed_settings,
)
from bench.ground.registry import views_of_runs

if TYPE_CHECKING:
    from bench.store.client import Store

COMMAND = Command(
    COMPARE,
    "open MLflow's page of the runs",
    "Starts MLflow's server on this machine only, for the store of this folder or MLFLOW_TRACKING_URI. Prints the "
    "address of the table of runs, and draws the figures of new runs. Ctrl-C stops the server.",
    options=(Option("port", "text", "5000", "port of the server"),),
)
HERE = "127.0.0.1"
NAME, WIDE = (
    "attributes.`Run Name`",
    300,
)  # pixels, instead of 190: kind, system, data and protocol fit
COLUMNS = {  # of MLflow's table of runs, and their widths in pixels
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
    "selectedColumns": [*COLUMNS],
    "columnOrder": [NAME, *COLUMNS],
    "columnWidths": {NAME: WIDE, **COLUMNS},
}


def command(arguments: list[str]) -> int:
    """Run MLflow's own server on this folder's store, for this machine only; its exit code."""
    import subprocess

    from bench.store.client import connect
    from bench.store.database import store_uri

    port = typed_settings("ui", parse_arguments(arguments, key_options("ui")))["port"]
    if not re.fullmatch("[0-9]{1,5}", port) or not 0 < int(port) < 65536:
        raise InputError(f"port={port[:60]}: give a number from 1 to 65535")
    if _answers(port):
        raise InputError(
            f"port={port}: another server uses this port; give port={int(port) % 65535 + 1}"
        )
    store = connect(writes=True)
    store.client.set_experiment_tag(
        store.experiment_id, "mlflow.sharedViewState.touchbench", json.dumps(VIEW)
    )
    # MLflow's front page is about language models; this one is the table of runs.
    page = f"http://{HERE}:{port}/#/experiments/{store.experiment_id}/runs?workflowType=machine_learning"
    page += "&viewStateShareKey=touchbench"  # as its button Share stores columns and their widths
    print("starting MLflow's server, which takes up to half a minute; Ctrl-C stops it", flush=True)
    words = [
        "--backend-store-uri",
        store_uri(),
        "--port",
        port,
        "--host",
        HERE,
        "--workers",
        "1",
    ]  # for one user
    server = subprocess.Popen([sys.executable, "-m", "mlflow", "ui", *words])
    before = signal.signal(
        signal.SIGTERM, lambda *_: server.terminate()
    )  # else it would outlive this process
    try:
        while server.poll() is None and not _answers(port):
            time.sleep(0.2)
        if server.poll() is None:
            print(
                f"{page}\nopen this page in a browser: accuracy (mean over subjects), SD and sizes of all runs",
                flush=True,
            )
        for _ in draw_missing_figures(store):
            if server.poll() is not None:
                break
        return server.wait()
    finally:
        signal.signal(signal.SIGTERM, before)
        server.terminate()  # after Ctrl-C, which the server has had as well
        server.wait()


def draw_missing_figures(store: Store) -> Iterator[str]:
    """Draw the figures of runs that have none, newest first; the id of each run."""
    import tempfile

    from bench.ground.progress import warn

    kinds = views_of_runs()
    for run in sorted(store.runs_of_kind(*kinds), key=lambda run: -run.info.start_time):
        run_id, artifacts = run.info.run_id, run.info.artifact_uri
        yield run_id
        if not run.data.metrics or any(
            name.endswith((".svg", ".png")) for name in store.artifact_names(run_id, artifacts)
        ):
            continue
        result = store.load_result(run)
        with tempfile.TemporaryDirectory() as folder:
            try:
                kinds[result.kind].draw_run(result, Path(folder))
            except InputError as e:  # such as a table that was deleted: the others go on
                warn(f"warning: no figure of run {run_id}: {e}")
                continue
            store.log_artifact(artifacts, Path(folder))


def _answers(port: str) -> bool:
    """Whether a web server answers on this machine."""
    from http.client import HTTPConnection, HTTPException

    connection = HTTPConnection(HERE, int(port), timeout=5)
    try:
        connection.request("GET", "/health")
        connection.getresponse()
    except (OSError, HTTPException):
        return False
    finally:
        connection.close()
    return True
