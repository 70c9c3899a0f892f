"""Submissions as a stranger writes them."""

import json
from pathlib import Path

from bench.board import tasks

ABOUT = {"task": "haart-challenge-v1", "system": "mine", "who": "A. Name", "date": "2026-01-31"}
CHALLENGE = tasks.rows_of(tasks.TASKS["haart-challenge-v1"])


def folder_of(name="mine", table=None, **about):
    """A submission as a stranger writes it: CSV with labels, all of them right unless a table is given."""
    folder = Path("all") / name
    folder.mkdir(parents=True)
    fields = {k: v for k, v in (ABOUT | about).items() if v is not None}
    (folder / "submission.json").write_text(json.dumps(fields))
    table = CHALLENGE[["capture"]].assign(predicted=CHALLENGE["true"]) if table is None else table
    table.to_csv(folder / "predictions.csv", index=False)
    return folder
