"""Reference results, which come with touchbench, on the captures and protocol of stored runs.

They stand in a table of their own and take part in no test, correction, front, ranking or choice.
"""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from bench.board.submissions import Submission, reference_of
from bench.board.tasks import TASKS, Task
from bench.comparable import REFERENCE, notes_on
from bench.result import Result


class Shipped:
    """The results that come with touchbench, for those who show results."""

    @staticmethod
    def beside(results: Sequence[Result]) -> list[dict[str, object]]:
        """Rows of the reference results that are comparable with the results of one group (`bench.reports.comparison`).

        A system that has a complete run among these is left out.
        """
        own = {r.system for r in results if r.complete}
        answered = [task.name for task in TASKS.values() if _answers(results[0], task)]
        ones = {str(one.metadata["system"]): one for name in answered for one in reference_of(name)}
        return [_row(name + REFERENCE, one) for name, one in ones.items() if name not in own]

    @staticmethod
    def tables() -> tuple[pd.DataFrame, dict[str, pd.DataFrame]]:
        """A row per frozen task and system, and by ``<task>/<name>`` the labels of every capture."""
        from bench.board.page import reference, scores_of  # with all plotting

        answers = reference()
        return scores_of(answers), {f"{one.task.name}/{one.name}": one.table for one in answers}


def _answers(run: Result, task: Task) -> bool:
    """Whether a run has the captures and protocol of a task, one label for each capture."""
    same = {"data": task.data, "corpus_digest": task.digest, "subset": "all", "target": "gesture"}
    same |= {"protocol": task.protocol, "synthetic": "false"}
    return task.plain and all(str(run.get(k, "")) == v for k, v in same.items())


def _row(name: str, answer: Submission) -> dict[str, object]:
    """The row of a reference result; what only runs tell is missing."""
    texts = dict.fromkeys(("combined", "seed", "against", "published", "folds", "run_id"), "")
    sizes = {k: answer.metadata.get(k) for k in ("parameters", "flash_bytes", "ram_bytes")}
    counts = {k: answer.table[k.removesuffix("s")].nunique() for k in ("captures", "subjects")}
    names = {f"subject_{k}": f"subject_accuracy_{k}" for k in ("mean", "sd")}
    scored = {names.get(k, k): v for k, v in answer.scores.items()}
    note = " ".join(notes_on(name, answer.task.data))
    about = {"system": name, "source": "reference", "unit": "capture", "note": note}
    return about | texts | scored | sizes | counts
