"""What tests share: own folders, one prepared store, folds without processes, small corpora."""

import importlib
import os
import shutil
import subprocess
import sys
from functools import cache

# Small networks are slower on two threads than on one.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd
import pytest
from filelock import FileLock
from hypothesis import HealthCheck, settings

from bench.corpora.corpus import Corpus
from bench.corpora.folder import open_folder, write_folder
from bench.ground import registry
from bench.running.workers import FoldExecutor
from bench.store.client import connect, create_database
from bench.values import measures

# The command in a process of its own, which does not ignore Ctrl-C as background processes do.
BENCH = [
    sys.executable,
    "-c",
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    "from bench.cli import main; sys.exit(main())",
]

# A busy machine is no failure. HYPOTHESIS_PROFILE=nightly looks fifty times as long.
patient = {
    "deadline": None,
    "suppress_health_check": [HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
}
settings.register_profile("ci", parent=settings(), max_examples=20, derandomize=True, **patient)
settings.register_profile("nightly", parent=settings(), max_examples=1000, **patient)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))


class WithoutAddons:
    """Entry points of installed packages but those of add-ons."""

    def __init__(self, every):
        self.every = every

    def select(self, group):
        found = self.every.select(group=group)
        return [e for e in found if e.dist is None or not e.dist.name.startswith("touchbench-")]


def forget_parts():
    """Look for installed packages, and load parts, again."""
    for module in (registry, measures):
        for value in [*vars(module).values()]:
            if hasattr(value, "cache_clear"):
                value.cache_clear()


def pytest_configure(config):
    """Hide add-ons that are installed: what they print and test is in their own tests."""
    every = registry._entry_points.__wrapped__
    registry._entry_points = cache(lambda: WithoutAddons(every()))
    forget_parts()
    without_numba(config)


def without_numba(config):
    """numba compiles for half a minute; with the few kernels of these tests, Python is faster."""
    if "not live" in config.option.markexpr and "not nightly" in config.option.markexpr:
        os.environ.setdefault("NUMBA_DISABLE_JIT", "1")


# Files that take longest begin first. The first makes `net_store`; those that the second process
# begins with do without.
LONG = (
    "test_net.py test_gates.py test_package.py test_server.py test_readme.py test_numbers.py "
    "test_next.py test_report.py test_export.py test_watch.py test_c.py test_chip.py"
).split()


def pytest_collection_modifyitems(items):
    """Order the files; `--no-loadscope-reorder` leaves it so."""
    items.sort(key=lambda item: LONG.index(item.path.name) if item.path.name in LONG else len(LONG))


def pytest_addoption(parser):
    parser.addoption(
        "--golden", action="store_true", help="write tests/net/golden anew: what users see"
    )
    parser.addoption(
        "--exact",
        action="store_true",
        help="compare stored numbers to the last digit, as made here",
    )


@pytest.fixture(autouse=True)
def own_folders(tmp_path, monkeypatch):
    """No test reads or writes the user's data folder or store."""
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path / "home"))
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="session")
def shared(tmp_path_factory):
    """The folder of all processes of tests."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture(scope="session")
def empty_store(shared):
    """MLflow's tables, made once for all tests and processes of tests: it takes seconds."""
    path = shared / "template.db"
    with FileLock(shared / "template.lock"):
        if not path.exists():
            create_database(path)
    return path


@pytest.fixture(autouse=True)
def prepared_store(request, monkeypatch):
    """New stores are copies of an empty one, but for tests that are marked ``real_store``."""
    if not request.node.get_closest_marker("real_store"):
        copied = lambda path: shutil.copy(request.getfixturevalue("empty_store"), path)  # noqa: E731
        monkeypatch.setattr("bench.store.client.create_database", copied)


@pytest.fixture(autouse=True)
def folds_here(request, monkeypatch):
    """Folds run in this process, except in tests marked ``pool``: workers take seconds to start."""
    if not request.node.get_closest_marker("pool"):
        monkeypatch.setattr("bench.running.workers.ProcessExecutor", FoldExecutor)


@pytest.fixture(autouse=True)
def brief_measurements(request, monkeypatch):
    """Few predictions are timed and repeated, except in tests marked ``measured`` or ``pool``."""
    never_busy(monkeypatch)
    if not any(map(request.node.get_closest_marker, ("measured", "pool"))):
        shorten_measurements(monkeypatch)


def never_busy(patch):
    """No output says that this machine was busy."""
    for printed in ("bench.commands.printing", "bench.reports.notes"):
        patch.setattr(f"{printed}.BUSY_SLOWDOWN", float("inf"))


