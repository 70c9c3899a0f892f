"""The answer of a tracked run to a frozen task: its rows, and where they come from."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import pandas as pd

from bench.board import tasks
from bench.board.submissions import EVENT, NUMBERS, TEXTS
from bench.board.tasks import RATE_HZ, Task
from bench.comparable import CONDITIONS, seed_number
from bench.errors import InputError
from bench.outcomes.events import REPORT
from bench.result import Result
from bench.scores import ABSTAINED

FILE = re.compile(r"(?<==)(?:.*[/\\])?([^/\\]+\.py)(:\w+)$")  # of a word of a command that names a part of a file
SHARED = {"subset": "all", "target": "gesture", "status": "FINISHED"}  # by the runs of all tasks


def find(results: Sequence[Result], task: Task, wanted: dict[str, str], how: str) -> tuple[Result, pd.DataFrame]:
    """The newest complete run of a system that answers a task, and its rows as of `table`.

    Args:
        results: results of all kinds, oldest first.
        task: task to answer.
        wanted: values that tags of the run must have (``system`` and ``seed``), or its ``run_id``.
        how: the command that makes such a run.

    Raises:
        InputError: there is none; where there are others of the system, the message says what differs or is missing.
    """
    results = [run for run in results if task.held_by(run)]
    system = ", ".join(v if k == "system" else f"{k} {v}" for k, v in wanted.items() if v != "none")
    runs = [run for run in results if all(str(run.get(k, "")) == v for k, v in wanted.items())]
    if not runs:
        raise InputError(f"no run of bench {task.command} with {system} is stored; make one: {how}")
    flaws = []
    for run in [run for run in reversed(runs) if not differs(task, run)]:
        try:
            return run, table(task, run)
        except InputError as e:  # an older one may have what this one lacks
            flaws.append(e)
    if flaws:
        raise flaws[0]
    raise InputError(f"{system} has a stored run with {differs(task, runs[-1])}, but {task.name} needs: {how}")


def differs(task: Task, run: Result) -> str:
    """Tags of a run that differ from the task, with their values; empty if none does."""
    fixed = {"corpus_digest": tasks.digest_of(task), "protocol": task.protocol, **SHARED}
    for name, *values in (*fixed.items(), *task.needs):
        here = str(run.get(name) or "")
        if here not in values:
            short = here[:16] if name == "corpus_digest" else here
            return f"{name.replace('corpus_', 'data ').rpartition('.')[2]} {short or 'unknown'}"
    return ""


def table(task: Task, run: Result) -> pd.DataFrame:
    """The rows of a task with ``predicted``, and of a task with one row per capture the mean probabilities.

    Of a watched task the reported events.

    Raises:
        InputError: the run lacks rows of the task, its captures have other labels, its recordings are composed
            otherwise, or its table is gone.
    """
    rows = task.maker.view.rows(run, tasks.cases_of(task), RATE_HZ)
    if task.watched:
        return _reported(task, rows, run)
    rows = rows.assign(capture=rows["capture"].astype(str)).rename(columns={"true": "tracked"})
    joined = tasks.rows_of(task).merge(rows, on=["capture", *task.keys], how="left", validate="one_to_one")
    if (missing := joined["predicted"].isna() | (joined["predicted"] == ABSTAINED)).any():
        row = ", ".join(f"{k} {v}" for k, v in joined.loc[missing, ["capture", *task.keys]].iloc[0].items())
        raise InputError(f"run {run['run_id']} has no label of {row}, which {task.name} needs")
    if (joined["tracked"] != joined["true"]).any():
        raise InputError(f"run {run['run_id']} has other captures than {task.name}; submit a run of the task")
    _check_amounts(task, joined)
    return joined.drop(columns=["tracked", "amount"], errors="ignore")


def _check_amounts(task: Task, rows: pd.DataFrame) -> None:
    """Refuse rows of a case that means something else than when the task was frozen.

    Raises:
        InputError: there is one.
    """
    amounts = tasks.amounts_of(task)
    for *case, amount in rows[[*task.keys, "amount"]].drop_duplicates().to_numpy() if amounts else ():
        if amounts[tuple(case)] != amount:
            words = " at ".join([case[0], *(f"{k} {v}" for k, v in zip(task.keys[1:], case[1:], strict=True))])
            raise InputError(f"{words} is {amount} in the run, not so in {task.name}")


def _reported(task: Task, stored: pd.DataFrame, run: Result) -> pd.DataFrame:
    """The reported events of recordings.

    Raises:
        InputError: the recordings or their touches differ from the task's.
    """
    rows = stored[stored["kind"] != "report"]
    rows = rows.assign(start=rows["start"].fillna(0), gesture=rows["gesture"].fillna(""))
    recordings = tasks.recordings_of(task)
    if sorted(rows[[*recordings]].itertuples(index=False)) != sorted(recordings.itertuples(index=False)):
        raise InputError(f"run {run['run_id']} has other recordings than {task.name}; submit a run of the task")
    kinds = {name: REPORT.get(name, str) for name in EVENT}
    return stored.loc[stored["kind"] == "report", [*EVENT]].astype(kinds).round({"confidence": 3})


def metadata(task: Task, run: Result, who: str, command: str) -> dict[str, Any]:
    """Origin and costs of a run, in the words of a submission.

    Of a system in a file of one's own: the file's name and its SHA-256, not the folder it lies in; touchbench's
    revision would tell nothing of it.
    """
    seed = f", seed {run['seed']}" if seed_number(str(run["seed"])) else ""
    texts = {
        "task": task.name,
        "system": f"{run['system']}{seed}",
        "who": who,
        "date": datetime.fromtimestamp(run["started"] / 1000, UTC).date().isoformat(),
        "revision": run.get("git"),
        "command": command,
        "digest": run["corpus_digest"],
        **_files(run, command),
        **rests_on(run),
    }
    texts = {k: v for k, v in texts.items() if isinstance(v, str) and v}
    numbers = {k: int(run[k]) for k in NUMBERS if isinstance(run.get(k), float) and run[k] == run[k]}
    versions = {k.removeprefix("version."): v for k, v in run.items() if k.startswith("version.")}
    return texts | numbers | {"versions": {k: v for k, v in versions.items() if isinstance(v, str)}}


def rests_on(run: Result) -> dict[str, str]:
    """Inputs of the labels of a run besides single captures, as a submission records them: ``batch``, ``conditions``.

    Empty for a run without the tags `BATCH` and `CONDITIONS`.
    """
    conditions = run.get(CONDITIONS)
    batch = {} if run.alone else {"batch": "yes"}
    return batch | ({"conditions": conditions} if isinstance(conditions, str) and conditions else {})


def _files(run: Result, command: str) -> dict[str, str]:
    """The command without the folders of its files; their SHA-256 for ``revision`` and ``note``."""
    words = shlex.split(command)
    files = {match[1]: run.get(f"{word.partition('=')[0]}_file") for word in words if (match := FILE.search(word))}
    if not files:
        return {}
    tracked_files = {name: digest for name, digest in files.items() if isinstance(digest, str)}
    notes = "; ".join(f"{name}: sha256 {tracked_files.get(name, 'not tracked')}" for name in files)
    revisions = ", ".join(f"{name} {digest[:12]}" for name, digest in tracked_files.items())
    return {
        "command": shlex.join(FILE.sub(r"\1\2", word) for word in words),
        "revision": revisions[: TEXTS["revision"].most],
        "note": f"{notes}; run with touchbench at {run.get('git') or 'an unknown revision'}"[: TEXTS["note"].most],
    }
