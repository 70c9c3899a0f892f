"""Workers of dask for a command: who is there, which of them give the results of this machine, what each is asked.

dask is asked for three things: who is there, to have a function called there, and to say when that is over. Everything
is asked of one worker by name, so that one that was not examined gets no fold.
"""

from __future__ import annotations

import asyncio
import json
import logging
import pickle
import queue
import secrets
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.corpora.folder import FILES, Address
from bench.errors import ClusterError, InputError
from bench.plan.cells import Cell
from bench.work import remote
from bench.work.alike import Facts, difference, facts
from bench.work.experiment import Experiment
from bench.work.remote import Answer

if TYPE_CHECKING:
    from distributed import Client

LOOK_S = 1.0  # between two looks at who is there
FIRST_S = 30.0  # for the first worker to come
BUSY_S = 10.0  # before it is said that no worker has answered yet
ANSWER_S = 10.0  # that a scheduler has to answer at first
SILENT_S = 60.0  # without a sign of a worker, or an answer of the scheduler, after which it is taken for hung
CHUNK = 4 << 20  # bytes of a corpus that are sent at a time
GOES_ON = "every finished fold is stored and the same command goes on from there"


@dataclass(eq=False)
class Remote:
    """A worker.

    Attributes:
        address: that dask knows it by.
        name: that lines call it by.
        threads: that it was started with.
        ready: whether it may do folds.
        refused: why it may not; empty while that is not known.
        examined: whether it is being asked what it has.
        asked: what it does.
        sign: the last that dask has seen of it, and since when, of `time.monotonic`.
    """

    address: str
    name: str
    threads: int
    ready: bool = False
    refused: str = ""
    examined: bool = False
    asked: set[Any] = field(default_factory=set)
    sign: tuple[float, float] = (0.0, 0.0)


