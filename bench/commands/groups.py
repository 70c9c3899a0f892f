"""``bench choose groups=yes``: groups of gestures that can be told apart, from stored predictions."""

from __future__ import annotations

from statistics import mean

import pandas as pd

from bench.commands.printing import output, say, then
from bench.errors import InputError
from bench.grammar.options import BATCH, STORED, settings
from bench.ground.words import Values
from bench.reading.candidates import eligible
from bench.reading.frame import choosing
from bench.reading.groups import Grouping, groupings, reactions
from bench.reading.runs import asked_of, stored, without_runs
from bench.store.client import connect
from bench.values import few
from bench.values.measures import Measure, text
from bench.values.result import MIXED, Result
from bench.values.table import Table, rows_of

KEYS = {option.key for option in (*STORED, BATCH)}
LEVELS = (90, 95, 99)  # percent
ACCURACY = Measure("accuracy", "accuracy %", ends="accuracy")
COLUMNS = (
    Measure("groups", form=".0f"),
    text("grouping", "gestures in one group", lambda row: _words(row["grouping"])),
    ACCURACY,
    Measure("largest", "largest group %"),
    Measure("same", "same choice", lambda row: f"{row['same']} of {row['subjects']}"),
)


def printed(values: Values) -> int:
    """Print accuracy against the number of groups, with a table ``[reactions]`` for 90, 95 and 99 %."""
    table, title, notes, results = grouped(
        {key: value for key, value in values.items() if key != "groups"}
    )
    found = rows_of(table.rename(columns={"low": "accuracy_low", "high": "accuracy_high"}))
    Table(
        COLUMNS, found, f"{title}; accuracy is the mean over subjects with its 95 % t-interval"
    ).print(output())
    say(
        "The groups of each subject are chosen on the other subjects. same choice: subjects with the groups above.",
        "largest group: accuracy of always naming the largest group.",
        *(
            [f"{few.too_few(people)}."]
            if (people := int(table["subjects"].iloc[0])) < few.INTERVAL
            else []
        ),
        *notes,
    )
    reached = {
        level: next((row for row in found if round(row["accuracy"], 9) >= level), None)
        for level in LEVELS
    }
    for level, row in reached.items():
        how = (
            f"{row['groups']} groups reach {ACCURACY.of(row)} %."
            if row
            else "not even two groups reach it."
        )
        say(f"{level} %: {how}")
    merged = {row["groups"]: row for row in reached.values() if row and row is not found[0]}
    for count, row in merged.items():
        say("", f"# {count} groups: {ACCURACY.of(row)} %", reactions(row["grouping"]))
    then(choosing(results))
    return 0


def grouped(values: Values) -> tuple[pd.DataFrame, str, list[str], list[Result]]:
    """Groups for the most accurate stored system; all its seeds are used."""
    if alone := [k for k in values if k not in KEYS and "." not in k]:
        raise InputError(f"{alone[0]}= has no effect on groups; leave {alone[0]}= out")
    batch, asked = settings("choose", values)["batch"], asked_of(values)
    every = stored(connect())
    without_runs(every, asked)
    results, notes = eligible(every, asked, batch=batch)
    by_system: dict[str, list[Result]] = {}
    for r in results:
        by_system.setdefault(r["system"], []).append(r)
    seeds = max(sorted(by_system.items()), key=lambda each: mean(r["accuracy"] for r in each[1]))[1]
    if seeds[-1].mixed:
        notes = [*notes, MIXED]
    tables = [r.tables["predictions"].assign(seed=r["seed"]) for r in seeds]
    title = f"{', '.join(seeds[-1].context)}; {seeds[-1].system}"
    return groupings(pd.concat(tables, ignore_index=True)), title, notes, seeds


def _words(grouping: Grouping) -> str:
    return (
        "; ".join(" + ".join(group) for group in grouping if len(group) > 1)
        or "every gesture alone"
    )
