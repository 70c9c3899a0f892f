"""Folds on a cluster of dask.distributed: which workers may do them, who does which, and what happens when one is gone.

dask is asked for three things: who is there, to have a function called there, and to say when that is over. Each worker
gets one fold at a time, by name, so that a worker that was not checked gets none, and the fold of one that is gone goes
to another.
"""

from __future__ import annotations

import logging
import pickle
import queue
import secrets
import threading
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from bench.corpora.folder import FILES, Address, address
from bench.errors import ClusterError, InputError
from bench.outcomes.results import FoldResult
from bench.plan.arguments import Backend
from bench.plan.plan import Plan
from bench.progress import Said, forget, note
from bench.work import remote
from bench.work.remote import Answer, Facts
from bench.work.workers import Done, Task, Todo

if TYPE_CHECKING:
    from distributed import Client

    from bench.work.machine import Machine

LOOK_S = 1.0  # between two looks at who is there
FIRST_S = 30.0  # for the first worker to come
NEXT_S = 600.0  # for another one, after the last is gone
SILENT_S = 60.0  # beyond the limit of a fold, after which its worker is taken for hung
TRIES = {"died": 2, "lost": 3}  # of a fold whose process died, and of one whose worker is gone
CHUNK = 4 << 20  # bytes of a corpus that are sent at a time


@dataclass(eq=False)
class Remote:
    """A worker.

    Attributes:
        address: that dask knows it by.
        name: that lines call it by.
        ready: whether it may do folds.
        refused: why it may not; empty while that is not known.
        asked: what it does, None while it has nothing to do.
        task: the fold that it does.
        since: when it began.
    """

    address: str
    name: str
    ready: bool = False
    refused: str = ""
    asked: Any = None
    task: Task | None = None
    since: float = 0.0


@dataclass(eq=False)
class Waiting:
    """A fold that is to be done.

    Attributes:
        task: it.
        question: as it is sent.
        tried: on which workers it came to no end, by how.
    """

    task: Task
    question: bytes
    tried: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))


