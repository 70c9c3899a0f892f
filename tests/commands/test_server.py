"""``mlflow server`` with several commands writing at once, ``bench ui``, and served models."""

import io
import json
import os
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
import pytest

import bench
from bench.cli import main
from tests.conftest import BENCH
from tests.running.test_fit import as_table

pytestmark = [pytest.mark.live, pytest.mark.real_store, pytest.mark.pool]
PATIENCE = 600  # seconds for a server to answer on a busy machine
SMALL = ["features=jung28", "data.subjects=3", "data.variants=normal"]
ENVIRONMENT = os.environ | {
    "PYTHONPATH": str(Path(__file__).parents[2]),
    "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
    "MLFLOW_DISABLE_TELEMETRY": "true",
}


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def answers(address):
    try:
        return urllib.request.urlopen(address).status == 200
    except OSError:
        return False


@contextmanager
def run_server(command, is_ready, log):
    """Run a server during the block; its output goes to a file, as a full pipe would stop it."""
    with log.open("w") as file:
        process = subprocess.Popen(command, stdout=file, stderr=file, env=ENVIRONMENT)
    try:
        end = time.time() + PATIENCE
        while not is_ready():
            assert process.poll() is None and time.time() < end, log.read_text()[-2000:]
            time.sleep(0.2)
        yield
    finally:
        process.terminate()
        process.wait(timeout=60)


def figures():
    return [path.name for path in Path().glob("mlruns/*/*/artifacts/*.svg")]


def test_the_ui_serves_the_runs_under_the_address_it_prints(tmp_path):
    assert main(["run", "model=bayes", "data.subjects=2", "data.variants=normal", "jobs=1"]) == 0
    port, log = free_port(), tmp_path / "ui.txt"
    place = f"http://127.0.0.1:{port}"
    with run_server([*BENCH, "ui", f"port={port}"], lambda: "/#/" in log.read_text(), log):
        assert answers(f"{place}/health")  # at once: it prints the address only when it answers
        first, *lines = log.read_text().splitlines()  # MLflow's own words among them
        (address,) = [line for line in lines if line.startswith(f"{place}/#/experiments/")]
        assert first.startswith("starting") and answers(address)
        end = time.time() + PATIENCE
        while figures() != ["confusion.svg"]:  # drawn when someone looks
            assert time.time() < end, log.read_text()
            time.sleep(0.2)
        import mlflow

        experiment = address.split("/experiments/")[1].split("/")[0]
        runs = mlflow.MlflowClient(place).search_runs([experiment])
    assert [r.info.run_name for r in runs] == ["run bayes · jung54 | synth | loso"]
    assert not answers(f"{place}/health")  # ended with the command


def test_a_saved_system_is_served(tmp_path, capsys):
    assert main(["fit", "model=bayes", *SMALL, "out=saved"]) == 0
    table = as_table(bench.corpus("synth", subjects=1, repetitions=1, variants=("normal",))[:5])
    table.to_csv("new.csv", index=False)
    capsys.readouterr()
    assert main(["predict", "saved", "new.csv"]) == 0
    expected = pd.read_csv(io.StringIO(capsys.readouterr().out))["label"].tolist()
    place = f"http://127.0.0.1:{(port := free_port())}"
    words = f"-m mlflow models serve -m saved --env-manager local --port {port}"

    def request_labels(**more):
        body = json.dumps({"dataframe_split": table.to_dict("split", index=False)} | more).encode()
        header = {"Content-Type": "application/json"}
        request = urllib.request.Request(f"{place}/invocations", body, header)
        return [row["label"] for row in json.load(urllib.request.urlopen(request))["predictions"]]

    server, log = [sys.executable, *words.split()], tmp_path / "server.txt"
    with run_server(server, lambda: answers(f"{place}/ping"), log):
        assert request_labels() == request_labels(params={"rate_hz": 135.0}) == expected
        with pytest.raises(urllib.error.HTTPError) as refused:
            request_labels(params={"rate_hz": 54.0})
        assert refused.value.code == 400 and "resample" in refused.value.read().decode()


def test_several_commands_write_to_one_server_at_once(tmp_path, monkeypatch):
    place = f"http://127.0.0.1:{(port := free_port())}"
    words = "-m mlflow server --backend-store-uri sqlite:///server.db --workers 1 "
    words += f"--artifacts-destination artifacts --port {port}"
    server, log = [sys.executable, *words.split()], tmp_path / "server.txt"
    with run_server(server, lambda: answers(f"{place}/health"), log):
        environment = ENVIRONMENT | {"MLFLOW_TRACKING_URI": place}
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        running = [
            subprocess.Popen([*BENCH, "run", *words, *SMALL, "jobs=1"], env=environment, **pipes)
            for words in (["model=svm"], ["model=bayes"], ["model=svm", "after=each"])
        ]
        try:
            for process in running:
                output = process.communicate(timeout=PATIENCE)[0]
                assert process.returncode == 0, output
        finally:
            for process in running:
                process.kill()
        import mlflow

        client = mlflow.MlflowClient(place)
        runs = client.search_runs([client.get_experiment_by_name("touchbench").experiment_id])
        assert len(runs) == 3 and {r.info.status for r in runs} == {"FINISHED"}
        for run in runs:
            assert len(client.get_metric_history(run.info.run_id, "fold/accuracy")) == 3
            assert "folds.parquet" in [a.path for a in client.list_artifacts(run.info.run_id)]
        assert not Path("mlflow.db").exists()
