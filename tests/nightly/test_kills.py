"""Commands that are killed and repeated store what an unbroken run stores, and nothing else.

On Linux. `KILLS=50 python -m pytest -m nightly tests/nightly/test_kills.py` kills each command so
often.
"""

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import psutil
import pytest
from filelock import FileLock

import bench
from bench.store import client as store
from tests.conftest import BENCH
from tests.net.stores import contents, untimed

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


class Place:
    """Folders of a round; the processes of it have their path in the environment."""

    def __init__(self, root, template=None):
        self.root, self.work, self.home, self.tmp = root, root / "work", root / "home", root / "tmp"
        shutil.rmtree(root, ignore_errors=True)
        for folder in (self.work, self.home, self.tmp):
            shutil.copytree(template / folder.name, folder) if template else folder.mkdir(
                parents=True
            )

    def start(self, arguments):
        """A command as the leader of a group of its own."""
        environment = os.environ | {
            "PYTHONPATH": str(ROOT),
            "TOUCHBENCH_HOME": str(self.home),
            "TMPDIR": str(self.tmp),
        }
        environment.pop("MLFLOW_TRACKING_URI", None)
        with (self.root / "log.txt").open("ab") as log:
            how = {
                "stdin": subprocess.DEVNULL,
                "stdout": log,
                "stderr": log,
                "start_new_session": True,
            }
            return subprocess.Popen([*BENCH, *arguments], cwd=self.work, env=environment, **how)

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
        end = time.monotonic() + PATIENCE
        while (
            left := [p.pid for p in psutil.process_iter() if self._started(p)]
        ) and time.monotonic() < end:
            time.sleep(0.1)
        return left

    def _started(self, process):
        try:
            return process.status() != psutil.STATUS_ZOMBIE and process.environ().get(
                "TMPDIR"
            ) == str(self.tmp)
        except psutil.Error:  # it has ended, or belongs to someone else
            return False

    def names(self):
        """All names in the folders, but the files of runs."""
        paths = (
            p.relative_to(self.root) for folder in (self.work, self.home) for p in folder.rglob("*")
        )
        return {
            str(p)
            for p in paths
            if p.parts[:2] not in (("work", "mlruns"), ("work", "model"), ("home", "tmp"))
        }

    def stored(self):
        """What runs, folders of results and imports hold, times left out."""
        found, folders = contents(self.work), [self.work / "report"]
        pointer = self.home / "corpora" / "arm" / "current"
        if pointer.exists():
            folders.append(pointer.parent / pointer.read_text())
        for path in (path for folder in folders for path in folder.rglob("*")):
            if path.suffix == ".csv":
                found[path.name] = untimed(pd.read_csv(path, dtype=str))
            elif (
                path.is_file()
                and path.suffix not in (".png", ".svg", ".html")
                and path.name != "seal.json"
            ):
                found[path.name] = path.read_bytes()
        return found


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """Folders with an earlier import, a table to import and, for the report, a run."""
    at = Place(tmp_path_factory.mktemp("kills") / "template")
    for name, size in (("large", "subjects=4"), ("small", "subjects=2")):
        at.done(["data", "export", "synth", f"{name}.csv", "format=cost", size, "variants=normal"])
    at.done(["data", "import", "table", "small.csv", *TABLE])
    at.done(["run", *SYNTH, "model=bayes"])
    return at.root


@pytest.mark.parametrize("name", COMMANDS)
def test_a_killed_command_ends_as_an_unbroken_one(template, tmp_path, name):
    arguments = COMMANDS[name]
    before = Place(tmp_path / "before", template).stored()
    reference = Place(tmp_path / "reference", template)
    seconds = reference.done(arguments)
    expected, names, rng = reference.stored(), reference.names(), random.Random(name)
    assert expected != before
    for turn in range(KILLS):
        at = Place(tmp_path / "round", template)
        moments = [rng.uniform(0, seconds) for _ in range(1 + turn % 2)]
        ways = [at.killed(arguments, moment, group=bool(turn % 2)) for moment in moments]
        how = f"{name}, killed after {moments}: {ways}"
        assert not at.running(), how
        if name == "import":
            assert at.stored() in (before, expected), how
        at.done(arguments)
        stored = at.stored()
        assert stored == expected, (
            how,
            {k for k in stored | expected if stored.get(k) != expected.get(k)},
        )
        assert at.names() <= names, (how, at.names() - names)
        assert not [*at.root.glob("tmp/*"), *at.root.glob("home/tmp/*")], how
        for lock in at.root.rglob("*.lock"):
            with FileLock(lock, timeout=0):
                pass


def test_a_kill_at_any_moment_of_its_creation_leaves_none_or_a_good_one():
    code = "from bench.store.database import create_database; from pathlib import Path; "
    code += "import mlflow.store.db.utils; print('now', flush=True); "
    code += "create_database(Path('mlflow.db'))"
    begun = time.monotonic()
    subprocess.run(
        [sys.executable, "-c", code.replace("mlflow.db'", "whole.db'")],
        check=True,
        capture_output=True,
    )
    lasts = time.monotonic() - begun
    for share in (0.0, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9):
        with subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        ) as p:
            p.stdout.readline()
            time.sleep(share * lasts / 2)
            p.send_signal(signal.SIGKILL)
        assert store.connect().runs_of_kind("cell") == []
        assert [q.name for q in Path().glob(".mlflow.db.*")] == []
        Path("mlflow.db").unlink()


@pytest.mark.pool
def test_a_full_disk_in_the_middle_of_a_run_loses_nothing(tmp_path):
    """A limit on the size of a file, one page below what the store needs, stands for the disk."""
    command = [
        *BENCH,
        "run",
        "model=bayes",
        "features=jung28",
        "data.variants=normal",
        "data.subjects=24",
    ]

    def ran(name, **how):
        (tmp_path / name).mkdir(exist_ok=True)
        done = subprocess.run(
            command, cwd=tmp_path / name, capture_output=True, text=True, timeout=600, **how
        )
        return done.returncode, done.stderr

    assert ran("reference")[0] == 0
    room = (tmp_path / "reference" / "mlflow.db").stat().st_size - 4096
    code, errors = ran(
        "full", preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))
    )
    assert code == 1 and "repeat the command" in errors and "Traceback" not in errors, errors
    assert ran("full")[0] == 0
    assert contents(tmp_path / "reference") == contents(tmp_path / "full") != {}