class Cluster:
    """Workers of dask (`bench.work.workers.Workers`).

    Args:
        backend: where its scheduler is, and how long a fold may take.
        todo: all that is to be run.
        say: tells the user a line.
        told: folder where folds say how far they are (`bench.progress`).

    Attributes:
        threads: of each fold, as the workers were started.

    Raises:
        InputError: there is no such cluster, or none of its workers can be used.
    """

    overlap = True

    def __init__(self, backend: Backend, todo: Todo, say: Callable[[str], None], told: Path) -> None:
        self.place, self.limit, self.say, self.told = backend.cluster, backend.limit, say, told
        plans = [plan for plan, _ in todo]
        self.corpora = {plan.corpus.digest: address(plan.corpus) for plan in plans}
        cells, experiments = representatives(todo)
        asked = (cells, experiments, list(self.corpora.values()))
        self.systems = [f"{cell.system()}, {cell.protocol}" for cell in cells]
        # Versions first: under others, the rest may not even be understood.
        self.questions = [(packed(remote.facts, *q), remote.facts(*q)) for q in (((), (), ()), asked)]
        self.remotes: dict[str, Remote] = {}
        self.waiting: deque[Waiting] = deque()
        self.running: dict[Task, Waiting] = {}
        self.answers: queue.Queue[tuple[Remote, Waiting, Any]] = queue.Queue()
        self.lines: queue.Queue[str] = queue.Queue()  # from threads
        self.changing = threading.RLock()  # of all that stands above
        self.sending: dict[tuple[str, str, str], threading.Lock] = defaultdict(threading.Lock)
        self.looked, self.seen, self.waited = 0.0, time.monotonic(), False  # at whom, that one was there, for another
        self.threads = 0  # until the first worker has come
        self.client = connected(self.place)
        self.topic = f"touchbench {secrets.token_hex(8)}"  # under which workers say how far they are
        self.client.subscribe_topic(self.topic, lambda event: hear(told, event[1]))
        try:
            self._wait_for_workers()
        except BaseException:
            self.client.close()
            raise

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, kind: type[BaseException] | None, e: BaseException | None, at: TracebackType | None) -> None:
        """Part from the cluster, whose workers then end what they do for this command."""
        with self.changing:
            self.waiting.clear()
        self.client.close(timeout=5)
        self._tell()

    def count(self, plan: Plan) -> int:
        """How many folds are done at a time."""
        with self.changing:
            return max(1, sum(r.ready for r in self.remotes.values()))

    def room(self, plan: Plan) -> bool:
        """Whether to submit a fold now: twice as many as can run, so that no worker waits while results are stored."""
        with self.changing:
            return len(self.running) < 2 * self.count(plan)

    def begin(self, plan: Plan) -> None:
        """Nothing: each machine computes its own features."""

    def submit(self, task: Task) -> None:
        """Have a fold done."""
        plan = task.plan
        question = packed(remote.fold, task.experiment, plan.cell, plan.corpus, task.fold, self.threads)
        with self.changing:
            self.running[task] = Waiting(task, question)
            self.waiting.append(self.running[task])
        self._dispatch()

    def finished(self) -> Done:
        """Wait until a fold that was submitted is done.

        Raises:
            ClusterError: the scheduler is gone, or all workers for too long.
        """
        while True:
            self._look()
            try:
                found = self._done(*self.answers.get(timeout=LOOK_S / 2))
            except queue.Empty:
                continue
            if found:
                return found

    def _wait_for_workers(self) -> None:
        """Until one worker may do folds.

        Raises:
            InputError: none comes, or all that are there differ from this machine.
        """
        until = time.monotonic() + FIRST_S
        while True:
            self._look()
            with self.changing:
                there = list(self.remotes.values())
            if any(r.ready for r in there):
                return
            if there and all(r.refused for r in there):
                raise InputError(f"cluster={self.place}: none of {len(there)} workers can be used; {there[0].refused}")
            if not there and time.monotonic() > until:
                raise InputError(
                    f"cluster={self.place}: it has no worker; start some, such as: dask worker {self.place} "
                    "--nworkers 4 --nthreads 1"
                )
            time.sleep(0.1)

    def _look(self) -> None:
        """See who has come and who is gone, once in a while."""
        self._tell()
        now = time.monotonic()
        if now - self.looked < LOOK_S:
            return
        self.looked = now
        there = self._there()
        if there and not self.threads:
            numbers = Counter(about["nthreads"] for about in there.values())
            self.threads = min(numbers, key=lambda n: (-numbers[n], n))
        with self.changing:
            gone = [r for name, r in self.remotes.items() if name not in there]
            come = [Remote(name, str(about["name"])) for name, about in there.items() if name not in self.remotes]
            for one in gone:
                del self.remotes[one.address]
            for one in come:
                self.remotes[one.address] = one
            most = self.limit + SILENT_S if self.limit else float("inf")
            silent = [r for r in self.remotes.values() if r.task and now - r.since > most]
            ready = any(r.ready or not r.refused for r in self.remotes.values())
        for one in silent:
            self._refuse(one, "it does not answer")
        for one in (*gone, *silent):
            if one.asked is not None:
                one.asked.cancel()  # whoever waits for it hears of it
        for one in come:
            threading.Thread(target=self._admit, args=(one, there[one.address]["nthreads"]), daemon=True).start()
        if ready:
            self.seen, self.waited = now, False
        elif self.running and not self.waited:
            self.say(f"warning: cluster={self.place}: no worker is left; waiting for another one")
            self.waited = True
        elif self.running and now - self.seen > NEXT_S:
            raise ClusterError(f"cluster={self.place}: all workers are gone; {GOES_ON}")

    def _tell(self) -> None:
        """Say what threads have found: they would write into the bars."""
        while not self.lines.empty():
            self.say(self.lines.get())

    def _there(self) -> dict[str, dict[str, Any]]:
        """What the scheduler says of each of its workers.

        Raises:
            ClusterError: it is gone.
        """
        if self.client.status != "running":
            raise self._gone()
        try:
            return self.client.scheduler_info()["workers"]
        except (OSError, TimeoutError, RuntimeError) as e:
            raise self._gone() from e

    def _admit(self, one: Remote, threads: int) -> None:
        """Find out, in a thread, whether a worker may do folds; a corpus that its machine lacks is sent."""
        try:
            if threads != self.threads:
                raise InputError(f"it was started with --nthreads {threads}, others with {self.threads}")
            for question, here in self.questions:
                there: Facts = self._ask(one, question)
                if said := difference(self.systems, here, there):
                    raise InputError(said)
            for digest in there.lacks:
                with self.changing:
                    lock = self.sending[there.host, there.home, digest]
                with lock:  # its other workers wait, and find it there
                    if digest in self._ask(one, question).lacks:
                        self._send(one, self.corpora[digest])
            with self.changing:
                one.ready = True
            self._dispatch()
        except InputError as e:
            self._refuse(one, str(e))
        except BaseException as e:  # dask raises what it likes: the worker is gone, or the command ends
            with self.changing:
                there_still = self.client.status == "running" and one.address in self.remotes
            if there_still:
                self._refuse(one, f"it cannot be asked: {type(e).__name__}: {e}; is touchbench installed there?")

    def _refuse(self, one: Remote, why: str) -> None:
        with self.changing:
            one.ready, one.refused = False, f"worker {one.name} is left out: {' '.join(why.split())}"
        self.lines.put(f"warning: {one.refused}")

    def _ask(self, one: Remote, question: bytes) -> Any:
        """What a function gives on a worker.

        Raises:
            InputError: it failed there.
        """
        found: Answer = self._call(one, remote.answer, question, self.threads, None, "")
        if found.status != "done":
            raise InputError((found.content.decode().strip().splitlines() or ["its process died"])[-1])
        return pickle.loads(found.content)

    def _call(self, one: Remote, function: Callable, *arguments: object) -> Any:
        """What a function gives in a worker itself; waits for it."""
        one.asked = self._begin(one, function, *arguments)
        try:
            return one.asked.result()
        finally:
            one.asked = None

    def _begin(self, one: Remote, function: Callable, *arguments: object) -> Any:
        """Have a function called in a worker itself.

        Raises:
            ClusterError: the scheduler is gone.
        """
        there: dict[str, Any] = {"workers": [one.address], "allow_other_workers": False}
        try:
            return self.client.submit(function, *arguments, **there, pure=False)
        except Exception as e:  # dask has several
            if self.client.status == "running":
                raise
            raise self._gone() from e

    def _gone(self) -> ClusterError:
        return ClusterError(f"cluster={self.place}: the scheduler is gone; {GOES_ON}")

    def _send(self, one: Remote, corpus: Address) -> None:
        """Send a corpus, a piece of a file after the other."""
        token, folder = secrets.token_hex(8), ""
        for name in ("corpus.json", *FILES):
            with (corpus.path / name).open("rb") as file:
                while content := file.read(CHUNK):
                    folder = self._call(one, remote.receive, token, name, content)
        self._ask(one, packed(remote.adopt, folder, corpus.digest))

    def _dispatch(self) -> None:
        """Give folds that wait to workers that do nothing; one that ended badly goes to another if there is one."""
        with self.changing:
            ready = [r for r in self.remotes.values() if r.ready]
            idle = [r for r in ready if r.asked is None]
            for waiting in list(self.waiting):
                bad = {name for names in waiting.tried.values() for name in names}
                fresh = [r for r in idle if r.name not in bad]
                if not fresh and any(r.name not in bad for r in ready):
                    continue
                if not (able := fresh or idle):
                    return
                one = able[0]
                idle.remove(one)
                self.waiting.remove(waiting)
                one.task, one.since = waiting.task, time.monotonic()
                asked = (waiting.question, self.threads, self.limit, self.topic)
                one.asked = self._begin(one, remote.answer, *asked)
                one.asked.add_done_callback(partial(self._over, one, waiting))

    def _over(self, one: Remote, waiting: Waiting, asked: Any) -> None:
        """Called in a thread of dask's."""
        with self.changing:
            if one.asked is asked:
                one.asked = one.task = None
        self.answers.put((one, waiting, asked))
        try:
            self._dispatch()
        except ClusterError:  # or the command has ended
            pass

    def _done(self, one: Remote, waiting: Waiting, asked: Any) -> Done | None:
        """What came of a fold, None if it has to be done again."""
        task, found = waiting.task, Answer("lost")
        try:
            if asked.status == "finished":
                found = asked.result(timeout=SILENT_S)
            elif asked.status == "error":
                self._refuse(one, f"it failed: {asked.exception()!r}")
        except (OSError, TimeoutError, RuntimeError):  # it went with its answer
            pass
        status = "lost" if found.status == "unwanted" else found.status
        if status == "done":
            result, machine = pickle.loads(found.content)
            return self._ended(task, result, machine)
        if status in TRIES:
            waiting.tried[status].append(one.name)
            if len(waiting.tried[status]) < TRIES[status]:
                with self.changing:
                    self.waiting.appendleft(waiting)
                self._dispatch()
                return None
        said = {
            "died": "The worker process died twice; out of memory?",
            "lost": f"Its worker was gone {TRIES['lost']} times; does the fold bring the machine down?",
            "late": f"The fold took longer than limit={self.limit:g} seconds" if self.limit else "",
            "raised": found.content.decode(),
        }[status]
        return self._ended(task, FoldResult(task.fold.name, error=said), None)

    def _ended(self, task: Task, result: FoldResult, machine: Machine | None) -> Done:
        forget(self.told, task.plan.cell.title(), task.fold.name)  # of a worker that is gone, nobody else would
        with self.changing:
            del self.running[task]
        return Done(task, result, machine)


