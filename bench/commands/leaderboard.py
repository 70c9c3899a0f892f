"""The commands ``bench submit`` and ``bench leaderboard``: results that others can check, and the page of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from bench.arguments import labelled, parse, typed
from bench.commands.printing import say, then
from bench.commands.rerun import rerun
from bench.corpora.read.limits import called
from bench.errors import InputError
from bench.leaderboard import answers, marks, submissions
from bench.leaderboard.submissions import ABOUT, Submission
from bench.leaderboard.tasks import Task, task_of
from bench.options import keys
from bench.outcomes.store import connect
from bench.plan.cells import cells
from bench.progress import warn
from bench.scratch import made_whole, new_folder, replacing
from reports.leaderboard import NOT_VERIFIED, board, note, reference
from reports.provenance import command as command_of

OPTIONS = ("task", "who", "out", "run", "batch")


def submit(arguments: list[str]) -> int:
    """Write the predictions of a stored run as a folder that answers a task.

    Raises:
        InputError: something in the arguments cannot be used, no stored run answers the task, or the folder cannot be
            written.
    """
    values = parse(arguments, keys("submit"))
    needs = {"task": "a frozen task", "who": 'whose result it is, as in who="A. Name, Lab"', "out": "a new folder"}
    for key, what in needs.items():
        if key not in values:
            raise InputError(f"bench submit needs {key}=, {what}; see bench submit --help")
    if values.get("batch", "no") not in ("yes", "no"):
        raise InputError(f"batch={values['batch']}: give yes or no")
    task = task_of(values["task"])
    out = new_folder(Path(values["out"]))
    wanted, how = _wanted(task, values)
    store = connect()
    run = answers.find(store, task, wanted, how)
    if "batch" in answers.rests_on(run) and values.get("batch") != "yes":
        raise InputError(
            f"run {run['run_id']}: the labels of this run depend on other test captures; to submit it, add batch=yes"
        )
    about = answers.about(task, run, values["who"], command_of(dict(run)))
    table = answers.table(store, task, run)
    with made_whole(out) as beside:
        found = submissions.score(submissions.written(beside, about, table))
    print(f"{out}: {about['system']}, {task.name}: {100 * found['accuracy']:.1f} % of {task.score}")
    print(f"next: bench leaderboard {out}")
    return 0


def _wanted(task: Task, values: dict[str, str]) -> tuple[dict[str, str], str]:
    """What identifies the run, and the command that makes one."""
    named = {k: v for k, v in values.items() if k not in OPTIONS}
    if "run" in values:
        if named:
            raise InputError(f"run= names the run; leave out {next(iter(named))}=")
        return {"run_id": values["run"]}, typed(task.command, {"data": task.data} | labelled("protocol", task.protocol))
    on = {"data": task.data} | labelled("protocol", task.protocol)
    asked = cells(on | named)
    if len(asked) > 1:
        raise InputError(f"these values name {len(asked)} systems; give one value of each")
    cell = asked[0]
    seed = "none" if cell.seed is None else str(cell.seed)
    return {"system": cell.system(), "seed": seed}, typed(task.command, on | named)


def leaderboard(arguments: list[str]) -> int:
    """Rescore folders of submissions and write the page; exit code 1 if one was left out.

    With ``rerun=`` repeat the command of one submission instead, see `bench.commands.rerun.rerun`.

    Raises:
        InputError: something in the arguments cannot be used, or the page cannot be written.
    """
    options = [a for a in arguments if a.startswith(("out=", "rerun="))]
    values = parse(options, keys("leaderboard"))
    folders = [Path(a) for a in arguments if a not in options]
    if "rerun" in values:
        if "out" in values:
            raise InputError(f"rerun={values['rerun']} writes no page; leave out out=")
        return rerun(values["rerun"], folders)
    known = marks.read()
    found, left_out = collected(folders)
    ours, found = [[_marked(one, known) for one in each] for each in (reference(), found)]
    out = Path(values.get("out", "leaderboard.html"))
    text = board([*ours, *found], left_out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with replacing(out) as beside:
            beside.write_text(text, encoding="utf-8")
    except OSError as e:
        raise InputError(f"out={out}: cannot be written ({e.strerror}); choose another place") from e
    for line in left_out:
        warn(f"left out: {line}")
    for submission in found:
        say(_line(submission))
    say(*dict.fromkeys(filter(None, map(note, found))))
    print(out)
    then("bench submit --help")
    return 1 if left_out else 0


def _marked(submission: Submission, known: marks.Marks) -> Submission:
    """A submission that says when it was verified."""
    verified = marks.verified(submission, known)
    return replace(submission, verified=verified) if verified else submission


def _line(submission: Submission) -> str:
    """A submission with its accuracy, and what a reader should know of it."""
    accuracy = f"{100 * submissions.score(submission)['accuracy']:.1f} % of {submission.task.score}"
    verified = f"verified {submission.verified}" if submission.verified else NOT_VERIFIED
    about = f"{submission.task.name}: {submission.about['system']} by {submission.about['who']}"
    return ", ".join(filter(None, [about, accuracy, verified, submission.remarks]))


def collected(given: list[Path]) -> tuple[list[Submission], list[str]]:
    """The submissions that folders are or hold, and a line for each that cannot be used.

    Raises:
        InputError: a folder is not there.
    """
    places: dict[Path, Path] = {}
    for folder in given:
        if not folder.is_dir():
            raise InputError(f"{folder}: there is no such folder; give submissions, or folders that hold some")
        own = (p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))
        inside = [folder] if (folder / ABOUT).exists() else sorted(own)
        if not inside:
            warn(f"{folder}: no submission is in it")
        places |= {place.resolve(): place for place in inside}
    found, left_out = [], []
    for place in places.values():
        try:
            if place.is_symlink() and place not in given:  # it may lead anywhere
                raise InputError(f"{called(place)}: is a link, not a folder")
            found.append(submissions.read(place))
        except InputError as e:
            left_out.append(str(e))
    return found, left_out
