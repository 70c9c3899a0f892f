"""The leaderboard: submissions, rescored, as one table for each task on one page that loads nothing."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import pandas as pd

from bench.leaderboard.submissions import METADATA, NUMBERS, REFERENCE, Submission, behind, read
from bench.leaderboard.tasks import TASKS
from bench.outcomes.ranking import ranking
from bench.outcomes.runs import rows_of
from bench.outcomes.scores import per_subject
from reports.layout import Table, page
from reports.numbers import bounded, number, whole, with_sd
from reports.over_corpora import OverCorpora, section

OWN = "reference"  # name of the results that come with touchbench
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
    return tuple(one for folder in sorted(REFERENCE.glob("*/")) for one in reference_of(folder.name))


@lru_cache
def reference_of(task: str) -> tuple[Submission, ...]:
    """Those of one task, by its name; read and scored once in a process."""
    return tuple(read(path.parent) for path in sorted(REFERENCE.glob(f"{task}/*/{METADATA}")))


def note(one: Submission) -> str:
    """The footnote of a system whose design saw people of HAART, on tasks of HAART; empty for others."""
    parts = re.findall(r"\b(?:model|features)=(\S+)", one.metadata.get("command", ""))
    names = {name for part in parts if ".py:" not in part for name in re.split(r"[+,]", part)}
    return DESIGNED_NOTE if one.task.data == "haart" and names & DESIGNED else ""


def scores_of(submissions: Sequence[Submission]) -> pd.DataFrame:
    """Scores of the submissions, best first within each task, those with too many false alarms last; in percent.

    ``behind``, ``behind_low`` and ``behind_high`` are the difference to the best of the task, as
    `bench.leaderboard.submissions.behind` gives it, in points; NaN for the best itself.
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
    fit = {
        task.data: task for task in TASKS.values() if task.protocol == "loso" and task.kind == "cell" and not task.keys
    }
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
            remarks = [[text] if text else [] for text in rows["note"]]
            tables[task.name] = Table(_shown(rows), remarks, code=("command",))
    title, over = "touchbench leaderboard", over_corpora(submissions)
    return page("leaderboard.jinja", title, left_out=left_out, tasks=list(TASKS.values()), tables=tables, over=over)


def _shown(table: pd.DataFrame) -> pd.DataFrame:
    """The scores of one task as text."""
    rows = []
    for row in rows_of(table):
        parts = {f"{k} %": number(v) for k, v in row.items() if k.startswith(("at ", "clean")) and v == v}
        parts |= {heading: number(row[k], digits) for k, (heading, digits) in WATCHED.items() if k in row}
        for fault, v in [(k.removeprefix(WORST), v) for k, v in row.items() if k.startswith(WORST) and v == v][:1]:
            parts["worst fault %"] = f"{fault.replace('_', ' ')} {number(v)}"
        behind_best = bounded(row["behind"], row["behind_low"], row["behind_high"], sign=True)
        rows.append(
            {
                "system": row["system"],
                "accuracy % [95 %]": bounded(row["accuracy"], row["low"], row["high"]),
                "behind the best [95 %]": re.sub(r"-(?=\d)", "\N{MINUS SIGN}", behind_best),
                "origin": row["origin"],
                "verified": row["verified"],
                **({"remarks": row["remarks"] or "-"} if table["remarks"].any() else {}),
                "macro-F1 %": number(row["macro_f1"]),
                "subjects: mean ± SD": with_sd(row["subject_mean"], row["subject_sd"]),
                **parts,
                "parameters": whole(row["parameters"]),
                "flash kB": whole(row["flash_bytes"] / 1000),
                "who": row["who"],
                "date": row["date"],
                "revision": row["revision"] or "-",
                "command": row["command"] or "-",
            }
        )
    return pd.DataFrame(rows)
