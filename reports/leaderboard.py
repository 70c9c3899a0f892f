"""The leaderboard: submissions, rescored, as one table for each task on one page that loads nothing."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import pandas as pd

from bench.leaderboard.submissions import ABOUT, REFERENCE, Submission, behind, read, score
from bench.leaderboard.tasks import TASKS, Task
from reports.layout import Block, Heading, Table, Text, footnotes, page

OWN = "reference"  # name of the results that come with touchbench
WORST = "worst fault: "
BEHIND = ("behind", "behind_low", "behind_high")
OURS = "reference, shipped with touchbench"  # a submission cannot write into this column
NOT_VERIFIED = "not verified"
DESIGNED = {"reflex", "touch", "touchnet", "rocket"}
DESIGNED_NOTE = (
    "This system or its features (reflex, touch, touchnet, rocket) were designed on seven of HAART's ten people, the "
    "training subjects of the challenge split. For reflex and rocket, accuracies under LOSO and challenge were seen "
    "as well. The accuracy of this row may be optimistic (docs/systems.md)."
)
INTRODUCTION = (
    "Every score is computed here from submitted labels. Parameters, flash, who, date, revision and command are shown "
    "as the submission gives them. Test labels are public, so this page guards against mistakes, not against fraud: "
    "labels do not show which subjects a system was trained on. Verified means that a maintainer repeated the command "
    "and got the same labels. Brackets hold 95 % bootstrap intervals over subjects, the same people for all "
    "systems of a task: ten people seldom tell neighbours in a table apart, three (haart-challenge-v1) hardly "
    "anything. Behind the best: points of accuracy less than the first row's, with the interval of that difference, "
    "person by person. One that holds 0 means that these people do not tell the two apart; as the best was picked by "
    "the same people, and one in twenty such intervals misses, one that just leaves 0 out means little."
)


@lru_cache(maxsize=1)
def reference() -> tuple[Submission, ...]:
    """The results that come with touchbench; read and scored once in a process."""
    return tuple(read(path.parent) for path in sorted(REFERENCE.glob(f"*/*/{ABOUT}")))


def note(one: Submission) -> str:
    """The footnote of a system whose design saw people of HAART, on tasks of HAART; empty for others."""
    parts = re.findall(r"\b(?:model|features)=(\S+)", one.about.get("command", ""))
    names = {name for part in parts if ".py:" not in part for name in re.split(r"[+,]", part)}
    return DESIGNED_NOTE if one.task.data == "haart" and names & DESIGNED else ""


def scores_of(submissions: Sequence[Submission]) -> pd.DataFrame:
    """One row per submission, best first within each task; accuracies in percent.

    ``behind``, ``behind_low`` and ``behind_high`` are the difference to the best of the task, as
    `bench.leaderboard.submissions.behind` gives it, in points; NaN for the best itself.
    """
    best: dict[str, Submission] = {}
    for one in submissions:
        first = best.setdefault(one.task.name, one)
        if score(one)["accuracy"] > score(first)["accuracy"]:
            best[one.task.name] = one
    rows = []
    for one in submissions:
        task, about, found = one.task, one.about, score(one)
        fixed = {"task": task.name, "system": about["system"], "data": task.data, "subset": "all"}
        fixed |= {"protocol": task.about, "unit": task.unit}
        fixed |= {"captures": one.table["capture"].nunique(), "subjects": one.table["subject"].nunique()}
        first = best[task.name]
        less = (np.nan,) * 3 if one is first else behind(one, first)
        found |= dict(zip(BEHIND, less, strict=True))
        said = {k: about.get(k, np.nan) for k in ("parameters", "flash_bytes", "ram_bytes")}
        said |= {k: about.get(k, "") for k in ("who", "date", "revision", "command")}
        said |= {"origin": OURS if one.reference else "submitted", "verified": one.verified or NOT_VERIFIED}
        said |= {"remarks": one.remarks, "note": note(one)}
        rows.append(fixed | {k: 100 * v for k, v in found.items()} | said | {"name": one.name})
    table = pd.DataFrame(rows)
    order = [list(TASKS).index(name) for name in table["task"]]
    ranked = table.assign(order=order).sort_values(["order", "accuracy"], ascending=[True, False], kind="stable")
    return ranked.drop(columns="order").reset_index(drop=True)


def board(submissions: Sequence[Submission], left_out: list[str]) -> str:
    """The page.

    Args:
        submissions: to be shown.
        left_out: a line for each folder that could not be used.
    """
    blocks: list[Block] = [Heading("Leaderboard", 1), Text(INTRODUCTION)]
    if left_out:
        blocks.append(Text(f"Left out: {'; '.join(left_out)}", warning=True))
    for task in TASKS.values():
        blocks += _of_task(task, [one for one in submissions if one.task == task])
    return page(blocks, "touchbench leaderboard")


def _of_task(task: Task, submissions: Sequence[Submission]) -> list[Block]:
    corpus = f"digest {task.digest[:16]}" if task.digest else "as published, known by the MD5 of its file"
    about = (
        f"Data: {task.data}, {corpus}, all captures. Protocol: {task.about}. Unit: {task.unit}. "
        f"Accuracy and macro-F1 are of {task.score}."
    )
    blocks: list[Block] = [Heading(task.name), Text(about)]
    if not submissions:
        return [*blocks, Text("Nobody has submitted a result yet.")]
    caption = f"{task.name}: {len(submissions)} systems, best first"
    table = scores_of(submissions)
    marks, notes = footnotes([[text] if text else [] for text in table["note"]])
    return [*blocks, Table(_shown(table), caption, marks, notes, code=("command",))]


def _shown(found: pd.DataFrame) -> pd.DataFrame:
    """The scores of one task as text."""
    rows = []
    for row in found.to_dict("records"):
        parts = {f"{k} %": f"{v:.1f}" for k, v in row.items() if str(k).startswith(("at ", "clean")) and v == v}
        worst = [f"{str(k).removeprefix(WORST)} {v:.1f}" for k, v in row.items() if str(k).startswith(WORST) and v == v]
        rows.append(
            {
                "system": row["system"],
                "accuracy % [95 %]": f"{row['accuracy']:.1f} [{row['low']:.1f}, {row['high']:.1f}]",
                "behind the best [95 %]": _less(row),
                "origin": row["origin"],
                "verified": row["verified"],
                **({"remarks": row["remarks"] or "-"} if found["remarks"].any() else {}),
                "macro-F1 %": f"{row['macro_f1']:.1f}",
                "subjects: mean ± SD": f"{row['subject_mean']:.1f} ± {row['subject_sd']:.1f}",
                **parts,
                **({"worst fault %": worst[0].replace("_", " ")} if worst else {}),
                "parameters": _whole(row["parameters"]),
                "flash kB": _whole(row["flash_bytes"] / 1000),
                "who": row["who"],
                "date": row["date"],
                "revision": row["revision"] or "-",
                "command": row["command"] or "-",
            }
        )
    return pd.DataFrame(rows)


def _less(row: dict) -> str:
    """Points behind the best, a negative number."""
    if pd.isna(row["behind"]):
        return "-"
    return f"{row['behind']:+.1f} [{row['behind_low']:+.1f}, {row['behind_high']:+.1f}]".replace("-", "\N{MINUS SIGN}")


def _whole(number: float) -> str:
    return "-" if pd.isna(number) else f"{number:,.0f}".replace(",", " ")