class Crew:
    """Workers of a scheduler.

    Args:
        place: the scheduler.
        cells: one of each kind that is to be run.
        experiments: their kinds of run.
        corpora: that are needed, by digest.
        say: tells the user a line.

    Attributes:
        name: that workers know this command by.
        client: of dask.
        threads: of each fold, as most workers were started.
        remotes: who is there, by address.
        changing: holds all that threads change.

    Raises:
        InputError: there is no such scheduler.
    """

    def __init__(
        self,
        place: str,
        cells: Sequence[Cell],
        experiments: Sequence[Experiment],
        corpora: dict[str, Address],
        say: Callable[[str], None],
    ) -> None:
        self.place, self.corpora, self.say = place, corpora, say
        self.systems = [f"{cell.system()}, {cell.protocol}" for cell in cells]
        self.name = secrets.token_hex(8)
        asked = (cells, experiments, list(corpora.values()))
        # Versions first: under others, the rest may not even be understood.
        self.questions = [
            (packed(facts, (), (), ()), facts((), (), ())),
            (packed(remote.examined, self.name, *asked), facts(*asked)),
        ]
        self.remotes: dict[str, Remote] = {}
        self.lines: queue.Queue[str] = queue.Queue()  # from threads
        self.changing = threading.RLock()
        self.sending: dict[tuple[str, str, str], threading.Lock] = defaultdict(threading.Lock)
        self.looked, self.threads = float("-inf"), 0  # until the first worker has come
        self.freed: Callable[[], None] = lambda: None  # called when a worker may do folds
        self.client = connected(place)

    def wait(self) -> None:
        """Until one worker may do folds.

        Raises:
            InputError: none comes, or all that are there differ from this machine.
        """
        begun, told = time.monotonic(), False
        while True:
            self.look()
            with self.changing:
                there = list(self.remotes.values())
            if any(r.ready for r in there):
                return
            if there and all(r.refused for r in there):
                raise InputError(f"cluster={self.place}: none of {len(there)} workers can be used; {there[0].refused}")
            waited = time.monotonic() - begun
            if there and waited > BUSY_S and not told:
                doing = "have not answered yet: they import, or do folds of another command"
                self.say(f"warning: cluster={self.place}: its {len(there)} workers {doing}; waiting, Ctrl-C ends it")
                told = True
            if not there and waited > FIRST_S:
                raise InputError(
                    f"cluster={self.place}: it has no worker; start some, such as: dask worker {self.place} "
                    "--nworkers 4 --nthreads 1"
                )
            time.sleep(0.1)

    def look(self) -> bool:
        """See who has come and who is gone, once in a while; whether there is one that may do folds, or may yet.

        Raises:
            ClusterError: the scheduler is gone.
        """
        self.tell()
        now = time.monotonic()
        if now - self.looked >= LOOK_S:
            self.looked = now
            self._meet(self._there())
        with self.changing:
            return any(not r.refused for r in self.remotes.values())

    def _meet(self, there: dict[str, dict[str, Any]]) -> None:
        if there and not self.threads:
            numbers = Counter(about["nthreads"] for about in there.values())
            self.threads = min(numbers, key=lambda n: (-numbers[n], n))
        with self.changing:
            gone = [r for name, r in self.remotes.items() if name not in there]
            for one in gone:
                del self.remotes[one.address]
            silent = [r for r in self.remotes.values() if self._silent(r, there[r.address]["last_seen"])]
            waited_for = [asked for one in (*gone, *silent) for asked in one.asked]
        for one in silent:
            self.refuse(one, "it does not answer")
        for asked in waited_for:
            asked.cancel()  # whoever waits for it hears of it
        come = [Remote(name, str(about["name"]), about["nthreads"]) for name, about in there.items()]
        for one in come:
            if one.address not in self.remotes:
                with self.changing:
                    self.remotes[one.address] = one
                self.examine(one)

    def _silent(self, one: Remote, seen: float) -> bool:
        """Whether a worker, which always has time to answer dask, has given no sign for long."""
        now = time.monotonic()
        if seen != one.sign[0]:
            one.sign = seen, now
        return not one.refused and now - one.sign[1] > SILENT_S

    def tell(self) -> None:
        """Say what threads have found: they would write into the bars."""
        while not self.lines.empty():
            self.say(self.lines.get())

    def _there(self) -> dict[str, dict[str, Any]]:
        """What the scheduler says of each of its workers.

        Raises:
            ClusterError: it is gone.
        """
        scheduler: Any = self.client.scheduler
        if self.client.status != "running":
            raise self._gone()
        try:  # dask's own `scheduler_info` may be overwritten by another thread before it is returned
            return self.client.sync(scheduler.identity, n_workers=-1, callback_timeout=SILENT_S)["workers"]
        except (OSError, TimeoutError, RuntimeError) as e:
            raise self._gone() from e

    def examine(self, one: Remote) -> None:
        """Find out, in a thread, whether a worker may do folds."""
        with self.changing:
            one.ready = False
            if one.examined or one.refused or self.remotes.get(one.address) is not one:
                return
            one.examined = True
        threading.Thread(target=self._admit, args=(one,), daemon=True).start()

    def _admit(self, one: Remote) -> None:
        """Ask a worker what it has, and send the corpora that its machine lacks."""
        try:
            if one.threads != self.threads:
                raise InputError(f"it was started with --nthreads {one.threads}, others with {self.threads}")
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
                one.ready, one.examined = not one.refused, False
            self.freed()
        except InputError as e:
            self.refuse(one, str(e))
        except BaseException as e:  # dask raises what it likes: the worker is gone, or the command ends
            with self.changing:
                there_still = self.client.status == "running" and self.remotes.get(one.address) is one
            if there_still:
                why = f"it cannot be asked: {type(e).__name__}: {e}"
                self.refuse(one, f"{why}; is touchbench installed there, and was it started anew after an upgrade?")

    def refuse(self, one: Remote, why: str) -> None:
        """Leave a worker out."""
        with self.changing:
            one.ready, one.examined = False, False
            one.refused = f"worker {one.name} is left out: {' '.join(why.split())}"
        self.lines.put(f"warning: {one.refused}")

    def _ask(self, one: Remote, question: bytes) -> Any:
        """What a function gives on a worker.

        Raises:
            InputError: it failed there.
        """
        for _ in range(2):
            found: Answer = self._call(one, remote.answer, question, self.name, self.threads)
            if found.status in ("done", "raised"):
                break
        if found.status != "done":
            raise InputError((found.content.decode().strip().splitlines() or ["its process died"])[-1])
        return pickle.loads(found.content)

    def _call(self, one: Remote, function: Callable, *arguments: object) -> Any:
        """What a function gives in a worker itself; waits for it.

        Raises:
            LookupError: the worker is gone; dask would wait for it.
        """
        with self.changing:
            if self.remotes.get(one.address) is not one:
                raise LookupError("it is gone")
            asked = self.begin(one, function, *arguments)
        try:
            return asked.result()
        finally:
            with self.changing:
                one.asked.discard(asked)

    def begin(self, one: Remote, function: Callable, *arguments: object) -> Any:
        """Have a function called in a worker itself; whoever asks holds ``changing``.

        Raises:
            ClusterError: the scheduler is gone.
        """
        there: dict[str, Any] = {"workers": [one.address], "allow_other_workers": False}
        try:
            asked = self.client.submit(function, *arguments, **there, pure=False)
            one.asked.add(asked)
            return asked
        except Exception as e:  # dask has several
            if self.client.status == "running":
                raise
            raise self._gone() from e

    def _gone(self) -> ClusterError:
        return ClusterError(f"cluster={self.place}: the scheduler is gone, or does not answer; {GOES_ON}")

    def _send(self, one: Remote, corpus: Address) -> None:
        """Send a corpus, a piece of a file after the other."""
        token, folder = secrets.token_hex(8), ""
        for name in ("corpus.json", *FILES):
            with (corpus.path / name).open("rb") as file:
                while content := file.read(CHUNK):
                    place = file.tell() - len(content)
                    folder = self._call(one, remote.receive, token, name, place, content)
        self._ask(one, packed(remote.adopt, folder, corpus.digest))


