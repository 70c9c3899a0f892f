"""The answer of a tracked run to a frozen task: its rows, and where they come from."""

from __future__ import annotations

import re
import shlex
from datetime import UTC, datetime
from typing import Any

import pandas as pd

from bench.errors import InputError
from bench.leaderboard import tasks
from bench.leaderboard.submissions import NUMBERS, TEXTS
from bench.leaderboard.tasks import RATE_HZ, Task
from bench.outcomes import scores
from bench.outcomes.comparable import Row, seed_number
from bench.outcomes.runs import NothingTracked, needed, rows_of, tracked
from bench.outcomes.stopping import standing
from bench.outcomes.store import Store

STREAM_START = "onset"
FILE = re.compile(r"(?<==)(?:.*[/\\])?([^/\\]+\.py):\w+$")  # of a word of a command that names a part of a file


def find(store: Store, task: Task, wanted: dict[str, str], how: str) -> Row:
    """The newest complete run of a system that answers a task.

    Args:
        store: where runs are.
        task: to be answered.
        wanted: values that tags of the run must have (``system`` and ``seed``), or its ``run_id``.
        how: the command that makes such a run.

    Raises:
        InputError: there is none; where there are others of the system, the message says what differs.
    """
    what = ", ".join(f"{k} {v}" if k != "system" else v for k, v in wanted.items())
    try:
        stored = rows_of(tracked(store, task.kind))
    except NothingTracked:
        stored = []
    of_system = [run for run in stored if all(str(run.get(k, "")) == v for k, v in wanted.items())]
    if not of_system:
        raise InputError(f"no run of bench {task.command} is stored of {what}; make one: {how}")
    reasons = [(differs(task, run), run) for run in of_system]
    if good := [run for why, run in reasons if not why]:
        return good[-1]
    raise InputError(f"{what} is stored with {reasons[-1][0]}, which is not {task.name}; make a run: {how}")


def differs(task: Task, run: Row) -> str:
    """What of a run is not what the task fixes, with its value; empty if all is."""
    facts = {
        "corpus_digest": tasks.digest_of(task),
        "subset": "all",
        "target": "gesture",
        "protocol": task.protocol,
        "status": "FINISHED",
    }
    if "ms" in task.keys:
        facts["stream.start"] = STREAM_START
    for name, value in facts.items():
        here = str(run.get(name, ""))
        if here != value:
            short = here[:16] if name == "corpus_digest" else here
            return f"{name.replace('corpus_', 'data ').replace('stream.', '')} {short or 'unknown'}"
    return ""


def table(store: Store, task: Task, run: Row) -> pd.DataFrame:
    """The rows of a task with ``predicted``, and of a task with one row per capture the mean probabilities.

    Raises:
        InputError: the run lacks rows of the task, its captures have other labels, or its table is gone.
    """
    name = "stress.parquet" if task.kind == "stress" else "predictions.parquet"
    stored = pd.read_parquet(needed(store, run, name))
    found = {"cell": _labelled, "stream": _standing, "stress": _damaged}[task.kind](task, stored)
    found = found.assign(capture=found["capture"].astype(str), given=found.pop("true"))
    expected = tasks.rows_of(task)
    joined = expected.merge(found, on=["capture", *task.keys], how="left", validate="one_to_one")
    if (missing := joined["predicted"].isna()).any():
        lacking = ", ".join(f"{k} {v}" for k, v in joined.loc[missing, ["capture", *task.keys]].iloc[0].items())
        raise InputError(f"run {run['run_id']} has no label of {lacking}; it does not answer {task.name}")
    if (joined["given"] != joined["true"]).any():
        raise InputError(f"run {run['run_id']} has other captures than {task.name}")
    return joined.drop(columns="given")


def _labelled(task: Task, stored: pd.DataFrame) -> pd.DataFrame:
    """Of an evaluation: the label of each capture (in each draw), by mean probability."""
    labelled = scores.captures(stored)
    columns = ["capture", "true", "predicted"]
    if "draw" in task.keys:
        draws = labelled["fold"].str.extract(r" draw (\d+)$")[0]
        return labelled[columns].assign(draw=draws)
    proba = [scores.PREFIX + c for c in scores.classes_of(stored)]
    mean = stored.groupby(["fold", "capture"], sort=False)[proba].mean().reset_index(drop=True)
    return pd.concat([labelled[columns], mean], axis=1)


