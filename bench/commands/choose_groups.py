"""``bench choose groups=yes``: groups of gestures that can be told apart, from stored predictions."""

from __future__ import annotations

from statistics import mean

import pandas as pd

from bench.commands.printing import print_lines, print_next_commands, results_console
from bench.errors import InputError
from bench.grammar.options import BATCH, STORED_OPTIONS, typed_settings
from bench.ground.typed import Values
from bench.reading.candidates import comparable_runs
from bench.reading.frame import choose_command
from bench.reading.groups import Grouping, accuracy_by_grouping, reactions_table
from bench.reading.runs import load_results_on_captures, parse_selection, warn_of_missing_runs
from bench.store.client import connect
from bench.values import few
from bench.values.measures import Measure, text_measure
from bench.values.result import MIXED_NOTE, Result
from bench.values.table import Table, rows_of_frame

KEYS = {option.key for option in (*STORED_OPTIONS, BATCH)}
LEVELS = (90, 95, 99)  # percent
ACCURACY = Measure("accuracy", "accuracy %", ends="accuracy")
COLUMNS = (
    Measure("groups", form=".0f"),
    text_measure("grouping", "gestures in one group", lambda row: _words(row["grouping"])),
    ACCURACY,
    Measure("largest", "largest group %"),
    Measure("same", "same choice", lambda row: f"{row['same']} of {row['subjects']}"),
)


def print_groups(values: Values) -> int:
    """Print accuracy against the number of groups, with a table ``[reactions]`` for 90, 95 and 99 %."""
    table, title, notes, results = find_groups(
        {key: value for key, value in values.items() if key != "groups"}
    )
    found = rows_of_frame(table.rename(columns={"low": "accuracy_low", "high": "accuracy_high"}))
    Table(
        COLUMNS, found, f"{title}; accuracy is the mean over subjects with its 95 % t-interval"
    ).print(results_console())
    print_lines(
        "The groups of each subject are chosen on the other subjects. same choice: subjects with the groups above.",
        "largest group: accuracy of always naming the largest group.",
        *(
            [f"{few.too_few_sentence(people)}."]
            if (people := int(table["subjects"].iloc[0])) < few.FEWEST_FOR_INTERVAL
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
            f"{row['groups']} groups reach {ACCURACY.as_text(row)} %."
            if row
            else "not even two groups reach it."
        )
        print_lines(f"{level} %: {how}")
    merged = {row["groups"]: row for row in reached.values() if row and row is not found[0]}
    for count, row in merged.items():
        print_lines(
            "", f"# {count} groups: {ACCURACY.as_text(row)} %", reactions_table(row["grouping"])
        )
    print_next_commands(choose_command(results))
    return 0


def find_groups(values: Values) -> tuple[pd.DataFrame, str, list[str], list[Result]]:
    """Groups for the most accurate stored system; all its seeds are used."""
    if alone := [k for k in values if k not in KEYS and "." not in k]:
        raise InputError(f"{alone[0]}= has no effect on groups; leave {alone[0]}= out")
    batch, asked = typed_settings("choose", values)["batch"], parse_selection(values)
    every = load_results_on_captures(connect())
    warn_of_missing_runs(every, asked)
    results, notes = comparable_runs(every, asked, batch=batch)
    by_system: dict[str, list[Result]] = {}
    for r in results:
        by_system.setdefault(r["system"], []).append(r)
    seeds = max(sorted(by_system.items()), key=lambda each: mean(r["accuracy"] for r in each[1]))[1]
    if seeds[-1].mixes_subjects:
        notes = [*notes, MIXED_NOTE]
    tables = [r.tables["predictions"].assign(seed=r["seed"]) for r in seeds]
    title = f"{', '.join(seeds[-1].context)}; {seeds[-1].system}"
    return accuracy_by_grouping(pd.concat(tables, ignore_index=True)), title, notes, seeds


def _words(grouping: Grouping) -> str:
    return (
        "; ".join(" + ".join(group) for group in grouping if len(group) > 1)
        or "every gesture alone"
    )
