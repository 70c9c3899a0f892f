"""Folds on a cluster: one machine, with a scheduler and workers of dask as people start them."""

import asyncio
import os
import pickle
import queue
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace

import pytest

from bench.cli import main
from bench.corpora import folder
from bench.corpora.folder import Address, address, open_folder, sent, write_folder
from bench.corpora.library import open_corpus
from bench.errors import InputError
from bench.plan.arguments import backend_of
from bench.plan.cells import cells
from bench.progress import Said, forget, note, told
from bench.work import alike, cluster, crew, loop, remote
from bench.work.alike import Facts, difference, representatives
from bench.work.crew import packed
from bench.work.evaluation import Evaluation
from bench.work.machine import Machine
from bench.work.remote import Answer
from bench.work.workers import Done
from models import contract
from tests.commands.test_server import free_port
from tests.conftest import BENCH, InProcess, predictions, random_corpus, runs

ROOT = Path(__file__).parents[2]
SMALL = ["data.subjects=4", "data.variants=normal", "data.repetitions=2"]
MODEL = '''
import os, sys, time
from pathlib import Path
import numpy as np
from sklearn.base import BaseEstimator, ClassifierMixin
from bench.progress import tell

class Slow(ClassifierMixin, BaseEstimator):
    """Leaves a mark of the fold and its process; then waits, dies or hangs."""
    def __init__(self, marks="", seconds=0.0, die="", hang="", exit=""):
        self.marks, self.seconds, self.die, self.hang, self.exit = marks, seconds, die, hang, exit
    def fit(self, X, y):
        (fold,) = {"1", "2", "3", "4"} - set(X.subjects)
        Path(self.marks, f"{fold}_{os.getpid()}_{os.getppid()}_{time.time()}").touch()
        if fold == self.die:
            os._exit(9)
        if fold == self.exit:
            sys.exit("no more")
        tell(f"fold {fold} waits", self.seconds)
        time.sleep(3600 if fold == self.hang else self.seconds)
        self.classes_ = np.unique(y)
        return self
    def predict_proba(self, X):
        return np.tile(np.eye(len(self.classes_))[0], (len(X), 1))
    def predict(self, X):
        return np.full(len(X), self.classes_[0])
'''


# Without processes.


class Several(InProcess):
    """Folds of several plans at once, the last one done first; done on machines in turn."""

    overlap = True
    most = 0
    machines = ()

    def room(self, plan):
        return len(self.submitted) < 6

    def finished(self):
        Several.most = max(Several.most, len({id(task.plan) for task in self.submitted}))
        self.submitted.append(self.submitted.pop(0))
        done = super().finished()
        return Done(done.task, done.result, self.machines[int(done.result.name) % 2]) if self.machines else done


def stored():
    store, found = runs("cell")
    return {run.info.run_name: predictions(store, run) for run in found}


def test_plans_that_overlap_give_what_they_give_one_after_the_other(monkeypatch, tmp_path, capsys):
    command = ["run", "model=bayes,tree,rf", "model.trees=5", "features=jung28", *SMALL]
    assert main(command) == 0
    expected = stored()
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/other.db")
    monkeypatch.setattr(loop, "Processes", Several)
    assert main(command) == 0
    found = stored()
    assert Several.most > 1 and len(found) == 3 and {r.info.status for r in runs("cell")[1]} == {"FINISHED"}
    assert all(found[name].equals(table) for name, table in expected.items())
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines() if "4/4" in line]


def test_a_cell_that_another_process_runs_stops_no_cell_before_it(monkeypatch, capsys):
    from filelock import FileLock

    from bench.scratch import home

    monkeypatch.setattr(loop, "Processes", Several)
    names = iter(["one", "two", "three"])
    monkeypatch.setattr(loop, "key_of", lambda *_: next(names))
    (home() / "locks").mkdir(parents=True)
    with FileLock(home() / "locks" / "two.lock"):
        assert main(["run", "model=bayes,tree,svm", "features=jung28", *SMALL]) == 2
    assert "another process is running this very cell" in capsys.readouterr().err
    assert [(r.data.tags["model"], r.info.status) for r in runs("cell")[1]] == [("bayes", "FINISHED")]


def test_a_run_says_so_where_its_folds_are_of_several_machines(monkeypatch):
    monkeypatch.setattr(loop, "Processes", Several)
    monkeypatch.setattr(Several, "machines", (Machine("fast", "avx2"), Machine("slow", "sse")))
    assert main(["run", "model=bayes", "features=jung28", *SMALL]) == 0
    store, (run,) = runs("cell")
    first = run.data.params["cpu"]
    assert first in ("fast", "slow") and run.data.tags["cpu"] == "fast; slow" and run.data.tags["simd"] == "avx2; sse"
    said = {f.data.tags["touchbench.fold"]: f.data.params.get("cpu", first) for f in store.folds(run.info.run_id)}
    assert said == {"1": "slow", "2": "fast", "3": "slow", "4": "fast"}