def _standing(task: Task, stored: pd.DataFrame) -> pd.DataFrame:
    """Of a replay: the label that stands at each instant."""
    parts = []
    for (ms,) in task.circumstances():
        frames = int(float(ms) * RATE_HZ / 1000 + 1e-6)
        parts.append(standing(stored, frames)[["capture", "true", "predicted"]].assign(ms=ms))
    return pd.concat(parts, ignore_index=True)


def _damaged(task: Task, stored: pd.DataFrame) -> pd.DataFrame:
    """Of a system under stress: what it says when fitted to all training subjects.

    Raises:
        InputError: an amount is not that of the task.
    """
    most = stored.groupby("fold")["train_subjects"].transform("max")
    whole = stored[stored["train_subjects"] == most].astype({"severity": str})
    known = tasks.faults()
    for fault, severity, amount in whole[["fault", "severity", "amount"]].drop_duplicates().to_numpy():
        if known.get((fault, severity)) != amount:
            raise InputError(f"{fault} at severity {severity} is {amount} in the run, not so in {task.name}")
    return whole[["capture", "fault", "severity", "true", "predicted"]]


def about(task: Task, run: Row, who: str, command: str) -> dict[str, Any]:
    """Where a run comes from and what it needs, as a submission says it.

    Of a system in a file of one's own: the file's name and what it held, not the folder it lies in; touchbench's
    revision would tell nothing of it.
    """
    day = datetime.fromtimestamp(run["started"] / 1000, UTC).date().isoformat()
    seed = f", seed {run['seed']}" if seed_number(str(run["seed"])) else ""
    said = {
        "task": task.name,
        "system": f"{run['system']}{seed}",
        "who": who,
        "date": day,
        "revision": run.get("git"),
        "command": command,
        "digest": run["corpus_digest"],
    } | _files(run, command)
    said |= rests_on(run)
    versions = {k.removeprefix("version."): v for k, v in run.items() if re.match(r"version\.", k)}
    numbers = {name: run[name] for name in NUMBERS if isinstance(run.get(name), float) and run[name] == run[name]}
    texts = {k: v for k, v in said.items() if isinstance(v, str) and v}
    told = {k: v for k, v in versions.items() if isinstance(v, str)}
    return texts | {k: int(v) for k, v in numbers.items()} | {"versions": told}


def rests_on(run: Row) -> dict[str, str]:
    """What the labels of a run rest on besides single captures, as a submission records it: ``batch``, ``conditions``.

    Empty for a run without the tags ``touchbench.depends_on_batch`` and ``touchbench.conditions``.
    """
    batch = {"batch": "yes"} if run.get("touchbench.depends_on_batch") == "true" else {}
    conditions = run.get("touchbench.conditions")
    return batch | ({"conditions": conditions} if isinstance(conditions, str) and conditions else {})


def _files(run: Row, command: str) -> dict[str, str]:
    """The command without the folders of its files; what these held, for ``revision`` and ``note``."""
    words = shlex.split(command)
    held = {}
    for word in words:
        if found := FILE.search(word):
            held[found[1]] = run.get(f"{word.partition('=')[0]}_file")
    if not held:
        return {}
    known = {name: digest for name, digest in held.items() if isinstance(digest, str)}
    noted = [f"{name}: sha256 {known.get(name, 'not tracked')}" for name in held]
    return {
        "command": shlex.join(FILE.sub(lambda m: m[0][m.start(1) - m.start() :], word) for word in words),
        "revision": ", ".join(f"{name} {digest[:12]}" for name, digest in known.items())[: TEXTS["revision"]],
        "note": f"{'; '.join(noted)}; run with touchbench at {run.get('git') or 'an unknown revision'}"[
            : TEXTS["note"]
        ],
    }
