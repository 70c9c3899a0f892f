"""Marks of submissions that a maintainer ran again with equal labels.

They lie in one file of the working folder, beside the folders of submissions: no submission can bring its own. A mark
holds for the content that was compared.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from bench.board.submissions import Submission
from bench.errors import InputError
from bench.scratch import replacing

FILE = "leaderboard-verified.json"


def read() -> dict[str, dict[str, Any]]:
    """The marks of the working folder by task and name of the submission; none where there is no file.

    Raises:
        InputError: the file cannot be used.
    """
    path = Path(FILE)
    try:
        marks = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        texts = [mark[key] for mark in marks.values() for key in ("sha256", "date", "revision", "system")]
        if not all(text.isprintable() for text in texts):
            raise ValueError("a mark that does not print")
    except (OSError, ValueError, RecursionError, AttributeError, KeyError, TypeError) as e:
        raise InputError(f"{FILE} does not hold marks of submissions; restore or remove it") from e
    return marks


def marked(submissions: Sequence[Submission]) -> list[Submission]:
    """The submissions, with the date of verification for those that were verified and have not changed since.

    Raises:
        InputError: the file cannot be used.
    """
    marks, checked = read(), []
    for one in submissions:
        mark = marks.get(_key(one))
        if mark is not None and mark["sha256"] == one.sha256:
            one = replace(one, verified=f"{mark['date']} at {mark['revision']}, ran {mark['system']}")
        checked.append(one)
    return checked


def add(submission: Submission, mark: dict[str, Any]) -> None:
    """Write the mark of a submission, in place of an earlier one.

    Args:
        submission: verified submission.
        mark: the day, the revision and the system of the rerun, the number of labels and the accuracy.

    Raises:
        InputError: the file cannot be used or written.
    """
    marks = read() | {_key(submission): {"sha256": submission.sha256} | mark}
    try:
        with replacing(Path(FILE)) as beside:
            beside.write_text(json.dumps(marks, indent=1, sort_keys=True, ensure_ascii=False) + "\n", encoding="utf-8")
    except OSError as e:
        raise InputError(f"{FILE} cannot be written ({e.strerror}); change to another folder") from e


def _key(submission: Submission) -> str:
    return f"{submission.task.name}/{submission.name}"