def test_what_runs_here_knows_nothing_of_dask(tmp_path):
    code = "import sys; from bench.cli import main; main(sys.argv[1:]); print({'dask', 'distributed'} & {*sys.modules})"
    command = [sys.executable, "-c", code, "run", "model=bayes", "features=jung28", *SMALL, "jobs=1"]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    assert done.returncode == 0 and done.stdout.splitlines()[-1] == "set()", done.stderr


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"cluster": "tcp://a:1", "jobs": "2"}, "jobs=2: with cluster="),
        ({"limit": "3"}, "limit=3: only with cluster="),
        ({"cluster": "tcp://a:1", "limit": "0"}, "limit=0: give a number above 0"),
    ],
)
def test_a_backend_that_means_nothing(values, told):
    with pytest.raises(InputError, match=told):
        backend_of(values)


def test_a_cluster_needs_dask(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(["run", *SMALL, "cluster=tcp://127.0.0.1:1"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "pip install 'touchbench[cluster]'" in line and not Path("mlflow.db").exists()


def test_the_first_difference_is_named():
    here = Facts({"python": "3.11.1", "numpy": "2.3.5"}, ["a", "b"], ["", ""], [], "here", "/home")
    names = ["svm", "rf"]
    there = here._replace(host="there", home="/there", lacks=["x"])
    assert difference(names, here, here) == "" == difference(names, here, there)
    other = here._replace(versions={"python": "3.11.1", "numpy": "2.4.0"})
    assert difference(names, here, other) == "it has numpy 2.4.0, this machine 2.3.5"
    other = here._replace(versions={"python": "3.11.1"})
    assert difference(names, here, other) == "it has numpy not at all, this machine 2.3.5"
    other = here._replace(versions=here.versions | {"torch": "2"})
    assert difference(names, here, other) == "it has torch 2, this machine not at all"
    assert "its code of rf differs" in difference(names, here, here._replace(code=["a", "c"]))
    assert difference(names, here, here._replace(code=["a", ""], wrong=["", "no file"])) == "rf: no file"


def test_what_a_machine_has_is_told_with_what_it_lacks(tmp_path):
    (tmp_path / "my.py").write_text(MODEL)
    asked = cells({"model": "svm,my.py:Slow"})
    corpus = open_corpus("synth", {"subjects": 2, "variants": ("normal",)})
    gone = Address(Path("/nowhere"), None, "0" * 64)
    given = (asked, [Evaluation()] * 2, [address(corpus), gone])
    found = alike.facts(*given)
    assert all(found.code) and found.code[0] != found.code[1] and found.lacks == [gone.digest]
    assert found.versions["python"].startswith("3.") and found.wrong == ["", ""]
    (tmp_path / "my.py").write_text(MODEL.replace("3600", "360"))
    assert "changed while it was in use" in remote.facts(*given).wrong[1]
    (tmp_path / "my.py").unlink()
    assert "cannot be read" in remote.facts(*given).wrong[1]


def test_one_cell_of_each_kind_is_asked_about():
    asked = cells({"model": "svm,rf", "model.C": "1,2,3", "seed": "0,1", "features": "jung28,jung54"})
    found, experiments = representatives((cell, Evaluation()) for cell in asked)
    assert len(asked) > len(found) == len(experiments) == 4
    faults = cells({"model": "reflex", "model.faults": "dead_taxels,stuck_taxels", "seed": "0,1"})
    found, _ = representatives((cell, Evaluation()) for cell in faults)
    assert len(faults) == 4 and [contract.trained_faults(c.estimator()) for c in found] == [
        ("dead_taxels",),
        ("stuck_taxels",),
    ]


def test_an_object_that_cannot_travel_is_one_line():
    with pytest.raises(InputError, match="cannot be sent to a worker"):
        packed(print, threading.Lock())


def test_a_corpus_is_found_wherever_the_data_folder_is(monkeypatch, tmp_path):
    corpus = open_corpus("synth", {"subjects": 2, "variants": ("normal",)})
    where, travelling = address(corpus), pickle.dumps(corpus[3:5])
    assert pickle.loads(travelling).path == corpus.path
    shutil.move(tmp_path / "home", tmp_path / "moved")
    monkeypatch.setenv("TOUCHBENCH_HOME", str(tmp_path / "moved"))
    found = pickle.loads(travelling)
    assert found.path == tmp_path / "moved" / where.within and list(found.index) == [3, 4]
    shutil.move(found.path, tmp_path / "apart")
    with pytest.raises(InputError, match="changed or damaged"):
        pickle.loads(travelling)
    write_folder(open_folder(tmp_path / "apart"), sent(where.digest))
    assert pickle.loads(travelling).path == sent(where.digest)
    other = random_corpus()
    write_folder(other, where.path)  # another corpus where it was
    assert pickle.loads(travelling).digest == where.digest
    shutil.rmtree(sent(where.digest))
    with pytest.raises(InputError, match="was replaced by another corpus"):
        pickle.loads(travelling)


def send(where, change=lambda name, content: content):
    for name in ("corpus.json", *folder.FILES):
        content = change(name, (where.path / name).read_bytes())
        for i in range(0, len(content), 1000):
            place = remote.receive("token", name, i, content[i : i + 1000])
            assert remote.receive("token", name, i, content[i : i + 1000]) == place  # dask may do it twice
    return place


def test_a_corpus_that_is_sent_is_stored_whole_or_not_at_all(tmp_path):
    where = address(open_corpus("synth", {"subjects": 2, "variants": ("normal",)}))
    with pytest.raises(InputError, match="changed or damaged"):
        remote.adopt(send(where, lambda name, content: content[:-1] if name == "frames.npy" else content), where.digest)
    write_folder(random_corpus(), tmp_path / "other")
    with pytest.raises(InputError, match="another corpus"):
        remote.adopt(send(address(open_folder(tmp_path / "other"))), where.digest)
    assert not sent(where.digest).exists()
    remote.adopt(send(where), where.digest)
    assert open_folder(sent(where.digest)).digest == where.digest
    remote.adopt(send(where), where.digest)  # another worker was faster
    left = [p.name for p in (sent(where.digest).parent.parent).iterdir()]
    assert sorted(left) == [".sent", "synth"]


def test_what_a_fold_says_arrives_by_the_clock_of_the_command(tmp_path, monkeypatch):
    """Whatever the clock of the worker says; each thing once, and in the end that it says nothing any longer."""
    there, here = tmp_path / "there", tmp_path / "here"
    there.mkdir()
    here.mkdir()
    heard, said, passed = {}, Said("svm | haart", "anna", "half", 8.0, time.time() - 9, time.time() - 2), []

    def look():
        remote.report(there, heard, passed.append)

    note(there, said)
    look()
    look()
    assert len(passed) == 1
    later = time.time() + 7200
    with monkeypatch.context() as patch:
        patch.setattr("time.time", lambda: later)
        cluster.hear(here, passed[0])
        (found,) = told(here)
        assert found[:4] == said[:4] and found.began - time.time() == pytest.approx(-9, abs=1)
        assert found.at - time.time() == pytest.approx(-2, abs=1)
    forget(there, "svm | haart", "anna")
    look()
    cluster.hear(here, passed[1])
    assert told(here) == [] and len(passed) == 2


def test_what_was_sent_in_part_is_cleared_away_when_nobody_sends_the_rest(monkeypatch):
    part, going = (Path(remote.receive(token, "frames.npy", 0, b"x")) for token in ("part", "going"))
    for path in (part, *part.iterdir(), going):
        os.utime(path, (time.time() - 2 * remote.OLD_S,) * 2)
    assert Path(remote.receive("new", "frames.npy", 0, b"x")).exists() and not part.exists()
    assert (going / "frames.npy").read_bytes() == b"x"


@pytest.mark.parametrize("kind", [SystemExit, KeyboardInterrupt, ValueError, asyncio.CancelledError])
def test_whatever_a_fold_raises_is_an_answer(kind):
    def fold():
        raise kind("so it is")

    found = remote.answered(packed(fold), "/nowhere")
    assert found.status == "raised" and "so it is" in found.content.decode()


def test_a_fold_is_done_by_a_process_that_its_command_has_examined():
    corpus = random_corpus()
    asked = packed(remote.fold, "mine", Evaluation(), None, corpus, None, 1, "key")
    assert remote.answered(asked, "/nowhere") == Answer("unknown")
    assert remote.answered(packed(remote.examined, "mine", (), (), ()), "/nowhere").status == "done"
    assert remote.answered(asked, "/nowhere").status == "raised"  # it has no cell


def crew_of(client):
    """One without a scheduler."""
    found = crew.Crew.__new__(crew.Crew)
    found.remotes, found.changing, found.client, found.place = {}, threading.RLock(), client, "tcp://a:1"
    found.name, found.threads = "mine", 1
    return found


def test_a_worker_that_is_gone_is_asked_nothing():
    """dask would wait for it to come back."""
    asked = []
    found = crew_of(SimpleNamespace(status="running", submit=lambda *given, **how: asked.append(given)))
    one = crew.Remote("tcp://b:1", "b", 1)
    with pytest.raises(LookupError):
        found._call(one, print)
    assert not asked
    found.remotes[one.address] = crew.Remote("tcp://b:1", "b", 1)  # another one that came to its place
    with pytest.raises(LookupError):
        found._call(one, print)


def test_only_the_worker_that_has_a_fold_is_heard(tmp_path):
    found = cluster.Cluster.__new__(cluster.Cluster)
    found.told, found.crew = tmp_path, crew_of(None)
    found.changing = found.crew.changing
    fold = cluster.Waiting(None, b"", by=crew.Remote("tcp://b:1", "b", 1))
    found.running = {("key", "anna"): fold}

    def said(command, by, words):
        found._hear([command, by, "key", "anna", words, None, 1.0, 0.0])
        return [one[:3] for one in told(tmp_path)]

    assert said("theirs", "tcp://b:1", "half") == []
    assert said("mine", "tcp://c:1", "half") == []  # which had it before
    assert said("mine", "tcp://b:1", "half") == [("key", "anna", "half")]
    fold.by = None  # it has to be done again, and what the lost worker said arrives late
    assert said("mine", "tcp://b:1", "late") == [("key", "anna", "half")]


def test_a_worker_is_examined_once_at_a_time_and_not_after_it_was_refused(monkeypatch):
    found, one, asked, answer = crew_of(None), crew.Remote("tcp://b:1", "b", 1, ready=True), [], threading.Event()
    monkeypatch.setattr(crew.Crew, "_admit", lambda self, one: (asked.append(one), answer.wait()))
    found.lines = queue.Queue()
    found.examine(one)
    assert not one.ready and not one.examined  # it is gone
    found.remotes[one.address] = one
    found.examine(one)
    found.examine(one)
    until(lambda: asked)
    answer.set()
    assert asked == [one] and one.examined and not one.ready
    found.refuse(one, "so")
    found.examine(one)
    assert not one.examined and asked == [one]


def test_a_worker_that_gives_no_sign_is_hung(monkeypatch):
    found, one, now = crew_of(None), crew.Remote("tcp://b:1", "b", 1), [1000.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    assert not found._silent(one, 5.0)
    now[0] += crew.SILENT_S - 1
    assert not found._silent(one, 5.0)
    now[0] += 2
    assert found._silent(one, 5.0) and not found._silent(one, 6.0)


def test_of_what_is_typed_in_the_files_that_it_uses_count(tmp_path, monkeypatch):
    """It travels itself, and so do its functions; a worker must have the files as they are here."""
    (tmp_path / "beside.py").write_text("def twice(x):\n    return 2 * x\n\n\ndef other():\n    return 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    import beside
    from sklearn.tree import DecisionTreeClassifier

    def typed(source):
        there = {"__name__": "__main__", "beside": beside, "Tree": DecisionTreeClassifier}
        exec(source, there)
        return there["Mine"]()

    direct = "class Mine(Tree):\n    def fit(self, X, y):\n        return super().fit(beside.twice(X), y)\n"
    through = "def f(x):\n    return beside.twice(x)\n\n\n" + direct.replace("beside.twice", "f")

    def digests():
        cases = [typed(direct), typed(through), typed("class Mine(Tree):\n    pass\n"), DecisionTreeClassifier()]
        found = [cells({"model": case, "features": "jung28"})[0] for case in cases]
        return [alike.digest_of(cell, Evaluation()) for cell in found]

    before = digests()
    assert before == digests()
    (tmp_path / "beside.py").write_text("def twice(x):\n    return 3 * x\n")
    assert [a != b for a, b in zip(before, digests(), strict=True)] == [True, True, False, False]
    jung = sys.modules["features.jung28"]
    changed = tmp_path / "jung28.py"
    changed.write_text(Path(jung.__file__).read_text() + "\nCHANGED = 1\n")
    monkeypatch.setattr(jung, "__file__", str(changed))  # features of a worker that are others
    assert all(a != b for a, b in zip(before, digests(), strict=True))


def test_the_address_in_a_schedulers_file(tmp_path):
    path = tmp_path / "any.name"
    path.write_text('{"type": "Scheduler", "address": "tcp://10.0.0.1:8786"}')
    assert crew.address_in(path) == "tcp://10.0.0.1:8786"
    for text in ("", "{", "[]", "{}", "12", '"a"'):
        path.write_text(text)
        with pytest.raises(ValueError, match="a scheduler has not written this file"):
            crew.address_in(path)
    with pytest.raises(OSError, match="no such file"):
        crew.address_in(tmp_path)


@pytest.mark.parametrize(("token", "name"), [("aa", "../evil"), ("aa", "/evil"), ("../aa", "frames.npy")])
def test_only_files_of_a_corpus_are_received(token, name, tmp_path):
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match="no file of a corpus"):
        remote.receive(token, name, 0, b"x")
    assert sorted(tmp_path.rglob("*")) == before


def test_a_worker_waits_while_it_is_wanted_and_no_longer_than_a_limit(monkeypatch):
    ended = []

    class Process:
        def shutdown(self, wait, kill_workers):
            ended.append(kill_workers)

    def watched(wanted, limit, began=None):
        return remote.watched(Process(), asked, wanted, limit, lambda: began)

    asked = Future()
    assert watched(lambda: True, 0.5, time.time()) == Answer("late", b"begun") and len(ended) == 1
    assert watched(lambda: False, None) == Answer("unwanted") and len(ended) == 2
    until = time.monotonic() + 2  # it has not begun, so the limit has no meaning yet
    assert watched(lambda: time.monotonic() < until, 0.5) == Answer("unwanted") and len(ended) == 3
    with monkeypatch.context() as patch:
        patch.setattr(remote, "READY_S", 0.5)
        assert watched(lambda: True, 0.5) == Answer("late") and len(ended) == 4
    asked.set_result(Answer("done", b"x"))
    assert watched(lambda: False, 0) == Answer("done", b"x") and len(ended) == 4


# With processes.

live = [pytest.mark.live, pytest.mark.skipif(shutil.which("true") is None, reason="signals")]
PATIENCE = 240  # seconds on a busy machine


@pytest.fixture(autouse=True)
def dask_is_there(request):
    if request.node.get_closest_marker("live"):
        pytest.importorskip(
            "distributed", reason="dask.distributed is not installed: pip install 'touchbench[cluster]'"
        )


@contextmanager
def dask(what, *arguments, **env):
    """``dask scheduler`` or ``dask worker``, in a group of its own that is killed at last."""
    said = Path(f"{what}_{time.time()}.txt").absolute()
    environment = os.environ | {"PYTHONPATH": str(ROOT), "TOUCHBENCH_HOME": str(Path("remote_home").absolute())} | env
    environment.pop("OMP_NUM_THREADS", None)
    with said.open("w") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{what}", *arguments, "--no-dashboard"],
            stdout=log,
            stderr=log,
            start_new_session=True,
            env=environment,
        )
    try:
        yield process
    finally:
        end(process.pid)
        process.wait()


def end(group):
    try:
        os.killpg(group, signal.SIGKILL)
    except ProcessLookupError:
        pass


@contextmanager
def scheduler(port=None):
    port = port or free_port()
    with dask("scheduler", "--host", "127.0.0.1", "--port", str(port)):
        yield f"tcp://127.0.0.1:{port}"


def workers(place, count=2, *more, **env):
    return dask("worker", place, "--nworkers", str(count), "--nthreads", "1", *more, **env)


@pytest.fixture
def two():
    with scheduler() as place, workers(place):
        yield place


@pytest.fixture
def slow(tmp_path):
    """The words that run the model above, and where it leaves its marks."""
    (tmp_path / "slow.py").write_text(MODEL)
    (tmp_path / "marks").mkdir()
    return ["run", "model=slow.py:Slow", f"model.marks={tmp_path / 'marks'}", *SMALL], tmp_path / "marks"


def marks(folder):
    """(fold, process, its parent) in the order in which they began."""
    found = [path.name.split("_") for path in folder.iterdir()]
    return [(fold, int(pid), int(parent)) for fold, pid, parent, _ in sorted(found, key=lambda m: float(m[3]))]


def until(true, seconds=PATIENCE):
    begun = time.monotonic()
    while not (found := true()):
        assert time.monotonic() - begun < seconds
        time.sleep(0.05)
    return found


def gone(pid):
    import psutil  # dask needs it

    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def begun(command, **how):
    return subprocess.Popen(
        [*BENCH, *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        **how,
    )


def mark_live(test):
    for mark in live:
        test = mark(test)
    return test


@mark_live
def test_folds_of_all_cells_are_done_there_and_are_the_same_bit_for_bit(two, tmp_path, monkeypatch, capsys):
    command = ["run", "model=svm,rf,cnn85", "model.trees=10", "model.epochs=2", "features=jung54", *SMALL]
    assert main([*command, f"cluster={two}"]) == 0
    found, (store, there) = stored(), runs("cell")
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/other.db")
    monkeypatch.setattr("bench.plan.plan.share_cores", lambda jobs, folds: (1, 1))  # as many threads as there
    assert main(command) == 0
    store, here = runs("cell")
    assert len(there) == 3 and {r.data.tags["touchbench.cell"] for r in there} == {
        r.data.tags["touchbench.cell"] for r in here
    }
    assert all(table.equals(found[name]) for name, table in stored().items())
    same = ("cpu", "simd", "threads", "corpus_digest", "version.numpy")
    assert all(a.data.params[k] == b.data.params[k] for a, b in zip(there, here, strict=True) for k in same)
    assert not any("cpu" in run.data.tags for run in there)
    capsys.readouterr()
    assert main([*command, f"cluster={two}"]) == 0 and "stored before" in capsys.readouterr().err


@mark_live
@pytest.mark.parametrize(
    ("command", "kind"),
    [
        (["tune", "model=svm", "features=jung28", "model.C=1,8"], "cell"),
        (["choose", "model=tree", "features=jung28", "over=features"], "cell"),
        (["stress", "model=bayes", "features=jung28", "faults=noise"], "stress"),
        (["stream", "model=bayes", "features=jung28", "start=onset,middle"], "stream"),
    ],
)
def test_every_kind_of_run(two, command, kind, capsys):
    assert main([*command, *SMALL, f"cluster={two}"]) == 0
    found = runs(kind)[1]
    assert found and {run.info.status for run in found} == {"FINISHED"}


@mark_live
def test_the_gate_and_an_object_of_the_users(two, tmp_path, monkeypatch, capsys):
    from sklearn.tree import DecisionTreeClassifier

    import bench

    added = ["data=synth", "model=bayes", "features=jung28", *SMALL]
    assert main(["check", "update=true", "baseline=b.json", *added]) == 0
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path}/other.db")
    assert main(["check", "baseline=b.json", f"cluster={two}"]) == 0
    assert "1 of 1 systems are what b.json says" in capsys.readouterr().out
    given = {"data__subjects": 4, "data__variants": "normal", "data__repetitions": 2, "features": "jung28"}
    table = bench.run(model=DecisionTreeClassifier(random_state=0), cluster=two, **given)
    assert list(table["folds"]) == ["4/4"]


def all_ready(self):
    while sum(one.ready for one in self.remotes.values()) < 2:
        self.look()
        time.sleep(0.1)


def lacking(tmp_path, monkeypatch):
    """A corpus ``mine`` in a data folder that has no meaning in the folder of workers that are apart."""
    assert main(["data", "export", "synth", "out.csv", "format=cost", "subjects=3", "variants=normal"]) == 0
    monkeypatch.setenv("TOUCHBENCH_HOME", "own")
    assert main(["data", "import", "cost", "out.csv", "name=mine"]) == 0
    (tmp_path / "elsewhere").mkdir()


@contextmanager
def apart(place, count, tmp_path, monkeypatch):
    """Workers with a data folder and a working folder of their own."""
    monkeypatch.chdir(tmp_path / "elsewhere")
    with workers(place, count, TOUCHBENCH_HOME=str(tmp_path / "remote_home")):
        monkeypatch.chdir(tmp_path)
        yield


@mark_live
def test_a_corpus_that_is_not_there_is_sent_once(tmp_path, monkeypatch, capsys):
    lacking(tmp_path, monkeypatch)
    home = tmp_path / "remote_home"
    with scheduler() as place:
        with apart(place, 2, tmp_path, monkeypatch):
            monkeypatch.setattr(crew, "CHUNK", 10_000)
            given, first = [], crew.Crew._send
            monkeypatch.setattr(crew.Crew, "_send", lambda *to: (given.append(to), first(*to)))
            # Both workers are asked, and found to lack it, before the command begins.
            monkeypatch.setattr(crew.Crew, "wait", all_ready)
            assert main(["run", "data=mine", "model=bayes", "features=jung28", f"cluster={place}"]) == 0
    corpus = open_corpus("mine", {})
    assert len(given) == 1
    assert [p.name for p in (home / "corpora").iterdir()] == [".sent"]
    (there,) = (home / "corpora" / ".sent").iterdir()
    assert open_folder(there).digest == corpus.digest and there.name == corpus.digest[:16]
    assert list((home / "features").glob("*.parquet")) and not (Path("own") / "features").exists()


@mark_live
def test_a_worker_with_other_code_is_left_out(tmp_path, capsys):
    for package in ("bench", "features", "models", "protocols", "reports"):
        shutil.copytree(ROOT / package, tmp_path / "old" / package)
    file = tmp_path / "old" / "models" / "svm.py"
    file.write_text(file.read_text() + "\nCHANGED = 1\n")
    with scheduler() as place, workers(place, 1, "--name", "old", PYTHONPATH=str(tmp_path / "old")):
        command = ["run", "model=svm", "features=jung28", *SMALL, f"cluster={place}"]
        assert main(command) == 2
        (*_, line) = capsys.readouterr().err.splitlines()
        assert "none of 1 workers can be used" in line and "its code of svm · jung28, loso differs" in line
        assert not Path("mlflow.db").exists()
        with workers(place, 1, "--name", "new"):
            assert until(lambda: main(command) == 0)
            told = capsys.readouterr().err
            assert "worker old is left out: its code" in told and "4/4" in told


@mark_live
@pytest.mark.parametrize(
    ("place", "why"),
    [
        ("tcp://127.0.0.1:1", "no scheduler answers"),
        ("nothing.json", "there is no such file"),
        ("what", "no scheduler answers"),
        ("bad.txt", "a scheduler has not written this file"),
        ("tls://127.0.0.1:1", "TLS expects a `ssl_context`"),
        ("ucx://127.0.0.1:1", "no scheduler answers"),
        ("tcp://..:1", "no scheduler answers"),
        ("carrier://pigeon", "no scheduler answers"),
    ],
)
def test_a_cluster_that_is_not_there(place, why, tmp_path):
    (tmp_path / "bad.txt").write_text('["tcp://127.0.0.1:1"]')
    out, error = begun(["run", *SMALL, f"cluster={place}"]).communicate(timeout=PATIENCE)
    (line,) = error.splitlines()  # nothing fails at the end
    assert why in line and not out and not Path("mlflow.db").exists()


@mark_live
def test_something_else_that_listens(monkeypatch, capsys):
    monkeypatch.setattr(crew, "ANSWER_S", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as mute:
        assert main(["run", *SMALL, f"cluster=tcp://127.0.0.1:{mute.getsockname()[1]}"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no scheduler answers (TimeoutError after 1 s)" in line


@mark_live
def test_a_scheduler_that_hangs_ends_the_command(slow, monkeypatch, capsys):
    command, folder = slow
    monkeypatch.setattr(crew, "SILENT_S", 3.0)
    with dask("scheduler", "--host", "127.0.0.1", "--port", str(port := free_port())) as process:
        place = f"tcp://127.0.0.1:{port}"
        with workers(place, 1):
            stop = threading.Thread(target=lambda: (until(lambda: marks(folder)), os.kill(process.pid, signal.SIGSTOP)))
            stop.start()
            assert main([*command, "model.seconds=30", f"cluster={place}"]) == 1
            stop.join()
    assert "the scheduler is gone, or does not answer; every finished" in capsys.readouterr().err


@mark_live
def test_a_cluster_without_workers(monkeypatch, capsys):
    monkeypatch.setattr(crew, "FIRST_S", 1.0)
    with scheduler() as place:
        assert until(lambda: main(["run", *SMALL, f"cluster={place}"]) == 2)
        assert f"has no worker; start some, such as: dask worker {place}" in capsys.readouterr().err


@mark_live
def test_a_fold_there_says_how_far_it_is(two, slow, monkeypatch, capsys):
    command, _ = slow
    real, heard = cluster.hear, []

    def hear(folder, said):
        real(folder, said)
        heard.append(([*said[1:3]], {found.words for found in told(folder)}))

    monkeypatch.setattr(cluster, "hear", hear)
    assert main([*command, "model.seconds=2", f"cluster={two}"]) == 0
    for fold in "1234":
        assert any(names == [fold, f"fold {fold} waits"] and f"fold {fold} waits" in seen for names, seen in heard)
    assert " left" in capsys.readouterr().err


@mark_live
def test_a_worker_that_is_killed_loses_no_fold(two, slow, capsys):
    command, folder = slow
    process = begun([*command, "model.seconds=4", f"cluster={two}"])
    fold, pid, worker = until(lambda: marks(folder))[0]
    os.kill(worker, signal.SIGKILL)
    out, error = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0 and "4/4" in out, error
    began = [m for m in marks(folder) if m[0] == fold]
    assert len(began) == 2 and began[1][2] != worker
    until(lambda: gone(pid))


@mark_live
def test_a_worker_that_is_killed_after_one_of_its_folds_has_died(slow):
    """Its new process is examined first, and what waits for the worker is not forgotten meanwhile."""
    command, folder = slow
    with scheduler() as place, workers(place, 1):
        process = begun([*command, "model.die=1", "model.seconds=3", f"cluster={place}"])
        _, _, worker = until(lambda: [m for m in marks(folder) if m[0] == "3"])[0]
        os.kill(worker, signal.SIGKILL)
        out, error = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1 and "3/4" in out and "fold 1 failed: The worker process died twice" in error, error


@mark_live
def test_a_fold_that_kills_its_process_fails_and_no_worker_does(two, slow, capsys):
    command, folder = slow
    command += ["model.die=3", f"cluster={two}"]
    assert main(command) == 1
    captured = capsys.readouterr()
    assert "fold 3 failed: The worker process died twice" in captured.err and "3/4" in captured.out
    died = [m for m in marks(folder) if m[0] == "3"]
    assert len(died) == 2 and died[0][2] != died[1][2]  # tried again, by another worker
    assert not any(gone(worker) for _, _, worker in marks(folder))
    assert main([*command[:-2], f"cluster={two}"]) == 0  # which takes the next command


@mark_live
def test_a_fold_that_exits_fails_and_nothing_else(two, slow, capsys):
    command, folder = slow
    for where in (f"cluster={two}", "jobs=2"):
        assert main([*command, "model.exit=3", where]) == 1
        captured = capsys.readouterr()
        assert "fold 3 failed: SystemExit: no more" in captured.err and "3/4" in captured.out
        assert sum(fold == "3" for fold, _, _ in marks(folder)) == 1 and not any(gone(w) for _, _, w in marks(folder))
        for path in folder.iterdir():
            path.unlink()


@mark_live
def test_a_worker_computes_with_the_code_that_is_there_now(tmp_path, monkeypatch):
    """Its process has the old code in memory, and would stay for the next command."""
    for package in ("bench", "features", "models", "protocols", "reports"):
        shutil.copytree(ROOT / package, tmp_path / "code" / package)
    file = tmp_path / "code" / "models" / "tree.py"
    command = ["run", "model=tree", "features=jung28", *SMALL]

    def labels(store, *where):
        env = {"PYTHONPATH": str(tmp_path / "code"), "MLFLOW_TRACKING_URI": f"sqlite:///{tmp_path}/{store}.db"}
        done = subprocess.run([*BENCH, *command, *where], capture_output=True, text=True, env=os.environ | env)
        assert done.returncode == 0, done.stderr
        monkeypatch.setenv("MLFLOW_TRACKING_URI", env["MLFLOW_TRACKING_URI"])
        store, found = runs("cell")
        return predictions(store, found[-1])

    with scheduler() as place, workers(place, 1, PYTHONPATH=str(tmp_path / "code")):
        before = labels("there", f"cluster={place}")
        file.write_text(file.read_text().replace("ccp_alpha=alpha", "max_depth=1"))
        after = labels("there", f"cluster={place}")
    here = labels("here", "jobs=1")
    assert after.equals(here) and not after.equals(before)


@mark_live
def test_a_worker_that_is_killed_while_a_corpus_is_sent_stops_nothing(tmp_path, monkeypatch, capsys):
    lacking(tmp_path, monkeypatch)
    first, killed = crew.Crew._call, []

    def call(self, one, function, *arguments):
        found = first(self, one, function, *arguments)
        if function is remote.receive and not killed:
            killed.append(one.address)
            (pid,) = self.client.run(os.getpid, workers=[one.address]).values()
            os.kill(pid, signal.SIGKILL)
            until(lambda: one.address not in self.remotes)
        return found

    monkeypatch.setattr(crew.Crew, "_call", call)
    with scheduler() as place, apart(place, 1, tmp_path, monkeypatch):
        assert main(["run", "data=mine", "model=bayes", "features=jung28", f"cluster={place}"]) == 0
    assert len(killed) == 1 and "3/3" in capsys.readouterr().out


@mark_live
def test_a_command_without_an_answer_of_any_worker_says_so_once(two, slow, monkeypatch, capsys):
    command, folder = slow
    process = begun([*command, "model.seconds=6", f"cluster={two}"])
    until(lambda: len(marks(folder)) == 2)
    monkeypatch.setattr(crew, "BUSY_S", 0.5)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "sqlite:///other.db")
    assert main(["run", "model=bayes", "features=jung28", *SMALL, f"cluster={two}"]) == 0
    assert capsys.readouterr().err.count("have not answered yet") == 1
    _, error = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, error


@mark_live
def test_a_fold_that_hangs_and_a_worker_that_does(two, slow, capsys, monkeypatch):
    command, folder = slow
    where = [f"cluster={two}"]
    assert main([*command, "model.hang=2", "limit=3", *where]) == 1
    captured = capsys.readouterr()
    assert "fold 2 failed: The fold took longer than limit=3 seconds" in captured.err and "3/4" in captured.out
    hung = [pid for fold, pid, _ in marks(folder) if fold == "2"]
    assert len(hung) == 1 and gone(hung[0])
    monkeypatch.setattr(crew, "SILENT_S", 15.0)
    stopped = {worker for _, _, worker in marks(folder)}.pop()
    first = cluster.Cluster.submit

    def stopping(self, task):
        """The worker is in order when it is asked, and hangs with its first fold."""
        until(lambda: sum(one.ready for one in self.crew.remotes.values()) == 2)
        first(self, task)
        os.kill(stopped, signal.SIGSTOP)

    monkeypatch.setattr(cluster.Cluster, "submit", stopping)
    try:
        assert main([*command, *where]) == 0
    finally:
        with suppress(ProcessLookupError):
            os.kill(stopped, signal.SIGCONT)
    assert "is left out: it does not answer" in capsys.readouterr().err


@mark_live
def test_the_scheduler_is_gone_and_the_same_command_goes_on(slow, capsys):
    command, folder = slow
    port = free_port()
    command += ["model.seconds=1.5", f"cluster=tcp://127.0.0.1:{port}"]
    with scheduler(port) as place, workers(place, 1):
        process = begun(command)
        until(lambda: len(marks(folder)) >= 3)
        last = marks(folder)[-1]
    out, error = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1 and "Traceback" not in error, error
    assert "the scheduler is gone, or does not answer; every finished fold is stored" in error.splitlines()[-1]
    until(lambda: gone(last[1]))
    store, (run,) = runs("cell")
    done = {f.info.run_id for f in store.folds(run.info.run_id) if f.info.status == "FINISHED"}
    assert run.info.status == "KILLED" and len(done) >= 1
    with scheduler(port) as place, workers(place, 1):
        assert until(lambda: main(command) == 0)
    store, (run,) = runs("cell")
    assert run.info.status == "FINISHED"
    assert done < {f.info.run_id for f in store.folds(run.info.run_id)}


@mark_live
def test_a_worker_that_comes_late_is_used_and_one_without_options_too(slow):
    command, folder = slow
    with scheduler() as place, workers(place, 1):
        process = begun([*command, "model.seconds=8", f"cluster={place}"])
        until(lambda: marks(folder))
        with workers(place, 1), dask("worker", place, "--nworkers", "1", "--nthreads", "3", "--name", "wide"):
            out, error = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, error
        assert "worker wide is left out: it was started with --nthreads 3, others with 1" in error
    assert len({worker for _, _, worker in marks(folder)}) == 2
    with scheduler() as place, dask("worker", place):  # one process with a thread for each core
        assert until(lambda: main([*command, f"cluster={place}"]) == 0)
    (run,) = [r for r in runs("cell")[1] if r.data.params["model.seconds"] == "0.0"]
    from dask.system import CPU_COUNT

    assert run.data.params["threads"] == str(CPU_COUNT)


@mark_live
@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGKILL])
def test_workers_stop_with_their_command_and_take_the_next(sign, two, slow):
    command, folder = slow
    process = begun([*command, "model.seconds=600", f"cluster={two}"])
    until(lambda: len(marks(folder)) == 2)
    os.kill(process.pid, sign)
    signalled = time.monotonic()
    folds = [pid for _, pid, _ in marks(folder)]
    until(lambda: all(map(gone, folds)), 20)
    took = time.monotonic() - signalled
    _, error = process.communicate(timeout=60)
    assert took < 10
    if sign == signal.SIGINT:
        assert process.returncode == 130 and "goes on from there" in error and "Traceback" not in error
    assert main([*command, f"cluster={two}"]) == 0
    assert {worker for _, _, worker in marks(folder)[2:]} == {worker for _, _, worker in marks(folder)[:2]}
