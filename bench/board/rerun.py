"""The command of a submission, checked before it is repeated, and the answer of the run that it made."""

from __future__ import annotations

import hashlib
import re
import shlex
from collections.abc import Sequence
from pathlib import Path

from bench.arguments import check_key, parse
from bench.board import answers, submissions
from bench.board.submissions import Submission
from bench.board.tasks import RUN, Task
from bench.corpora.read.limits import quoted
from bench.errors import InputError
from bench.options import makers
from bench.outcomes.earlier import command_now
from bench.plan.cells import cells
from bench.result import Result
from bench.words import PARTS

ALWAYS = {"data", "seed", *PARTS}
SEARCHES = {"tune": {"trials", "inner", "seconds", "smallest"}}  # with their keys
FIXED = ("data", "protocol")  # parts that a search does not change


def read(name: str, folders: Sequence[Path]) -> Submission:
    """The submission of a name.

    Raises:
        InputError: it cannot be used, or no folder or several have one of this name.
    """
    among = ", ".join(map(str, folders))
    if Path(name).name != name or "," in name:
        raise InputError(f"rerun={name}: give the name of one folder in {among}")
    places = [folder / name for folder in folders if (folder / name).is_dir() and not (folder / name).is_symlink()]
    if len(places) != 1:
        raise InputError(f"rerun={name}: there is {'more than one' if places else 'no'} such folder in {among}")
    return submissions.read(places[0])


def command_of(one: Submission) -> list[str]:
    """The command of a submission as bench takes it: on the corpus of its task, with full paths of files.

    Raises:
        InputError: it cannot be repeated.
    """
    task, typed = one.task, one.metadata.get("command", "")
    try:
        bench, then, *words = shlex.split(typed)
    except ValueError:
        bench, then, words = "", "", []
    kind, arguments = command_now(then, parse(words, None))
    own = _keys(kind)
    if bench != "bench" or not _made_by(task, kind, [*arguments]):
        raise InputError(f"its command {quoted(typed)} is not a bench {task.command}; only bench can repeat it")
    for key in arguments:
        check_key(key, ALWAYS | own)
    values = arguments | {"data": task.data}
    values = {key: _with_path(one, value) if ".py:" in value else value for key, value in values.items()}
    searched = kind in SEARCHES  # whose values of parameters between commas are no systems
    systems = cells({k: v for k, v in values.items() if k not in own and (not searched or k.split(".")[0] in FIXED)})
    if len(systems) > 1:
        raise InputError(f"its command names {len(systems)} systems; one is needed")
    if str(systems[0].protocol) != task.protocol:
        raise InputError(f"its protocol {systems[0].protocol} is not that of {task.name}, {task.protocol}")
    return [kind, *(f"{key}={value}" for key, value in values.items())]


def _keys(command: str) -> set[str]:
    """Keys of a stored command besides `ALWAYS`; none of them says where to compute or to write."""
    if command not in makers():
        return SEARCHES.get(command, set())
    return {option.key for option in makers()[command].options()} - {"out"}


def _made_by(task: Task, command: str, keys: Sequence[str]) -> bool:
    """Whether a command with some keys makes runs for a task: its own, or that of its kind with its circumstance."""
    if command == task.command:
        return True
    if task.command == RUN:
        return command in SEARCHES
    return command == RUN and task.maker.view is not task.maker.kind and task.maker.view.asked(dict.fromkeys(keys))


def _with_path(one: Submission, part: str) -> str:
    """A part in a file, with the full path of the file.

    Raises:
        InputError: it is not in the working folder, or not what the submission names by its SHA-256.
    """
    match = re.fullmatch(r"([^/\\,:]+\.py):(\w+)", part)
    if not match:
        raise InputError(f"{quoted(part)} is not a file of the working folder, such as my.py:Mine")
    path = Path(match[1])
    if not path.is_file():
        raise InputError(f"its command needs {path}, which a submission does not hold; copy it to the working folder")
    if hashlib.sha256(path.read_bytes()).hexdigest() not in one.metadata.get("note", ""):
        raise InputError(f"{path} here has another content than the SHA-256 in the note of the submission")
    return f"{path.absolute()}:{match[2]}"


def answer(results: Sequence[Result], one: Submission, folder: Path) -> Submission:
    """Submission from the only result of a repeated command, for the task of another submission.

    Args:
        results: results that the command made, of all kinds.
        one: the submission.
        folder: new folder for the answer.

    Raises:
        InputError: the run does not answer the task, or rests on more than the submission says.
    """
    results = [run for run in results if one.task.held_by(run)]
    if len(results) != 1:
        raise InputError(f"{one.name}: its command made {len(results)} runs; one is needed")
    run = results[0]
    if flaw := answers.differs(one.task, run):
        raise InputError(f"{one.name}: its command made a run with {flaw}, which is not {one.task.name}")
    if answers.rests_on(run) != {key: v for key, v in one.metadata.items() if key in ("batch", "conditions")}:
        raise InputError(
            f"{one.name}: batch and conditions of the submission differ from those of the run; correct them"
        )
    metadata = answers.metadata(one.task, run, one.metadata["who"], one.metadata["command"])
    return submissions.write(folder, metadata, answers.table(one.task, run))
