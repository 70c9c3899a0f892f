"""Commands killed at random moments and repeated: they store what an unbroken run stores, and leave nothing behind.

`KILLS=50 python -m pytest -m nightly tests/nightly/test_kills.py` kills each command so often; Linux only.
"""

import contextlib
import hashlib
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlparse

import pandas as pd
import pytest
from filelock import FileLock
from mlflow import MlflowClient

import bench
from bench import store
from tests.conftest import BENCH, predictions, runs

pytestmark = [pytest.mark.nightly, pytest.mark.real_store]
ROOT = Path(bench.__file__).parents[1]
KILLS = int(os.environ.get("KILLS", "3"))  # of each command
PATIENCE = 20.0  # seconds in which workers must end after their parent
SYNTH = ["data=synth", "data.subjects=4", "data.variants=normal", "features=jung28"]
TABLE = ["name=arm", "grid=8x8", "rate_hz=135"]
COMMANDS = {
    "run": ["run", *SYNTH, "model=svm"],
    "stress": ["stress", *SYNTH, "model=svm", "faults=noise,shift"],
    "replay": ["run", *SYNTH, "model=svm", "after=each", "stopping=yes"],
    "tune": ["tune", *SYNTH, "model=svm", "trials=4", "inner=2"],
    "fit": ["fit", *SYNTH, "model=rf", "out=model"],
    "import": ["data", "import", "table", "large.csv", *TABLE],
    "report": ["report"],
}
# What a clock or the memory of the process gives differs between any two runs.
MEASURED = re.compile(
    r"(decide_ms|predict_ms)(_p\d+)?|reference_ms|predict_relative|decisions_per_second"
    r"|peak_rss_bytes|seconds|\w+_seconds|front"
)


@dataclass
class Place:
    """Folders of a round; the processes of it have their path in the environment."""

    root: Path

    def start(self, arguments):
        """A command as the leader of a group of its own."""
        environment = {k: v for k, v in os.environ.items() if k != "MLFLOW_TRACKING_URI"}
        environment |= {"PYTHONPATH": str(ROOT), "TOUCHBENCH_HOME": str(self.root / "home")}
        environment["TMPDIR"] = str(self.root / "tmp")
        with (self.root / "log.txt").open("ab") as log:
            streams = {"stdin": subprocess.DEVNULL, "stdout": log, "stderr": log}
            return subprocess.Popen(
                [*BENCH, *arguments], cwd=self.root / "work", env=environment, start_new_session=True, **streams
            )

    def done(self, arguments):
        """The seconds of a command that ends well."""
        begin = time.monotonic()
        code = self.start(arguments).wait(600)
        text = (self.root / "log.txt").read_text(errors="replace")[-2000:]
        assert code == 0 or (code == 2 and "this place is not empty" in text), text
        return time.monotonic() - begin

    def killed(self, arguments, moment, group):
        """Kill a command at a moment; False if it had ended."""
        process = self.start(arguments)
        try:
            process.wait(moment)
            return False
        except subprocess.TimeoutExpired:
            (os.killpg if group else os.kill)(process.pid, signal.SIGKILL)
        return process.wait() == -signal.SIGKILL

    def running(self):
        """Processes of this round that have not ended after some patience."""
        until, mark = time.monotonic() + PATIENCE, f"TMPDIR={self.root / 'tmp'}\0".encode()
        while (
            left := [pid for pid in Path("/proc").glob("[0-9]*") if _marked(pid, mark)]
        ) and time.monotonic() < until:
            time.sleep(0.1)
        return left

    def names(self):
        """All names in the folders, but the files of runs."""
        paths = (p.relative_to(self.root) for part in ("work", "home") for p in (self.root / part).rglob("*"))
        return {str(p) for p in paths if p.parts[:2] not in (("work", "mlruns"), ("work", "model"), ("home", "tmp"))}

    def stored(self):
        """What runs, folders of results and imports hold, times left out, as digests by name."""
        found = {}
        folders = {name: self.root / "work" / name for name in ("report",)}
        pointer = self.root / "home" / "corpora" / "arm" / "current"
        if pointer.exists():
            folders["arm"] = pointer.parent / pointer.read_text()
        for name, folder in folders.items():
            for path in folder.rglob("*"):
                if path.is_file() and path.suffix not in (".png", ".svg", ".html", ".pdf") and path.name != "seal.json":
                    found[f"{name}/{path.relative_to(folder)}"] = _digest(path)
        if not (self.root / "work" / "mlflow.db").exists():
            return found
        client = MlflowClient(f"sqlite:///{self.root / 'work' / 'mlflow.db'}")
        for run in client.search_runs([e.experiment_id for e in client.search_experiments()], max_results=1000):
            tags = {k: v for k, v in run.data.tags.items() if not k.startswith("mlflow.")}
            name = f"{tags.get('touchbench.kind')} {run.info.run_name}"
            while f"{name}: status" in found:  # there should be one
                name += " again"
            metrics = {k: v for k, v in run.data.metrics.items() if not MEASURED.fullmatch(k)}
            found |= {f"{name}: status": run.info.status, f"{name}: values": (metrics, run.data.params, tags)}
            artifacts = Path(unquote(urlparse(run.info.artifact_uri).path))
            for path in (p for p in artifacts.rglob("*") if p.suffix in (".csv", ".parquet")):
                found[f"{name}: {path.relative_to(artifacts)}"] = _digest(path)
        return found


