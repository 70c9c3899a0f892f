"""The command ``bench groups``: groups of gestures that can be told apart, from stored predictions."""

from __future__ import annotations

from pathlib import Path
from statistics import mean

import pandas as pd

from bench import few
from bench.arguments import parse, settings
from bench.commands.printing import output, say, then, unwritable, writable
from bench.comparable import MIXED, facts_of
from bench.errors import InputError
from bench.measures import Measure, text
from bench.options import keys
from bench.outcomes.candidates import eligible
from bench.outcomes.groups import LEVELS, Grouping, enough, groupings, reactions
from bench.outcomes.runs import asked_of, choosing, stored, without_runs
from bench.outcomes.store import connect
from bench.progress import warn
from bench.result import Result
from bench.table import Table, rows_of, write_sheet
from bench.words import Values

ACCURACY = Measure("accuracy", "accuracy %", ends="accuracy")
COLUMNS = (
    Measure("groups", form=".0f"),
    text(
        "grouping",
        "gestures in one group",
        lambda row: _words([group for group in row["grouping"] if len(group) > 1]) or "every gesture alone",
    ),
    ACCURACY,
    Measure("largest", "largest group %"),
    Measure("same", "same choice", lambda row: f"{row['same']} of {row['subjects']}"),
)


def groups(arguments: list[str]) -> int:
    """Print accuracy against the number of groups, with a table ``[reactions]`` for 90, 95 and 99 %, and draw it.

    Raises:
        InputError: something in the arguments cannot be used, or no run is stored for them.
    """
    values = parse(arguments, keys("groups"))
    table, title, notes, results = grouped(values)
    out = writable(Path(settings("groups", values)["out"]))
    found = rows_of(table.rename(columns={"low": "accuracy_low", "high": "accuracy_high"}))
    Table(COLUMNS, found, f"{title}; accuracy is the mean over subjects with its 95 % t-interval").print(output())
    say(
        "The groups of each subject are chosen on the other subjects. same choice: subjects with the groups above.",
        "largest group: accuracy of always naming the largest group.",
        *([f"{few.too_few(people)}."] if (people := int(table["subjects"].iloc[0])) < few.INTERVAL else []),
        *notes,
    )
    reached = {level: enough(table, level) for level in LEVELS}
    for level, index in reached.items():
        how = "not even two groups reach it."
        if index is not None:
            row = found[index]
            how = f"{row['groups']} groups reach {ACCURACY.of(row)} %."
        say(f"{level} %: {how}")
    for index in dict.fromkeys(i for i in reached.values() if i):  # 0 is every gesture alone
        row = found[index]
        say("", f"# {row['groups']} groups: {ACCURACY.of(row)} %", reactions(row["grouping"]))
    from bench.reports.dendrogram import draw  # loads all plotting

    with unwritable(out):
        write_sheet(table.assign(grouping=table["grouping"].map(_words)), out / "groups.csv")
        paths = [out / "groups.csv", draw(table, out, title).path]
    say("", f"table and figure: {', '.join(map(str, paths))}")
    then(choosing(results))
    return 0


def grouped(values: Values) -> tuple[pd.DataFrame, str, list[str], list[Result]]:
    """Groups for the most accurate stored system; all its seeds are used.

    Returns:
        Table of `bench.outcomes.groups.groupings`; captures, protocol and system in words; limits in sentences;
        results of the system.

    Raises:
        InputError: something in the values cannot be used, or no run is stored for them.
    """
    if dotted := [k for k in values if "." in k and not k.startswith("protocol.")]:
        raise InputError(f"{dotted[0]}= runs a system, and bench groups reads stored runs; leave {dotted[0]}= out")
    asked = asked_of(values)
    every = stored(connect())
    for lacking in without_runs([every], asked):
        warn(f"warning: {lacking}: no run is stored")
    results, notes = eligible(every, asked, batch=settings("groups", values)["batch"])
    by_system: dict[str, list[Result]] = {}
    for r in results:
        by_system.setdefault(r["system"], []).append(r)
    seeds = max(sorted(by_system.items()), key=lambda each: mean(r["subject_accuracy_mean"] for r in each[1]))[1]
    if facts_of(seeds[-1]).mixes_subjects:
        notes = [*notes, MIXED]
    tables = [r.tables["predictions"].assign(seed=r["seed"]) for r in seeds]
    title = f"{', '.join(seeds[-1].context)}; {seeds[-1].system}"
    return groupings(pd.concat(tables, ignore_index=True)), title, notes, seeds


def _words(grouping: Grouping | list[tuple[str, ...]]) -> str:
    return "; ".join(" + ".join(group) for group in grouping)
