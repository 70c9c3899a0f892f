"""The leaderboard: submissions, rescored, as one table for each task on one page that loads nothing."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np
import pandas as pd

from bench.board.submissions import NUMBERS, Submission, behind, reference_of
from bench.board.tasks import TASKS
from bench.measures import Cell, Interval, Measure, Row, known, text, whole
from bench.outcomes.ranking import ranking
from bench.reports.layout import page
from bench.reports.over_corpora import OverCorpora, section
from bench.scores import per_subject
from bench.table import Table, rows_of

TEMPLATE = Path(str(files("bench.board"))) / "leaderboard.jinja"
WORST = "worst fault: "
NO_SHARES = {"false_alarms_per_hour", "latency_s_p50"}
WATCHED = {"touches_found": ("found %", 1), "first_correct": ("first %", 1)}
WATCHED |= {"false_alarms_per_hour": ("alarms/h", 1), "latency_s_p50": ("latency s", 2)}  # headings, decimal places
BEHIND = ("behind", "behind_low", "behind_high")
OURS = "reference, shipped with touchbench"  # a submission cannot write into this column
NOT_VERIFIED = "not verified"
DESIGNED = {"reflex", "touch", "touchnet", "rocket"}
DESIGNED_NOTE = (
    "This system or its features (reflex, touch, touchnet, rocket) were designed on seven of HAART's ten people, the "
    "training subjects of the challenge split. For reflex and rocket, accuracies under LOSO and challenge were seen "
    "as well. The accuracy of this row may be optimistic (docs/notes/systems.md)."
)


def reference() -> tuple[Submission, ...]:
    """The results that come with touchbench."""
    return tuple(one for name in sorted(TASKS) for one in reference_of(name))


def note(one: Submission) -> str:
    """The footnote of a system whose design saw people of HAART, on tasks of HAART; empty for others."""
    parts = re.findall(r"\b(?:model|features)=(\S+)", one.metadata.get("command", ""))
    names = {name for part in parts if ".py:" not in part for name in re.split(r"[+,]", part)}
    return DESIGNED_NOTE if one.task.data == "haart" and names & DESIGNED else ""


def scores_of(submissions: Sequence[Submission]) -> pd.DataFrame:
    """Scores of the submissions, best first within each task, those with too many false alarms last; in percent.

    ``behind``, ``behind_low`` and ``behind_high`` are the difference to the best of the task, as
    `bench.board.submissions.behind` gives it, in points; NaN for the best itself.
    """
    rows = []
    for one in submissions:
        task, metadata = one.task, one.metadata
        best = max((other for other in submissions if other.task == task), key=_rank)
        less = (np.nan,) * 3 if one is best else behind(one, best)
        scores = one.scores | dict(zip(BEHIND, less, strict=True))
        rows.append(
            {
                "task": task.name,
                "system": metadata["system"],
                "data": task.data,
                "subset": "all",
                "protocol": task.protocol_text,
                "unit": task.unit,
                "captures": len(one.table) if task.watched else one.table["capture"].nunique(),
                "subjects": one.table["subject"].nunique(),
                **{k: v if k in NO_SHARES else 100 * v for k, v in scores.items()},
                **{k: metadata.get(k, np.nan) for k in NUMBERS},
                **{k: metadata.get(k, "") for k in ("who", "date", "revision", "command")},
                "origin": OURS if one.reference else "submitted",
                "verified": one.verified or NOT_VERIFIED,
                "remarks": one.remarks,
                "note": note(one),
                "name": one.name,
            }
        )
    table = pd.DataFrame(rows)
    order = [list(TASKS).index(name) for name in table["task"]]
    ranked = table.assign(order=order, last=[one.alarming for one in submissions])
    ranked = ranked.sort_values(["order", "last", "accuracy"], ascending=[True, True, False], kind="stable")
    return ranked.drop(columns=["order", "last"]).reset_index(drop=True)


def _rank(one: Submission) -> tuple[bool, float]:
    return not one.alarming, one.scores["accuracy"]


def over_corpora(submissions: Sequence[Submission]) -> OverCorpora | None:
    """The ranking over the tasks that leave each subject of a corpus out and have a label for each capture.

    Results of one system are those of one author under one name; the newest answer to a task counts. Labels that depend
    on other test captures are not ranked.

    Returns:
        None unless two systems answer two of these tasks.
    """
    fit = {task.data: task for task in TASKS.values() if task.protocol == "loso" and task.plain}
    newest: dict[tuple[str, str], Submission] = {}
    left_out: dict[str, str] = {}
    notes: dict[str, list[str]] = {}
    for one in sorted(submissions, key=lambda one: str(one.metadata["date"])):
        if one.task not in fit.values():
            continue
        system = str(one.metadata["system"]) + ("" if one.reference else f" by {one.metadata['who']}")
        if "batch" in one.metadata:
            left_out[system] = one.remarks
        else:
            newest[one.task.data, system] = one
            notes[system] = [*dict.fromkeys(filter(None, [*notes.get(system, []), note(one)]))]
    parts = [
        per_subject(one.table).assign(data=data, system=system, accuracy=lambda rows: 100 * rows["accuracy"])
        for (data, system), one in newest.items()
    ]
    if not parts or not (found := ranking(pd.concat(parts))):
        return None
    left_out = {system: why for system, why in left_out.items() if system not in notes}
    about = {data: f"{task.name}, {task.protocol_text}" for data, task in fit.items()}
    return section(found, about, left_out, notes)


def board(submissions: Sequence[Submission], left_out: list[str]) -> str:
    """The page.

    Args:
        submissions: submissions to list.
        left_out: a line for each folder that could not be used.
    """
    tables = {}
    for task in TASKS.values():
        if of_task := [one for one in submissions if one.task == task]:
            rows = scores_of(of_task)
            remarks = [[words] if words else [] for words in rows["note"]]
            tables[task.name] = Table(_columns(rows), rows_of(rows.replace({"": None})), remarks=remarks)
    title, over = "touchbench leaderboard", over_corpora(submissions)
    return page(TEMPLATE, title, left_out=left_out, tasks=list(TASKS.values()), tables=tables, over=over)


def _columns(table: pd.DataFrame) -> list[Measure]:
    """Columns of the scores of one task."""
    parts = [k for k in table if k.startswith(("at ", "clean")) and table[k].notna().any()]
    faults = [k for k in table if k.startswith(WORST) and table[k].notna().any()]

    def worst(row: Row) -> str | None:
        fault = next((k for k in faults if known(row[k]) is not None), None)
        return None if fault is None else f"{fault.removeprefix(WORST).replace('_', ' ')} {row[fault]:.1f}"

    def less(row: Row) -> str:
        behind = Measure("behind", form="+.1f", ends="behind").of(row)
        return re.sub(r"-(?=\d)", "\N{MINUS SIGN}", behind)

    def accuracy(row: Row) -> Cell:
        return Interval(row["accuracy"], row["low"], row["high"]) if known(row["low"]) is not None else row["accuracy"]

    return [
        text("system"),
        Measure("accuracy", "pooled accuracy % [95 %]", accuracy),
        Measure("behind", "behind the best [95 %]", less),
        text("origin"),
        text("verified"),
        text("remarks", spare=1),
        Measure("macro_f1", "macro-F1 %"),
        Measure("subjects_mean", "subjects: mean ± SD", ("subject_mean", "subject_sd"), join=" ± "),
        *(Measure(name, f"{name} %") for name in parts),
        *(Measure(name, heading, form=f".{digits}f", spare=1) for name, (heading, digits) in WATCHED.items()),
        *([text("worst", "worst fault %", worst)] if faults else []),
        Measure("parameters", form=whole),
        Measure("flash", "flash kB", "flash_bytes", whole, per=1000),
        *(text(name, code=name == "command") for name in ("who", "date", "revision", "command")),
    ]