def shorten_measurements(patch):
    """Time 3 captures once instead of 5 twice, beside less work, and predict 2 alone, not 8."""
    importlib.import_module("bench.running.estimates")  # which keeps the workload as it is
    for name in ("running.fold", "running.replay"):
        patch.setattr(f"bench.{name}.TIMED_CAPTURES", 3)
    patch.setattr("bench.ground.timing.AROUND", 1)
    patch.setattr("bench.ground.timing.REPEATS", 1)
    patch.setattr("bench.ground.timing.run_reference_workload", lambda: sum(range(5000)))
    patch.setattr("bench.running.fold.AGAIN", 4)
    patch.setattr("bench.running.fold.ALONE", 2)


def random_corpus(
    subjects=4,
    per_class=3,
    gestures=("pat", "rub", "tap"),
    grid=(8, 8),
    longest=40,
    seed=0,
    **fields,
):
    """Captures of different lengths and levels: classes differ, but not perfectly."""
    rng = np.random.default_rng(seed)
    arrays, labels = [], []
    for subject in range(1, subjects + 1):
        for c, gesture in enumerate(gestures):
            for repetition in range(1, per_class + 1):
                frames = int(rng.integers(1, longest))
                levels = rng.poisson(20 + 60 * c + 5 * subject, (frames, *grid))
                arrays.append(levels.clip(0, 1023).astype(np.uint16))
                labels.append((str(subject), gesture, repetition))
    captures = pd.DataFrame(labels, columns=["subject", "gesture", "repetition"])
    return Corpus.from_captures(arrays, captures, 100.0, name="random", **fields)


def with_other_values(corpus, captures):
    """The same corpus with random values in some captures, to show that they are not looked at."""
    frames = corpus.frames.copy()
    for start, length in zip(corpus.starts[captures], corpus.lengths[captures], strict=True):
        frames[start : start + length] = np.random.default_rng(1).integers(
            0, 1023, (length, *corpus.grid)
        )
    return corpus.with_fields(frames=frames)


def runs(kind):
    """The store and its runs of a kind, the oldest first."""
    store = connect()
    found = store.search_runs(f"tags.`touchbench.kind` = '{kind}'")
    return store, sorted(found, key=lambda run: run.info.start_time)


def predictions(store, run, name="predictions"):
    """A table of a run."""
    path = store.artifact_path(run.info.run_id, run.info.artifact_uri, f"{name}.parquet")
    return pd.read_parquet(path)


SMALL = ["data=synth", "data.subjects=3", "data.variants=normal", "data.repetitions=1", "jobs=1"]


@pytest.fixture(scope="session")
def net_store(tmp_path_factory, empty_store):
    """The folder of `tests.net.build`, a small run of every kind; all processes copy it."""
    from tests.net.build import RUNS, build

    folder = empty_store.parent / "net"
    with FileLock(folder.with_suffix(".lock")):
        if not (folder / "done").exists():
            with pytest.MonkeyPatch.context() as patch:
                shorten_measurements(patch)
                never_busy(patch)
                build(folder, RUNS, empty_store)
            (folder / "done").touch()
    return folder


@pytest.fixture
def in_net(net_store, tmp_path):
    """A copy of the same, in which the test works."""
    from tests.net.build import copy, inside

    with inside(copy(net_store, tmp_path / "net")):
        yield tmp_path / "net"


@pytest.fixture
def corpus():
    """4 subjects, 3 gestures, 36 captures of 1 to 39 frames on 8 x 8."""
    return random_corpus()


@pytest.fixture
def stored(corpus, tmp_path):
    """The same in a folder, mapped."""
    write_folder(corpus, tmp_path / "c")
    return open_folder(tmp_path / "c")


@pytest.fixture
def store(empty_store):
    """An empty store."""
    return connect()


@pytest.fixture(scope="session")
def dead():
    """The number of a process that has ended."""
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    return process.pid


@pytest.fixture
def plug(tmp_path, monkeypatch):
    """Install a package with these entry points, in a folder of its own."""
    site = tmp_path / "site"
    info, installed = site / "watts-1.0.dist-info", []

    def forget():
        forget_parts()
        for name in installed:
            sys.modules.pop(name, None)

    def install(points, source, name):
        installed.append(name)
        info.mkdir(parents=True, exist_ok=True)
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: watts\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(points)
        (site / f"{name}.py").write_text(source)
        monkeypatch.syspath_prepend(site)
        forget()

    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    yield install
    forget()