def hear(folder: Path, heard: list) -> None:
    """Note what a fold says that is done elsewhere, by the clock of this machine, or that it says nothing any longer.

    Args:
        folder: of `bench.progress`.
        heard: as `bench.work.remote.watched` sends it.
    """
    of, name, *rest = heard
    if not rest:
        forget(folder, of, name)
        return
    words, left, elapsed, since = rest
    now = time.time()
    note(folder, Said(of, name, words, left, now - elapsed, now - since))


GOES_ON = "every finished fold is stored and the same command goes on from there"


def connected(place: str) -> Client:
    """Dask's client of a scheduler.

    Args:
        place: its address, or the file that it has written it into.

    Raises:
        InputError: dask is not installed, or nothing answers there.
    """
    try:
        from distributed import Client
    except ImportError as e:
        raise InputError(f"cluster={place}: dask is not installed; pip install 'touchbench[cluster]'") from e
    for name in ("distributed.client", "distributed.core"):  # what they say of lost connections, we say
        logging.getLogger(name).setLevel(logging.CRITICAL)
    by_file = "://" not in place and Path(place).suffix == ".json"
    try:
        if by_file and not Path(place).is_file():
            raise OSError("there is no such file")
        where = {"scheduler_file": place} if by_file else {"address": place}
        return Client(**where, timeout=10, set_as_default=False)
    except (OSError, TimeoutError, ValueError, KeyError, ImportError) as e:
        said = " ".join(str(e).split()) or type(e).__name__
        raise InputError(
            f"cluster={place}: no scheduler answers ({said[:80]}); give tcp://HOST:8786 of one that runs, or its file"
        ) from e


