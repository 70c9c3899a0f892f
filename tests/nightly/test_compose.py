"""The compose file: what it says, and its commands as they stand there, run without containers."""

import os
import shutil
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
import yaml

from bench.cli import main
from tests.commands.test_server import answers, free_port, postgres, started
from tests.conftest import runs

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "compose"


def services():
    return yaml.safe_load((FOLDER / "compose.yaml").read_text())["services"]


@pytest.mark.nightly
@pytest.mark.real_store
def test_its_commands_work_together(tmp_path, monkeypatch, capsys):
    pytest.importorskip("distributed")
    ports = {name: free_port() for name in ("scheduler", "mlflow")}
    (tmp_path / "artifacts").mkdir()
    known = {
        "scheduler:8786": f"127.0.0.1:{ports['scheduler']}",
        "=8786": f"={ports['scheduler']}",
        "=5000": f"={ports['mlflow']}",
        "mlflow:5000": f"127.0.0.1:{ports['mlflow']}",
        "localhost:5000": f"localhost:{ports['mlflow']}",
        "=/artifacts": f"={tmp_path / 'artifacts'}",
        "0.0.0.0": "127.0.0.1",
    }
    found = services()

    def command(name):
        words = []
        for word in found[name]["command"]:
            for container, here in known.items():
                word = word.replace(container, here)
            words.append(word)
        program, *rest = words
        beside = shutil.which(program, path=str(Path(sys.executable).parent))
        assert beside, f"{program} is not installed"
        return [beside, *rest]

    env = os.environ | {"PYTHONPATH": str(ROOT)}
    with ExitStack() as stack:
        database = stack.enter_context(postgres(tmp_path))
        known["postgresql+psycopg2://bench:bench@database:5432/mlflow"] = database
        place = f"http://127.0.0.1:{ports['mlflow']}"

        def start(name, ready, **own):
            how = {"cwd": tmp_path, "env": env | own}
            stack.enter_context(started(command(name), ready, tmp_path / f"{name}.txt", **how))

        start("mlflow", lambda: answers(f"{place}/health"))
        start("scheduler", lambda: "Scheduler at" in (tmp_path / "scheduler.txt").read_text())
        for name in ("first", "second"):
            said = tmp_path / f"{name}.txt"
            start(
                name,
                lambda said=said: said.read_text().count("Registered to") == 2,
                TOUCHBENCH_HOME=str(tmp_path / name),
            )
        assert found["bench"]["environment"]["MLFLOW_TRACKING_URI"] == "http://mlflow:5000"
        monkeypatch.setenv("MLFLOW_TRACKING_URI", place)
        cluster = f"cluster=tcp://127.0.0.1:{ports['scheduler']}"
        small = ["data.subjects=4", "data.variants=normal", "data.repetitions=2"]
        assert main(["run", "model=svm,bayes", *small, cluster]) == 0
        assert "4/4" in capsys.readouterr().out
        assert [r.info.status for r in runs("cell")[1]] == ["FINISHED"] * 2
