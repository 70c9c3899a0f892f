"""Reference results, which come with touchbench, beside the runs of a store on the same captures and protocol."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import pandas as pd

from bench.leaderboard.submissions import Submission, reference_of
from bench.leaderboard.tasks import TASKS, Task
from bench.outcomes import scores
from bench.outcomes.runs import by_subject
from bench.result import Result

REFERENCE = " (reference)"  # behind the name of such a system


class BySubject(NamedTuple):
    """The compared values of a group.

    Attributes:
        subjects: accuracy in percent [systems, subjects], best mean first.
        seeds: number of seeds of each row, unknown for a reference result.
        references: the reference results among the rows, by name.
    """

    subjects: pd.DataFrame
    seeds: pd.Series
    references: dict[str, Submission]


def references(results: Sequence[Result]) -> dict[str, Submission]:
    """Reference results by their name in tables, if they are comparable with the results of one group."""
    answered = [task.name for task in TASKS.values() if _answers(results[0], task)]
    return {one.metadata["system"] + REFERENCE: one for name in answered for one in reference_of(name)}


def accuracies(one: Submission) -> dict[str, float]:
    """Accuracy of the captures of each subject, in percent."""
    return (100 * scores.per_subject(one.table).set_index("subject")["accuracy"]).to_dict()


def systems_by_subject(results: Sequence[Result], beside: bool = True) -> BySubject:
    """Accuracies of the systems of a group by subject, with its reference results.

    Left out are runs that depend on the batch, and reference results of systems that the store has a complete run of.

    Args:
        results: results of one group.
        beside: True to include reference results.
    """
    subjects, seeds = by_subject([r for r in results if r.alone])
    if not beside or not len(subjects):
        return BySubject(subjects, seeds, {})
    others = {
        name: one for name, one in references(results).items() if name.removesuffix(REFERENCE) not in subjects.index
    }
    table = {name: accuracies(one) for name, one in others.items()}
    table = {name: each for name, each in table.items() if set(each) == set(subjects.columns)}
    both = pd.concat([subjects, pd.DataFrame(table, index=subjects.columns).T])
    order = both.mean(axis=1).sort_values(ascending=False, kind="stable").index
    return BySubject(both.loc[order], seeds.reindex(order), {name: others[name] for name in table})


def _answers(run: Result, task: Task) -> bool:
    """Whether a run has the captures and protocol of a task, one label for each capture."""
    same = {"data": task.data, "corpus_digest": task.digest, "subset": "all", "target": "gesture"}
    same |= {"protocol": task.protocol, "synthetic": "false"}
    return task.plain and all(str(run.get(k, "")) == v for k, v in same.items())