def connected(place: str) -> Client:
    """Dask's client of a scheduler.

    Args:
        place: its address, or the file that it has written it into.

    Raises:
        InputError: dask is not installed, or no scheduler answers there.
    """
    try:
        from distributed import Client
    except ImportError as e:
        raise InputError(f"cluster={place}: dask is not installed; pip install 'touchbench[cluster]'") from e
    for name in ("distributed.client", "distributed.core"):  # what they say of lost connections, we say
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        where = address_in(Path(place)) if _named_like_a_file(place) else place
        with ThreadPoolExecutor(1) as thread:  # in a notebook, a loop runs in this one
            thread.submit(asyncio.run, _greeted(where)).result()
        return Client(where, timeout=ANSWER_S, set_as_default=False)
    except Exception as e:  # dask has many
        said = " ".join(str(e).split()) or f"{type(e).__name__} after {ANSWER_S:g} s"
        raise InputError(
            f"cluster={place}: no scheduler answers ({said[:80]}); give tcp://HOST:8786 of one that runs, or the file "
            "that it was started with (--scheduler-file)"
        ) from e


async def _greeted(where: str) -> None:
    """Ask a scheduler for its name: dask's client waits for ever for what answers otherwise, and ends badly."""
    from distributed import Security
    from distributed.core import rpc

    async with rpc(where, connection_args=Security().get_connection_args("client")) as scheduler:
        await asyncio.wait_for(scheduler.identity(n_workers=0), ANSWER_S)


def _named_like_a_file(place: str) -> bool:
    return "://" not in place and (Path(place).exists() or Path(place).suffix == ".json" or "/" in place)


def address_in(file: Path) -> str:
    """The address that a scheduler has written into a file.

    Raises:
        OSError: it cannot be read.
        ValueError: there is none in it.
    """
    if not file.is_file():
        raise OSError("there is no such file")
    with file.open("rb") as content:
        text = content.read(1 << 20)
    try:
        return str(json.loads(text)["address"])
    except (KeyError, TypeError, ValueError) as e:
        raise ValueError("a scheduler has not written this file") from e


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
