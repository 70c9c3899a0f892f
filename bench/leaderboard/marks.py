"""Marks of submissions that a maintainer ran again with equal labels.

They lie in one file of the working folder, beside the folders of submissions: no submission can bring its own. A mark
holds for the content that was compared.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.errors import InputError
from bench.leaderboard.submissions import Submission
from bench.scratch import replacing

FILE = "leaderboard-verified.json"
TEXTS = ("sha256", "date", "revision", "system")
Marks = dict[str, dict[str, Any]]  # by task and name of the submission


def read() -> Marks:
    """The marks of the working folder; none where there is no file.

    Raises:
        InputError: the file cannot be used.
    """
    path = Path(FILE)
    if not path.exists():
        return {}
    try:
        marks = json.loads(path.read_text(encoding="utf-8"))
        texts = [mark[key] for mark in marks.values() for key in TEXTS]
    except (OSError, ValueError, RecursionError, AttributeError, KeyError, TypeError) as e:
        raise InputError(f"{FILE} does not hold marks of submissions; restore or remove it") from e
    if not all(isinstance(text, str) and text.isprintable() for text in texts):
        raise InputError(f"{FILE} holds a mark that is not text; restore or remove it")
    return marks


def verified(submission: Submission, marks: Mapping[str, dict[str, Any]]) -> str:
    """When and at which revision the labels of a submission were repeated; empty if they were not, or have changed."""
    mark = marks.get(_key(submission))
    if mark is None or mark["sha256"] != submission.sha256:
        return ""
    return f"{mark['date']} at {mark['revision']}, ran {mark['system']}"


def add(submission: Submission, mark: dict[str, Any]) -> None:
    """Write the mark of a submission, in place of an earlier one.

    Args:
        submission: whose labels were repeated.
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
