"""Reference results, which come with touchbench, on the captures and protocol of stored runs.

They stand in a table of their own and take part in no test, correction, front, ranking or choice.
"""

from __future__ import annotations

from collections.abc import Sequence

from bench.leaderboard.submissions import Submission, reference_of
from bench.leaderboard.tasks import TASKS, Task
from bench.result import Result

REFERENCE = " (reference)"  # behind the name of such a system


def references(results: Sequence[Result]) -> dict[str, Submission]:
    """Reference results by their name in tables, if they are comparable with the results of one group."""
    answered = [task.name for task in TASKS.values() if _answers(results[0], task)]
    return {one.metadata["system"] + REFERENCE: one for name in answered for one in reference_of(name)}


def beside(results: Sequence[Result]) -> dict[str, Submission]:
    """The reference results of systems that have no complete run among the results of a group; no test has them."""
    own = {r.system for r in results if r.complete}
    return {name: one for name, one in references(results).items() if name.removesuffix(REFERENCE) not in own}


def _answers(run: Result, task: Task) -> bool:
    """Whether a run has the captures and protocol of a task, one label for each capture."""
    same = {"data": task.data, "corpus_digest": task.digest, "subset": "all", "target": "gesture"}
    same |= {"protocol": task.protocol, "synthetic": "false"}
    return task.plain and all(str(run.get(k, "")) == v for k, v in same.items())
