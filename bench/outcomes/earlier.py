"""Runs of earlier versions, read as runs of this one: their tags, numbers and tables under today's names.

Tags name the command and the keys of a search as the first version did. In version 1 of the stored form, a run under
faults, a replay and a run in C were kinds of their own. Each is read here as a run on captures in one circumstance,
without the labels of the captures as they are. Its times are of the wall clock, and keep that name.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd

from bench.result import PLAIN, Result, Tables

CELL = "cell"
RENAMED = {  # numbers, by kind of run
    "stress": {},
    "stream": {
        **{f"accuracy{end}": f"replay_accuracy{end}" for end in ("", "_low", "_high")},
        **{f"decide_wall_ms_p{p}": f"replay_wall_ms_p{p}" for p in (50, 95, 99)},
    },
    "chip": {"accuracy": "c_accuracy", "python_accuracy": "accuracy"},
}
C_SCORES = "accuracy_low accuracy_high macro_f1 macro_precision macro_recall subject_accuracy_mean subject_accuracy_sd"
RENAMED["chip"] |= {name: f"c_{name}" for name in C_SCORES.split()}
STORED = {  # names of stored tables, by kind of run and by today's name
    "stress": {"labels": "stress", "margins": "half_margins"},
    "stream": {"replay": "predictions", "rules": "chosen", "thresholds": "trials"},
    "chip": {"c": "predictions"},
}
TAGS = tuple(STORED)  # kinds of run that are no more
GONE = {"stress": ("predictions", "stress"), "stream": ("predictions", "chosen", "trials")}
GONE |= {"chip": ("predictions", "per_subject")}
DERIVED = {"stress": ("faults", "margins", "conditions", "learning", "slices")}  # tables that lay beside the run
ABOUT = ("data", "subset", "protocol", "system", "seed")  # their first columns


def adopted(result: Result) -> Result:
    """A run as this version has it: the same, or one of an earlier version under today's names."""
    kind = result.kind
    if arguments := result.get("touchbench.arguments"):
        command, typed = command_now(result.get("touchbench.command", ""), json.loads(arguments))
        now = {"touchbench.command": command, "touchbench.arguments": json.dumps(typed)}
        result = Result(result.about | now, result.metrics, result.tables, result.errors)
    if "quiet_ms" not in result.metrics:
        result = Result(result.about, by_the_wall(result.metrics), result.tables, result.errors)
    if kind not in TAGS:
        return result
    about = result.about | {"touchbench.kind": CELL, PLAIN: kind}
    if kind == "stream":
        about |= {"stream.after": "each", "stream.stopping": "True"}
    numbers = {RENAMED[kind].get(name, name): value for name, value in result.metrics.items()}
    if kind == "stress":
        numbers |= {f"{n}.under": numbers[n] for n in ("failing_slices", "tested_slices") if n in numbers}
    return Result(about, numbers, _Adopted(result, kind), result.errors)


def command_now(command: str, arguments: Mapping[str, str]) -> tuple[str, dict[str, str]]:
    """A tracked command and its arguments as they are typed today."""
    names = {"over": "smallest", "budget": "seconds"} if command in ("choose", "tune") else {}
    names |= {"model.budget": "model.seconds"} if arguments.get("model") == "auto" else {}
    now = {names.get(key, key): value for key, value in arguments.items()}
    return ("tune" if command == "choose" else command), now


def by_the_wall(numbers: Mapping[str, float]) -> dict[str, float]:
    """The numbers of a run whose times are of the wall clock, under names that say so; sums with them are left out."""
    timed = re.compile(r"(fit|adapt)(_seconds)|(predict|decide|replay)(_ms_p\d+)")
    named = {timed.sub(lambda m: "_wall".join(filter(None, m.groups())), name): v for name, v in numbers.items()}
    return {name: value for name, value in named.items() if name not in ("decision_ms", "capture_decision_ms")}


class _Adopted(Tables):
    """Tables of an earlier run under today's names."""

    def __init__(self, result: Result, kind: str) -> None:
        before = result.tables

        def read(name: str) -> pd.DataFrame | None:
            if name in GONE[kind] and name not in STORED[kind]:
                return None
            table = before.get(STORED[kind].get(name, name))
            table = before.get(name) if table is None and name not in GONE[kind] else table
            if table is None and name in DERIVED.get(kind, ()):
                table = _own(before.get(f"stability/stability_{STORED[kind].get(name, name)}"), result)
            return None if table is None else MENDED.get(name, lambda table: table)(table)

        def names() -> list[str]:
            every = [*STORED[kind], *(name for name in before if name not in GONE[kind])]
            return [*dict.fromkeys([*every, *DERIVED.get(kind, ())])]

        super().__init__({}, read, before.missing, names)


def _own(table: pd.DataFrame | None, result: Result) -> pd.DataFrame | None:
    """The rows of a run in a table that it shared with other systems of its command."""
    if table is None:
        return None
    mine = (table["system"] == result["system"]) & (table["seed"].astype(str).replace("nan", "none") == result["seed"])
    return table[mine].drop(columns=[*ABOUT]).reset_index(drop=True)


def _labels(table: pd.DataFrame) -> pd.DataFrame:
    """Labels under faults and by fewer subjects, in the columns of `bench.work.curves`."""
    most = table.groupby("fold")["train_subjects"].transform("max")
    harmed, fewer = table["fault"] != "none", table["train_subjects"] < most
    key = np.select([harmed, fewer], ["under", "train_subjects"], "")
    case = np.where(fewer & ~harmed, "train_subjects", table["fault"])
    level = np.where(fewer & ~harmed, table["train_subjects"], table["severity"])
    table = table.drop(columns=["fault", "severity"]).assign(circumstance=key, case=case, level=level)
    last = ["p_true", "length", "circumstance", "case", "level", "amount", "train_subjects"]
    return table[[*(name for name in table if name not in last), *last]]


def _slices(table: pd.DataFrame) -> pd.DataFrame:
    fault = table["fault"].fillna("")
    place = list(table.columns).index("amount") + 1
    table = table.assign(fault=fault, amount=table["amount"].fillna(""))
    table.insert(place, "circumstance", np.where(fault != "", "fault", ""))
    return table


MENDED: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {"labels": _labels, "slices": _slices}