def _marked(process, mark):
    """Whether a process is alive and of this round."""
    try:
        state = (process / "stat").read_text().rpartition(")")[2].split()[0]
        return state not in "ZX" and mark in (process / "environ").read_bytes()
    except OSError:  # it has ended, or belongs to someone else
        return False


def _digest(path):
    content = path.read_bytes()
    if path.suffix in (".csv", ".parquet"):
        table = pd.read_csv(path, dtype=str) if path.suffix == ".csv" else pd.read_parquet(path)
        content = table[[c for c in table.columns if not MEASURED.fullmatch(str(c))]].to_csv(index=False).encode()
    return hashlib.sha256(content).hexdigest()[:16]


def fresh(root, template=None):
    shutil.rmtree(root, ignore_errors=True)
    for part in ("work", "home", "tmp"):
        if template:
            shutil.copytree(template / part, root / part)
        else:
            (root / part).mkdir(parents=True)
    return Place(root)


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """Folders with an earlier import, a table to import and, for the report, a run."""
    at = fresh(tmp_path_factory.mktemp("kills") / "template")
    for name, size in (("large", "subjects=4"), ("small", "subjects=2")):
        at.done(["data", "export", "synth", f"{name}.csv", "format=cost", size, "variants=normal"])
    at.done(["data", "import", "table", "small.csv", *TABLE])
    at.done(["run", *SYNTH, "model=bayes"])
    return at.root


@pytest.mark.parametrize("name", COMMANDS)
def test_a_killed_command_ends_as_an_unbroken_one(template, tmp_path, name):
    arguments = COMMANDS[name]
    before = fresh(tmp_path / "before", template).stored()
    reference = fresh(tmp_path / "reference", template)
    seconds = reference.done(arguments)
    expected, names, rng = reference.stored(), reference.names(), random.Random(name)
    assert expected != before
    for turn in range(KILLS):
        at = fresh(tmp_path / "round", template)
        moments = [rng.uniform(0, seconds) for _ in range(1 + turn % 2)]
        ways = [at.killed(arguments, moment, group=bool(turn % 2)) for moment in moments]
        how = f"{name}, killed after {moments}: {ways}"
        assert not at.running(), how
        if name == "import":
            assert at.stored() in (before, expected), how
        at.done(arguments)
        stored = at.stored()
        assert stored == expected, (how, {k for k in stored | expected if stored.get(k) != expected.get(k)})
        assert at.names() <= names, (how, at.names() - names)
        assert not [*at.root.glob("tmp/*"), *at.root.glob("home/tmp/*")], how
        for lock in at.root.rglob("*.lock"):
            with FileLock(lock, timeout=0):
                pass


# The store


SMALL = ["model=bayes", "features=jung28", "data.variants=normal"]


def started(folder, *command, **how):
    return subprocess.run([*BENCH, *command], cwd=folder, capture_output=True, text=True, timeout=600, **how)


@pytest.mark.real_store
def test_a_kill_at_any_moment_of_its_creation_leaves_none_or_a_good_one(tmp_path):
    code = "from bench.store import create; from pathlib import Path; import mlflow.store.db.utils; "
    code += "print('now', flush=True); create(Path('mlflow.db'))"
    begun = time.monotonic()
    subprocess.run([sys.executable, "-c", code.replace("mlflow.db'", "whole.db'")], check=True, capture_output=True)
    lasts = time.monotonic() - begun
    for share in (0.0, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9):
        with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as p:
            p.stdout.readline()
            time.sleep(share * lasts / 2)
            p.send_signal(signal.SIGKILL)
        assert store.connect().of_kind("cell") == []
        assert [q.name for q in Path().glob(".mlflow.db.*")] == []
        Path("mlflow.db").unlink()


def limited():
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))


@pytest.mark.pool
def test_a_full_disk_in_the_middle_of_a_run_loses_nothing(tmp_path):
    """A limit on the size of a file, which is just above that of an empty store, stands for the disk."""
    reference, full = tmp_path / "reference", tmp_path / "full"
    command = ["run", "data.subjects=24", *SMALL]
    for folder in (reference, full):
        folder.mkdir()
    assert started(reference, *command).returncode == 0
    said = started(full, *command, preexec_fn=limited)
    assert said.returncode == 1, said.stderr
    assert "repeat the command" in said.stderr and "Traceback" not in said.stderr
    assert started(full, *command).returncode == 0
    assert table(reference).equals(table(full))


def table(folder):
    with contextlib.chdir(folder):
        connected, (run,) = runs("cell")
        return predictions(connected, run)