def packed(function: Callable, *arguments: object) -> bytes:
    """A call as it travels; dask's own workers do not open it.

    Raises:
        InputError: an object of the user's cannot be pickled.
    """
    import cloudpickle

    try:
        return cloudpickle.dumps((function, arguments))
    except (TypeError, AttributeError, pickle.PicklingError) as e:
        raise InputError(f"cluster=: what is run cannot be sent to a worker ({e}); leave cluster= out") from e


def representatives(todo: Todo) -> tuple[list, list]:
    """Cells and kinds of run, one of each that share all their code."""
    found: dict[tuple, tuple] = {}
    for plan, experiment in todo:
        cell = plan.cell
        parts = [part for part in (cell.protocol, cell.features, cell.model) if part is not None]
        names = [(p.room, p.name, p.module, id(p.given) if p.given else 0, *sorted(p.parameters)) for p in parts]
        found.setdefault((type(experiment), cell.tuning is None, *names), (cell, experiment))
    return [cell for cell, _ in found.values()], [experiment for _, experiment in found.values()]


def difference(systems: list[str], here: Facts, there: Facts) -> str:
    """The first thing that makes a worker's results others than this machine's; empty if there is none.

    Args:
        systems: what is called by these names here was asked about, in this order.
        here: what this machine has.
        there: what the worker has.
    """
    for name in (*here.versions, *there.versions):
        if here.versions.get(name) != (other := there.versions.get(name)):
            return f"it has {name} {other or 'not at all'}, this machine {here.versions.get(name) or 'not at all'}"
    for name, digest, other, why in zip(systems, here.code, there.code, there.wrong, strict=False):
        if why:
            return f"{name}: {why}"
        if digest != other:
            return f"its code of {name} differs from this machine's"
    return ""
