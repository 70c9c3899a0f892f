"""The commands ``bench submit`` and ``bench leaderboard``: results that others can check, and the page of them."""

from __future__ import annotations

import shlex
import tempfile
from datetime import UTC, datetime
from pathlib import Path

from bench.arguments import parse, settings
from bench.board import answers, marks, rerun, submissions
from bench.board.page import NOT_VERIFIED, board, note, over_corpora, reference
from bench.board.submissions import Submission
from bench.board.tasks import Task, task_of
from bench.commands.demo import inside
from bench.commands.printing import led, output, say, then, unwritable
from bench.corpora.read.limits import called
from bench.errors import InputError
from bench.options import keys
from bench.outcomes.runs import every_result
from bench.outcomes.store import connect
from bench.plan.cells import cells
from bench.progress import warn
from bench.reports.provenance import command as command_of
from bench.scratch import made_whole, new_folder, replacing
from bench.source import git_revision, versions
from bench.words import labelled, typed

NEEDED = {"task": "a frozen task", "who": 'the author of the result, such as who="A. Name, Lab"', "out": "a new folder"}
FOLDER = Path("submissions")


def submit(arguments: list[str]) -> int:
    """Write the predictions of a stored run as a folder that answers a task.

    Raises:
        InputError: something in the arguments cannot be used, no stored run answers the task, or the folder cannot be
            written.
    """
    values = parse(arguments, keys("submit"))
    for key, what in NEEDED.items():
        if key not in values:
            raise InputError(f"bench submit needs {key}=, {what}; see bench submit --help")
    task, out, batch = task_of(values["task"]), new_folder(Path(values["out"])), settings("submit", values)["batch"]
    wanted, how = _wanted(task, {k: v for k, v in values.items() if k not in (*NEEDED, "batch")})
    run, table = answers.find(every_result(connect()), task, wanted, how)
    if "batch" in answers.rests_on(run) and not batch:
        raise InputError(f"run {run['run_id']}: its labels depend on other test captures; to submit it, add batch=yes")
    metadata = answers.metadata(task, run, values["who"], command_of(run))
    with made_whole(out) as beside:
        accuracy = submissions.write(beside, metadata, table).scores["accuracy"]
    print(f"{out}: {metadata['system']}, {task.name}: {100 * accuracy:.1f} % of {task.score}")
    print(f"next: bench leaderboard {out}")
    return 0


def _wanted(task: Task, values: dict[str, str]) -> tuple[dict[str, str], str]:
    """Tags that identify the run, and the command that makes one."""
    fixed = {"data": task.data} | labelled("protocol", task.protocol)
    if run_id := values.pop("run", None):
        if values:
            raise InputError(f"run= names the run; leave out {next(iter(values))}=")
        return {"run_id": run_id}, typed(task.command, fixed)
    systems = cells(fixed | values)
    if len(systems) > 1:
        raise InputError(f"these values describe {len(systems)} systems; give one value of each key")
    seed = "none" if systems[0].seed is None else str(systems[0].seed)
    return {"system": systems[0].system(), "seed": seed}, typed(task.command, fixed | values)


def leaderboard(arguments: list[str]) -> int:
    """Rescore folders of submissions and write the page; exit code 1 if one was left out.

    With ``rerun=`` repeat the command of one submission instead.

    Raises:
        InputError: something in the arguments cannot be used, or the page cannot be written.
    """
    options = [a for a in arguments if a.startswith(("out=", "rerun="))]
    values = parse(options, keys("leaderboard"))
    folders = [Path(a) for a in arguments if a not in options]
    if "rerun" in values:
        if "out" in values:
            raise InputError(f"rerun={values['rerun']} writes no page; leave out out=")
        return _rerun(values["rerun"], folders or [FOLDER])
    others, left_out = collected(folders)
    ours = reference()
    entries = marks.marked([*ours, *others])
    out = Path(settings("leaderboard", values)["out"])
    text = board(entries, left_out)
    with unwritable(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        with replacing(out) as beside:
            beside.write_text(text, encoding="utf-8")
    for line in left_out:
        warn(f"left out: {line}")
    others = entries[len(ours) :]
    say(*map(_line, others), *dict.fromkeys(filter(None, map(note, others))))
    if over := over_corpora(entries):
        over.table.print(output())
        say(*over.sentences)
    print(out)
    then("bench submit --help")
    return 1 if left_out else 0


def _line(one: Submission) -> str:
    """A submission with its accuracy, and what a reader should know of it."""
    accuracy = f"{100 * one.scores['accuracy']:.1f} % of {one.task.score}"
    verified = f"verified {one.verified}" if one.verified else NOT_VERIFIED
    system = f"{one.task.name}: {one.metadata['system']} by {one.metadata['who']}"
    return ", ".join(filter(None, [system, accuracy, verified, one.remarks]))


def collected(folders: list[Path]) -> tuple[list[Submission], list[str]]:
    """The submissions that folders are or hold, and a line for each that cannot be used.

    Raises:
        InputError: a folder is not there.
    """
    places: dict[Path, Path] = {}
    for folder in folders:
        if not folder.is_dir():
            raise InputError(f"{folder}: there is no such folder; give a submission or a folder of submissions")
        parts = sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))
        parts = [folder] if (folder / submissions.METADATA).exists() else parts
        if not parts:
            warn(f"{folder}: contains no submission")
        places |= {place.resolve(): place for place in parts}
    entries, left_out = [], []
    for place in places.values():
        try:
            if place.is_symlink() and place not in folders:  # it may lead anywhere
                raise InputError(f"{called(place)}: is a link, not a folder; copy the folder")
            entries.append(submissions.read(place))
        except InputError as e:
            left_out.append(str(e))
    return entries, left_out


def _rerun(name: str, folders: list[Path]) -> int:
    """Repeat a submission in a store of its own; mark it where all labels are equal, else exit code 1.

    Raises:
        InputError: the submission or its command cannot be used, or its file is not here.
    """
    one = rerun.read(name, folders)
    try:
        words = rerun.command_of(one)
    except InputError as e:
        raise InputError(f"{one.name}: {e}") from e
    say(f"$ bench {shlex.join(words)}")
    with tempfile.TemporaryDirectory() as folder, inside(Path(folder)):
        from bench.cli import main

        with led():
            code = main(words)
        if code:
            return code
        again = rerun.answer(every_result(connect()), one, Path("again"))
    total = max(len(one.answers), len(again.answers))  # not equal where events were reported
    equal = len(one.answers.merge(again.answers))
    percent = int(10_000 * equal / total) / 100  # not rounded up to 100
    what = "events" if one.task.watched else "labels"
    say(f"{one.task.name}/{one.name}: {equal} of {total} {what} are equal ({percent:.2f} %), {total - equal} differ")
    if equal < total:
        warn(f"{one.name} is not verified, because labels differ; nothing was written")
        return 1
    mark = {
        "date": datetime.now(UTC).date().isoformat(),
        "revision": git_revision() or f"touchbench {versions()['touchbench']}",
        "system": again.metadata["system"],
        "labels": total,
        "labels_that_differ": 0,
        "accuracy": one.scores["accuracy"],
    }
    marks.add(one, mark)
    say(f"{one.name} is verified; {marks.FILE} records it")
    then(shlex.join(["bench", "leaderboard", *map(str, folders)]))
    return 0
