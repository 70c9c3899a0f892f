"""``mlflow server`` as teams have it, on SQLite and on PostgreSQL, with several commands writing at once."""

import io
import json
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pandas as pd
import pytest

from bench.cli import main
from tests.conftest import BENCH
from tests.running.test_fit import as_table
from tests.running.test_loop import SMALL

pytestmark = [pytest.mark.live, pytest.mark.real_store, pytest.mark.pool]
PATIENCE = 600  # seconds for a server to answer on a busy machine


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def program(name):
    """A program of PostgreSQL, which Debian keeps off the path."""
    found = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return shutil.which(name) or (str(found[-1]) if found else None)


@contextmanager
def started(command, ready, said, **how):
    """A server, ended again; what it said goes to a file, as a full pipe would stop it."""
    with said.open("w") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, **how)
    try:
        end = time.time() + PATIENCE
        while not ready():
            assert process.poll() is None and time.time() < end, said.read_text()[-2000:]
            time.sleep(0.2)
        yield
    finally:
        process.terminate()
        process.wait(timeout=60)


@contextmanager
def postgres(folder):
    """The address of a PostgreSQL server with an empty database; it does not run as root."""
    if program("initdb") is None:
        pytest.skip("PostgreSQL is not installed")
    pytest.importorskip("psycopg2")
    import pwd

    user, log = {}, folder / "postgres.txt"
    if os.getuid() == 0:
        if not any(p.pw_name == "postgres" for p in pwd.getpwall()):
            pytest.skip("root cannot start PostgreSQL, and there is no user postgres")
        user = {"user": "postgres"}
    folder = Path(
        subprocess.run(
            ["mktemp", "-d"], capture_output=True, text=True, check=True, **user
        ).stdout.strip()
    )
    made = [
        program("initdb"),
        "-D",
        folder / "db",
        "-U",
        "bench",
        "-A",
        "trust",
        "-E",
        "UTF8",
        "--no-sync",
    ]
    try:
        subprocess.run(made, check=True, capture_output=True, cwd="/", **user)
        port = free_port()
        command = [
            program("postgres"),
            "-D",
            folder / "db",
            "-p",
            str(port),
            "-h",
            "127.0.0.1",
            "-k",
            folder,
            "-F",
        ]
        place = f"bench@127.0.0.1:{port}/postgres"

        def ready():
            import psycopg2

            try:
                psycopg2.connect(f"postgresql://{place}").close()
            except psycopg2.OperationalError:
                return False
            return True

        with started(command, ready, log, cwd="/", **user):
            yield f"postgresql+psycopg2://{place}"
    finally:
        shutil.rmtree(folder)


def figures(folder):
    return [path.name for path in folder.glob("mlruns/*/*/artifacts/*.svg")]


def answers(address):
    try:
        return urllib.request.urlopen(address).status == 200
    except OSError:
        return False


def test_the_ui_serves_the_runs_under_the_address_it_prints(tmp_path):
    assert main(["run", "model=bayes", "data.subjects=2", "data.variants=normal", "jobs=1"]) == 0
    port, said = free_port(), tmp_path / "said.txt"
    here = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    place = f"http://127.0.0.1:{port}"
    printed = lambda: f"{place}/#/experiments/" in (said.read_text() if said.exists() else "")  # noqa: E731
    with started([*BENCH, "ui", f"port={port}"], printed, said, env=here, cwd=tmp_path):
        assert answers(f"{place}/health")  # at once: it says so only when it answers
        starting, *between = said.read_text().splitlines()  # MLflow's own words among them
        (address,) = [line for line in between if line.startswith(f"{place}/#/experiments/")]
        assert starting.startswith("starting") and answers(address)
        end = time.time() + PATIENCE
        while figures(tmp_path) != ["confusion.svg"]:  # drawn when someone looks
            assert time.time() < end, said.read_text()
            time.sleep(0.2)
        import mlflow

        runs = mlflow.MlflowClient(place).search_runs(
            [address.split("/experiments/")[1].split("/")[0]]
        )
    assert [r.info.run_name for r in runs] == ["run bayes · jung54 | synth | loso"]
    assert not answers(f"{place}/health")  # ended with the command


def test_a_saved_system_is_served(tmp_path, capsys):
    from bench.corpora.synth import generate

    assert main(["fit", "model=bayes", "features=jung28", *SMALL[1:-1], "out=saved"]) == 0
    corpus = generate(subjects=1, repetitions=1, variants=("normal",))[:5]
    table = as_table(corpus)
    table.to_csv("new.csv", index=False)
    capsys.readouterr()
    assert main(["predict", "saved", "new.csv"]) == 0
    expected = pd.read_csv(io.StringIO(capsys.readouterr().out))
    port = free_port()
    words = f"-m mlflow models serve -m saved --env-manager local --port {port}"
    server = [sys.executable, *words.split()]

    def asked(**more):
        body = json.dumps({"dataframe_split": table.to_dict("split", index=False)} | more).encode()
        request = urllib.request.Request(
            f"http://127.0.0.1:{port}/invocations", body, {"Content-Type": "application/json"}
        )
        return json.load(urllib.request.urlopen(request))["predictions"]

    place = {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    with started(
        server,
        lambda: answers(f"http://127.0.0.1:{port}/ping"),
        tmp_path / "s.txt",
        env=os.environ | place,
    ):
        assert [row["label"] for row in asked()] == expected["label"].tolist()
        assert [row["label"] for row in asked(params={"rate_hz": 135.0})] == expected[
            "label"
        ].tolist()
        with pytest.raises(urllib.error.HTTPError) as refused:
            asked(params={"rate_hz": 54.0})
        assert refused.value.code == 400 and "resample" in refused.value.read().decode()


def server_command(store, folder, port):
    words = f"-m mlflow server --backend-store-uri {store} --artifacts-destination {folder / 'artifacts'} --port {port}"
    return [sys.executable, *words.split(), "--workers", "1"]


def test_several_commands_write_to_one_server_at_once(tmp_path, monkeypatch):
    with postgres(tmp_path) as store:
        port = free_port()
        place = f"http://127.0.0.1:{port}"
        ready = partial(answers, f"{place}/health")
        env = os.environ | {"MLFLOW_DISABLE_TELEMETRY": "true"}
        with started(
            server_command(store, tmp_path, port), ready, tmp_path / "server.txt", env=env
        ):
            monkeypatch.setenv("MLFLOW_TRACKING_URI", place)
            small = ["features=jung28", "data.subjects=3", "data.variants=normal", "jobs=1"]
            how = {
                "stdout": subprocess.PIPE,
                "stderr": subprocess.STDOUT,
                "text": True,
                "cwd": tmp_path,
            }
            how["env"] = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
            commands = [
                ("run", "model=svm"),
                ("run", "model=bayes"),
                ("run", "model=svm", "after=each"),
            ]
            running = [subprocess.Popen([*BENCH, *command, *small], **how) for command in commands]
            try:
                for process in running:
                    said = process.communicate(timeout=PATIENCE)[0]
                    assert process.returncode == 0, said
            finally:
                for process in running:
                    process.kill()
            import mlflow

            client = mlflow.MlflowClient(place)
            runs = client.search_runs([client.get_experiment_by_name("touchbench").experiment_id])
            assert len(runs) == 3 and {r.info.status for r in runs} == {"FINISHED"}
            assert {
                len(client.get_metric_history(r.info.run_id, "fold/accuracy")) for r in runs
            } == {3}
            assert {a.path for r in runs for a in client.list_artifacts(r.info.run_id)} >= {
                "folds.parquet"
            }
            assert not Path("mlflow.db").exists()
