"""``bench leaderboard rerun=``: the command of a submission repeated, and its labels compared."""

from __future__ import annotations

import hashlib
import re
import shlex
import tempfile
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from bench.arguments import PARTS, parse
from bench.commands.demo import inside
from bench.commands.printing import led, say, then
from bench.commands.tune import OPTIONS as SEARCH
from bench.corpora.read.limits import quoted
from bench.errors import InputError
from bench.leaderboard import answers, marks, submissions
from bench.leaderboard.submissions import Submission
from bench.outcomes.runs import rows_of, tracked
from bench.outcomes.store import connect
from bench.plan.cells import cells
from bench.progress import warn
from bench.source import git_revision, versions

ALWAYS = {"data", "seed", *PARTS}
KEYS = {  # that a stored command can have; none of them says where to compute or to write
    "run": ALWAYS,
    "tune": ALWAYS | SEARCH.keys(),
    "choose": ALWAYS | {"over", "inner"},
    "stream": ALWAYS | {"hop_ms", "start"},
    "stress": ALWAYS | {"faults", "train_subjects"},
}
FOLDER = Path("submissions")


def rerun(name: str, folders: Sequence[Path]) -> int:
    """Repeat a submission in a store of its own; mark it where all labels are equal, else exit code 1.

    Args:
        name: of its folder.
        folders: that hold submissions, `FOLDER` if there are none.

    Raises:
        InputError: the submission or its command cannot be used, or its file is not here.
    """
    one = submissions.read(_place(name, folders or [FOLDER]))
    try:
        words = _command(one)
    except InputError as e:
        raise InputError(f"{one.name}: {e}") from e
    say(f"$ bench {shlex.join(words)}")
    with tempfile.TemporaryDirectory() as folder, inside(Path(folder)):
        from bench.cli import main

        with led():
            code = main(words)
        if code:
            return code
        again = _answer(one)
    total = len(one.table)
    differ = int((one.table["predicted"].to_numpy() != again.table["predicted"].to_numpy()).sum())
    equal = total - differ
    percent = int(10_000 * equal / total) / 100  # not rounded up to 100
    verb = "differs" if differ == 1 else "differ"
    say(f"{one.task.name}/{one.name}: {equal} of {total} labels are equal ({percent:.2f} %), {differ} {verb}")
    if differ:
        warn(f"{one.name} is not verified: only a rerun with equal labels is; nothing was written")
        return 1
    marks.add(
        one,
        {
            "date": datetime.now(UTC).date().isoformat(),
            "revision": git_revision() or f"touchbench {versions()['touchbench']}",
            "system": again.about["system"],
            "labels": total,
            "labels_that_differ": differ,
            "accuracy": one.scores["accuracy"],
        },
    )
    say(f"{one.name} is verified; its mark is in {marks.FILE}")
    then(shlex.join(["bench", "leaderboard", *map(str, folders or [FOLDER])]))
    return 0


def _place(name: str, folders: Sequence[Path]) -> Path:
    """The folder of a submission.

    Raises:
        InputError: there is none of this name, or several.
    """
    among = ", ".join(map(str, folders))
    if Path(name).name != name or "," in name:
        raise InputError(f"rerun={name}: give the name of one folder in {among}")
    found = [folder / name for folder in folders if (folder / name).is_dir() and not (folder / name).is_symlink()]
    if not found and any(submissions.REFERENCE.glob(f"*/{name}/*.json")):
        raise InputError(f"rerun={name}: this is a reference result that comes with touchbench; give a submission")
    if len(found) != 1:
        raise InputError(f"rerun={name}: there is {'more than one' if found else 'no'} such folder in {among}")
    return found[0]


def _command(one: Submission) -> list[str]:
    """The command of a submission as bench takes it: on the corpus of its task, with full paths of files.

    Raises:
        InputError: it cannot be repeated.
    """
    task, typed = one.task, one.about.get("command", "")
    try:
        bench, kind, *arguments = shlex.split(typed)
    except ValueError:
        bench, kind, arguments = "", "", []
    if bench != "bench" or kind not in ((task.command, "tune", "choose") if task.command == "run" else (task.command,)):
        raise InputError(f"its command {quoted(typed)} is not a bench {task.command}; only bench can repeat it")
    values = parse(arguments, KEYS[kind]) | {"data": task.data}
    values = {key: _file(one, value) if ".py:" in value else value for key, value in values.items()}
    asked = cells({k: v for k, v in values.items() if kind == "run" or k.split(".")[0] in ("data", "protocol")})
    if len(asked) > 1:
        raise InputError(f"its command names {len(asked)} systems; one is needed")
    if str(asked[0].protocol) != task.protocol:
        raise InputError(f"its protocol {asked[0].protocol} is not that of {task.name}, {task.protocol}")
    return [kind, *(f"{key}={value}" for key, value in values.items())]


def _file(one: Submission, value: str) -> str:
    """A part in a file, with the full path of the file.

    Raises:
        InputError: it is not in the working folder, or not what the submission names by its SHA-256.
    """
    found = re.fullmatch(r"([^/\\,:]+\.py):(\w+)", value)
    if not found:
        raise InputError(f"{quoted(value)} is not a file of the working folder, such as my.py:Mine")
    path = Path(found[1])
    if not path.is_file():
        raise InputError(f"its command needs {path}, which a submission does not hold; copy it to the working folder")
    if hashlib.sha256(path.read_bytes()).hexdigest() not in one.about.get("note", ""):
        raise InputError(f"{path} here has another content than the SHA-256 in the note of the submission")
    return f"{path.absolute()}:{found[2]}"


def _answer(one: Submission) -> Submission:
    """What the only run of the working folder's store answers, as it would be submitted.

    Raises:
        InputError: the run does not answer the task, or rests on more than the submission says.
    """
    store = connect()
    stored = rows_of(tracked(store, one.task.kind))
    if len(stored) != 1:
        raise InputError(f"{one.name}: its command made {len(stored)} runs; one is needed")
    (run,) = stored
    if why := answers.differs(one.task, run):
        raise InputError(f"{one.name}: its command made a run with {why}, which is not {one.task.name}")
    if answers.rests_on(run) != {key: one.about[key] for key in ("batch", "conditions") if key in one.about}:
        raise InputError(
            f"{one.name}: batch and conditions of the submission differ from those of the run; correct them"
        )
    about = answers.about(one.task, run, one.about["who"], one.about["command"])
    return submissions.written(Path("again"), about, answers.table(store, one.task, run))
