"""Frozen tasks: captures, subset, protocol and unit under a name, so that all results can be compared.

What a name means never changes; a task that is mended gets a new one, with ``-v2`` at its end.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import numpy as np
import pandas as pd

from bench.corpora.corpus import Corpus
from bench.corpora.library import open_corpus
from bench.corpora.read import cost
from bench.corpora.read.limits import quoted
from bench.errors import InputError, nearest
from bench.options import Maker, makers
from bench.result import Result
from bench.usual import NO_TOUCH

HAART = "d086fb847e3caddb00adea342d9b33818a69d2866419d9caf8ce84b50bd34a8f"
CUDDLEBOT = "3b64981c717155af5277d8945cc9cc94d7f573998c1d5f65c55e5f05c7b9620e"
RATE_HZ = 54.0  # of HAART
INSTANTS_MS = (500, 1000, 2000, 4000, 8000)
DRAWS = 5
# Frozen with the tasks, so not that of bench.usual: another default of bench watch must not change a task.
FALSE_ALARMS = 5.0  # per hour of background, at most, where touches are found in recordings
CLEAN = "none"
FAULT = ("fault", "severity")  # keys of a task under faults
RUN = "run"  # the command whose runs label captures as they are


@dataclass(frozen=True)
class Task:
    """Data, protocol and unit under a name. The subset is the whole corpus and the class the gesture, in all of them.

    Attributes:
        name: name with its version at the end.
        protocol: protocol label of its runs.
        protocol_text: the protocol in words.
        unit: meaning of one row of predictions.
        score: the rows that accuracy is of, in words.
        command: bench command whose run answers the task; a run of another answers it if it has the same circumstance.
        needs: parameters that its runs must have: the name of each, and the values that it may have.
        keys: columns that, with ``capture``, name a row.
        split: the part of the corpus that is tested, empty for all of it.
        data: name of the corpus.
        digest: digest of the imported corpus; empty for CoST, which is identified by the MD5 of its file.
    """

    name: str
    protocol: str
    protocol_text: str
    unit: str
    score: str
    command: str = RUN
    needs: tuple[tuple[str, ...], ...] = ()
    keys: tuple[str, ...] = ()
    split: str = ""
    data: str = "haart"
    digest: str = HAART

    @property
    def maker(self) -> Maker:
        """The kind of its runs, and the class that gives its rows: the kind, or a circumstance."""
        return makers()[self.command]

    @property
    def watched(self) -> bool:
        """True for a task whose predictions are events reported in recordings."""
        return self.maker.kind.recordings

    @property
    def plain(self) -> bool:
        """True for a task that has one label for each capture as it is."""
        return self.command == RUN and not self.keys

    def held_by(self, run: Result) -> bool:
        """Whether a run is of the kind of the task, in its circumstance."""
        return run.kind == self.maker.kind.tag and self.maker.view.holds(run)

    @property
    def names(self) -> tuple[str, ...]:
        """Columns that name a row of predictions."""
        return ("subject", "reported") if self.watched else ("capture", *self.keys)

    def circumstances(self) -> list[tuple[str, ...]]:
        """Values of `keys` that every capture is tested under, as text."""
        match self.keys:
            case ("ms",):
                return [(str(ms),) for ms in INSTANTS_MS]
            case ("draw",):
                return [(str(draw),) for draw in range(1, DRAWS + 1)]
        return [*faults()] if self.keys == FAULT else [()]


CAPTURE = "capture: one label each, by mean probability of a system that decides several times"
LOSO = "leave one subject out (10 subjects)"
_TASKS = (
    Task("haart-loso-v1", "loso", LOSO, CAPTURE, "829 captures"),
    Task(
        "haart-challenge-v1",
        "challenge",
        "the split of the 2015 challenge: 578 captures of 7 subjects to train on, 251 of 3 others to test",
        CAPTURE,
        "251 captures",
        split="test",
    ),
    Task(
        "haart-early-v1",
        "loso",
        f"{LOSO}; trained on whole captures, predictions from the touch so far",
        "the label of a capture 0.5, 1, 2, 4 and 8 s after its onset",
        "829 captures at 5 times",
        command="stream",
        needs=(("stream.start", "onset"),),
        keys=("ms",),
    ),
    Task(
        "haart-faults-v1",
        "loso",
        f"{LOSO}; tested under 17 faults at 5 severities, trained on clean captures",
        "a capture under a fault at a severity, one label each",
        "829 captures under 17 faults at 5 severities, without the clean ones",
        command="stress",
        keys=FAULT,
    ),
    Task(
        "haart-personal-v1",
        "personal[shots=3]",
        "a new person with up to 3 labelled captures of each gesture, 5 draws, seed 0",
        "a capture in a draw, one label each",
        "829 captures in 5 draws",
        keys=("draw",),
    ),
    Task(
        "haart-watch-v1",
        "loso",
        f"{LOSO}; one recording of each, composed of captures, with at most {FALSE_ALARMS:g} false alarms per hour of "
        "background",
        "a touch in a recording, one label each (the last reported)",
        "710 touches, by their last label",
        command="watch",
        needs=(
            ("watch.false_alarms", f"{FALSE_ALARMS}"),
            ("watch.background", "", NO_TOUCH),  # of HAART both are the same
            ("watch.unknown", ""),
        ),
    ),
    Task(
        "cuddlebot-loso-v1",
        "loso",
        "leave one subject out (16 subjects)",
        CAPTURE,
        "902 captures",
        data="cuddlebot",
        digest=CUDDLEBOT,
    ),
    Task(
        "cost-loso-v1",
        "loso",
        "leave one subject out (31 subjects)",
        CAPTURE,
        "7805 captures",
        data="cost",
        digest="",
    ),
)
TASKS = {task.name: task for task in _TASKS if task.command in makers()}  # that something here can answer


def task_of(name: str) -> Task:
    """The task of a name.

    Raises:
        InputError: there is none.
    """
    if name not in TASKS:
        raise InputError(f"no task is called {quoted(name)}; {nearest(name, TASKS)}")
    return TASKS[name]


def digest_of(task: Task) -> str:
    """Digest of the captures of a task.

    Raises:
        InputError: CoST is not here as it was published.
    """
    return task.digest or published_cost().digest


def captures_of(task: Task) -> pd.DataFrame:
    """Position, ``subject`` and ``gesture`` of every capture that a task tests; ``capture`` is the position as text.

    HAART's and CuddleBot's are known here; those of CoST are read from the imported corpus.

    Raises:
        InputError: CoST is not here as it was published.
    """
    if task.digest:
        captures = _table(f"{task.data}.csv")
    else:
        captures = published_cost().captures
        captures = captures.assign(capture=[str(i) for i in range(len(captures))])
    if task.split:
        captures = captures[captures["split"] == task.split]
    return captures[["capture", "subject", "gesture"]].reset_index(drop=True)


def rows_of(task: Task) -> pd.DataFrame:
    """Every row that predictions must have, once: ``capture`` and `Task.keys` as text, ``subject``, ``true``.

    Of a watched task the touches instead: ``subject``, ``recording`` (position), ``start``, ``end`` and ``true``.

    Raises:
        InputError: CoST is not here as it was published.
    """
    if task.watched:
        touches = recordings_of(task).query("gesture != ''").reset_index(drop=True)
        return touches.assign(recording=pd.factorize(touches["subject"])[0]).rename(columns={"gesture": "true"})
    captures = captures_of(task).rename(columns={"gesture": "true"})
    return captures.merge(cases_of(task), how="cross")[["capture", *task.keys, "subject", "true"]]


def cases_of(task: Task) -> pd.DataFrame:
    """The values of `Task.keys` that every capture is tested under, as text, a row each."""
    values = task.circumstances()
    return pd.DataFrame(values, columns=list(task.keys), index=range(len(values)))


def recordings_of(task: Task) -> pd.DataFrame:
    """Composed recordings of a watched task: ``subject``, ``start`` and ``end`` (frames), ``gesture``.

    The first row of each subject is the whole recording, without gesture; a row for each touch follows, by start.
    `bench watch` composed them. They are stored, so that later versions of touchbench or NumPy
    cannot change them.
    """
    return _table(f"{task.data}-watch.csv").astype({"start": np.int64, "end": np.int64})


def published_cost() -> Corpus:
    """CoST as it was published.

    Raises:
        InputError: it is not here, or differs.
    """
    corpus = open_corpus("cost", {})
    differs = corpus.info.get("warnings", []) if corpus.info.get("format") == "cost" else ["another format"]
    if differs:
        raise InputError(
            f"data=cost is not CoST as published ({differs[0]}); import the file with MD5 {cost.PUBLISHED_MD5}"
        )
    return corpus


def amounts_of(task: Task) -> dict[tuple[str, ...], str]:
    """What each case of a task meant when the task was frozen; empty where a case says it itself."""
    return {**faults()} if task.keys == FAULT else {}


def faults() -> dict[tuple[str, str], str]:
    """The amount of every fault and severity, and of clean captures nothing."""
    table = _table("faults.csv")
    return dict(zip(zip(table["fault"], table["severity"], strict=True), table["amount"], strict=True))


@lru_cache(maxsize=4)
def _table(name: str) -> pd.DataFrame:
    """A table of ``bench/board/reference``, all text."""
    with (files("bench.board") / "reference" / name).open(encoding="utf-8") as f:
        return pd.read_csv(f, dtype=str, keep_default_na=False)
